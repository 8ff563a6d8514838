#include "app/studies/calibration/calibration_study.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <limits>
#include <set>
#include <stdexcept>
#include <utility>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/stated_truth.h"
#include "app/results/analysis/analyses.h"
#include "app/studies/calibration/second_model.h"
#include "app/studies/trials/measured_run.h"
#include "app/studies/trials/parallel_trials.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/effect_sizes.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

constexpr std::size_t kOutputs = 18;  // s row by row, O, intrinsic s, phi
constexpr double kHolm = 0.05;
constexpr int kResamples = 2000;
/// Fewest benches whose resampled means can show that intervals are too wide.
constexpr int kEnoughToResample = 100;
constexpr double kReadingHz = 100.0;

/// Sensitivity matrices and offsets of the items, from bench to bench in turn.
struct ItemDesign {
  Eigen::Matrix3d s;
  Eigen::Vector3d offset;
};
const std::array<ItemDesign, 4>& item_designs() {
  static const std::array<ItemDesign, 4> kDesigns = [] {
    Eigen::Matrix3d near, tilted;
    near << 1.0021, -0.0047, 0.0037, 0.0069, 0.9982, 0.0086, -0.0117, 0.0064, 1.0009;
    tilted << 0.95, 0.3, -0.1, -0.25, 1.05, 0.2, 0.1, -0.3, 0.9;
    const Eigen::Vector3d offset(0.0054, -0.0183, 0.0226);
    return std::array<ItemDesign, 4>{ItemDesign{near, offset},
                                     {tilted, 3.0 * offset},
                                     {4096.0 * near, 4096.0 * offset},     // counts
                                     {9.80665 * near, 9.80665 * offset}};  // m/s2
  }();
  return kDesigns;
}

EffectSizes sizes_of(const CalibrationKind& kind) {
  EffectSizes sizes;
  if (kind.fixed_size) {
    sizes = without_further_effects(sizes);
    sizes.k2 = sizes.k3 = 0.0;
  }
  if (kind.quiet_item) {
    sizes.drift = sizes.sensitivity_drift = 1e-5;
    sizes.hysteresis = 1e-6;
  }
  return kind.at_a_rate ? with_effects_of_motion(sizes) : sizes;
}

ProtocolConfig protocol_of(const CalibrationKind& kind) {
  ProtocolConfig protocol;
  protocol.steps = kind.steps;
  protocol.step = Angle::degrees(360.0 / kind.steps);
  protocol.faces = kind.faces;
  protocol.settle_auto = true;
  protocol.dwell_readings = kind.readings;
  if (!kind.at_a_rate) return protocol;
  protocol.motion = kMotionNames[1];
  protocol.rate_deg_per_s = {60.0, 20.0};
  protocol.sweeps = 2;
  protocol.acceleration_deg_per_s2 = 200.0;
  protocol.check_poses = false;
  return protocol;
}

/// A bench as it is before anything is drawn.
StudyBench plain_bench(const CalibrationKind& kind, std::uint64_t seed, std::size_t number) {
  StudyBench bench;
  bench.protocol = protocol_of(kind);
  bench.stage.seed = seed;
  bench.stage.stands_in_second_face = kind.faces == 2;
  for (int k = 0; k < kind.items; ++k) {
    const std::size_t which =
        kind.fixed_size ? 0 : (number / 4 + static_cast<std::size_t>(k)) % item_designs().size();
    const ItemDesign& design = item_designs().at(which);
    StudyItem& item = bench.items.emplace_back();
    item.sizes = sizes_of(kind);
    item.reading_hz = kReadingHz;
    const double scale = design.s.rowwise().norm().mean();
    item.truth.sensitivity_matrix = design.s;
    item.truth.offset = design.offset;
    item.truth.noise = kind.noise * scale;
    // The run compares the norm of the readings with gravity where the outputs are about square.
    constexpr std::size_t kTilted = 1;
    if (which != kTilted) item.expected.nominal_sensitivity = scale;
    if (!kind.at_a_rate && (kind.play || number % 2 == 1))
      item.truth.hysteresis_width = 10.0 * item.sizes.hysteresis * scale;
    if (!kind.at_a_rate) continue;
    item.truth.low_pass_hz = 5.0;
    item.truth.group_delay_s = 0.02;
    item.truth.time_stamp_jitter_s = 0.001;
  }
  for (sim::AxisTruth* axis : {&bench.stage.x, &bench.stage.z}) {
    axis->travel_min = Angle::degrees(-720.0);
    axis->travel_max = Angle::degrees(720.0);
    if (!kind.at_a_rate) continue;
    axis->rate_ripple = 4e-4;
    axis->speed_deg_per_s = 60.0;
    axis->acceleration_deg_per_s2 = 200.0;
  }
  if (kind.at_a_rate) {
    bench.stage.encoder_latency_s = 0.005;
    bench.stage.encoder_jitter_s = 1e-3;
  }
  return bench;
}

