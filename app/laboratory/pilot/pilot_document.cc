#include "app/laboratory/pilot/pilot_document.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "app/document/number_text.h"
#include "app/document/plot.h"
#include "app/results/analysis/result_text.h"
#include "app/system/version.h"

namespace abcal {
namespace {

using Eigen::Index;

constexpr std::size_t kShownDigitsOfHash = 16;
/// Claims beyond U by chance, for k = 2.
constexpr double kByChance = 1.0 - kCoverageProbability;

std::string procedure_words(ReferenceProcedure procedure) {
  switch (procedure) {
    case ReferenceProcedure::kMean:
      return "A: generalised weighted mean of all participants";
    case ReferenceProcedure::kMedian:
      return "B: median by draws";
    case ReferenceProcedure::kMeanOrMedian:
      return "A if the participants agree, else B";
    case ReferenceProcedure::kSubset:
      return "mean of the largest consistent subset of participants";
    case ReferenceProcedure::kSubsetPerQuantity:
      return "mean of the largest consistent subset of each quantity";
    case ReferenceProcedure::kRandomEffects:
      return "mean with random effects (Mandel and Paule)";
  }
  return {};
}

/// A value with an uncertainty, to two digits of it.
std::string with_plus_minus(double value, double u) {
  const int decimals = decimals_for(u);
  return u > 0.0 ? with_decimals(value, decimals, true) + " ± " + with_decimals(u, decimals)
                 : fmt::format("{:g}", value);
}

std::string probability_words(double probability) {
  return probability < 0.001 ? fmt::format("{:.0e}", probability) : fmt::format("{:.3f}", probability);
}

std::string test_words(const ConsistencyTest& test) {
  return fmt::format("chi2 = {:.1f} with {} degrees of freedom, probability {}", test.chi2,
                     test.degrees_of_freedom, probability_words(test.probability));
}

/// Differences of one quantity in a power of ten of its unit, with two decimals of the largest uncertainty.
struct DifferenceScale {
  int exponent = 0;
  explicit DifferenceScale(double largest) {
    if (largest > 0.0 && std::isfinite(largest)) exponent = static_cast<int>(std::floor(std::log10(largest)));
  }
  std::string number(double value) const {
    return without_negative_zero(fmt::format("{:.2f}", value / std::pow(10.0, exponent)));
  }
  std::string unit(const std::string& unit) const {
    return exponent == 0 ? unit : power_of_ten(exponent) + " " + unit;
  }
};

Section comparison_section(const PilotAnalysis& analysis) {
  const ComparisonProtocol& protocol = analysis.protocol;
  FactList facts;
  facts.facts = {{"pilot", protocol.pilot},
                 {"participants", fmt::format("{}", fmt::join(analysis.participants, ", "))},
                 {"artefact", "serial number " + protocol.item_serial_number},
                 {"quantities", fmt::format("{}", fmt::join(protocol.quantities, " "))},
                 {"units", "sensitivities per m/s2, angles in degrees, offsets in " + protocol.response_unit},
                 {"procedure", procedure_words(protocol.procedure)},
                 {"level of tests", fmt::format("{:g} %", 100.0 * protocol.level)},
                 {"protocol", "SHA-256 " + protocol.sha256},
                 {"chain", "last link " + analysis.chain_head}};
  return {.title = "Comparison", .blocks = {facts}};
}

Section results_section(const PilotAnalysis& analysis) {
  DocumentTable schedule{"Measurements in the order of the schedule",
                         {{"no.", CellKind::kNumber}, {"participant"}, {"date"}, {"result"}, {"stage"}},
                         {}};
  for (const PilotMeasurement& one : analysis.measurements) {
    const std::string& planned = analysis.protocol.schedule[one.number - 1].date;
    schedule.rows.push_back({std::to_string(one.number), one.participant,
                             one.result.date.empty() ? planned : one.result.date.substr(0, 10),
                             one.result.what.empty() ? one.result.kind : one.result.what,
                             one.result.stage.empty() ? "not named" : one.result.stage});
  }
  schedule.may_break = true;
  Section section{.title = "Results as given", .blocks = {schedule}};
  for (const std::vector<Index>& kind : analysis.protocol.kinds()) {
    DocumentTable table{
        "Value ± standard uncertainty in " + analysis.units[static_cast<std::size_t>(kind.front())],
        {{"no.", CellKind::kNumber}, {"participant"}},
        {},
        CellKind::kUnit};
    for (const Index q : kind)
      table.columns.push_back({analysis.protocol.quantities[static_cast<std::size_t>(q)], CellKind::kNumber});
    for (const PilotMeasurement& one : analysis.measurements) {
      table.rows.push_back({std::to_string(one.number), one.participant});
      for (const Index q : kind) {
        const Index at = analysis.protocol.positions()[static_cast<std::size_t>(q)];
        table.rows.back().push_back(
            with_plus_minus(one.result.values(at), std::sqrt(one.result.covariance(at, at))));
      }
    }
    section.blocks.emplace_back(std::move(table));
  }
  return section;
}

Section artefact_section(const PilotAnalysis& analysis) {
  const TransferredResults& transferred = analysis.transferred;
  const auto repeats =
      std::ranges::count(analysis.measurements, analysis.protocol.pilot, &PilotMeasurement::participant);
  Section section{.title = "The artefact", .blocks = {}};
  if (const std::string words = analysis.step_words(); !words.empty())
    section.blocks.emplace_back(Paragraph{words});
  FactList facts;
  facts.facts.emplace_back("measurements by the pilot", std::to_string(repeats));
  if (transferred.constant.degrees_of_freedom > 0)
    facts.facts.emplace_back("without drift", test_words(transferred.constant));
  if (transferred.line) facts.facts.emplace_back("with a line", test_words(*transferred.line));
  const bool averaged = transferred.walk_probability.size() > 0;
  if (averaged) {
    const DriftPrior prior;
    facts.facts.emplace_back(
        "model of the drift",
        fmt::format(
            "lines and random walks, averaged by marginal likelihood; prior of each quantity: a walk "
            "with probability {:g}, changes between the pilot's first and last measurements of {:g} to "
            "{:g} repeatabilities",
            prior.walk, prior.sizes.front(), prior.sizes.back()));
  }
  section.blocks.emplace_back(facts);
  if (analysis.protocol.drift == DriftModel::kNone) return section;
  const std::string time = analysis.protocol.drift_per_day ? "day" : "transfer";
  DocumentTable table{"Drift, by which all results are brought to the mean time of the pilot's measurements",
                      {{"quantity", CellKind::kSymbol},
                       {"change in a " + time + " ± u", CellKind::kNumber},
                       {"unit", CellKind::kUnit}},
                      {}};
  if (averaged) table.columns.push_back({"probability of a walk", CellKind::kNumber});
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    const auto at = static_cast<Index>(q);
    table.rows.push_back(
        {analysis.protocol.quantities[q],
         with_plus_minus(transferred.rate(at), std::sqrt(transferred.rate_covariance(at, at))),
         analysis.units[q]});
    if (averaged) table.rows.back().push_back(probability_words(transferred.walk_probability(at)));
  }
  section.blocks.emplace_back(std::move(table));
  return section;
}

/// Participants whose results make the reference value of a quantity.
std::string makers_of(const PilotAnalysis& analysis, std::size_t quantity) {
  const Eigen::MatrixXi& contributes = analysis.reference.contributes;
  std::vector<std::string> without;
  for (std::size_t i = 0; i < analysis.participants.size(); ++i)
    if (contributes(static_cast<Index>(i), static_cast<Index>(quantity)) == 0)
      without.push_back(analysis.participants[i]);
  return without.empty() ? "all" : fmt::format("without {}", fmt::join(without, ", "));
}

Section reference_section(const PilotAnalysis& analysis) {
  const ReferenceValue& reference = analysis.reference;
  const bool random = reference.procedure == ReferenceProcedure::kRandomEffects;
  FactList facts;
  facts.facts = {{"procedure", procedure_words(reference.procedure)},
                 {"all quantities together", test_words(analysis.consistency.joint)}};
  if (reference.alternatives > 0)
    facts.facts.emplace_back("other subsets of this size that agree", std::to_string(reference.alternatives));
  DocumentTable table{"Reference values ± standard uncertainty, and the agreement of all participants",
                      {{"quantity", CellKind::kSymbol},
                       {"reference ± u", CellKind::kNumber},
                       {"unit", CellKind::kUnit},
                       {"made of"},
                       {"chi2", CellKind::kNumber},
                       {"probability", CellKind::kNumber},
                       {"Birge", CellKind::kNumber}},
                      {}};
  if (random) table.columns.push_back({"between", CellKind::kNumber});
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    const auto at = static_cast<Index>(q);
    const ConsistencyTest& test = analysis.consistency.of_quantity[q];
    table.rows.push_back({analysis.protocol.quantities[q],
                          with_plus_minus(reference.values(at), std::sqrt(reference.covariance(at, at))),
                          analysis.units[q], makers_of(analysis, q), fmt::format("{:.1f}", test.chi2),
                          probability_words(test.probability),
                          fmt::format("{:.2f}", analysis.consistency.birge(q))});
    if (random) table.rows.back().push_back(fmt::format("{:.2g}", reference.between(at)));
  }
  Section section{.title = "Reference value", .blocks = {facts, table}};
  DocumentTable others{"Other procedures: reference value minus the one above ± standard uncertainty",
                       {{"quantity", CellKind::kSymbol}, {"in", CellKind::kUnit}},
                       {}};
  others.dense = true;
  for (const ReferenceValue& other : analysis.others)
    others.columns.push_back({std::string(kReferenceProcedures.of(other.procedure)), CellKind::kNumber});
  for (std::size_t q = 0; q < analysis.units.size() && !analysis.others.empty(); ++q) {
    const auto at = static_cast<Index>(q);
    const DifferenceScale scale(std::sqrt(analysis.others.front().covariance(at, at)));
    others.rows.push_back({analysis.protocol.quantities[q], scale.unit(analysis.units[q])});
    for (const ReferenceValue& other : analysis.others)
      others.rows.back().push_back(scale.number(other.values(at) - reference.values(at)) + " ± " +
                                   scale.number(std::sqrt(other.covariance(at, at))));
  }
  if (!others.rows.empty()) section.blocks.emplace_back(std::move(others));
  return section;
}

