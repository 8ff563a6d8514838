#include "app/laboratory/compare/compare_json.h"

#include <cmath>
#include <nlohmann/json.hpp>

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

// A number that is not finite is written as null.

Json rows_of(const Eigen::MatrixXd& matrix) {
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    Json row = Json::array();
    for (Eigen::Index j = 0; j < matrix.cols(); ++j) row.push_back(matrix(i, j));
    rows.push_back(std::move(row));
  }
  return rows;
}

Json result_of(const ComparedResult& result, const std::array<std::string, 9>& units) {
  Json properties;
  for (std::size_t i = 0; i < 9; ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    properties[kIntrinsicSymbols[i]] = {{"value", result.values(at)},
                                        {"standard_uncertainty", std::sqrt(result.covariance(at, at))},
                                        {"unit", units[i]}};
  }
  return {{"file", result.file},
          {"kind", result.kind},
          {"what", result.what},
          {"estimator", result.estimator.empty() ? Json(nullptr) : Json(result.estimator)},
          {"formula", result.published           ? Json("published")
                      : result.estimator.empty() ? Json(nullptr)
                                                 : Json("line response")},
          {"date", result.date},
          {"item", result.item},
          {"item_serial_number", result.item_serial_number},
          {"stage", result.stage},
          {"stage_serial_number", result.stage_serial_number},
          {"properties", std::move(properties)},
          {"covariances_known", result.with_correlations},
          {"notes", result.notes}};
}

Json rotation_of(const RotationBetween& rotation) {
  if (!rotation.same_handedness) return {{"same_handedness", false}};
  Json json{{"same_handedness", true},
            {"matrix", rows_of(rotation.rotation)},
            {"angle",
             {{"value", rotation.angle_deg},
              {"standard_uncertainty", rotation.angle_standard_uncertainty_deg},
              {"unit", "degree"}}},
            {"axis", nullptr},
            {"axis_standard_uncertainty_degree", rotation.axis_standard_uncertainty_deg},
            {"residual", rows_of(rotation.residual)},
            {"residual_standard_uncertainty", rows_of(rotation.residual_standard_uncertainty)}};
  if (rotation.axis) json["axis"] = {rotation.axis->x(), rotation.axis->y(), rotation.axis->z()};
  return json;
}

Json pair_of(const PairComparison& pair, const ResultsComparison& comparison) {
  Json properties;
  for (std::size_t i = 0; i < 9; ++i) {
    const PropertyDifference& p = pair.intrinsic.properties[i];
    properties[kIntrinsicSymbols[i]] = {{"difference", p.difference},
                                        {"standard_uncertainty", p.standard_uncertainty},
                                        {"unit", comparison.units[i]},
                                        {"zeta", p.zeta},
                                        {"e_n", p.e_n}};
  }
  Json json{{"first", comparison.results[pair.first].file},
            {"second", comparison.results[pair.second].file},
            {"agrees", pair.agrees()},
            {"why", pair.why},
            {"common_fit", pair.common_fit},
            {"properties", std::move(properties)},
            {"largest_e_n", pair.intrinsic.largest_e_n},
            {"chi2", nullptr},
            {"degrees_of_freedom", pair.intrinsic.degrees_of_freedom},
            {"chi2_probability", nullptr},
            {"rotation", nullptr},
            {"joint_probability", pair.intrinsic.joint_probability},
            {"expected_beyond", pair.intrinsic.expected_beyond()}};
  if (pair.intrinsic.chi2) json["chi2"] = *pair.intrinsic.chi2;
  if (pair.intrinsic.chi2_probability) json["chi2_probability"] = *pair.intrinsic.chi2_probability;
  if (pair.rotation) json["rotation"] = rotation_of(*pair.rotation);
  return json;
}

Json chart_of(const std::optional<ControlChart>& chart) {
  if (!chart) return nullptr;
  Json points = Json::array();
  for (std::size_t k = 0; k < chart->points.size(); ++k) {
    const ChartPoint& point = chart->points[k];
    points.push_back({{"value", point.value},
                      {"lower", point.lower},
                      {"upper", point.upper},
                      {"inside", chart->inside(k)}});
  }
  return {{"centre", chart->centre},
          {"standard_deviation", chart->standard_deviation},
          {"spread", chart->has_spread()},
          {"in_control", chart->in_control()},
          {"points", std::move(points)}};
}

