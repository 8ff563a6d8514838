#include <cmath>
#include <nlohmann/json.hpp>

#include "app/laboratory/pilot/pilot_document.h"
#include "protocol/record/message_json.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;
using Eigen::Index;

Json list_of_numbers(const Eigen::VectorXd& vector) {
  return std::vector<double>(vector.begin(), vector.end());
}

Json list_of_rows(const Eigen::MatrixXd& matrix) {
  Json rows = Json::array();
  for (Index i = 0; i < matrix.rows(); ++i) rows.push_back(list_of_numbers(matrix.row(i).transpose()));
  return rows;
}

Json json_of_test(const ConsistencyTest& test) {
  return {{"chi2", test.chi2},
          {"degrees_of_freedom", test.degrees_of_freedom},
          {"chi2_probability", test.probability}};
}

Json json_of_reference(const ReferenceValue& reference) {
  return {{"procedure", kReferenceProcedures.of(reference.procedure)},
          {"values", list_of_numbers(reference.values)},
          {"covariance", list_of_rows(reference.covariance)},
          {"alternatives", reference.alternatives},
          {"between", list_of_numbers(reference.between)}};
}

Json json_of_participant(const PilotAnalysis& analysis, std::size_t i) {
  const ParticipantResults& results = analysis.transferred.results;
  const ReferenceValue& reference = analysis.reference;
  const Index p = results.quantities, from = static_cast<Index>(i) * p;
  const Eigen::VectorXd
      differences = reference.differences.segment(from, p),
      expanded = reference.expanded.segment(from, p),
      u = reference.difference_covariance.diagonal().segment(from, p).cwiseMax(0.0).cwiseSqrt();
  Json z = nullptr;
  if (const std::vector<double>& sigma = analysis.protocol.sigma_pt; !sigma.empty())
    z = list_of_numbers(differences.cwiseQuotient(Eigen::VectorXd::Map(sigma.data(), p)));
  Json contributes = Json::array();
  for (Index q = 0; q < p; ++q) contributes.push_back(reference.contributes(static_cast<Index>(i), q) != 0);
  Json pairs = Json::array();
  for (std::size_t j = 0; j < analysis.participants.size(); ++j) {
    if (j == i) continue;
    const PairEquivalence pair = pair_equivalence(results, static_cast<Index>(i), static_cast<Index>(j));
    pairs.push_back({{"with", analysis.participants[j]},
                     {"differences", list_of_numbers(pair.difference)},
                     {"expanded_uncertainties", list_of_numbers(pair.expanded)},
                     {"covariance", list_of_rows(pair.covariance)}});
  }
  Json json{{"name", analysis.participants[i]},
            {"coverage_factor", results.coverage_factors[i]},
            {"values", list_of_numbers(results.values.segment(from, p))},
            {"covariance", list_of_rows(results.covariance.block(from, from, p, p))},
            {"contributes", std::move(contributes)},
            {"differences", list_of_numbers(differences)},
            {"standard_uncertainties", list_of_numbers(u)},
            {"expanded_uncertainties", list_of_numbers(expanded)},
            {"e_n", list_of_numbers(differences.cwiseQuotient(expanded))},
            {"zeta", list_of_numbers(differences.cwiseQuotient(u))},
            {"z", std::move(z)},
            {"beyond", analysis.claims[i].beyond},
            {"all_quantities", json_of_test(analysis.claims[i].joint)},
            {"detectable_faults", list_of_numbers(analysis.detectable.segment(from, p))},
            {"pairs", std::move(pairs)},
            {"linked_differences", nullptr},
            {"linked_standard_uncertainties", nullptr}};
  if (analysis.linked) {
    json["linked_differences"] = list_of_numbers(analysis.linked->differences.segment(from, p));
    json["linked_standard_uncertainties"] =
        list_of_numbers(analysis.linked->covariance.diagonal().segment(from, p).cwiseSqrt());
  }
  return json;
}

/// null if the protocol states no bound.
Json json_of_bounds(const PilotAnalysis& analysis) {
  if (!analysis.at_bounds) return nullptr;
  const ComparisonOutcome& outcome = *analysis.at_bounds;
  Json named = Json::array();
  for (const FaultyParticipant& fault : outcome.faulty)
    named.push_back(analysis.participants[fault.participant]);
  return {{"agree", outcome.agree(analysis.protocol.level)},
          {"named", std::move(named)},
          {"all_quantities", json_of_test(outcome.consistency.joint)},
          {"reference", json_of_reference(outcome.reference)},
          {"differences", list_of_numbers(outcome.reference.differences)},
          {"expanded_uncertainties", list_of_numbers(outcome.reference.expanded)},
          {"statements", analysis.bound_statements}};
}

