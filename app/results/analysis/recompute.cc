#include "app/results/analysis/recompute.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <utility>

#include "app/results/analysis/analyses.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/other_file.h"
#include "app/results/analysis/result_json.h"
#include "app/system/version.h"
#include "protocol/record/run_seal.h"

namespace abcal {
namespace {

/// Differences of rounding: an angle goes through text of 17 digits.
constexpr double kAngleRoundingDeg = 1e-9;

bool same_direction(Angle a, Angle b) {
  const double turns = (a.deg() - b.deg()) / 360.0;
  return std::abs(turns - std::round(turns)) * 360.0 <= kAngleRoundingDeg;
}

bool is_check_pose(const PlannedAngle& angle) {
  if (angle.n < 1 || angle.n > kCheckPoses) return false;
  const CheckPose pose = check_poses()[static_cast<std::size_t>(angle.n - 1)];
  return same_direction(angle.x, pose.x) && same_direction(angle.z, pose.z);
}

/// The first difference of the stored plan from that of the bench file; empty: none. Whole turns and order
/// are not compared, because they depend on the travel of the stage, which is not in the bench file.
std::string difference_of_plans(const std::vector<PlannedAngle>& stored, const BenchConfig& bench) {
  constexpr AxisTravel kAny{Angle::degrees(-1080.0), Angle::degrees(1080.0)};
  std::map<std::pair<int, int>, PlannedAngle> expected;
  ProtocolConfig protocol = bench.protocol;
  protocol.check_poses = false;  // Runs of version 0.1 have none, and a bench file does not say so.
  for (const PlannedAngle& angle : make_rotation_plan(protocol, {kAny, kAny}))
    if (!angle.closing) expected[{angle.experiment, angle.n}] = angle;
  std::set<std::pair<int, int>> seen;
  for (const PlannedAngle& angle : stored) {
    if (angle.experiment == 0) {
      if (!is_check_pose(angle))
        return fmt::format("pose {} is neither of an experiment nor a check pose", angle.n);
      continue;
    }
    const auto found = expected.find({angle.experiment, angle.n});
    if (found == expected.end())
      return fmt::format("experiment {}, angle {} is not in the plan of the bench file", angle.experiment,
                         angle.n);
    const PlannedAngle& planned = found->second;
    if (angle.face != planned.face || !same_direction(angle.alpha, planned.alpha) ||
        !same_direction(angle.x, planned.x) || !same_direction(angle.z, planned.z))
      return fmt::format("experiment {}, angle {} is not where the bench file has it", angle.experiment,
                         angle.n);
    if (!angle.closing) seen.insert({angle.experiment, angle.n});
  }
  if (seen.size() != expected.size())
    return fmt::format("{} of the {} angles of the bench file are planned", seen.size(), expected.size());
  return {};
}

/// The first difference of the dwells from the plan; empty: none.
std::string difference_from_plan(const StoredRun& stored, const BenchConfig* bench) {
  const std::vector<PlannedAngle>& plan = stored.header.plan;
  std::set<std::size_t> measured;
  for (std::size_t k = 0; k < stored.measured.size(); ++k) {
    const std::size_t position = stored.measured[k];
    const DwellRecord& dwell = stored.dwells[k];
    if (position >= plan.size())
      return fmt::format("a dwell has the position {}, which is not planned", position);
    measured.insert(position);
    const PlannedAngle& planned = plan[position];
    const std::string where = fmt::format("experiment {}, angle {}", planned.experiment, planned.n);
    if (dwell.experiment != planned.experiment || dwell.n != planned.n || dwell.closing != planned.closing ||
        dwell.face != planned.face || !same_direction(dwell.alpha, planned.alpha))
      return where + ": the dwell is of another angle";
    if (!same_direction(dwell.commanded_x, planned.x) || !same_direction(dwell.commanded_z, planned.z))
      return where + ": was not commanded as planned";
    if (bench == nullptr || (dwell.flags & kFlagOutsideWindow) != 0U) continue;
    for (const auto& [encoder, commanded] :
         {std::pair{dwell.encoder_x, dwell.commanded_x}, std::pair{dwell.encoder_z, dwell.commanded_z}}) {
      // Twice the window: the encoder may be read at another moment than the check of the window.
      if (encoder && std::abs(encoder->deg() - commanded.deg()) > 2.0 * bench->protocol.position_window.deg())
        return where + ": the encoder is outside the position window, but no flag is set";
    }
  }
  const bool is_dropped = stored.own_progress().dropped_at.has_value();
  if (stored.state == RunState::kComplete && !is_dropped && measured.size() != plan.size())
    return fmt::format("the run is complete, but {} of {} angles are measured", measured.size(), plan.size());
  return {};
}

IntegrityCheck check_plan(const StoredRun& stored, const BenchConfig* bench) {
  std::string wrong = difference_from_plan(stored, bench);
  // Angles of no rotation experiment are those of a levelling, which the bench file does not plan.
  const bool is_planned =
      bench != nullptr && std::any_of(stored.header.plan.begin(), stored.header.plan.end(),
                                      [](const PlannedAngle& angle) { return angle.experiment != 0; });
  if (wrong.empty() && is_planned) {
    try {
      wrong = difference_of_plans(stored.header.plan, *bench);
    } catch (const PlanError& error) {
      wrong = error.what();
    }
  }
  if (!wrong.empty()) return {"plan", false, wrong};
  return {"plan", true,
          fmt::format("{} angles{}, each measured as planned", stored.measured.size(),
                      is_planned ? " as the bench file gives them" : "")};
}

/// Nothing for a bench file of another version, or of a test: the plan is then compared with the dwells only.
std::optional<BenchConfig> bench_of(const StoredRun& stored) {
  try {
    return parse_bench(stored.header.bench_toml, "its bench file");
  } catch (const BenchError&) {
    return std::nullopt;
  }
}

/// Appends all values and standard uncertainties below a node, in order.
void gather(const nlohmann::json& node, std::vector<double>& values, std::vector<double>& uncertainties) {
  if (node.is_object() && node.contains("value") && node.contains("standard_uncertainty")) {
    const auto number = [](const nlohmann::json& at) {
      return at.is_number() ? at.get<double>() : std::nan("");
    };
    values.push_back(number(node["value"]));
    uncertainties.push_back(number(node["standard_uncertainty"]));
    return;
  }
  if (!node.is_structured()) return;
  for (const auto& child : node) gather(child, values, uncertainties);
}

/// Difference between a stored analysis and the present one.
struct Distance {
  bool comparable = false;
  double of_values = 0.0;         ///< Largest difference, in present standard uncertainties.
  double of_uncertainties = 0.0;  ///< Largest relative difference.
};

Distance distance_between(const nlohmann::json& stored, const nlohmann::json& now) {
  Distance distance;
  for (const char* group : {"sensitivity_matrix", "offset", "intrinsic_sensitivity", "intrinsic_angle"}) {
    std::vector<double> a, u_a, b, u_b;
    if (stored.contains(group)) gather(stored[group], a, u_a);
    if (now.contains(group)) gather(now[group], b, u_b);
    if (a.size() != b.size()) return distance;
    for (std::size_t k = 0; k < a.size(); ++k) {
      if (std::isnan(a[k]) && std::isnan(b[k])) continue;
      const double of_value = std::abs(a[k] - b[k]) / u_b[k], of_u = std::abs(u_a[k] / u_b[k] - 1.0);
      if (!std::isfinite(of_value) || !std::isfinite(of_u)) {
        if (a[k] == b[k] && u_a[k] == u_b[k]) continue;
        return distance;
      }
      distance.of_values = std::max(distance.of_values, of_value);
      distance.of_uncertainties = std::max(distance.of_uncertainties, of_u);
    }
  }
  distance.comparable = stored.value("verdict", "") == now.value("verdict", "");
  return distance;
}

/// Whether a complete run must have analyses: it is analysed when it ends. A levelling, whose angles belong
/// to no experiment, has none.
bool must_have_analyses(const std::filesystem::path& run, const StoredRun& stored) {
  std::error_code error;
  return std::filesystem::exists(ResultsFile::path_beside(run), error) &&
         std::any_of(stored.header.plan.begin(), stored.header.plan.end(),
                     [](const PlannedAngle& angle) { return angle.experiment != 0; });
}

/// The finding on missing analyses of a complete run; empty: that of the declared estimator is stored.
/// @param found  the estimators of the stored analyses
std::string missing_analyses(const StoredRun& stored, const std::vector<CalibrationResult>& results,
                             const std::set<std::string>& found) {
  const bool is_dropped = stored.own_progress().dropped_at.has_value();
  // An item that was dropped has only the result of the common fit.
  const std::string& wanted =
      results.size() == 1 ? results.front().estimator : declared_estimator(stored.record).name;
  if (is_dropped ? !found.empty() : found.contains(wanted)) return {};
  std::string missing;
  for (const CalibrationResult& result : results)
    if (!found.contains(result.estimator)) missing += (missing.empty() ? "" : ", ") + result.estimator;
  return fmt::format(
      "no analysis is stored of {}; required: that of {}, stored when the run ended. It was removed, or "
      "could not be stored: `abcal analyse RUN` stores it again",
      missing, wanted);
}

/// The stored analyses of the item of `stored`, computed again.
IntegrityCheck check_results(const std::filesystem::path& run, const StoredRun& stored_run,
                             const std::vector<CalibrationResult>& results,
                             const std::vector<ParsedAnalysis>& analyses) {
  // The same version gives the same numbers except for rounding. Another version may have other methods, so
  // that its analyses are only reported, not judged. Reports and certificates never use them.
  constexpr double kRounding = 1e-6;
  std::size_t same = 0, other = 0;
  std::set<std::string> found;
  double largest_of_other = 0.0;
  for (const auto& [stored, json] : analyses) {
    const std::string& estimator = stored.estimator;
    const auto now = std::find_if(results.begin(), results.end(), [&](const CalibrationResult& result) {
      return result.estimator == estimator;
    });
    if (now == results.end() || json.is_discarded() || json.value("item", 1) != stored_run.item) continue;
    found.insert(stored.estimator);
    const Distance distance = distance_between(json, nlohmann::json(result_json(*now)));
    if (stored.program_version != program_version()) {
      ++other;
      largest_of_other = std::max(largest_of_other, distance.of_values);
      continue;
    }
    ++same;
    if (!distance.comparable || distance.of_values > kRounding || distance.of_uncertainties > kRounding)
      return {"results", false,
              fmt::format("the analysis {} of {} does not follow from the dwells: it differs by {:.2g} "
                          "standard uncertainties",
                          stored.estimator, stored.utc, distance.of_values)};
  }
  if (must_have_analyses(run, stored_run)) {
    if (std::string missing = missing_analyses(stored_run, results, found); !missing.empty())
      return {"results", false, std::move(missing)};
  }
  std::string words = fmt::format("{} analyses recomputed", same);
  if (other > 0)
    words += fmt::format("; {} of another version of abcal differ by up to {:.2g} standard uncertainties",
                         other, largest_of_other);
  return {"results", true, words};
}

}  // namespace

std::vector<ParsedAnalysis> parsed_analyses(const std::filesystem::path& run) {
  std::vector<ParsedAnalysis> parsed;
  for (StoredAnalysis& stored : stored_analyses(run)) {
    nlohmann::json json = nlohmann::json::parse(stored.result_json, nullptr, false);
    parsed.push_back({std::move(stored), std::move(json)});
  }
  return parsed;
}

void keep_analysis(ResultsFile& results, const std::string& utc, const CalibrationResult& result,
                   const StoredRun& run) {
  nlohmann::ordered_json json = result_json(result);
  if (const int item = run.named_item(); item > 0) json["item"] = item;
  results.add_analysis(utc, program_version(), result.estimator, json.dump());
}

std::vector<IntegrityCheck> recompute(const std::filesystem::path& run, const StoredRun& stored,
                                      const BenchConfig* bench, const std::vector<CalibrationResult>& results,
                                      const std::vector<ParsedAnalysis>& analyses) {
  std::vector<IntegrityCheck> checks{check_plan(stored, bench)};
  if (stored.state == RunState::kComplete) checks.push_back(check_results(run, stored, results, analyses));
  return checks;
}

std::vector<IntegrityCheck> check_analyses(const std::filesystem::path& path, const AnalysedRun& run) {
  std::vector<IntegrityCheck> checks;
  const std::vector<ParsedAnalysis> analyses = parsed_analyses(path);
  for (const AnalysedItem& item : run.items) {
    checks.push_back(check_results(path, item.stored, item.results, analyses));
    checks.back().what = about_item(item.stored, checks.back().what, ", ");
  }
  return checks;
}

std::vector<IntegrityCheck> verify_measurement(const std::filesystem::path& path, const AnalysedRun& run) {
  std::vector<IntegrityCheck> checks;
  for (const RunOfMeasurement& part : run.runs) {
    std::vector<IntegrityCheck> of_run = verify_run(part.file);
    const std::optional<BenchConfig> bench = bench_of(part.stored());
    for (const StoredRun& item : part.items) {
      of_run.push_back(check_plan(item, bench ? &*bench : nullptr));
      of_run.back().what = about_item(item, of_run.back().what, ", ");
    }
    for (IntegrityCheck& check : of_run) {
      check.what = fmt::format("{}, {}", std::filesystem::path(part.file).filename().string(), check.what);
      check.item = 0;
      checks.push_back(std::move(check));
    }
  }
  std::ranges::move(check_analyses(path, run), std::back_inserter(checks));
  return checks;
}

std::vector<IntegrityCheck> verify_and_recompute(const std::filesystem::path& run) {
  refuse_other_file(run, kRunOnly);
  CheckedRun checked = read_and_check(run);
  std::vector<IntegrityCheck> checks = verify_run(checked);
  const std::vector<ParsedAnalysis> analyses =
      checked.complete() ? parsed_analyses(run) : std::vector<ParsedAnalysis>();
  const AnalysedRun analysed = analyse_run(std::move(checked.items));
  const std::optional<BenchConfig> bench = bench_of(analysed.items.front().stored);
  const BenchConfig* known = bench ? &*bench : nullptr;
  for (const AnalysedItem& item : analysed.items) {
    for (IntegrityCheck& check : recompute(run, item.stored, known, item.results, analyses)) {
      check.what = about_item(item.stored, check.what, ", ");
      checks.push_back(std::move(check));
    }
  }
  return checks;
}

}  // namespace abcal
