#include "protocol/estimators/checks/result_checks.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <string>
#include <utility>

#include "drivers/text/letters.h"
#include "drivers/text/names.h"
#include "protocol/estimators/checks/change_scan.h"
#include "protocol/estimators/checks/check_poses.h"
#include "protocol/estimators/shared/objection.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;

// ---- Changes -------------------------------------------------------------------------------------------

constexpr auto kChangeNames = names<ChangeKind>({{ChangeKind::kSlip, "mounting slip"},
                                                 {ChangeKind::kAxisX, "missed step of axis X"},
                                                 {ChangeKind::kAxisZ, "missed step of axis Z"},
                                                 {ChangeKind::kOutput, "jump of an output"},
                                                 {ChangeKind::kGain, "change of a gain"},
                                                 {ChangeKind::kAngle, "single angle"},
                                                 {ChangeKind::kReading, "single output"},
                                                 {ChangeKind::kReadings, "single readings"}});

std::string_view unit_of(ChangeKind kind) {
  switch (kind) {
    case ChangeKind::kSlip:
    case ChangeKind::kAxisX:
    case ChangeKind::kAxisZ:
    case ChangeKind::kAngle:
      return "degree";
    default:
      return "of the sensitivity";
  }
}

/// Letters of the outputs whose readings agree, within their noise, with those at the angle before.
std::string outputs_as_before(const ChangeScan& scan, const Change& change) {
  if (change.at == 0) return {};
  const DwellRecord& before = *scan.dwells[change.at - 1];
  const DwellRecord& here = *scan.dwells[change.at];
  const Eigen::Vector3d none = Eigen::Vector3d::Zero();
  const Eigen::Vector3d u_before = before.u_mean.value_or(none), u_here = here.u_mean.value_or(none);
  std::string outputs;
  for (int j = 0; j < 3; ++j) {
    if (change.accelerometer >= 0 && change.accelerometer != j) continue;
    const double noise = kFalseAlarmDeviate * std::hypot(u_before(j), u_here(j));
    if (std::abs(here.mean(j) - before.mean(j)) <= noise) outputs += kOutputNames[j];
  }
  return outputs;
}

/// Explanations that are nearly as good, as the end of a sentence.
std::vector<Message> alternatives(const Change& change) {
  std::vector<Message> all;
  const auto add = [&](Term words) { all.push_back(Message(", {alternative}", words)); };
  for (const ChangeKind kind : change.as_well) {
    switch (kind) {
      case ChangeKind::kSlip:
        // The words for a missed step of axis Z name the slip already.
        if (change.kind != ChangeKind::kAxisZ) add("or the accelerometer slipped on the platter");
        break;
      case ChangeKind::kAxisX:
        add("or axis X missed a step that its encoder does not see");
        break;
      case ChangeKind::kAxisZ:
        add("or axis Z missed a step that its encoder does not see");
        break;
      case ChangeKind::kOutput:
        add("or an output jumped");
        break;
      case ChangeKind::kGain:
        add("or the gain of an output changed");
        break;
      case ChangeKind::kAngle:
        add("or the stage stood at another angle there");
        break;
      case ChangeKind::kReading:
        add("or one output was disturbed there");
        break;
      case ChangeKind::kReadings:
        break;  // explains everything that another single change does
    }
  }
  return all;
}