Json series_of(const PropertySeries& series, const std::string& unit) {
  Json json{{"unit", unit}, {"values", series.values}, {"spread", nullptr}, {"anova", nullptr}};
  if (const auto& s = series.spread) {
    json["spread"] = {{"mean", s->mean},
                      {"mean_standard_uncertainty", s->mean_standard_uncertainty},
                      {"standard_deviation", s->standard_deviation},
                      {"type_a", s->within},
                      {"between_runs", s->between},
                      {"chi2", s->chi2},
                      {"degrees_of_freedom", s->runs - 1},
                      {"chi2_probability", s->chi2_probability}};
  }
  json["random_effects"] = nullptr;
  if (const auto& r = series.random_effects) {
    json["random_effects"] = {{"mean", r->mean},
                              {"standard_uncertainty", r->standard_uncertainty},
                              {"between", r->between},
                              {"e_n", r->normalised_error}};
  }
  if (const auto& a = series.anova) {
    json["anova"] = {{"mean", a->mean},
                     {"mean_standard_uncertainty", a->mean_standard_uncertainty},
                     {"between_sum_squares", a->between_sum_squares},
                     {"between_degrees_of_freedom", a->between_degrees_of_freedom},
                     {"within_sum_squares", a->within_sum_squares},
                     {"within_degrees_of_freedom", a->within_degrees_of_freedom},
                     {"f", a->f},
                     {"f_probability", a->f_probability},
                     {"repeatability", a->repeatability},
                     {"between_groups", a->between},
                     {"reproducibility", a->reproducibility}};
  }
  json["individuals_chart"] = chart_of(series.individuals);
  json["mean_chart"] = chart_of(series.means);
  json["ewma_chart"] = chart_of(series.ewma);
  return json;
}

Json consistency_of(const ResultsComparison& comparison) {
  if (!comparison.consistency) return nullptr;
  const ConsistentSubset& found = *comparison.consistency;
  const auto test = [](const ConsistencyTest& t) {
    return Json{
        {"chi2", t.chi2}, {"degrees_of_freedom", t.degrees_of_freedom}, {"chi2_probability", t.probability}};
  };
  Json outliers = Json::array();
  for (const std::size_t i : found.outliers) outliers.push_back(comparison.results[i].file);
  return {{"agree", found.agree(kAgreementLevel)}, {"all", test(found.all)},
          {"majority_agrees", found.found},        {"outliers", std::move(outliers)},
          {"subset", test(found.subset)},          {"alternatives", found.alternatives},
          {"exhaustive", found.exhaustive},        {"covariances_used", found.covariances_used}};
}

}  // namespace

nlohmann::ordered_json compare_json(const ResultsComparison& comparison) {
  Json json{{"schema", "abcal.compare/1"},        {"agree", comparison.agree()},
            {"agreement_level", kAgreementLevel}, {"shared_stage_subtracted", comparison.shared_subtracted},
            {"results", Json::array()},           {"pairs", Json::array()}};
  for (const ComparedResult& result : comparison.results)
    json["results"].push_back(result_of(result, comparison.units));
  for (const PairComparison& pair : comparison.pairs) json["pairs"].push_back(pair_of(pair, comparison));
  json["several"] = nullptr;
  if (comparison.series) {
    Json order = Json::array();
    for (const std::size_t i : comparison.order) order.push_back(comparison.results[i].file);
    Json groups = Json::array();
    for (std::size_t g = 0; g < comparison.groups.size(); ++g) {
      Json files = Json::array();
      for (const std::size_t i : comparison.groups[g]) files.push_back(comparison.results[i].file);
      groups.push_back({{"name", comparison.group_names[g]}, {"files", std::move(files)}});
    }
    Json properties;
    for (std::size_t i = 0; i < 9; ++i)
      properties[kIntrinsicSymbols[i]] = series_of((*comparison.series)[i], comparison.units[i]);
    json["several"] = {{"order", std::move(order)},
                       {"groups", std::move(groups)},
                       {"properties", std::move(properties)},
                       {"consistency", consistency_of(comparison)}};
  }
  json["notes"] = comparison.notes;
  return json;
}

}  // namespace abcal
