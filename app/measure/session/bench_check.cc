#include "app/measure/session/bench_check.h"

#include <fmt/format.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "app/bench_file/chamber_consistency.h"
#include "app/bench_file/not_real.h"
#include "app/measure/session/run_bench.h"
#include "app/measure/session/small_turn.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/text/names.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/run/dwell.h"
#include "protocol/run/sampling_times.h"

namespace abcal {
namespace {

using Grade = Finding::Grade;

// Largest difference from the prediction, relative to the change caused by gravity: room for an
// accelerometer mounted some degrees askew, and well below the effect of a wrong sign (at least 0.5).
constexpr double kAgreement = 0.2;
// A norm of the readings this far from local gravity means another unit, range or scale.
constexpr double kNormTolerance = 0.1;
constexpr double kRateTolerance = 0.05;
constexpr double kShortestLookS = 1.0;

/// A simple difference between bench and bench file that may explain the readings.
struct Hypothesis {
  Message words;
  int sign_x = +1, sign_z = +1;
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();  ///< Output = axes * (force along x, y, z).
};

std::vector<Hypothesis> hypotheses() {
  std::vector<Hypothesis> all{
      {{}, +1, +1, Eigen::Matrix3d::Identity()},
      {Message("[stage.x] sign is wrong"), -1, +1, Eigen::Matrix3d::Identity()},
      {Message("[stage.z] sign is wrong"), +1, -1, Eigen::Matrix3d::Identity()},
      {Message("both signs, [stage.x] and [stage.z], are wrong"), -1, -1, Eigen::Matrix3d::Identity()}};
  std::array<int, 3> order{0, 1, 2};
  do {
    for (int signs = 0; signs < 8; ++signs) {
      Hypothesis h{{}, +1, +1, Eigen::Matrix3d::Zero()};
      std::array<std::string, 3> along;
      for (int j = 0; j < 3; ++j) {
        const bool reversed = ((signs >> j) & 1) != 0;
        const int axis = order[static_cast<std::size_t>(j)];
        h.axes(j, axis) = reversed ? -1.0 : 1.0;
        along[static_cast<std::size_t>(j)] = fmt::format("{}{}", reversed ? "-" : "+", "xyz"[axis]);
      }
      h.words = Message("u, v, w of the accelerometer are along {u}, {v}, {w}", along[0], along[1], along[2]);
      if (!h.axes.isIdentity()) all.push_back(std::move(h));
    }
  } while (std::next_permutation(order.begin(), order.end()));
  return all;
}

/// Relative disagreement of a hypothesis with the changes between poses, its scale fitted.
double disagreement(const std::vector<PoseReading>& poses, const Hypothesis& h) {
  const auto predicted = [&](const PoseReading& pose) -> Eigen::Vector3d {
    return h.axes * gravity_at(pose.x * h.sign_x, pose.z * h.sign_z);
  };
  const auto changes = static_cast<Eigen::Index>(3 * (poses.size() - 1));
  Eigen::VectorXd seen(changes), expected(changes);
  for (std::size_t i = 1; i < poses.size(); ++i) {
    seen.segment<3>(static_cast<Eigen::Index>(3 * (i - 1))) = poses[i].mean - poses[0].mean;
    expected.segment<3>(static_cast<Eigen::Index>(3 * (i - 1))) = predicted(poses[i]) - predicted(poses[0]);
  }
  const double scale = seen.dot(expected) / expected.squaredNorm();
  if (!(scale > 0.0)) return std::numeric_limits<double>::infinity();
  return (seen - scale * expected).norm() / (scale * expected.norm());
}

/// Readings per second (at least 2 readings): by the line of their sampling times, which a first or last
/// arrival that this computer delays does not move; by their arrivals if they do not follow a line.
double rate_of(std::span<const Reading> readings) {
  if (const auto times = fit_sampling_times(readings)) return 1.0 / to_seconds(times->period);
  return static_cast<double>(readings.size() - 1) /
         to_seconds(readings.back().arrival - readings.front().arrival);
}

std::string in_words(const Eigen::Vector3d& v, const std::string& unit) {
  return fmt::format("({:+.5g}, {:+.5g}, {:+.5g}) {}", v[0], v[1], v[2], unit);
}

/// A text that an instrument reports, e.g. its serial number.
Message reported(const std::string& text) {
  return text.empty() ? Message("not reported") : Message("{reported}", text);
}

class Checker {
 public:
  Checker(Bench& bench, const BenchConfig& config, const CheckOptions& options)
      : bench_(bench), config_(config), options_(options) {}