Message words_of(const ChangeScan& scan, const Change& change, const RunRecord& record) {
  const DwellRecord& here = *scan.dwells[change.at];
  const auto before = [&] { return dwell_words(*scan.dwells[change.at - 1]); };
  const std::string as_before = outputs_as_before(scan, change);
  std::vector<Message> alternative = alternatives(change);
  const Message others = in_sequence(alternative, "");
  switch (change.kind) {
    case ChangeKind::kSlip: {
      const Eigen::Vector3d axis = change.size.normalized();
      // The linear model may not list axis Z as an alternative for a large turn about z.
      if (std::abs(axis.z()) > 0.999 &&
          std::ranges::find(change.as_well, ChangeKind::kAxisZ) == change.as_well.end())
        alternative.push_back(
            Message(", {alternative}", Message("or axis Z missed a step that its encoder does not see")));
      return {
          "the accelerometer slipped on the platter by {angle:.3f} degrees about ({x:.2f}, {y:.2f}, {z:.2f}) "
          "between {before} and {after}{more}",
          change.magnitude,
          axis.x(),
          axis.y(),
          axis.z(),
          before(),
          dwell_words(here),
          in_sequence(alternative, "")};
    }
    case ChangeKind::kAxisX:
      return Message(
          "axis X is off by {angle:+.3f} degrees from {where} on: a missed step that its encoder does not "
          "see{more}",
          change.size(0) * kDegrees, dwell_words(here), others);
    case ChangeKind::kAxisZ:
      return Message(
          "axis Z is off by {angle:+.3f} degrees from {where} on: a missed step that its encoder does not "
          "see, or the accelerometer slipped on the platter about z{more}",
          change.size(0) * kDegrees, dwell_words(here), others);
    case ChangeKind::kOutput:
      return {"output {output} jumped by {jump:.2g} {unit} between {before} and {after}{more}",
              kOutputNames[change.accelerometer],
              change.size(0),
              record.response_unit,
              before(),
              dwell_words(here),
              others};
    case ChangeKind::kGain:
      return {"the gain of output {output} changed by {change:+.4f} % between {before} and {after}{more}",
              kOutputNames[change.accelerometer],
              100.0 * change.size(0),
              before(),
              dwell_words(here),
              others};
    case ChangeKind::kAngle:
      alternative.insert(
          alternative.begin(),
          as_before.size() == 3
              ? Message(
                    ", {cause}",
                    Message("and as at the angle before: the outputs were stuck, or the axis did not move"))
              : Message(
                    ": {cause}",
                    Message(
                        "a missed step that was made up for, or the axis was moved while they were taken")));
      return {"{where}: the readings are those of an angle {angle:+.3f} degrees away{more}",
              dwell_words(here), change.size(0) * kDegrees, in_sequence(alternative, "")};
    case ChangeKind::kReading:
    case ChangeKind::kReadings: {
      const bool one = change.kind == ChangeKind::kReading;
      const Message where = dwell_words(here);
      if (as_before.empty() && one)
        return {
            "{where}: output {output} is off by {change:.2g} of the sensitivity: disturbed or stuck{more}",
            where, kOutputNames[change.accelerometer], change.magnitude, others};
      if (as_before.empty())
        return {"{where}: the outputs are off by {change:.2g} of the sensitivity: disturbed or stuck{more}",
                where, change.magnitude, others};
      const std::vector<char> names(as_before.begin(), as_before.end());
      const std::string readers = fmt::format("{}", fmt::join(names, " and "));
      const Message they = names.size() == 1 ? Message("it") : Message("they");
      if (one)
        return {
            "{where}: output {output} is off by {change:.2g} of the sensitivity; {reader} read what {what} "
            "had read at the angle before: stuck{more}",
            where,
            kOutputNames[change.accelerometer],
            change.magnitude,
            readers,
            they,
            others};
      return {
          "{where}: the outputs are off by {change:.2g} of the sensitivity; {reader} read what {what} had "
          "read at the angle before: stuck{more}",
          where,
          change.magnitude,
          readers,
          they,
          others};
    }
  }
  return {};
}

void check_changes(const RunRecord& record, const ChangeScan& scan, std::vector<Check>& checks) {
  for (const Change& change : scan.found) {
    checks.push_back({std::string(kChangeNames.of(change.kind)), change.magnitude, change.limit,
                      std::string(unit_of(change.kind)), false, words_of(scan, change, record)});
  }
  if (scan.too_large) return;
  for (const Change& change : scan.largest) {
    const bool named = std::any_of(scan.found.begin(), scan.found.end(),
                                   [&](const Change& found) { return found.kind == change.kind; });
    if (named) continue;
    checks.push_back({std::string(kChangeNames.of(change.kind)),
                      change.magnitude,
                      change.limit,
                      std::string(unit_of(change.kind)),
                      true,
                      {}});
  }
}

