#include "app/results/analysis/stored_result.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>
#include <utility>

#include "app/system/version.h"
#include "protocol/record/run_seal.h"

namespace abcal {
namespace {

/// A number that json_number() wrote; null is NaN.
double stored_number(const nlohmann::json& json) {
  return json.is_null() ? std::nan("") : json.get<double>();
}

Quantity stored_quantity(const nlohmann::json& json) {
  const auto optional = [&json](const char* key) {
    const nlohmann::json& part = json.at(key);
    return part.is_null() ? std::nullopt : std::optional(part.get<double>());
  };
  Quantity out;
  out.value = stored_number(json.at("value"));
  out.standard_uncertainty = stored_number(json.at("standard_uncertainty"));
  out.type_a = optional("type_a");
  out.type_b = optional("type_b");
  out.unit = json.at("unit").get<std::string>();
  // Infinite degrees of freedom are null.
  if (const auto found = json.find("degrees_of_freedom"); found != json.end() && !found->is_null())
    out.degrees_of_freedom = found->get<double>();
  return out;
}

std::array<Quantity, 3> stored_three(const nlohmann::json& json) {
  return {stored_quantity(json.at(0)), stored_quantity(json.at(1)), stored_quantity(json.at(2))};
}

std::array<std::array<Quantity, 3>, 3> stored_rows(const nlohmann::json& json) {
  return {stored_three(json.at(0)), stored_three(json.at(1)), stored_three(json.at(2))};
}

template <class Matrix>
Matrix stored_matrix(const nlohmann::json& json) {
  Matrix out;
  for (Eigen::Index i = 0; i < out.rows(); ++i)
    for (Eigen::Index j = 0; j < out.cols(); ++j)
      out(i, j) = stored_number(json.at(static_cast<std::size_t>(i)).at(static_cast<std::size_t>(j)));
  return out;
}

template <class Matrix>
std::optional<Matrix> optional_stored_matrix(const nlohmann::json& json) {
  return json.is_null() ? std::nullopt : std::optional(stored_matrix<Matrix>(json));
}

PublishedResult stored_published(const nlohmann::json& json) {
  PublishedResult out;
  out.sensitivity_matrix = stored_rows(json.at("sensitivity_matrix"));
  out.offset = stored_three(json.at("offset"));
  out.intrinsic_sensitivity = stored_three(json.at("intrinsic_sensitivity"));
  out.intrinsic_angle = stored_three(json.at("intrinsic_angle"));
  out.covariance = stored_matrix<Covariance12>(json.at("covariance"));
  out.covariance_intrinsic = stored_matrix<Covariance9>(json.at("covariance_intrinsic"));
  return out;
}

CalibrationResult result_from(const nlohmann::json& json) {
  CalibrationResult out;
  out.estimator = json.at("estimator").get<std::string>();
  out.verdict = Verdict::kUsable;
  out.why = Message::bare(json.at("why").get<std::string>());
  out.source = json.at("source").get<std::string>();
  out.response_unit = json.at("response_unit").get<std::string>();
  out.g_loc = stored_quantity(json.at("g_loc"));
  out.g_loc_source = json.at("g_loc").at("source").get<std::string>();
  if (const nlohmann::json& at = json.at("sensitivity_matrix"); !at.is_null())
    out.sensitivity_matrix = stored_rows(at);
  out.offset = stored_three(json.at("offset"));
  out.intrinsic_sensitivity = stored_three(json.at("intrinsic_sensitivity"));
  out.intrinsic_angle = stored_three(json.at("intrinsic_angle"));
  out.covariance = optional_stored_matrix<Covariance12>(json.at("covariance"));
  out.covariance_intrinsic = optional_stored_matrix<Covariance9>(json.at("covariance_intrinsic"));
  if (json.contains("published")) out.published = stored_published(json.at("published"));
  return out;
}

/// Whether every output of a stored result is a number with an uncertainty.
bool is_whole(const CalibrationResult& result) {
  const auto is_known = [](const Quantity& q) {
    return std::isfinite(q.value) && std::isfinite(q.standard_uncertainty);
  };
  const auto are_known = [&](const std::array<Quantity, 3>& of) { return std::ranges::all_of(of, is_known); };
  if (!result.covariance_intrinsic || !result.covariance_intrinsic->allFinite()) return false;
  if (result.sensitivity_matrix && (!std::ranges::all_of(*result.sensitivity_matrix, are_known) ||
                                    !result.covariance || !result.covariance->allFinite()))
    return false;
  return are_known(result.offset) && are_known(result.intrinsic_sensitivity) &&
         are_known(result.intrinsic_angle);
}

/// The last stored analysis of an estimator; nullopt if it is not this version's.
std::optional<CalibrationResult> last_result(const std::filesystem::path& run, const std::string& estimator) {
  if (!analyses_are_linked(run)) return std::nullopt;
  const std::optional<StoredAnalysis> last = last_analysis(run, estimator);
  if (!last || last->program_version != program_version()) return std::nullopt;
  const nlohmann::json json = nlohmann::json::parse(last->result_json);
  if (json.at("schema") != "abcal.result/1" || json.at("estimator") != estimator ||
      json.at("verdict") != to_string(Verdict::kUsable) || json.contains("item"))
    return std::nullopt;
  CalibrationResult result = result_from(json);
  return is_whole(result) ? std::optional(std::move(result)) : std::nullopt;
}

}  // namespace

std::optional<CalibrationResult> stored_result(const CheckedRun& run, const std::string& estimator) {
  const bool is_of_known_commit =
      std::string_view(program_version()).find("unknown") == std::string_view::npos;
  const bool is_of_this_file = run.complete() && run.hash && run.hash->good;
  if (!is_of_known_commit || !is_of_this_file || run.items.front().header.items.size() != 1)
    return std::nullopt;
  // Results that cannot be read are a doubt: the readings are there.
  try {
    return last_result(run.path, estimator);
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  } catch (const RunFileError&) {
    return std::nullopt;
  }
}

}  // namespace abcal