Figure difference_figure(const PilotAnalysis& analysis, std::size_t quantity) {
  constexpr double kHeight = 230.0;
  const ReferenceValue& reference = analysis.reference;
  const auto n = static_cast<double>(analysis.participants.size());
  const double u_ref =
      std::sqrt(reference.covariance(static_cast<Index>(quantity), static_cast<Index>(quantity)));
  PlotSeries band{.name = {}, .colour = "#7f7f7f", .line = true, .x = {0.5, n + 0.5}, .y = {0.0, 0.0}};
  band.half_width = {2.0 * u_ref, 2.0 * u_ref};
  PlotSeries part{
      .name = "D ± U", .colour = "#0072B2", .mark = PlotMark::kDisc, .mark_radius = 3.5, .x = {}, .y = {}};
  PlotSeries apart{.name = "not in the reference value",
                   .colour = "#D55E00",
                   .mark = PlotMark::kDiamond,
                   .mark_radius = 4.0,
                   .x = {},
                   .y = {}};
  for (std::size_t i = 0; i < analysis.participants.size(); ++i) {
    const Index at = analysis.place(i, quantity);
    PlotSeries& series =
        reference.contributes(static_cast<Index>(i), static_cast<Index>(quantity)) != 0 ? part : apart;
    series.x.push_back(static_cast<double>(i) + 1.0);
    series.y.push_back(reference.differences(at));
    series.half_width.push_back(reference.expanded(at));
  }
  std::vector<PlotSeries> series{band, part};
  if (!apart.x.empty()) series.push_back(apart);
  return {fmt::format("Degrees of equivalence of {}; band: reference value, k = 2.",
                      analysis.protocol.quantities[quantity]),
          plot({{.title = {},
                 .x = {.label = {},
                       .unit = {},
                       .low = 0.5,
                       .high = n + 0.5,
                       .step = 1.0,
                       .names = analysis.participants},
                 .y = {.label = "D", .unit = analysis.units[quantity]},
                 .series = std::move(series)}},
               kHeight)};
}