void check_drift(const RunRecord& record, const ChangeScan& scan, std::vector<Check>& checks) {
  const double limit = drift_limit(record.limits, record.tolerances);
  for (int j = 0; j < 3; ++j) {
    const double s = scan.sensitivity(j);
    const double prior = record.tolerances.drift;
    const double posterior = scan.u_drift(j) / s;
    // The drift from the readings alone: the prior pulls the estimate towards zero.
    const double shrinkage = 1.0 - posterior * posterior / (prior * prior);
    if (!(shrinkage > 0.1)) continue;  // the readings hardly determine the drift
    const double drift = scan.drift(j) / s / shrinkage;
    const double noise = posterior / std::sqrt(shrinkage);
    const double within = std::hypot(limit, kFalseAlarmDeviate * noise);
    Check check{fmt::format("drift of {}", kOutputNames[j]), drift, within,
                "of the sensitivity, over the run",          true,  {}};
    check.passed = std::abs(drift) <= within;
    if (!check.passed) {
      check.words = Message(
          "output {output} drifted by {change:.2g} of its sensitivity over the run, {times:.1f} times its "
          "tolerance: temperature, warm-up or supply",
          kOutputNames[j], drift, std::abs(drift) / prior);
    }
    checks.push_back(std::move(check));
  }
}

// ---- Stuck outputs -------------------------------------------------------------------------------------

/// Names the output that was frozen in the run, which the flag does not identify.
void check_stuck(const RunRecord& record, std::vector<Check>& checks) {
  constexpr std::size_t kMostNamed = 3;
  for (int j = 0; j < 3; ++j) {
    std::vector<Message> places;
    int frozen = 0;
    for (const DwellRecord* dwell : dwells_in_time(record)) {
      // If the spreads of all three are zero, they are not known (a CSV).
      const bool one_is_frozen = dwell->spread(j) == 0.0 && dwell->spread.maxCoeff() > 0.0;
      if ((dwell->flags & kFlagStuck) == 0U || !one_is_frozen) continue;
      if (++frozen <= static_cast<int>(kMostNamed))
        places.push_back(dwell->experiment > 0 ? dwell_words(*dwell)
                                               : Message("check pose {number}", dwell->n));
    }
    if (frozen == 0) continue;
    checks.push_back(
        {fmt::format("stuck output {}", kOutputNames[j]), static_cast<double>(frozen), 0.0, "dwells", false,
         Message("output {output} was stuck: it did not change at all at {where}", kOutputNames[j],
                 frozen > static_cast<int>(kMostNamed)
                     ? Message("{places} and {more} more", places, frozen - static_cast<int>(kMostNamed))
                     : in_sequence(places))});
  }
}

// ---- Temperature ---------------------------------------------------------------------------------------

void check_temperature(const RunRecord& record, std::vector<Check>& checks) {
  const LimitsConfig& limits = record.limits;
  std::optional<double> first;
  const DwellRecord* worst = nullptr;
  double worst_excess = 0.0, change = 0.0;
  const double allowed = temperature_change_limit_degc(limits, record.tolerances);
  for (const DwellRecord& dwell : record.dwells) {
    if (!dwell.temperature_degc || !std::isfinite(*dwell.temperature_degc)) continue;
    const double t = *dwell.temperature_degc;
    if (!first) first = t;
    if (std::abs(t - *first) > std::abs(change)) change = t - *first;
    const double excess = std::max(
        {std::abs(t - *first) - allowed, limits.temperature_min_degc - t, t - limits.temperature_max_degc});
    if (excess > worst_excess) {
      worst_excess = excess;
      worst = &dwell;
    }
  }
  if (!first) return;
  Check check{"temperature", change, allowed, "degC from the first angle", worst == nullptr, {}};
  if (worst != nullptr) {
    Message range;
    if (limits.temperature_max_degc < 1e9 || limits.temperature_min_degc > -1e9) {
      range = Message(", and from {least:g} to {most:g} degC", limits.temperature_min_degc,
                      limits.temperature_max_degc);
    }
    check.words = Message(
        "{where}: {temperature:.2f} degC, {change:+.2f} from the first angle; required: within {limit:.2g} "
        "degC of it{more}",
        dwell_words(*worst), *worst->temperature_degc, *worst->temperature_degc - *first, allowed, range);
  }
  checks.push_back(std::move(check));
}