/// A bench of a bench file, drawn. Its instruments are at their driver interfaces.
StudyBench bench_of_file(const CalibrationKind& kind, std::uint64_t seed) {
  // A seed in a file is not negative.
  const BenchConfig config = parse_drawn_bench(kind.bench_file, kind.name, seed >> 1U);
  if (!config.temperature.set_points_degc.empty())
    throw std::invalid_argument(
        fmt::format("study of calibrations: {} is a series over temperature; required: one run", kind.name));
  StudyBench bench;
  bench.protocol = config.protocol;
  bench.stage = config.simulation;
  bench.stage.x.speed_deg_per_s = config.stage.x.speed_deg_per_s.value_or(bench.stage.x.speed_deg_per_s);
  bench.stage.z.speed_deg_per_s = config.stage.z.speed_deg_per_s.value_or(bench.stage.z.speed_deg_per_s);
  for (int k = 1; k <= static_cast<int>(config.items.size()); ++k) {
    const BenchItemConfig& item = config.item(k);
    bench.items.push_back({truth_on_platter(config, k, item.simulation), item.tolerances, item.expected,
                           item.limits, item.accelerometer.settings.rate_hz});
  }
  return bench;
}

/// One of the 18 outputs of one item of a bench.
struct Score {
  double z = 0.0;
  double rank = 0.0;  ///< Probability below the truth.
  double u = 0.0;     ///< Relative; phi: degrees.
};

struct ItemScores {
  bool usable = false;
  std::array<std::optional<Score>, kOutputs> outputs;
};

struct BenchOutcome {
  std::vector<ItemScores> items;
  bool no_result = false, doubtful = false;
  std::set<std::string> reasons;
};

/// The part of a verdict in words that is the same in other runs.
std::string reason_without_numbers(const std::string& why) {
  constexpr std::size_t kLongest = 70;
  std::string out;
  for (const char c : why) {
    if (c == ';' || out.size() >= kLongest) break;
    const bool digit = std::isdigit(static_cast<unsigned char>(c)) != 0;
    if (digit && !out.empty() && out.back() == '#') continue;
    out += digit ? '#' : c;
  }
  return out;
}

void add_reasons(const CalibrationResult& result, BenchOutcome& out) {
  const std::size_t before = out.reasons.size();
  for (const Check& check : result.diagnostics.checks)
    if (!check.passed) out.reasons.insert("check " + check.name);
  if (result.joint) {
    for (const EffectTest& test : result.joint->effects)
      if (!test.passed) out.reasons.insert("size of " + test.name);
  }
  if (out.reasons.size() == before) out.reasons.insert(reason_without_numbers(result.why));
}