double largest_expanded(const PilotAnalysis& analysis, std::size_t quantity) {
  double largest = 0.0;
  for (std::size_t i = 0; i < analysis.participants.size(); ++i)
    largest = std::max(largest, analysis.reference.expanded(analysis.place(i, quantity)));
  return largest;
}

DocumentTable differences_table(const PilotAnalysis& analysis, std::size_t quantity) {
  const ReferenceValue& reference = analysis.reference;
  const bool with_z = !analysis.protocol.sigma_pt.empty();
  const DifferenceScale scale(largest_expanded(analysis, quantity));
  DocumentTable table{fmt::format("{}: D and U in {}", analysis.protocol.quantities[quantity],
                                  scale.unit(analysis.units[quantity])),
                      {{"participant"},
                       {"D", CellKind::kNumber},
                       {"U(D)", CellKind::kNumber},
                       {"k", CellKind::kNumber},
                       {"E_n", CellKind::kNumber},
                       {"zeta", CellKind::kNumber}},
                      {},
                      CellKind::kUnit};
  if (with_z) table.columns.push_back({"z", CellKind::kNumber});
  for (std::size_t i = 0; i < analysis.participants.size(); ++i) {
    const Index at = analysis.place(i, quantity);
    const Scores scores = scores_of(
        reference.differences(at), std::sqrt(reference.difference_covariance(at, at)), reference.expanded(at),
        with_z ? std::optional(analysis.protocol.sigma_pt[quantity]) : std::nullopt);
    table.rows.push_back({analysis.participants[i], scale.number(reference.differences(at)),
                          scale.number(reference.expanded(at)),
                          fmt::format("{:.2f}", analysis.transferred.results.coverage_factors[i]),
                          fmt::format("{:.2f}", scores.e_n), fmt::format("{:.2f}", scores.zeta)});
    if (scores.z) table.rows.back().push_back(fmt::format("{:.2f}", *scores.z));
  }
  return table;
}