  std::vector<Finding> run() {
    for (const std::string& warning : config_.warnings)
      add(Grade::kWarning, Message("bench file"), Message::bare(warning));
    if (bench_.chamber) attempt(Message("chamber"), [&] { check_chamber(); });
    const bool stage = attempt(Message("stage"), [&] { check_stage(); });
    const bool accelerometer = check_accelerometers();
    if (options_.no_motion) {
      add(Grade::kLeftOut, kSignsFinding, Message("not checked: nothing was moved (--no-motion)"));
    } else if (!stage || !accelerometer || failed_) {
      add(Grade::kLeftOut, kSignsFinding,
          Message("not checked: nothing was moved because of the problems above"));
    } else {
      attempt(kSignsFinding, [&] { turn(); });
    }
    return std::move(findings_);
  }

 private:
  void add(Grade grade, const Message& what, Message found, Message advice = {}) {
    failed_ = failed_ || grade == Grade::kProblem;
    const bool of_one = item_ > 0 && config_.has_several_items();
    findings_.push_back({grade, of_one ? Message("item {item}, {what}", item_, what) : what, std::move(found),
                         std::move(advice)});
  }

  /// @return whether all accelerometers answer
  bool check_accelerometers() {
    bool all = true;
    identities_.items.clear();
    for (const BenchItem& item : bench_.items) {
      item_ = item.k;
      if (!item.is_open()) {
        add(Grade::kProblem, Message("accelerometer"), item.missing,
            Message("connect it, or measure without it"));
        all = false;
        continue;
      }
      info_ = {};
      all = check_one(*item.accelerometer, config_.item(item.k)) && all;
      identities_.items.push_back({item.k, info_, {}, {}});
    }
    item_ = 0;
    return all;
  }

  bool check_one(Accelerometer& accelerometer, const BenchItemConfig& item) {
    const AccelerometerConfig& stated = item.accelerometer;
    const bool answers =
        attempt(Message("accelerometer"), [&] { check_accelerometer(accelerometer, stated); });
    if (answers) attempt(kItemFinding, [&] { check_identity(item); });
    if (answers) attempt(Message("readings at rest"), [&] { check_at_rest(accelerometer, stated); });
    accelerometer.stop();
    return answers;
  }

  /// A failing instrument is a finding here, not an error.
  template <class Look>
  bool attempt(const Message& topic, Look look) {
    try {
      look();
      return true;
    } catch (const InstrumentError& error) {
      add(Grade::kProblem, topic, message_of(error));
    } catch (const PlanError& error) {
      add(Grade::kProblem, topic, message_of(error));
    } catch (const std::invalid_argument& error) {
      add(Grade::kProblem, topic, message_of(error));
    }
    return false;
  }

  /// Reports the chamber's own limits; sets nothing.
  void check_chamber() {
    const ChamberInfo info = bench_.chamber->identify();
    require_serial_number("chamber", info.model, info.serial_number, config_.chamber.settings.serial_number);
    const ChamberReading now = bench_.chamber->read();
    add(Grade::kGood, Message("chamber"),
        Message("{maker} {model}, set points {least:g} to {most:g} degC by its own hardware, air {air:.1f} "
                "degC, {state}",
                info.maker, info.model, info.least_set_degc, info.most_set_degc, now.air_degc,
                now.running ? Message("running") : Message("not running")));
    for (const Problem& problem : chamber_problems(config_, info))
      add(Grade::kProblem, Message("[temperature]"), Message::bare(problem.found),
          Message("required: {required}", problem.required));
    if (now.door_open)
      add(Grade::kProblem, Message("chamber"), Message("its door is open"), Message("close it"));
    for (const std::string& alarm : now.alarms)
      add(Grade::kProblem, Message("chamber"), Message("alarm: {alarm}", alarm),
          Message("find its cause at the chamber"));
  }

  void check_stage() {
    identities_.stage = bench_.stage->identify();
    const StageInfo& info = identities_.stage;
    const std::string& stated = config_.stage.serial_number;
    require_or_state_serial_number("stage", info.model, info.serial_number, stated);
    const Message serial_number =
        is_serial_number_reported(info.serial_number) || stated.empty()
            ? reported(info.serial_number)
            : Message("{stated} as the bench file states it (not reported)", stated);
    add(Grade::kGood, Message("stage"),
        Message("{maker} {model}, serial number {serial}, firmware {firmware}", info.maker, info.model,
                serial_number, reported(info.firmware)));
    for (const StageAxis axis : kStageAxes) {
      const StageAxisInfo& a = info.axes[index(axis)];
      const Message name("stage axis {axis}", to_string(axis));
      add(Grade::kGood, name,
          Message("travel {lowest:g} to {highest:g} deg, speed {speed:g} deg/s, resolution {resolution:g} "
                  "deg, {state}",
                  a.travel_min.deg(), a.travel_max.deg(), a.speed_deg_per_s, a.resolution.deg(),
                  a.referenced ? Message("homed") : Message("not homed yet: a run homes it first")));
      if (a.resolution > config_.protocol.position_window)
        add(Grade::kProblem, name,
            Message("its resolution of {resolution:g} deg is coarser than position_window_deg = {window:g}",
                    a.resolution.deg(), config_.protocol.position_window.deg()),
            Message("set position_window_deg to the resolution or more"));
    }
    const auto plan = make_rotation_plan(config_.protocol, identities_.travel());
    add(Grade::kGood, Message("travel"),
        Message("all {angles} angles of the plan are within the travel", plan.size()));
  }