ItemScores scores_of(const CalibrationResult& result, const sim::TrueLineResponse& truth) {
  ItemScores out;
  out.usable = result.verdict == Verdict::kUsable;
  const IntrinsicProperties intrinsic = intrinsic_properties(truth.sensitivity_matrix);
  const auto add = [&](std::size_t at, const Quantity& found, double right, double unit) {
    if (!(found.standard_uncertainty > 0.0) || !std::isfinite(found.value)) return;
    const double t = (right - found.value) / found.standard_uncertainty;
    const double above = student_t_tail(t, found.degrees_of_freedom);
    constexpr double kLeast = 1e-300;
    const double z = above < 0.5
                         ? -normal_quantile(std::max(above, kLeast))
                         : normal_quantile(std::max(student_t_tail(-t, found.degrees_of_freedom), kLeast));
    out.outputs.at(at) = Score{z, 1.0 - above, found.standard_uncertainty / unit};
  };
  for (std::size_t j = 0; j < 3; ++j) {
    const auto row = static_cast<Eigen::Index>(j);
    const double size = intrinsic.sensitivity(row);
    if (result.sensitivity_matrix) {
      for (std::size_t k = 0; k < 3; ++k)
        add(3 * j + k, (*result.sensitivity_matrix)[j][k],
            truth.sensitivity_matrix(row, static_cast<Eigen::Index>(k)), size);
    }
    add(9 + j, result.offset[j], truth.offset(row), size);
    add(12 + j, result.intrinsic_sensitivity[j], size, size);
    add(15 + j, result.intrinsic_angle[j], intrinsic.angle_deg(row), 1.0);
  }
  return out;
}

/// One effect that is drawn from another size than stated.
struct DrawnSize {
  const EffectSizeKey* key = nullptr;  ///< Null: none is.
  double size = 0.0;
};

/// One run of a study.
struct StudyRun {
  std::uint64_t seed = 0;  ///< That of the study.
  std::size_t number = 0;  ///< Number of the bench in its kind.
  double span_s = 0.0;
  std::uint64_t file = 0;  ///< Another number for each run at a time.
};

BenchOutcome measure_and_judge(const CalibrationKind& kind, const StudyRun& of, const DrawnSize& other = {}) {
  constexpr std::uint64_t kBetweenBenches = 0x9E3779B97F4A7C15;
  std::uint64_t name = 0;
  for (const char c : kind.name) name = name * 131 + static_cast<unsigned char>(c);
  const std::uint64_t own = of.seed + name * 1'000'003 + (of.number + 1) * kBetweenBenches;
  const bool of_file = !kind.bench_file.empty();
  StudyBench bench = of_file ? bench_of_file(kind, own) : plain_bench(kind, own, of.number);
  std::vector<EffectSizes> sizes;
  std::vector<sim::OutputTruth*> truths;
  for (StudyItem& item : bench.items) {
    sizes.push_back(item.sizes);
    if (other.key != nullptr) other.key->set(sizes.back(), other.size);
    truths.push_back(&item.truth);
  }
  if (!of_file)
    draw_stated_truth(
        sizes, {of.span_s, kind.at_a_rate}, [](std::size_t, std::string_view) { return false; }, bench.stage,
        truths);
  // Two benches of four come from the simulator and two from the theory, with either kind of hysteresis each.
  // Flat ranks follow from truths that are exactly as stated, which those of the theory are.
  const bool by_theory =
      !of_file && kind.faces == 1 && !kind.at_a_rate && (of.number % 4 >= 2 || kind.fixed_size);
  MeasuredRecords run = by_theory ? measure_by_theory(bench, own) : measure_bench(bench, of.file);
  for (RunRecord& record : run.items)
    for (DwellRecord& dwell : record.dwells)
      if (!kind.stated_u) dwell.u_mean.reset();
  const std::vector<const Estimator*> estimators{&find_estimator(std::string(kind.estimator))};
  const RunAnalysis analysis = analyse_items(run.items, estimators);
  BenchOutcome out;
  for (std::size_t k = 0; k < run.items.size(); ++k) {
    const CalibrationResult& result = analysis.results.at(k).front();
    if (result.verdict != Verdict::kUsable) {
      out.doubtful = true;
      add_reasons(result, out);
    }
    if (result.verdict == Verdict::kNotUsable) {
      out.no_result = true;
      continue;
    }
    out.items.push_back(scores_of(result, run.truths[k]));
  }
  return out;
}