Section equivalence_section(const PilotAnalysis& analysis) {
  Section section{.title = "Degrees of equivalence", .blocks = {}};
  section.blocks.emplace_back(Paragraph{
      "D is the result minus the reference value, at the mean time of the pilot's measurements. U(D) is its "
      "expanded uncertainty for 95 %, with the covariance of result and reference value and the "
      "participant's k; "
      "by procedure B it is half the shortest interval of the draws. E_n = D/U(D), zeta = D/u(D)."});
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    section.blocks.emplace_back(differences_table(analysis, q));
    section.blocks.emplace_back(difference_figure(analysis, q));
  }
  return section;
}

Section pairs_section(const PilotAnalysis& analysis) {
  const std::size_t n = analysis.participants.size();
  Section section{.title = "Participants with one another", .blocks = {}};
  section.blocks.emplace_back(
      Paragraph{"The row's result minus the column's, and its expanded uncertainty for 95 % with the larger "
                "k of the two."});
  std::vector<std::vector<PairEquivalence>> pairs(n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
      pairs[i].push_back(
          pair_equivalence(analysis.transferred.results, static_cast<Index>(i), static_cast<Index>(j)));
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    const auto at = static_cast<Index>(q);
    double largest = 0.0;
    for (const auto& row : pairs)
      for (const PairEquivalence& pair : row) largest = std::max(largest, pair.expanded(at));
    const DifferenceScale scale(largest);
    DocumentTable table{
        fmt::format("{} in {}", analysis.protocol.quantities[q], scale.unit(analysis.units[q])),
        {{""}},
        {},
        CellKind::kUnit};
    table.dense = n > 5;
    for (const std::string& name : analysis.participants) table.columns.push_back({name, CellKind::kNumber});
    for (std::size_t i = 0; i < n; ++i) {
      table.rows.push_back({analysis.participants[i]});
      for (std::size_t j = 0; j < n; ++j)
        table.rows.back().push_back(i == j ? ""
                                           : scale.number(pairs[i][j].difference(at)) + " ± " +
                                                 scale.number(pairs[i][j].expanded(at)));
    }
    section.blocks.emplace_back(std::move(table));
  }
  return section;
}