// ---- Unit and full scale -------------------------------------------------------------------------------

/// Usual cause of a factor that is far from 1: "the readings are in m/s2, not in g"; empty if none fits.
Message usual_factor(double factor, const std::string& unit, double tolerance) {
  const auto is = [&](double candidate) { return std::abs(factor / candidate - 1.0) <= tolerance; };
  if (unit == "g" && is(kStandardGravity)) return Message("the readings are in m/s2, not in g");
  if (nominal_response({}, unit, 1.0) == 1.0 && is(1.0 / kStandardGravity))
    return {"the readings are in g, not in {unit}", unit};
  if (is(1e3)) return {"the readings are in thousandths of {unit}", unit};
  if (is(1e-3)) return {"the readings are in thousands of {unit}", unit};
  for (int k = 1; k <= 8; ++k) {
    const double power = std::exp2(k);
    if (is(power) || is(1.0 / power)) {
      return {"the full scale is wrong by a factor of {factor}",
              fmt::format("{}{:g}", is(power) ? "" : "1/", power)};
    }
  }
  return {};
}

constexpr const char* kFullScale = "full scale";

/// @param sensitivity, u  |s_u|, |s_v|, |s_w| and their standard uncertainties, R/g_loc
void check_full_scale(const RunRecord& record, const Eigen::Vector3d& sensitivity, const Eigen::Vector3d& u,
                      std::vector<Check>& checks) {
  const auto nominal = nominal_response(record.expected, record.response_unit, record.g_loc.value_mps2);
  if (!nominal) return;
  // Without a bench file local gravity may be anything between equator and pole.
  const double gravity = record.g_loc_known ? kFalseAlarmDeviate * record.g_loc.expanded_uncertainty_mps2 /
                                                  record.g_loc.coverage_factor / record.g_loc.value_mps2
                                            : 0.0035;
  Eigen::Vector3d ratio;
  Check check{kFullScale, 0.0, 0.0, "relative to the nominal sensitivity", true, {}};
  for (int j = 0; j < 3; ++j) {
    ratio(j) = sensitivity(j) / *nominal;
    const double noise = std::isfinite(u(j)) ? u(j) / *nominal : 0.0;
    const double limit =
        record.expected.sensitivity_tolerance + std::hypot(gravity, kFalseAlarmDeviate * noise);
    if (j == 0 || std::abs(ratio(j) - 1.0) - limit > std::abs(check.found) - check.limit) {
      check.found = ratio(j) - 1.0;
      check.limit = limit;
    }
  }
  check.passed = std::abs(check.found) <= check.limit;
  if (!check.passed) {
    const double mean = ratio.mean();
    const bool common = (ratio / mean - Eigen::Vector3d::Ones()).cwiseAbs().maxCoeff() <= check.limit;
    const Message usual = common ? usual_factor(mean, record.response_unit, 2.0 * check.limit) : Message();
    const auto percent = [](double r) { return Message("{change:+.3g} %", 100.0 * (r - 1.0)); };
    Message cause("unit, full scale or scale factor is wrong");
    if (!usual.empty()) {
      cause = usual;
    } else if (!common) {
      cause = Message("the scale of an output is wrong");
    }
    check.words = Message(
        "sensitivities of u, v, w differ by {u}, {v}, {w} from the nominal {nominal:.6g} {unit} per g_loc, "
        "required: within {limit:.2g} % ([item] sensitivity_tolerance): {causes}",
        percent(ratio(0)), percent(ratio(1)), percent(ratio(2)), *nominal, record.response_unit,
        100.0 * check.limit, cause);
  }
  checks.push_back(std::move(check));
}

// ---- Directions ----------------------------------------------------------------------------------------