/// A generator of its own for resampling: nothing else depends on it.
class Resampler {
 public:
  explicit Resampler(std::uint64_t seed) : state_(seed * 2 + 1) {}
  std::size_t below(std::size_t count) {
    state_ = state_ * 6364136223846793005ULL + 1442695040888963407ULL;
    return static_cast<std::size_t>((state_ >> 33U) % count);
  }

 private:
  std::uint64_t state_;
};

/// The part of one bench in the sums of a group.
struct BenchSums {
  double count = 0.0, z2 = 0.0;
  std::array<double, kTestedProbabilities.size()> inside{};
};

GroupScores group_scores(const std::vector<BenchOutcome>& benches, std::size_t group, bool usable_only) {
  GroupScores out;
  std::vector<BenchSums> sums;
  double u2 = 0.0;
  for (const BenchOutcome& bench : benches) {
    BenchSums one;
    for (const ItemScores& item : bench.items) {
      if (usable_only && !item.usable) continue;
      for (std::size_t i = 0; i < kOutputs; ++i) {
        if (group_of_output(i) != group || !item.outputs.at(i)) continue;
        const Score& score = *item.outputs.at(i);
        one.count += 1.0;
        one.z2 += score.z * score.z;
        u2 += score.u * score.u;
        for (std::size_t p = 0; p < kTestedProbabilities.size(); ++p)
          one.inside.at(p) += std::abs(score.rank - 0.5) <= 0.5 * kTestedProbabilities.at(p) ? 1.0 : 0.0;
      }
    }
    if (one.count > 0.0) sums.push_back(one);
  }
  if (sums.empty()) return out;
  const auto summed = [&](auto&& pick) {
    BenchSums total;
    for (std::size_t i = 0; i < sums.size(); ++i) {
      const BenchSums& one = sums[pick(i)];
      total.count += one.count;
      total.z2 += one.z2;
      for (std::size_t p = 0; p < total.inside.size(); ++p) total.inside.at(p) += one.inside.at(p);
    }
    return total;
  };
  const BenchSums total = summed([](std::size_t i) { return i; });
  out.count = static_cast<std::size_t>(total.count);
  out.rms_z = std::sqrt(total.z2 / total.count);
  out.rms_u = std::sqrt(u2 / total.count);
  for (std::size_t p = 0; p < out.coverage.size(); ++p) out.coverage.at(p) = total.inside.at(p) / total.count;
  std::vector<double> rms;
  double rms_squares = 0.0;
  std::array<double, kTestedProbabilities.size()> held{}, held_squares{};
  Resampler resampler(group + 1);
  for (int r = 0; r < kResamples; ++r) {
    const BenchSums drawn = summed([&](std::size_t) { return resampler.below(sums.size()); });
    rms.push_back(std::sqrt(drawn.z2 / drawn.count));
    rms_squares += std::pow(rms.back() - out.rms_z, 2) / kResamples;
    for (std::size_t p = 0; p < held.size(); ++p) {
      held.at(p) += drawn.inside.at(p) / drawn.count / kResamples;
      held_squares.at(p) += std::pow(drawn.inside.at(p) / drawn.count, 2) / kResamples;
    }
  }
  std::ranges::sort(rms);
  out.low = rms[kResamples / 40];
  out.high = rms[kResamples - 1 - kResamples / 40];
  // Tails far beyond what the resamples reach: they are normal, with the spread of the resamples.
  const auto tail = [](double distance, double sd) {
    return sd > 0.0 ? normal_tail(distance / sd) : distance > 0.0 ? 0.0 : 1.0;
  };
  out.above = tail(out.rms_z - kMostZ, std::sqrt(rms_squares));
  out.below = tail(kLeastZ - out.rms_z, std::sqrt(rms_squares));
  for (std::size_t p = 0; p < held.size(); ++p)
    out.too_small.at(p) = tail(kTestedProbabilities.at(p) - out.coverage.at(p),
                               std::sqrt(std::max(0.0, held_squares.at(p) - held.at(p) * held.at(p))));
  return out;
}