/// "differs, in phi_vw"; empty: the participant is not named.
std::string naming_words(const PilotAnalysis& analysis, std::size_t participant) {
  const auto fault = std::ranges::find(analysis.faulty, participant, &FaultyParticipant::participant);
  if (fault == analysis.faulty.end()) return {};
  if (!fault->quantity) return "differs";
  return "differs, in " + analysis.protocol.quantities[static_cast<std::size_t>(*fault->quantity)];
}

/// The faults that would be named, in units of each participant's standard uncertainty.
DocumentTable detectable_table(const PilotAnalysis& analysis) {
  const ParticipantResults& results = analysis.transferred.results;
  DocumentTable table{
      fmt::format(
          "Error of one quantity, in standard uncertainties of the participant, that is named in {:g} % "
          "of comparisons",
          100.0 * kNamingPower),
      {{"participant"}},
      {}};
  table.dense = true;
  for (const std::string& quantity : analysis.protocol.quantities)
    table.columns.push_back({quantity, CellKind::kNumber});
  for (std::size_t i = 0; i < analysis.participants.size(); ++i) {
    table.rows.push_back({analysis.participants[i]});
    for (std::size_t q = 0; q < analysis.units.size(); ++q) {
      const Index at = analysis.place(i, q);
      table.rows.back().push_back(
          fmt::format("{:.1f}", analysis.detectable(at) / std::sqrt(results.covariance(at, at))));
    }
  }
  return table;
}

Section claims_section(const PilotAnalysis& analysis) {
  const std::size_t p = analysis.units.size();
  DocumentTable table{"",
                      {{"participant"},
                       {"|D| > U(D)", CellKind::kNumber},
                       {"chi2 of all", CellKind::kNumber},
                       {"probability", CellKind::kNumber},
                       {"named"}},
                      {}};
  for (std::size_t i = 0; i < analysis.participants.size(); ++i) {
    const ClaimTest& claim = analysis.claims[i];
    table.rows.push_back({analysis.participants[i], fmt::format("{} of {}", claim.beyond, p),
                          fmt::format("{:.1f}", claim.joint.chi2), probability_words(claim.joint.probability),
                          naming_words(analysis, i)});
  }
  return {
      .title = "Claims of the participants",
      .blocks = {
          Paragraph{fmt::format(
              "By chance {:.1f} of the {} differences are beyond their U. A participant is named if its "
              "result differs from the mean of the others that agree, in all quantities together or in one: "
              "without a fault one is named in at most {:g} % of comparisons.",
              kByChance * static_cast<double>(p * analysis.participants.size()),
              p * analysis.participants.size(), 100.0 * kNamingLevel)},
          table, detectable_table(analysis)}};
}

Section link_section(const PilotAnalysis& analysis) {
  const LinkedDifferences& linked = *analysis.linked;
  DocumentTable table{
      "D ± U (95 %) with respect to the reference value of " + analysis.protocol.linked_comparison,
      {{"quantity", CellKind::kSymbol}, {"in", CellKind::kUnit}},
      {}};
  table.dense = true;
  for (const std::string& name : analysis.participants) table.columns.push_back({name, CellKind::kNumber});
  for (std::size_t q = 0; q < analysis.units.size(); ++q) {
    const DifferenceScale scale(largest_expanded(analysis, q));
    table.rows.push_back({analysis.protocol.quantities[q], scale.unit(analysis.units[q])});
    for (std::size_t i = 0; i < analysis.participants.size(); ++i) {
      const Index at = analysis.place(i, q);
      const double expanded =
          analysis.transferred.results.coverage_factors[i] * std::sqrt(linked.covariance(at, at));
      table.rows.back().push_back(scale.number(linked.differences(at)) + " ± " + scale.number(expanded));
    }
  }
  return {.title = "Link to an earlier comparison", .blocks = {table}};
}

}  // namespace

