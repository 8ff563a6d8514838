#include "app/measure/session/item_check.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include "app/bench_file/not_real.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "app/measure/session/run_bench.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/limits.h"
#include "protocol/run/experiment_run.h"

namespace abcal {
namespace {

using Grade = Finding::Grade;

/// Room for an accelerometer mounted some degrees askew with some offset; the next axis is 90 degrees away.
constexpr double kLargestTiltDeg = 15.0;
constexpr int kReadings = 50;

std::string along(const Eigen::Vector3d& direction) {
  return fmt::format("({:+.2f}, {:+.2f}, {:+.2f})", direction[0], direction[1], direction[2]);
}

Eigen::Vector3d read_at_rest(Bench& bench, const BenchConfig& config, const std::stop_token& stop) {
  Accelerometer& accelerometer = *bench.first().accelerometer;
  accelerometer.start();
  accelerometer.discard_pending();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int n = 0; n < kReadings; ++n) {
    if (stop.stop_requested()) throw RunInterrupted(Message("stopped by the operator"));
    const auto reading =
        accelerometer.next(bench.clock->now() + from_seconds(config.protocol.reading_timeout_s));
    if (!reading)
      throw InstrumentError(
          "accelerometer", Fault::kNoReply,
          Message("no reading for {seconds} s (reading_timeout_s)", config.protocol.reading_timeout_s));
    sum += reading->output;
  }
  accelerometer.stop();
  return sum / kReadings;
}

Finding check_mounting(Bench& bench, const BenchConfig& config, const std::stop_token& stop) {
  const StageInfo stage = bench.stage->identify();
  if (!stage.axes[0].referenced || !stage.axes[1].referenced)
    return {Grade::kLeftOut,
            Message("mounting"),
            Message("not checked: the stage is not homed, and nobody knows how it stands; the run checks the "
                    "mounting"),
            {}};
  PoseReading pose;
  pose.x = bench.stage->encoder_angle(StageAxis::kX);
  pose.z = bench.stage->encoder_angle(StageAxis::kZ);
  pose.mean = read_at_rest(bench, config, stop);
  return judge_mounting(pose, config.items.front().expected.mounting);
}

}  // namespace

bool ItemCheck::passed() const {
  return std::none_of(findings.begin(), findings.end(),
                      [](const Finding& finding) { return finding.grade == Grade::kProblem; });
}

Finding judge_identity(const std::string& wanted, const std::string& reported, const ItemBefore& before,
                       bool simulated) {
  const Message reports("it reports serial number {reported}", reported);
  Finding finding{Grade::kGood, Message("identity"), reports, {}};
  if (simulated) {
    finding.grade = Grade::kLeftOut;
    finding.found = Message("{reports}: simulated, the same whatever is mounted", reports);
  } else if (reported.empty()) {
    finding.grade = Grade::kLeftOut;
    finding.found = Message("it reports no serial number");
    finding.advice = Message("read its label: required is {wanted}", wanted);
  } else if (reported == wanted) {
    finding.found = Message("{reports}, as required", reports);
  } else if (reported == before.reported && before.serial_number != wanted) {
    finding.grade = Grade::kProblem;
    finding.found =
        Message("{reports}, as {before} did before: it has not been changed", reports, before.serial_number);
    finding.advice = Message("mount and connect {wanted}", wanted);
  } else {
    finding.grade = Grade::kProblem;
    finding.found = Message("{reports}; required: {wanted}", reports, wanted);
    finding.advice = Message(
        "connect {wanted}, or enter {reported} as its serial number if the instrument that answers is the "
        "item",
        wanted, reported);
  }
  return finding;
}

Finding judge_mounting(const PoseReading& pose, const std::string& mounting) {
  const auto axes = mounting_matrix(mounting);
  if (!axes) throw std::invalid_argument(fmt::format("mounting \"{}\": required: e.g. \"x y z\"", mounting));
  const Eigen::Vector3d expected = *axes * gravity_at(pose.x, pose.z);
  const Eigen::Vector3d found = pose.mean.normalized();
  const double apart_deg = std::acos(std::clamp(found.dot(expected), -1.0, 1.0)) * 180.0 / std::numbers::pi;
  Finding finding{Grade::kGood,
                  Message("mounting"),
                  Message("gravity is along u, v, w = {found}, {apart:.1f} degrees from {expected}, as "
                          "mounting = \"{mounting}\" requires where the stage stands",
                          along(found), apart_deg, along(expected), mounting),
                  {}};
  if (apart_deg <= kLargestTiltDeg) return finding;
  finding.grade = Grade::kProblem;
  finding.found = Message(
      "gravity is along u, v, w = {found}; required: {expected} within {limit:g} degrees, by mounting = "
      "\"{mounting}\" where the stage stands (X {x:.1f} degrees, Z {z:.1f} degrees)",
      along(found), along(expected), kLargestTiltDeg, mounting, pose.x.deg(), pose.z.deg());
  finding.advice =
      Message("turn the item as it is to be mounted, or set mounting under [item] in the bench file");
  return finding;
}

ItemCheck check_mounted_item(Bench& bench, const BenchConfig& config, const ItemBefore& before,
                             const std::stop_token& stop) {
  ItemCheck check;
  check.findings = check_bench(bench, config, {true, {}, stop});
  std::erase_if(check.findings,
                [](const Finding& finding) { return finding.what == kSignsFinding.english(); });
  const bool is_other_item_only = std::ranges::all_of(check.findings, [](const Finding& finding) {
    return finding.grade != Grade::kProblem || finding.what == kItemFinding.english();
  });
  if (!is_other_item_only) return check;  // After a problem nothing more is asked.
  try {
    const BenchItemConfig& item = config.items.front();
    const IdentityPart serial_number =
        identity_parts_of(item, bench.first().accelerometer->identify()).back();
    check.reported = serial_number.reported;
    const std::vector<std::string> simulated = simulated_instruments(config);
    Finding identity =
        judge_identity(item.item.serial_number, check.reported, before,
                       std::find(simulated.begin(), simulated.end(), "accelerometer") != simulated.end());
    // On a wrong serial number it is more specific than the comparison with the bench file.
    if (identity.grade == Grade::kProblem)
      std::erase_if(check.findings,
                    [](const Finding& finding) { return finding.what == kItemFinding.english(); });
    check.findings.push_back(std::move(identity));
    if (!check.passed()) return check;
    check.findings.push_back(check_mounting(bench, config, stop));
  } catch (const InstrumentError& error) {
    check.findings.push_back({Grade::kProblem, Message("mounting"), error.message(), {}});
  }
  return check;
}

}  // namespace abcal