std::string signed_axis(const Eigen::Vector3d& row) {
  Eigen::Index at = 0;
  row.cwiseAbs().maxCoeff(&at);
  return fmt::format("{}{}", row(at) < 0.0 ? "-" : "+", kPlatterAxes[at]);
}

/// Errors that turn the expected directions into those found; both are signed permutations.
Message cause_of(const Eigen::Matrix3d& expected, const Eigen::Matrix3d& found) {
  std::vector<Message> causes;
  const Eigen::Matrix3d columns = expected.transpose() * found;  // found = expected * columns
  const Eigen::Matrix3d rows = found * expected.transpose();     // found = rows * expected
  if (columns.determinant() > 0.0) {
    // s_j turns with the accelerometer: its row is multiplied by the transposed turn.
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(columns.transpose()));
    const Eigen::Vector3d axis = turn.axis();
    causes.push_back(Message(
        "the accelerometer is mounted turned by {angle:.0f} degrees about ({x:.2g}, {y:.2g}, {z:.2g})",
        turn.angle() * kDegrees, axis.x(), axis.y(), axis.z()));
  }
  std::vector<Message> outputs;
  for (int j = 0; j < 3; ++j) {
    Eigen::Index from = 0;
    rows.row(j).cwiseAbs().maxCoeff(&from);
    const bool reversed = rows(j, from) < 0.0;
    if (from == j && reversed) outputs.push_back(Message("{output} is reversed", kOutputNames[j]));
    if (from != j) {
      outputs.push_back(
          Message("{output} is {sign}{other}", kOutputNames[j], reversed ? "-" : "", kOutputNames[from]));
    }
  }
  const bool swapped = rows.trace() != 0.0 && !rows.isDiagonal();
  const Message which = in_sequence(outputs, ", ");
  causes.push_back(rows.isDiagonal() ? Message("the outputs are reversed ({outputs})", which)
                   : swapped         ? Message("the outputs are exchanged ({outputs})", which)
                                     : Message("the outputs are exchanged in turn ({outputs})", which));
  // A stage axis with the wrong sign has the same effect, and nothing else shows it.
  const auto is = [&](double x, double y, double z) {
    return columns.isApprox(Eigen::Vector3d(x, y, z).asDiagonal().toDenseMatrix());
  };
  if (is(-1, -1, 1)) causes.push_back(Message("stage axis X counts the wrong way ([stage.x] sign)"));
  if (is(-1, 1, 1)) causes.push_back(Message("stage axis Z counts the wrong way ([stage.z] sign)"));
  if (is(1, -1, 1))
    causes.push_back(Message("both stage axes count the wrong way ([stage.x] and [stage.z] sign)"));
  for (std::size_t i = 1; i < causes.size(); ++i) causes[i] = Message(", or {cause}", causes[i]);
  return in_sequence(causes, "");
}

void check_directions(const RunRecord& record, const CalibrationResult& result, std::vector<Check>& checks) {
  const auto expected = mounting_matrix(record.expected.mounting);
  if (!result.sensitivity_matrix || !expected) return;
  const Eigen::Matrix3d s = result.sensitivity_values();
  Eigen::Matrix3d found = Eigen::Matrix3d::Zero();
  Check check{"directions of the outputs", 0.0, record.limits.mounting.deg(), "degree", true, {}};
  for (int j = 0; j < 3; ++j) {
    const Eigen::Vector3d row = s.row(j), wanted = expected->row(j);
    check.found = std::max(check.found, std::atan2(row.cross(wanted).norm(), row.dot(wanted)) * kDegrees);
    Eigen::Index at = 0;
    row.cwiseAbs().maxCoeff(&at);
    found(j, at) = row(at) < 0.0 ? -1.0 : 1.0;
  }
  check.passed = check.found <= check.limit;
  if (!check.passed) {
    const bool permutation = std::abs(found.determinant()) == 1.0;
    Message cause("two outputs point along one axis");
    if (permutation) {
      cause = found.isApprox(*expected) ? Message("the accelerometer is mounted askew")
                                        : cause_of(*expected, found);
    }
    check.words = Message(
        "outputs u, v, w point along {u}, {v}, {w}; required: \"{mounting}\" ([item] mounting): {cause}",
        signed_axis(s.row(0)), signed_axis(s.row(1)), signed_axis(s.row(2)), record.expected.mounting, cause);
  }
  checks.push_back(std::move(check));
}

