#include "app/studies/constant_rate/constant_rate_study.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <utility>

#include "app/studies/robustness/scenario.h"
#include "app/studies/trials/measured_run.h"
#include "app/studies/trials/parallel_trials.h"
#include "protocol/estimators/checks/comparison.h"
#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/joint/joint_result.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "sim/sim_bench.h"

namespace abcal {
namespace {

constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;
constexpr double kLowPassHz = 5.0;
/// Size of each of twelve coefficients: the rate then ripples by 1e-3 (rms).
constexpr double kRipple = 4e-4;

/// Groups of outputs, in the order of Group.
enum Group { kS, kO, kPhi, kFrame, kAmplitude, kPhase, kAbcS, kAbcO, kAbcPhi, kGroups };
struct GroupWords {
  const char* name;
  const char* unit;
};
constexpr std::array<GroupWords, kGroups> kGroupWords{{{"s", "1"},
                                                       {"O", "1"},
                                                       {"phi", "degree"},
                                                       {"s_vz, s_wy", "1"},
                                                       {"amplitude", "1"},
                                                       {"phase", "degree"},
                                                       {"s by ABC", "1"},
                                                       {"O by ABC", "1"},
                                                       {"phi by ABC", "degree"}}};

struct Design {
  const char* words;
  std::vector<double> rates;
  double reading_hz;
  double encoder_jitter_s;
  double speed_deg_per_s;
  double acceleration_deg_per_s2;
  double span_s;  ///< Time of the run, over which the item drifts.
  std::array<double, kGroups> limits;
};
const std::array<Design, 2>& designs() {
  static const std::array<Design, 2> kDesigns{
      Design{"60 up, 20 down (degree/s), 200 degree/s2, 100 Hz, encoder polled (jitter 1 ms)",
             {60.0, 20.0},
             kReadingHzAt60And20,
             1e-3,
             60.0,
             200.0,
             87.0,
             {1.0e-5, 4e-5, 5e-4, 1e-4, 0.0, 0.0, 0.0, 0.0, 0.0}},
      Design{"180 up, 180 down, 20 up (degree/s), 300 degree/s2, 200 Hz, encoder recorded (jitter 0.05 ms)",
             {180.0, 180.0, 20.0},
             200.0,
             5e-5,
             180.0,
             300.0,
             90.0,
             {1.1e-5, 0.0, 0.0, 0.0, 1e-4, 0.01, 0.0, 0.0, 0.0}}};
  return kDesigns;
}

struct Trial {
  bool solved = false;
  double time_s = 0.0;
  std::array<ErrorsAndU, kGroups> groups;
  std::optional<bool> agrees_with_steps;
};

struct DrawnBench {
  sim::BenchTruth truth;
  ProtocolConfig protocol;
  EffectSizes sizes;
};

const Scenario& every_effect() {
  return *std::ranges::find(robustness_scenarios(), "everything", &Scenario::name);
}

void set_motion(const Design& design, sim::BenchTruth& truth, EffectSizes& sizes, ProtocolConfig& protocol,
                ScenarioDraw& further) {
  sizes = with_effects_of_motion(sizes);
  truth.noise = 1e-4;
  truth.span_s = design.span_s;
  truth.low_pass_hz = kLowPassHz;
  truth.group_delay_s = 0.02;
  truth.time_stamp_jitter_s = 0.001;
  truth.encoder_latency_s = 0.005;
  truth.encoder_jitter_s = design.encoder_jitter_s;
  truth.rate_offset = further.normals(sizes.rate_offset);
  truth.position_u_mm = further.normals(sizes.position_mm);
  truth.position_v_mm = further.normals(sizes.position_mm);
  truth.position_w_mm = further.normals(sizes.position_mm);
  truth.axes_distance_mm = sizes.axes_distance_mm * further.normal();
  for (sim::AxisTruth* axis : {&truth.x, &truth.z}) {
    axis->rate_ripple = kRipple;
    axis->speed_deg_per_s = design.speed_deg_per_s;
    axis->acceleration_deg_per_s2 = design.acceleration_deg_per_s2;
    axis->travel_min = Angle::degrees(-720.0);
    axis->travel_max = Angle::degrees(720.0);
  }
  protocol.motion = kMotionNames[1];
  protocol.rate_deg_per_s = design.rates;
  protocol.sweeps = static_cast<int>(design.rates.size());
  protocol.acceleration_deg_per_s2 = design.acceleration_deg_per_s2;
  protocol.steps = 36;
  protocol.step = Angle::degrees(10.0);
  protocol.check_poses = false;
  protocol.settle_auto = true;
  protocol.dwell_readings = 100;
}

DrawnBench draw(const Design& design, std::uint64_t seed, std::uint64_t bench) {
  const ScenarioBench drawn = draw_bench(every_effect(), seed, bench);
  ScenarioDraw further(seed, 0xC0A5, bench);
  DrawnBench out{.truth = drawn.truth, .protocol = {}, .sizes = drawn.stated};
  set_motion(design, out.truth, out.sizes, out.protocol, further);
  return out;
}

/// The item of `swept` on another bench, in steps: 72 angles of 5 degrees in each circle, an hour.
DrawnBench in_steps(const DrawnBench& swept, std::uint64_t seed, std::uint64_t bench) {
  constexpr std::uint64_t kOtherBenches = 500'000'000U;
  const ScenarioBench drawn = draw_bench(every_effect(), seed, kOtherBenches + bench);
  DrawnBench out;
  out.truth = drawn.truth;
  sim::OutputTruth& item = out.truth;
  item = swept.truth;
  item.drift_1 = drawn.truth.drift_1;
  item.drift_2 = drawn.truth.drift_2;
  item.drift_3 = drawn.truth.drift_3;
  item.sensitivity_drift = drawn.truth.sensitivity_drift;
  out.sizes = drawn.stated;
  out.protocol.check_poses = false;
  out.protocol.settle_auto = true;
  out.protocol.dwell_readings = 1000;
  return out;
}

RunRecord measured(const DrawnBench& bench, double reading_hz, std::uint64_t number, double& time_s) {
  const StudyItem item{.truth = bench.truth, .sizes = bench.sizes, .reading_hz = reading_hz};
  StudyBench study{bench.truth, bench.protocol, {item}};
  MeasuredRecords run = measure_bench(study, number);
  time_s = run.time_s;
  return std::move(run.items.front());
}

void add_response(const MotionResult& motion, Trial& out) {
  for (const RateResponse& response : motion.responses) {
    const double relative = response.frequency_hz / kLowPassHz;
    for (const Quantity& amplitude : response.amplitude)
      out.groups[kAmplitude].emplace_back(amplitude.value - 1.0 / std::sqrt(1.0 + relative * relative),
                                          amplitude.standard_uncertainty);
    out.groups[kPhase].emplace_back(
        response.phase.value - (relative - std::atan(relative)) * kDegreesPerRadian,
        response.phase.standard_uncertainty);
  }
}

/// Whether the nine intrinsic quantities of two results agree: chi2 of their differences below its 95 %
/// point. Absent without two results.
std::optional<bool> agree(const CalibrationResult& a, const CalibrationResult& b) {
  if (!a.covariance_intrinsic || !b.covariance_intrinsic) return std::nullopt;
  const IntrinsicComparison both = compare_intrinsic(intrinsic_values(a), *a.covariance_intrinsic,
                                                     intrinsic_values(b), *b.covariance_intrinsic);
  constexpr double kOutside = 0.05;
  if (!both.chi2_probability) return std::nullopt;
  return *both.chi2_probability >= kOutside;
}

Trial run_trial(const Design& design, std::uint64_t seed, std::uint64_t bench, bool with_steps) {
  const DrawnBench drawn = draw(design, seed, bench);
  Trial out;
  const RunRecord record = measured(drawn, design.reading_hz, bench, out.time_s);
  const CalibrationResult result = joint_result(record, fit_item(record, {}));
  if (!result.sensitivity_matrix || !result.joint || !result.joint->motion) return out;
  out.solved = true;
  const CalibrationResult abc = analyse_abc(record);

  sim::BenchTruth still = drawn.truth;
  still.drift_1 = still.drift_2 = still.drift_3 = still.sensitivity_drift = Eigen::Vector3d::Zero();
  const sim::SimBench world(still);
  const sim::TrueLineResponse truth = world.true_line_response(world.start());
  const IntrinsicProperties intrinsic = intrinsic_properties(truth.sensitivity_matrix);
  for (std::size_t j = 0; j < 3; ++j) {
    const auto at = static_cast<Eigen::Index>(j);
    const auto add = [&](Group group, const Quantity& found, double true_value) {
      out.groups.at(group).emplace_back(found.value - true_value, found.standard_uncertainty);
    };
    add(kS, result.intrinsic_sensitivity[j], intrinsic.sensitivity(at));
    add(kPhi, result.intrinsic_angle[j], intrinsic.angle_deg(at));
    add(kO, result.offset[j], truth.offset(at));
    if (!abc.sensitivity_matrix) continue;
    add(kAbcS, abc.intrinsic_sensitivity[j], intrinsic.sensitivity(at));
    add(kAbcPhi, abc.intrinsic_angle[j], intrinsic.angle_deg(at));
    add(kAbcO, abc.offset[j], truth.offset(at));
  }
  const auto& s = *result.sensitivity_matrix;
  for (const auto& [j, k] : {std::pair<std::size_t, std::size_t>{1, 2}, {2, 1}})
    out.groups[kFrame].emplace_back(
        s[j][k].value - truth.sensitivity_matrix(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(k)),
        s[j][k].standard_uncertainty);
  add_response(*result.joint->motion, out);
  if (with_steps) {
    double unused_s = 0.0;
    const RunRecord stepped =
        measured(in_steps(drawn, seed, bench), design.reading_hz, 500'000'000U + bench, unused_s);
    out.agrees_with_steps = agree(result, joint_result(stepped, fit_item(stepped, {})));
  }
  return out;
}

ConstantRateOutcome summed(const Design& design, const std::vector<Trial>& trials, std::uint64_t seed) {
  ConstantRateOutcome out;
  out.words = design.words;
  out.benches = static_cast<int>(trials.size());
  for (const Trial& trial : trials) {
    out.failed += trial.solved ? 0 : 1;
    out.longest_s = std::max(out.longest_s, trial.time_s);
    if (!trial.agrees_with_steps) continue;
    ++out.pairs;
    out.agreeing += *trial.agrees_with_steps ? 1 : 0;
  }
  for (std::size_t g = 0; g < kGroups; ++g) {
    std::vector<ErrorsAndU> of_group;
    for (const Trial& trial : trials) of_group.push_back(trial.groups.at(g));
    out.groups.push_back({kGroupWords.at(g).name, kGroupWords.at(g).unit,
                          error_group(of_group, design.limits.at(g), seed + g)});
  }
  return out;
}

}  // namespace

void turn_at_60_and_20(sim::BenchTruth& truth, EffectSizes& sizes, ProtocolConfig& protocol,
                       ScenarioDraw& further) {
  set_motion(designs().front(), truth, sizes, protocol, further);
}

ConstantRateStudy run_constant_rate_study(const ConstantRateOptions& options) {
  if (options.benches < 1)
    throw std::invalid_argument("study of constant rates: at least 1 bench is required");
  if (options.pairs < 0 || options.pairs > options.benches)
    throw std::invalid_argument("study of constant rates: as many pairs as benches at most are possible");
  if (options.threads < 1)
    throw std::invalid_argument("study of constant rates: at least 1 thread is required");
  const auto count = static_cast<std::size_t>(options.benches);
  std::vector<Trial> trials(count * designs().size());
  const std::size_t done = each_in_parallel(
      trials.size(), {options.threads, options.stop, options.progress, 4}, [&](std::size_t i) {
        trials[i] = run_trial(designs().at(i / count), options.seed, i % count + (i / count) * 1'000'000U,
                              i < static_cast<std::size_t>(options.pairs));
      });
  ConstantRateStudy study;
  study.benches = options.benches;
  study.seed = options.seed;
  study.interrupted = done < trials.size();
  for (std::size_t d = 0; d < designs().size(); ++d) {
    const std::size_t from = d * count, to = std::min(done, from + count);
    if (to <= from) break;
    study.outcomes.push_back(summed(designs().at(d),
                                    {trials.begin() + static_cast<std::ptrdiff_t>(from),
                                     trials.begin() + static_cast<std::ptrdiff_t>(to)},
                                    options.seed));
  }
  return study;
}

std::string constant_rate_text(const ConstantRateStudy& study) {
  std::string text = fmt::format(
      "Constant rate: {} simulated benches of each design, seed {}. Noise of a reading 1e-4.\nu: rms of the "
      "stated standard uncertainty (figure of the design); z: rms of error / u; 95 %: coverage.\n\n",
      study.benches, study.seed);
  for (const ConstantRateOutcome& outcome : study.outcomes) {
    text += fmt::format("{}; at most {:.1f} s{}\n", outcome.words, outcome.longest_s,
                        outcome.failed > 0 ? fmt::format("; {} without a solution", outcome.failed) : "");
    for (const auto& [name, unit, group] : outcome.groups) {
      const std::string limit = group.limit > 0.0 ? fmt::format("({:.1e})", group.limit) : "";
      text += fmt::format("  {:<10} u {:.2e} {:<10} z {:.3f} ({:.3f})  95 % {:.3f}  largest z {:.1f}\n", name,
                          group.rms_u, limit, group.rms_z, group.probability, group.coverage, group.most_z);
    }
    if (outcome.pairs > 0) {
      text += fmt::format(
          "  with runs in steps of the same items on other benches: chi2 of the nine intrinsic quantities "
          "below\n  its 95 % point in {} of {} pairs ({:.0f} expected)\n",
          outcome.agreeing, outcome.pairs, 0.95 * outcome.pairs);
    }
  }
  if (study.interrupted) text += "\ninterrupted: the benches above are complete\n";
  return text;
}

nlohmann::ordered_json constant_rate_json(const ConstantRateStudy& study) {
  nlohmann::ordered_json json{{"schema", "abcal.constant-rate/1"},
                              {"benches", study.benches},
                              {"seed", study.seed},
                              {"interrupted", study.interrupted},
                              {"designs", nlohmann::ordered_json::array()}};
  for (const ConstantRateOutcome& outcome : study.outcomes) {
    nlohmann::ordered_json one{{"design", outcome.words},
                               {"failed", outcome.failed},
                               {"longest_s", outcome.longest_s},
                               {"pairs_with_steps", outcome.pairs},
                               {"pairs_that_agree", outcome.agreeing},
                               {"groups", nlohmann::ordered_json::array()}};
    for (const auto& [name, unit, group] : outcome.groups)
      one["groups"].push_back(error_group_json(name, unit, group));
    json["designs"].push_back(std::move(one));
  }
  return json;
}

}  // namespace abcal