/// P(at most `k` of n) with probability p each.
double binomial_at_most(int k, int n, double p) {
  double term = n * std::log1p(-p), sum = 0.0;
  for (int i = 0; i <= k; ++i) {
    sum += std::exp(term);
    term += std::log(static_cast<double>(n - i) / (i + 1)) + std::log(p) - std::log1p(-p);
  }
  return std::min(1.0, sum);
}

/// The share that `k` or fewer of n exceed with a probability of 99 %.
double upper_share(int k, int n) {
  double low = 0.0, high = 1.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (binomial_at_most(k, n, middle) > 0.01 ? low : high) = middle;
  }
  return k >= n ? 1.0 : high;
}

KindOutcome summed(const CalibrationKind& kind, const std::vector<BenchOutcome>& benches) {
  KindOutcome out;
  out.kind = kind;
  out.benches = static_cast<int>(benches.size());
  for (const BenchOutcome& bench : benches) {
    out.no_result += bench.no_result ? 1 : 0;
    out.doubtful += bench.doubtful ? 1 : 0;
    for (const std::string& reason : bench.reasons) ++out.reasons[reason];
    for (const ItemScores& item : bench.items) {
      for (std::size_t i = 0; i < kOutputs; ++i) {
        if (!item.outputs.at(i)) continue;
        const double bin = item.outputs.at(i)->rank * static_cast<double>(kRankBins);
        ++out.ranks.at(i).at(std::min(static_cast<std::size_t>(bin), kRankBins - 1));
      }
    }
  }
  out.doubtful_limit = upper_share(out.doubtful, out.benches);
  for (std::size_t g = 0; g < kOutputGroups; ++g) {
    out.all.at(g) = group_scores(benches, g, false);
    out.usable.at(g) = group_scores(benches, g, true);
  }
  return out;
}

/// One statement that may be false, with the probability of what was found if it is true.
struct Hypothesis {
  double probability;
  KindOutcome* kind;
  std::string words;
};

/// Adds the words of those that Holm's procedure rejects.
void reject(std::vector<Hypothesis> all) {
  std::ranges::sort(all, {}, &Hypothesis::probability);
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (all[i].probability > kHolm / static_cast<double>(all.size() - i)) return;
    all[i].kind->failures.push_back(all[i].words);
  }
}

std::string_view reason_for_wide(const CalibrationKind& kind, std::string_view group) {
  for (const KnownWide& known : known_wide())
    if (known.group == group && (known.kind == kind.name || known.kind == "*")) return known.reason;
  return {};
}