  void check_accelerometer(Accelerometer& accelerometer, const AccelerometerConfig& stated) {
    info_ = accelerometer.identify();
    const AccelerometerInfo& info = info_;
    require_serial_number_of_accelerometer("accelerometer", stated, info);
    const Message known("{maker} {model}, serial number {serial}, firmware {firmware}, output in {unit}",
                        info.maker, info.model, reported(info.serial_number), reported(info.firmware),
                        info.output_unit);
    add(Grade::kGood, Message("accelerometer"),
        info.full_scale
            ? Message("{known}, full scale {full_scale:g} {unit}", known, *info.full_scale, info.output_unit)
            : known);
    const std::string& unit = stated.settings.unit;
    if (!unit.empty() && stated.driver != "simulated" && unit != info.output_unit)
      add(Grade::kProblem, Message("response unit"),
          Message("its output is in {found}, response_unit is {stated}", info.output_unit, unit),
          Message("set response_unit to the unit of the instrument, or remove it"));
  }

  /// Compares what the instrument reports with [item].
  void check_identity(const BenchItemConfig& item) {
    require_item_as_stated("accelerometer", item, info_);
    const ItemIdentityParts parts = identity_parts_of(item, info_);
    std::vector<Message> names;
    for (const IdentityPart& part : parts) {
      const Message text = part.text().empty() ? Message("not known") : Message("{text}", part.text());
      names.push_back(Message("{part} {text}", Message::bare(part.words), text));
    }
    const Message all = in_sequence(names, ", ");
    const std::string sources = describe_sources(parts);
    add(Grade::kGood, kItemFinding,
        sources.empty() ? all : Message("{parts}: {sources}", all, Message::bare(sources)));
  }

  void check_at_rest(Accelerometer& accelerometer, const AccelerometerConfig& stated) {
    Clock& clock = *bench_.clock;
    accelerometer.start();
    accelerometer.discard_pending();
    const int wanted = std::min(kMostTurnReadings, std::max(config_.protocol.dwell_readings,
                                                            static_cast<int>(stated.settings.rate_hz)));
    std::vector<Reading> readings;
    const Clock::Instant begin = clock.now();
    const Clock::Duration patience = from_seconds(config_.protocol.reading_timeout_s);
    while (static_cast<int>(readings.size()) < wanted || to_seconds(clock.now() - begin) < kShortestLookS) {
      const auto reading = accelerometer.next(clock.now() + patience);
      if (!reading)
        throw InstrumentError(
            "accelerometer " + info_.model, Fault::kNoReply,
            Message("no reading for {seconds} s (reading_timeout_s)", config_.protocol.reading_timeout_s));
      readings.push_back(*reading);
    }
    const DwellStatistics at_rest = dwell_statistics(readings, info_);
    const std::string& unit = info_.output_unit;
    const double rate = rate_of(readings);
    const double asked = stated.settings.rate_hz;
    const bool rate_good = std::abs(rate / asked - 1.0) <= kRateTolerance;
    add(rate_good ? Grade::kGood : Grade::kWarning, Message("sample rate"),
        Message("{found:.4g} readings/s, rate_hz = {stated:g}", rate, asked),
        rate_good ? Message() : Message("set rate_hz to the rate of the instrument"));
    const StreamHealth health = accelerometer.health();
    const bool whole = at_rest.lost == 0 && health.bad_frames == 0;
    add(whole ? Grade::kGood : Grade::kWarning, Message("losses"),
        Message("{lost} of {all} readings lost, {damaged} damaged frames", at_rest.lost, readings.size(),
                health.bad_frames),
        whole ? Message() : Message("use a better cable, a higher baud rate or a lower rate_hz"));
    if ((at_rest.flags & kFlagClipped) != 0)
      add(Grade::kProblem, Message("range"), Message("an output clips at rest"),
          Message("set a larger full scale, or change the mounting"));
    if (at_rest.not_finite > 0)
      add(Grade::kProblem, Message("readings at rest"),
          Message("{readings} readings are not finite", at_rest.not_finite));
    const bool silent = (at_rest.spread.array() == 0.0).all();
    add(silent ? Grade::kWarning : Grade::kGood, Message("noise at rest"),
        Message("mean {mean}, standard deviation {spread}, of the mean of {readings} readings {of_mean}",
                in_words(at_rest.mean, unit), in_words(at_rest.spread, unit), at_rest.count,
                in_words(at_rest.u_mean, unit)),
        silent ? Message("an output that does not change at all may be stuck: touch the bench and check "
                         "whether it changes")
               : Message());
    if (const auto gravity = nominal_response({}, unit, config_.g_loc.value_mps2)) {
      const double norm = at_rest.mean.norm();
      const bool plausible = std::abs(norm / *gravity - 1.0) <= kNormTolerance;
      add(plausible ? Grade::kGood : Grade::kProblem, Message("norm"),
          Message("the readings' norm is {found:.5g} {unit}, local gravity {required:.5g} {required_unit}",
                  norm, unit, *gravity, unit),
          plausible ? Message()
                    : Message("check unit and full scale: at rest the norm is within 10 % of local gravity"));
    }
  }

