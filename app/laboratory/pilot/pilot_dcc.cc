#include "app/laboratory/pilot/pilot_dcc.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "app/laboratory/certificate/dcc_administrative.h"
#include "app/laboratory/certificate/dcc_quantity.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dcc_xml.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/system/version.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

Wording english(std::string text) {
  return {std::move(text), "en"};
}

/// A label of a list, which must not have blanks.
std::string label_of_name(std::string name) {
  std::ranges::replace(name, ' ', '_');
  return name;
}

/// A list of values with k u = U.
ValueList list_with_expanded(std::vector<std::string> labels, const VectorXd& values, const VectorXd& u,
                             const VectorXd& expanded, const std::string& unit) {
  ValueList list;
  list.labels = std::move(labels);
  list.values = values;
  list.standard_uncertainty = u;
  list.coverage_factor = expanded.cwiseQuotient(u);
  list.degrees_of_freedom = VectorXd::Constant(values.size(), std::numeric_limits<double>::infinity());
  list.unit = unit;
  return list;
}

/// Day of a measurement: that of its result, or the planned one.
std::optional<Date> day_of(const PilotAnalysis& analysis, const PilotMeasurement& one) {
  return parse_date(one.result.date.empty() ? analysis.protocol.schedule[one.number - 1].date
                                            : one.result.date);
}

void refuse(const PilotAnalysis& analysis, const std::vector<Problem>& problems) {
  if (!problems.empty())
    throw KeyComparisonError("no certificate for " + analysis.protocol.path + ":" + list_of(problems));
}

void require_facts(const PilotAnalysis& analysis, const PilotCertificate& facts) {
  std::vector<Problem> problems;
  if (facts.laboratory.person_who_may("approve", facts.approved_by) == nullptr)
    problems.push_back({"--approved-by", "\"" + facts.approved_by + "\"",
                        "a person of the laboratory file who may approve"});
  if (one_line(facts.number).empty())
    problems.push_back({"--number", "nothing", "the number of the certificate"});
  for (const PilotMeasurement& one : analysis.measurements)
    if (!day_of(analysis, one))
      problems.push_back({fmt::format("measurement {} by {}", one.number, one.participant), "no date",
                          "a date in the result or in the protocol"});
  refuse(analysis, problems);
}

void add_core(XmlElement& administrative, const PilotAnalysis& analysis, const PilotCertificate& facts) {
  XmlElement core = administrative.add("dcc:coreData");
  core.add("dcc:countryCodeISO3166_1", facts.laboratory.laboratory.contact.country_code);
  core.add("dcc:usedLangCodeISO639_1", "en");
  core.add("dcc:mandatoryLangCodeISO639_1", "en");
  add_line(core, "dcc:uniqueIdentifier", facts.number);
  std::vector<std::string> days;
  for (const PilotMeasurement& one : analysis.measurements)
    days.push_back(format_date(day_of(analysis, one).value()));
  core.add("dcc:beginPerformanceDate", *std::ranges::min_element(days));
  core.add("dcc:endPerformanceDate", *std::ranges::max_element(days));
  core.add("dcc:performanceLocation", "other");
  core.add("dcc:issueDate", format_date(facts.date));
}

void add_statements(XmlElement& administrative, const PilotAnalysis& analysis) {
  XmlElement statements = administrative.add("dcc:statements");
  const auto add = [&](const char* ref_type, const std::string& name, const std::string& text) {
    XmlElement statement = statements.add("dcc:statement");
    statement.attribute("refType", ref_type);
    add_words(statement, "dcc:name", english(name));
    add_words(statement, "dcc:declaration", english(text));
  };
  add("abc_agreement", "Agreement", "All participants agreed with Draft A of the comparison's report.");
  add("abc_chain", "Record of the comparison",
      fmt::format("Protocol: SHA-256 {}. Last link of the chain of acts: {}.", analysis.protocol.sha256,
                  analysis.chain_head));
  for (const std::string& bound : analysis.bound_statements) add("abc_note", "Bounds of correlation", bound);
  for (const std::string& note : analysis.notes) add("abc_note", "Assumption or change", note);
  for (const auto& [name, text] : analysis.statements) add("abc_participantStatement", name, text);
}

void add_administrative(XmlElement& root, const PilotAnalysis& analysis, const PilotCertificate& facts) {
  const Words words;
  XmlElement administrative = root.add("dcc:administrativeData");
  add_software_and_definitions(administrative, words, program_version());
  add_core(administrative, analysis, facts);
  XmlElement item = administrative.add("dcc:items").add("dcc:item");
  add_name(item, "dcc:name", facts.laboratory.job.item_name);
  XmlElement identifications = item.add("dcc:identifications");
  add_identification(identifications, "manufacturer", analysis.protocol.item_serial_number,
                     english("Serial number"));
  add_laboratory(administrative, words, facts.laboratory.laboratory);
  XmlElement persons = administrative.add("dcc:respPersons");
  add_person(persons, facts.laboratory, facts.approved_by, "approved by", true);
  add_customer(administrative, words, facts.laboratory.customer);
  add_statements(administrative, analysis);
}