void judge(CalibrationStudy& study) {
  std::vector<Hypothesis> wide, small, flat;
  for (KindOutcome& kind : study.kinds) {
    for (std::size_t g = 0; g < kOutputGroups; ++g) {
      const GroupScores& scores = kind.all.at(g);
      if (scores.count == 0) continue;
      const std::string& name = output_group_names().at(g);
      wide.push_back(
          {scores.above, &kind, fmt::format("{}: rms z {:.3f}, at most {}", name, scores.rms_z, kMostZ)});
      const std::string_view reason = reason_for_wide(kind.kind, name);
      const std::string words = fmt::format("{}: rms z {:.3f}, at least {}", name, scores.rms_z, kLeastZ);
      const bool enough = kind.benches >= kEnoughToResample;
      if (enough && scores.high < kNeverBelowZ) {
        kind.failures.push_back(
            fmt::format("{}: rms z {:.3f}, never below {}", name, scores.rms_z, kNeverBelowZ));
      } else if (reason.empty()) {
        if (enough) wide.push_back({scores.below, &kind, words});
      } else if (scores.rms_z < kLeastZ) {
        kind.remarks.push_back(fmt::format("{}: rms z {:.3f}: {}", name, scores.rms_z, reason));
      }
      for (std::size_t p = 0; p < kTestedProbabilities.size(); ++p)
        small.push_back({scores.too_small.at(p), &kind,
                         fmt::format("{}: {:.4f} of the intervals for {:.4f} hold", name,
                                     scores.coverage.at(p), kTestedProbabilities.at(p))});
    }
    constexpr int kFewestPerBin = 5;
    if (kind.kind.fixed_size && kind.benches >= kFewestPerBin * static_cast<int>(kRankBins)) {
      for (std::size_t i = 0; i < kOutputs; ++i) {
        double chi2 = 0.0, count = 0.0;
        for (const int ranked : kind.ranks.at(i)) count += ranked;
        const double expected = count / static_cast<double>(kRankBins);
        for (const int ranked : kind.ranks.at(i))
          chi2 += (ranked - expected) * (ranked - expected) / expected;
        const double probability = chi2_tail(chi2, static_cast<int>(kRankBins) - 1);
        const std::string words = fmt::format("output {}: ranks are not flat, chi2 {:.1f}", i + 1, chi2);
        const std::string_view reason = reason_for_wide(kind.kind, "ranks");
        // A reason for wide intervals does not explain truths at the ends of the ranks.
        const double at_ends = kind.ranks.at(i).front() + kind.ranks.at(i).back();
        if (reason.empty() || at_ends > 2.0 * expected) {
          flat.push_back({probability, &kind, words});
        } else if (probability < kHolm / kOutputs) {
          kind.remarks.push_back(fmt::format("{}: {}", words, reason));
        }
      }
    }
    constexpr int kEnough = 1000;
    const bool too_often = kind.benches >= kEnough
                               ? kind.doubtful_limit > kMostDoubtful
                               : binomial_at_most(kind.doubtful - 1, kind.benches, kMostDoubtful) > 0.99;
    if (too_often)
      kind.failures.push_back(
          fmt::format("{} of {} sound benches are called doubtful (99 % bound {:.3f}, at most {})",
                      kind.doubtful, kind.benches, kind.doubtful_limit, kMostDoubtful));
  }
  reject(std::move(wide));
  reject(std::move(small));
  reject(std::move(flat));
}

std::vector<CalibrationKind> chosen(const CalibrationOptions& options) {
  if (options.bench_file) {
    CalibrationKind kind;
    kind.name = options.bench_file->first;
    kind.words = "the bench file";
    kind.bench_file = options.bench_file->second;
    return {kind};
  }
  const std::vector<CalibrationKind>& all = calibration_kinds();
  if (options.kinds.empty()) return all;
  std::vector<CalibrationKind> out;
  for (const std::string& name : options.kinds) {
    const auto found = std::ranges::find(all, name, &CalibrationKind::name);
    if (found == all.end()) {
      std::string names;
      for (const CalibrationKind& kind : all) names += (names.empty() ? "" : ", ") + kind.name;
      throw std::invalid_argument(fmt::format("no kind \"{}\"; there are: {}", name, names));
    }
    out.push_back(*found);
  }
  return out;
}

void require_valid(const CalibrationOptions& options) {
  if (options.benches < 2)
    throw std::invalid_argument("study of calibrations: at least 2 benches are required");
  if (options.threads < 1)
    throw std::invalid_argument("study of calibrations: at least 1 thread is required");
}

/// Sizes from which an effect is drawn that is stated otherwise; none where the simulator does not have it.
std::vector<double> sizes_to_notice(const EffectSizeKey& key, const EffectSizes& stated) {
  if (std::ranges::any_of(effects_not_drawn(), [&](const EffectNotDrawn& one) { return one.key == key.key; }))
    return {};
  const double size = key.get(stated);
  if (size > 0.0) return {3.0 * size, 10.0 * size};
  std::vector<double> sizes{1e-6, 1e-5, 1e-4};
  if (key.unit == "degree")
    for (double& each : sizes) each = Angle::radians(each).deg();
  return sizes;
}