Document pilot_document(const PilotAnalysis& analysis, PilotDraft draft, const std::string& created_utc) {
  Document document;
  const std::string letter(kPilotDrafts.of(draft));
  document.title = "Draft " + letter + ": " + analysis.protocol.name;
  document.subtitle = analysis.verdict().english();
  document.identification = analysis.protocol.name;
  document.origin = fmt::format("abcal {}, {}", program_version(), created_utc);
  document.created_utc = created_utc;
  document.page_mark = "DRAFT " + letter;
  if (!analysis.agree()) document.cautions.push_back(document.subtitle);
  document.sections = {comparison_section(analysis),  artefact_section(analysis),
                       reference_section(analysis),   claims_section(analysis),
                       equivalence_section(analysis), pairs_section(analysis)};
  if (analysis.linked) document.sections.push_back(link_section(analysis));
  if (!analysis.bound_statements.empty())
    document.sections.push_back(
        {.title = "Bounds of correlation", .blocks = {BulletList{analysis.bound_statements}}});
  document.sections.push_back(results_section(analysis));
  if (draft == PilotDraft::kB)
    document.sections.push_back(
        {.title = "Agreement",
         .blocks = {Paragraph{"All participants agreed with Draft A; the chain has their acts."}}});
  if (!analysis.notes.empty())
    document.sections.push_back({.title = "Assumptions and changes", .blocks = {BulletList{analysis.notes}}});
  FactList statements;
  statements.facts = analysis.statements;
  for (const std::string& name : analysis.participants)
    if (std::ranges::find(analysis.statements, name, &std::pair<std::string, std::string>::first) ==
        analysis.statements.end())
      statements.facts.emplace_back(name, "none");
  document.sections.push_back({.title = "Statements of the participants", .blocks = {statements}});
  return document;
}

Document pilot_status(const ComparisonProtocol& protocol, const ComparisonChain& chain) {
  Document document;
  document.title = protocol.name;
  document.subtitle = fmt::format("{} of {} results are in; values are shown when all are.",
                                  chain.committed(), chain.states().size());
  DocumentTable table{
      "", {{"no.", CellKind::kNumber}, {"participant"}, {"planned"}, {"state"}, {"SHA-256"}}, {}};
  for (std::size_t k = 0; k < chain.states().size(); ++k) {
    const MeasurementState& state = chain.states()[k];
    const std::string since = state.committed_utc.substr(0, 10);
    std::string words = "open";
    if (state.stage() == MeasurementStage::kCommitted) words = "committed " + since + ", file missing";
    if (state.stage() == MeasurementStage::kIn) words = "in since " + since;
    if (state.stage() == MeasurementStage::kWithdrawn) words = "withdrawn: " + state.withdrawn;
    table.rows.push_back({std::to_string(k + 1), protocol.schedule[k].participant, protocol.schedule[k].date,
                          words, state.sha256.substr(0, kShownDigitsOfHash)});
  }
  document.sections.push_back({.title = "Measurements", .blocks = {table}});
  if (chain.complete()) {
    const std::vector<std::string> waiting = chain.not_agreed();
    document.sections.push_back(
        {.title = "Agreement with Draft A",
         .blocks = {Paragraph{waiting.empty() ? std::string("All participants agree.")
                                              : fmt::format("Missing: {}.", fmt::join(waiting, ", "))}}});
  }
  BulletList bounds;
  for (const ProtocolBound& one : protocol.correlation_bounds) bounds.items.push_back(one.words());
  if (!bounds.items.empty())
    document.sections.push_back(
        {.title = "Bounds of correlation: the analysis states what differs between 0 and these",
         .blocks = {bounds}});
  if (const std::vector<std::string> changes = chain.changes(); !changes.empty())
    document.sections.push_back({.title = "Changes", .blocks = {BulletList{changes}}});
  return document;
}

}  // namespace abcal