/// Whether the readings state no uncertainties and leave too few residuals to estimate the noise: one of the
/// three readings at each angle determines its step error, and twelve in all determine the outputs.
bool tells_little(const RunRecord& record) {
  constexpr int kFewFree = 24;  // The scatter of 24 residuals is known to 14 %.
  int usable = 0;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.u_mean && dwell.u_mean->minCoeff() > 0.0) return false;
    usable += dwell.mean.allFinite() && (dwell.flags & kFlagClipped) == 0U ? 1 : 0;
  }
  return 2 * usable - 12 < kFewFree;
}

void check_the_check_poses(const RunRecord& record, std::vector<Check>& checks) {
  try {
    for (Check& check : check_pose_checks(record)) checks.push_back(std::move(check));
  } catch (const UnusableData& error) {
    checks.push_back({"check poses", std::numeric_limits<double>::quiet_NaN(),
                      std::numeric_limits<double>::quiet_NaN(), "", true,
                      Message("the check poses were not compared: {why}", error.message())});
  }
}

}  // namespace

std::vector<Check> check_record(const RunRecord& record) {
  std::vector<Check> checks;
  check_temperature(record, checks);
  check_stuck(record, checks);
  check_the_check_poses(record, checks);
  try {
    const ChangeScan scan = scan_for_changes(record);
    if (!scan.converged && tells_little(record)) {
      checks.push_back(
          {"changes during the run", std::numeric_limits<double>::quiet_NaN(),
           std::numeric_limits<double>::quiet_NaN(), "", true,
           Message("slips, missed steps and disturbed angles were not looked for: {why}",
                   Message("so few angles without uncertainties do not tell noise from a change"))});
      return checks;
    }
    if (!scan.converged) {
      checks.push_back({"joint fit", std::numeric_limits<double>::quiet_NaN(),
                        std::numeric_limits<double>::quiet_NaN(), "", false,
                        Message("the joint fit does not converge: the readings are not those of the three "
                                "experiments, or their angles are wrong")});
      return checks;
    }
    check_changes(record, scan, checks);
    if (scan.too_large) return checks;
    check_drift(record, scan, checks);
    // These sensitivities are free of the effects of wrong angles and slips.
    check_full_scale(record, scan.sensitivity, scan.u_sensitivity, checks);
  } catch (const UnusableData& error) {
    checks.push_back(
        {"changes during the run", std::numeric_limits<double>::quiet_NaN(),
         std::numeric_limits<double>::quiet_NaN(), "", true,
         Message("slips, missed steps and disturbed angles were not looked for: {why}", error.message())});
  }
  return checks;
}

void apply_checks(std::vector<Check> checks, const RunRecord& record, CalibrationResult& result) {
  if (result.verdict != Verdict::kNotUsable) {
    const bool scale_checked = std::any_of(checks.begin(), checks.end(),
                                           [](const Check& check) { return check.name == kFullScale; });
    if (!scale_checked) {
      Eigen::Vector3d sensitivity, u;
      for (int j = 0; j < 3; ++j) {
        const Quantity& s = result.intrinsic_sensitivity[static_cast<std::size_t>(j)];
        sensitivity(j) = s.value;
        u(j) = s.standard_uncertainty;
      }
      check_full_scale(record, sensitivity, u, checks);
    }
    check_directions(record, result, checks);
  }
  std::vector<Message> failed;
  std::vector<Message>& notes = result.diagnostics.notes;
  for (const Check& check : checks) {
    if (check.words.empty()) continue;
    if (check.passed) {
      notes.push_back(check.words);
    } else {
      failed.push_back(check.words);
    }
  }
  result.diagnostics.checks = std::move(checks);
  if (failed.empty()) return;
  notes.insert(notes.begin(), failed.begin(), failed.end());
  object_to(result, in_sequence(failed));
}

}  // namespace abcal