/// Time from the start to the last angle; the same for all benches of a kind but for the waits.
double span_of(const CalibrationKind& kind, const CalibrationOptions& options) {
  if (!kind.bench_file.empty()) return 0.0;  // That of its plan.
  constexpr std::uint64_t kNoBench = std::numeric_limits<std::uint32_t>::max();
  const StudyBench bench = plain_bench(kind, options.seed, 0);
  const MeasuredRecords run = measure_bench(bench, kNoBench);
  return run.items.front().dwells.back().time_s.value_or(run.time_s);
}

}  // namespace

std::size_t group_of_output(std::size_t output) {
  if (output < 9) return output % 4 == 0 ? 0 : 1;
  return output / 3 - 1;
}

const std::vector<CalibrationKind>& calibration_kinds() {
  static const std::vector<CalibrationKind> kKinds{
      {"72", "the shipped example: 3 x 72, 1000 readings, noise 1e-4", 72, 1000},
      {"24-1000", "3 x 24, 1000 readings, noise 1e-4", 24, 1000},
      {"12-1000", "3 x 12, 1000 readings, noise 1e-4", 12, 1000},
      {"24-noise-1e-3", "3 x 24, 100 readings, noise 1e-3", 24, 100, 1e-3},
      {"24-noise-1e-4", "3 x 24, 100 readings, noise 1e-4", 24, 100, 1e-4},
      {"24-noise-1e-5", "3 x 24, 200 readings, noise 1e-5, hysteresis by the last motion or by play", 24, 200,
       1e-5},
      {.name = "24-play",
       .words = "the same, hysteresis by play",
       .readings = 200,
       .noise = 1e-5,
       .play = true},
      {.name = "24-noise-1e-6",
       .words = "3 x 24, 200 readings, noise 1e-6; stated are drifts of 1e-5 and a hysteresis of 1e-6",
       .readings = 200,
       .noise = 1e-6,
       .quiet_item = true},
      {"24-10", "3 x 24, 10 readings, noise 1e-4", 24, 10},
      {.name = "faces", .words = "two faces 6 x 12, 100 readings", .readings = 100, .faces = 2},
      {.name = "rate",
       .words = "60 up, 20 down degree/s, 100 Hz, noise 1e-4",
       .steps = 36,
       .at_a_rate = true},
      {.name = "tray-4", .words = "tray of four items, 3 x 24, 100 readings", .readings = 100, .items = 4},
      {.name = "abc", .words = "estimator abc, 3 x 24, 100 readings", .readings = 100, .estimator = "abc"},
      {.name = "norm", .words = "estimator norm, 3 x 24, 100 readings", .readings = 100, .estimator = "norm"},
      {.name = "norm-no-u",
       .words = "estimator norm, 3 x 24, readings without u",
       .readings = 100,
       .estimator = "norm",
       .stated_u = false},
      {.name = "linear",
       .words = "3 x 24, only the effects of the published protocol: all normal, ranks flat",
       .readings = 1000,
       .fixed_size = true},
  };
  return kKinds;
}

const std::vector<KnownWide>& known_wide() {
  constexpr std::string_view kNoise =
      "the fit leaves a probability for a noise that wanders from angle to angle, which these items do not "
      "have";
  static const std::vector<KnownWide> kList{
      {"*", "s off-diagonal",
       "the simulated stage has no error at the zeros of its axes, and that of the initial turn at -90 "
       "degrees (decision 5), which is less than is stated"},
      {"12-1000", "s diagonal", kNoise},
      {"12-1000", "intrinsic s", kNoise},
      {"24-noise-1e-4", "intrinsic s", kNoise},
      {"linear", "s diagonal", kNoise},
      {"linear", "O", kNoise},
      {"linear", "intrinsic s", kNoise},
      {"linear", "ranks", kNoise},
  };
  return kList;
}