  void turn() {
    const std::vector<TurnedItem> items =
        measure_small_turn(bench_, config_, identities_, options_.listener, options_.stop);
    for (std::size_t k = 1; k <= items.size(); ++k) {
      item_ = static_cast<int>(k);
      judge_turn(items[k - 1]);
    }
    item_ = 0;
  }

  void judge_turn(const TurnedItem& item) {
    if (!item.missing.empty()) return add(Grade::kProblem, kSignsFinding, item.missing);
    Eigen::Matrix3d from_outputs = Eigen::Matrix3d::Identity();  // Along the axes of the platter.
    if (const auto mounting = mounting_matrix(item.mounting)) from_outputs = mounting->transpose();
    std::vector<PoseReading> poses = item.poses;
    for (PoseReading& pose : poses) {
      pose.mean = from_outputs * pose.mean;
      if (pose.flags != 0)
        add(Grade::kWarning, Message("readings"),
            Message("at X = {x:g} deg, Z = {z:g} deg: {flags}", pose.x.deg(), pose.z.deg(),
                    describe_flags(pose.flags)));
    }
    const Finding signs = judge_signs(poses);
    add(signs.grade, signs.what, signs.found, signs.advice);
  }

  Bench& bench_;
  const BenchConfig& config_;
  const CheckOptions& options_;
  bool failed_ = false;
  int item_ = 0;            ///< The item under test; 0: the bench.
  AccelerometerInfo info_;  ///< The identity that its accelerometer reported.
  Identities identities_;
  std::vector<Finding> findings_;
};

}  // namespace

Finding judge_signs(const std::vector<PoseReading>& poses) {
  Finding finding{Grade::kGood, kSignsFinding, {}, {}};
  double largest_change = 0.0;
  for (const PoseReading& pose : poses)
    largest_change = std::max(largest_change, (pose.mean - poses.front().mean).norm());
  if (!(largest_change > 0.05 * poses.front().mean.norm())) {
    finding.grade = Grade::kProblem;
    finding.found = Message("turning both axes changes the readings by only {change:.2g}", largest_change);
    finding.advice = Message("check that the accelerometer is fixed to this stage, and check both ports");
    return finding;
  }
  std::vector<Hypothesis> all = hypotheses();
  const double as_configured = disagreement(poses, all.front());
  if (as_configured <= kAgreement) {
    finding.found = Message(
        "both axes turn right-handed, as gravity requires; u, v, w are along x, y, z to about {within:.0f} %",
        100.0 * as_configured);
    return finding;
  }
  std::vector<Message> reasons;
  for (std::size_t i = 1; i < all.size(); ++i)
    if (disagreement(poses, all[i]) <= kAgreement) reasons.push_back(all[i].words);
  // Any orientation of the accelerometer can be calibrated; a reversed stage axis cannot be distinguished
  // from it by gravity alone, and gives a wrong matrix: a person must look.
  finding.grade = Grade::kProblem;
  if (reasons.empty()) {
    finding.found =
        Message("the readings do not change as gravity requires, and no simple cause explains this");
    finding.advice = Message("check cables, mounting and the names of the axes");
    return finding;
  }
  finding.found = Message("the readings do not change as gravity and the bench file require");
  Message causes = reasons.front();
  for (std::size_t i = 1; i < reasons.size(); ++i)
    causes = Message("{cause}; or {further}", causes, reasons[i]);
  finding.advice = Message("inspect the bench; possible causes: {causes}", causes);
  return finding;
}

constexpr auto kGrades = names<Finding::Grade>({{Finding::Grade::kGood, "good"},
                                                {Finding::Grade::kWarning, "warning"},
                                                {Finding::Grade::kProblem, "problem"},
                                                {Finding::Grade::kLeftOut, "left out"}});

std::string_view to_string(Finding::Grade grade) {
  return kGrades.of(grade, "unknown");
}

std::vector<Finding> check_bench(Bench& bench, const BenchConfig& config, const CheckOptions& options) {
  return Checker(bench, config, options).run();
}

}  // namespace abcal