Json json_of_step(const PilotAnalysis& analysis) {
  if (!analysis.transferred.step) return nullptr;
  const ArtefactStep& step = *analysis.transferred.step;
  return {{"between", {analysis.measurements[step.before].number, analysis.measurements[step.after].number}},
          {"quantity", analysis.protocol.quantities[static_cast<std::size_t>(step.quantity)]},
          {"change", step.change},
          {"standard_uncertainty", step.u},
          {"without_step", json_of_test(step.test)},
          {"words", analysis.step_words()}};
}

Json json_of_measurements(const PilotAnalysis& analysis) {
  Json list = Json::array();
  for (const PilotMeasurement& one : analysis.measurements)
    list.push_back({{"number", one.number},
                    {"participant", one.participant},
                    {"date", one.result.date},
                    {"result", one.result.what},
                    {"stage", one.result.stage},
                    {"sha256", one.result.sha256}});
  return list;
}

}  // namespace

Json pilot_json(const PilotAnalysis& analysis) {
  const TransferredResults& transferred = analysis.transferred;
  Json json{{"schema", "abcal.pilot/1"},
            {"name", analysis.protocol.name},
            {"complete", true},
            {"agree", analysis.agree()},
            {"quantities", analysis.protocol.quantities},
            {"units", analysis.units},
            {"measurements", json_of_measurements(analysis)},
            {"artefact",
             {{"reference_time", transferred.reference_time},
              {"rate", list_of_numbers(transferred.rate)},
              {"rate_covariance", list_of_rows(transferred.rate_covariance)},
              {"walk_probability", list_of_numbers(transferred.walk_probability)},
              {"constant", json_of_test(transferred.constant)},
              {"line", transferred.line ? json_of_test(*transferred.line) : Json(nullptr)},
              {"step", json_of_step(analysis)}}},
            {"reference", json_of_reference(analysis.reference)},
            {"other_procedures", Json::array()},
            {"consistency",
             {{"all_quantities", json_of_test(analysis.consistency.joint)}, {"quantities", Json::array()}}},
            {"participants", Json::array()},
            {"named", Json::array()},
            {"faults", Json::array()},
            {"correlation_bounds", json_of_bounds(analysis)},
            {"verdict", analysis.verdict().english()},
            {"notes", analysis.notes},
            {"statements", Json::array()},
            {"protocol_sha256", analysis.protocol.sha256},
            {"chain", analysis.chain_head}};
  for (const ReferenceValue& other : analysis.others)
    json["other_procedures"].push_back(json_of_reference(other));
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    Json test = json_of_test(analysis.consistency.of_quantity[q]);
    test["birge_ratio"] = analysis.consistency.birge(q);
    json["consistency"]["quantities"].push_back(std::move(test));
  }
  for (std::size_t i = 0; i < analysis.participants.size(); ++i)
    json["participants"].push_back(json_of_participant(analysis, i));
  for (const FaultyParticipant& fault : analysis.faulty) {
    const std::string& name = analysis.participants[fault.participant];
    json["named"].push_back(name);
    json["faults"].push_back(
        {{"participant", name},
         {"quantity", fault.quantity
                          ? Json(analysis.protocol.quantities[static_cast<std::size_t>(*fault.quantity)])
                          : Json(nullptr)}});
  }
  for (const auto& [name, text] : analysis.statements)
    json["statements"].push_back({{"participant", name}, {"text", text}});
  return json;
}

Json pilot_status_json(const ComparisonProtocol& protocol, const ComparisonChain& chain) {
  Json measurements = Json::array();
  for (std::size_t k = 0; k < chain.states().size(); ++k) {
    const MeasurementState& state = chain.states()[k];
    measurements.push_back({{"number", k + 1},
                            {"participant", protocol.schedule[k].participant},
                            {"planned", protocol.schedule[k].date},
                            {"sha256", state.sha256},
                            {"committed_utc", state.committed_utc},
                            {"opened", !state.file.empty()},
                            {"state", kMeasurementStages.of(state.stage())},
                            {"withdrawn", state.withdrawn}});
  }
  Json bounds = Json::array();
  std::vector<Message> words;
  for (const ProtocolBound& one : protocol.correlation_bounds) {
    words.push_back(one.words());
    bounds.push_back(words.back().english());
  }
  return {{"schema", "abcal.pilot/1"},
          {"name", protocol.name},
          {"pilot", protocol.pilot},
          {"complete", chain.complete()},
          {"not_agreed", chain.not_agreed()},
          {"measurements", std::move(measurements)},
          {"correlation_bounds", std::move(bounds)},
          {"changes", chain.changes()},
          {"messages", messages_json(words)},
          {"protocol_sha256", protocol.sha256},
          {"chain", chain.head()}};
}

}  // namespace abcal