bool CalibrationStudy::passed() const {
  return std::ranges::all_of(kinds, [](const KindOutcome& kind) { return kind.failures.empty(); });
}

CalibrationStudy run_calibration_study(const CalibrationOptions& options) {
  require_valid(options);
  const std::vector<CalibrationKind> kinds = chosen(options);
  for (const CalibrationKind& kind : kinds)
    if (!kind.bench_file.empty()) bench_of_file(kind, options.seed);  // Its mistakes are reported at once.
  const auto count = static_cast<std::size_t>(options.benches);
  std::vector<double> spans(kinds.size());
  for (std::size_t k = 0; k < kinds.size(); ++k) spans[k] = span_of(kinds[k], options);
  std::vector<BenchOutcome> benches(kinds.size() * count);
  const std::size_t done = each_in_parallel(
      benches.size(), {options.threads, options.stop, options.progress, 4}, [&](std::size_t i) {
        benches[i] = measure_and_judge(kinds[i / count], {options.seed, i % count, spans[i / count], i});
      });
  CalibrationStudy study;
  study.benches = options.benches;
  study.seed = options.seed;
  study.interrupted = done < benches.size();
  for (std::size_t k = 0; k < kinds.size() && (k + 1) * count <= done; ++k)
    study.kinds.push_back(summed(kinds[k], {benches.begin() + static_cast<std::ptrdiff_t>(k * count),
                                            benches.begin() + static_cast<std::ptrdiff_t>((k + 1) * count)}));
  judge(study);
  return study;
}

PowerStudy run_power_study(const CalibrationOptions& options) {
  require_valid(options);
  if (options.bench_file)
    throw std::invalid_argument("simulate calibration: found a bench file; --power reads --kinds");
  CalibrationOptions asked = options;
  if (asked.kinds.empty()) asked.kinds = {"24-1000", "rate"};
  const std::vector<CalibrationKind> kinds = chosen(asked);
  PowerStudy study;
  std::vector<std::size_t> kind_of_row;
  std::vector<const EffectSizeKey*> key_of_row;
  for (std::size_t k = 0; k < kinds.size(); ++k) {
    const EffectSizes stated = sizes_of(kinds[k]);
    for (const EffectSizeKey& key : effect_size_keys()) {
      if ((key.in_motion > 0.0) != kinds[k].at_a_rate) continue;
      for (const double size : sizes_to_notice(key, stated)) {
        study.rows.push_back({kinds[k].name, key.key, key.get(stated), size, options.benches, 0, {}});
        kind_of_row.push_back(k);
        key_of_row.push_back(&key);
      }
    }
  }
  std::vector<double> spans;
  for (const CalibrationKind& kind : kinds) spans.push_back(span_of(kind, options));
  const auto count = static_cast<std::size_t>(options.benches);
  std::vector<BenchOutcome> benches(study.rows.size() * count);
  const std::size_t done = each_in_parallel(
      benches.size(), {options.threads, options.stop, options.progress, 4}, [&](std::size_t i) {
        const std::size_t row = i / count, kind = kind_of_row[row];
        benches[i] = measure_and_judge(kinds[kind], {options.seed, i % count, spans[kind], i},
                                       {key_of_row[row], study.rows[row].drawn});
      });
  study.benches = options.benches;
  study.seed = options.seed;
  study.interrupted = done < benches.size();
  study.rows.resize(done / count);
  for (std::size_t row = 0; row < study.rows.size(); ++row) {
    const auto begin = benches.begin() + static_cast<std::ptrdiff_t>(row * count);
    const std::vector<BenchOutcome> of_row(begin, begin + static_cast<std::ptrdiff_t>(count));
    for (const BenchOutcome& bench : of_row) study.rows[row].doubtful += bench.doubtful ? 1 : 0;
    for (std::size_t g = 0; g < kOutputGroups; ++g)
      study.rows[row].usable.at(g) = group_scores(of_row, g, true);
  }
  return study;
}

}  // namespace abcal