/// Statements on all results: the procedure, and when the artefact had the stated values.
void add_method(XmlElement& measurement, const PilotAnalysis& analysis) {
  XmlElement method = measurement.add("dcc:usedMethods").add("dcc:usedMethod");
  method.attribute("refType", "abc_comparison");
  add_words(method, "dcc:name",
            english(fmt::format("Reference value by procedure {}",
                                kReferenceProcedures.of(analysis.reference.procedure))));
  add_line(method, "dcc:reference", "M. G. Cox, Metrologia 39, 589 (2002); 44, 187 (2007)");
  XmlElement software = measurement.add("dcc:usedSoftware");
  add_software(software, Words(), "abcal", program_version());
  XmlElement condition = measurement.add("dcc:influenceConditions").add("dcc:influenceCondition");
  condition.attribute("refType", "abc_referenceTime");
  add_words(condition, "dcc:name", english("Time at which the artefact has the reference values"));
  XmlElement data = condition.add("dcc:data");
  const bool days = analysis.protocol.drift_per_day;
  XmlElement quantity = add_quantity(
      data, "abc_referenceTime",
      english(days ? "Mean time of the pilot's measurements, in days since 1970-01-01"
                   : "Mean time of the pilot's measurements, in transfers since the first measurement"));
  XmlElement real = quantity.add("si:real");
  real.add("si:value", dsi_number(analysis.transferred.reference_time, "reference time"));
  real.add("si:unit", days ? "\\day" : "\\one");
}

void add_reference(XmlElement& results, const PilotAnalysis& analysis) {
  const ReferenceValue& reference = analysis.reference;
  XmlElement data = add_result(results, "comparison_referenceValue", english("Reference values"));
  for (const std::vector<Index>& kind : analysis.protocol.kinds()) {
    std::vector<std::string> labels;
    for (const Index q : kind) labels.push_back(analysis.protocol.quantities[static_cast<std::size_t>(q)]);
    const MatrixXd covariance = reference.covariance(kind, kind);
    const VectorXd u = covariance.diagonal().cwiseSqrt();
    constexpr double kCoverage = 2.0;
    ValueList list = list_with_expanded(std::move(labels), reference.values(kind), u, kCoverage * u,
                                        analysis.units[static_cast<std::size_t>(kind.front())]);
    list.covariance = covariance;
    add_list(data, Words(), english("Reference values, k = 2"), list);
  }
}

std::vector<Index> places_of_quantity(const PilotAnalysis& analysis, std::size_t quantity) {
  std::vector<Index> at;
  for (std::size_t i = 0; i < analysis.participants.size(); ++i) at.push_back(analysis.place(i, quantity));
  return at;
}

void add_differences(XmlElement& results, const PilotAnalysis& analysis) {
  const ReferenceValue& reference = analysis.reference;
  std::vector<std::string> labels;
  for (const std::string& name : analysis.participants) labels.push_back(label_of_name(name));
  XmlElement data = add_result(results, "comparison_equivalenceValue",
                               english("Degrees of equivalence: result minus reference value"));
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    const std::vector<Index> at = places_of_quantity(analysis, q);
    const MatrixXd covariance = reference.difference_covariance(at, at);
    ValueList list = list_with_expanded(labels, reference.differences(at), covariance.diagonal().cwiseSqrt(),
                                        reference.expanded(at), analysis.units[q]);
    list.covariance = covariance;
    add_list(data, Words(), {analysis.protocol.quantities[q], {}}, list);
  }
  XmlElement e_n = add_result(results, "comparison_equivalenceValueEnCriterion",
                              english("E_n: degree of equivalence divided by its expanded uncertainty"));
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    std::vector<std::string> numbers;
    for (const Index at : places_of_quantity(analysis, q))
      numbers.push_back(fmt::format("{:.2f}", reference.differences(at) / reference.expanded(at)));
    XmlElement quantity =
        add_quantity(e_n, "comparison_equivalenceValueEnCriterion", {analysis.protocol.quantities[q], {}});
    add_number_list(quantity, labels, numbers, "\\one");
  }
}

void add_pairs(XmlElement& results, const PilotAnalysis& analysis) {
  const std::size_t n = analysis.participants.size(), p = analysis.units.size();
  std::vector<std::string> labels;
  std::vector<PairEquivalence> pairs;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = i + 1; j < n; ++j) {
      labels.push_back(label_of_name(analysis.participants[i] + "-" + analysis.participants[j]));
      pairs.push_back(
          pair_equivalence(analysis.transferred.results, static_cast<Index>(i), static_cast<Index>(j)));
    }
  XmlElement data = add_result(results, "abc_pairEquivalence",
                               english("Degrees of equivalence of pairs: first minus second"));
  for (std::size_t q = 0; q < p; ++q) {
    const auto at = static_cast<Index>(q);
    VectorXd values(static_cast<Index>(pairs.size())), u(values.size()), expanded(values.size());
    for (Index k = 0; k < values.size(); ++k) {
      const PairEquivalence& pair = pairs[static_cast<std::size_t>(k)];
      values(k) = pair.difference(at);
      u(k) = std::sqrt(pair.covariance(at, at));
      expanded(k) = pair.expanded(at);
    }
    add_list(data, Words(), {analysis.protocol.quantities[q], {}},
             list_with_expanded(labels, values, u, expanded, analysis.units[q]));
  }
}

}  // namespace

std::string pilot_dcc(const PilotAnalysis& analysis, const PilotCertificate& facts, const DccSchema* schema) {
  require_facts(analysis, facts);
  const XmlDocument document(xmlNewDoc(as_xml("1.0")));
  XmlElement root = dcc_root(document);
  try {
    add_administrative(root, analysis, facts);
    XmlElement measurement = root.add("dcc:measurementResults").add("dcc:measurementResult");
    measurement.attribute("refType", "comparison_referenceValues");
    add_words(measurement, "dcc:name", english(analysis.protocol.name));
    add_method(measurement, analysis);
    XmlElement results = measurement.add("dcc:results");
    add_reference(results, analysis);
    add_differences(results, analysis);
    add_pairs(results, analysis);
  } catch (const NumberNotFinite& error) {
    refuse(analysis, {{"results", error.what(), "finite numbers"}});
  }
  refuse(analysis, problems_of_xml(document, schema));
  return xml_text(document);
}

}  // namespace abcal
