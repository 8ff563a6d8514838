#include "app/laboratory/pilot/pilot_analysis.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/LU>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <iterator>
#include <limits>
#include <memory>

#include "app/laboratory/certificate/laboratory_file.h"
#include "app/laboratory/register/register.h"
#include "protocol/plan/response_unit.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::VectorXd;

constexpr double kStraight = 180.0;

/// All problems of a result in one message.
void throw_problems(const std::string& about, const std::vector<std::string>& problems) {
  if (!problems.empty())
    throw KeyComparisonError(fmt::format("{}:\n  {}", about, fmt::join(problems, "\n  ")));
}

/// A result without numbers in the unit of the protocol, to which others are converted.
ComparedResult in_unit_of(const ComparisonProtocol& protocol) {
  ComparedResult pattern;
  pattern.file = "the protocol";
  pattern.unit_name = protocol.response_unit;
  pattern.unit = meaning_of_response_unit(protocol.response_unit);
  pattern.per_g_loc = false;
  pattern.values.setZero();
  pattern.covariance.setZero();
  return pattern;
}

/// @throws CompareError another kind of unit, or a local gravity that is not known
void convert(const ComparisonProtocol& protocol, ComparedResult& result) {
  std::vector<ComparedResult> both{in_unit_of(protocol), std::move(result)};
  try {
    convert_to_common_units(both);
  } catch (...) {
    result = std::move(both.back());
    throw;
  }
  result = std::move(both.back());
}

const ProtocolParticipant& participant_of(const ComparisonProtocol& protocol, const std::string& name) {
  return protocol.participants.at(protocol.participant(name));
}

/// The numbers of the protocol's quantities.
VectorXd chosen_values(const ComparisonProtocol& protocol, const ComparedResult& result) {
  return result.values(protocol.positions());
}

Eigen::MatrixXd chosen_covariance(const ComparisonProtocol& protocol, const ComparedResult& result) {
  const std::vector<Index> places = protocol.positions();
  const Eigen::MatrixXd covariance = result.covariance(places, places);
  if (result.with_correlations) return covariance;
  return covariance.diagonal().asDiagonal().toDenseMatrix();
}

/// Why the axes of a result do not point as those of the pilot's; empty: they do.
std::string axes_problem(const PilotMeasurement& one, const PilotMeasurement& pilot) {
  const ComparedResult& result = one.result;
  if (result.matrix && pilot.result.matrix &&
      (result.matrix->determinant() > 0.0) != (pilot.result.matrix->determinant() > 0.0))
    return "its axes have another handedness than the pilot's: an axis is reversed, or two are swapped";
  for (Index q = 3; q < 6; ++q) {
    const double here = result.values(q), there = pilot.result.values(q);
    const double u = std::sqrt(result.covariance(q, q) + pilot.result.covariance(q, q));
    constexpr double kFar = 10.0;
    if (std::abs(here - there) > kFar * u && std::abs(kStraight - here - there) < kFar * u)
      return fmt::format(
          "its {} is {:.5f} degrees and the pilot's {:.5f}: together 180, so that an axis has the other sign",
          kIntrinsicSymbols[static_cast<std::size_t>(q)], here, there);
  }
  for (Index q = 0; q < 3; ++q)
    if (result.values(q) * pilot.result.values(q) < 0.0)
      return fmt::format("its {} has the other sign than the pilot's",
                         kIntrinsicSymbols[static_cast<std::size_t>(q)]);
  return {};
}

double days_since_epoch(const std::string& date) {
  const std::optional<Date> day = parse_date(date);
  return day ? static_cast<double>(std::chrono::sys_days(*day).time_since_epoch().count())
             : std::numeric_limits<double>::quiet_NaN();
}

/// Loads what the chain has.
void load_measurements(const ComparisonChain& chain, const CertificateDoubt& doubt, PilotAnalysis& analysis) {
  const ComparisonProtocol& protocol = analysis.protocol;
  std::vector<std::string> waiting, problems;
  for (std::size_t k = 0; k < protocol.schedule.size(); ++k) {
    const MeasurementState& state = chain.states()[k];
    const std::string who = fmt::format("measurement {} by {}", k + 1, protocol.schedule[k].participant);
    if (!state.withdrawn.empty()) continue;  // stated by the chain
    if (state.sha256.empty())
      waiting.push_back(who + ": no result is committed");
    else if (state.file.empty())
      waiting.push_back(who + ": its result is committed, its file was not added");
  }
  if (!waiting.empty())
    throw ChainError(
        fmt::format("{}: no value is shown before all results are in:\n  {}\n  required: abcal pilot add {} "
                    "--participant NAME FILE, or --withdraw REASON",
                    protocol.path, fmt::join(waiting, "\n  "), protocol.path));
  for (std::size_t k = 0; k < protocol.schedule.size(); ++k) {
    const MeasurementState& state = chain.states()[k];
    const std::string& name = protocol.schedule[k].participant;
    if (!state.withdrawn.empty()) continue;
    const std::filesystem::path file = chain.path_of(state.file);
    const std::string who = fmt::format("measurement {} by {}: {}", k + 1, name, file.string());
    try {
      if (sha256_of_file(file) != state.sha256) {
        problems.push_back(who + ": was changed after it was committed (its SHA-256 is another)");
        continue;
      }
      PilotMeasurement one{
          .number = k + 1, .participant = name, .result = read_pilot_result(protocol, name, file)};
      const std::string why = doubt && (one.result.kind == "certificate" || one.result.kind == "table") &&
                                      !one.result.what.empty()
                                  ? doubt(one.result.what)
                                  : std::string();
      if (!why.empty()) {
        problems.push_back(
            fmt::format("{}: certificate {} {}; required: --withdraw REASON or --replace REASON", who,
                        one.result.what, why));
        continue;
      }
      analysis.measurements.push_back(std::move(one));
    } catch (const std::exception& error) {
      problems.push_back(fmt::format("{}: {}", who, error.what()));
    }
  }
  throw_problems(protocol.path + ": results that cannot be compared", problems);
}

/// Participants that take part, and what keeps the others out.
void choose_participants(PilotAnalysis& analysis) {
  const ComparisonProtocol& protocol = analysis.protocol;
  for (const ProtocolParticipant& one : protocol.participants) {
    if (std::ranges::find(analysis.measurements, one.name, &PilotMeasurement::participant) !=
        analysis.measurements.end())
      analysis.participants.push_back(one.name);
    else
      analysis.notes.push_back(one.name + " does not take part: all its results are withdrawn");
  }
  if (analysis.participants.size() < 3)
    throw KeyComparisonError(
        fmt::format("{}: {} participants have a result; required: three or more. Of two that disagree nobody "
                    "can say which "
                    "is right; `abcal compare` says whether they agree",
                    protocol.path, analysis.participants.size()));
  if (std::ranges::find(analysis.participants, protocol.pilot) == analysis.participants.end())
    throw KeyComparisonError(fmt::format(
        "{}: the pilot {} has no result left, so that the artefact cannot be followed; required: a result of "
        "the pilot",
        protocol.path, protocol.pilot));
}

void require_like_axes(const PilotAnalysis& analysis) {
  const auto pilot =
      std::ranges::find(analysis.measurements, analysis.protocol.pilot, &PilotMeasurement::participant);
  std::vector<std::string> problems;
  for (const PilotMeasurement& one : analysis.measurements) {
    if (const std::string why = axes_problem(one, *pilot); !why.empty())
      problems.push_back(
          fmt::format("measurement {} by {}: {}: {}", one.number, one.participant, one.result.file, why));
  }
  throw_problems(analysis.protocol.path + ": results of other axes", problems);
}

/// Notes sources that two results have in common though the protocol does not state them.
void note_common(PilotAnalysis& analysis) {
  const auto stated = [&](const std::string& a, const std::string& b) {
    return std::ranges::any_of(analysis.protocol.shared, [&](const ProtocolSource& source) {
      const auto has = [&](const std::string& name) {
        return std::ranges::find(source.participants, name) != source.participants.end();
      };
      return has(a) && has(b);
    });
  };
  std::vector<std::string> unknown;
  for (std::size_t i = 0; i < analysis.measurements.size(); ++i) {
    const PilotMeasurement& one = analysis.measurements[i];
    if (one.result.stage.empty() && std::ranges::find(unknown, one.participant) == unknown.end())
      unknown.push_back(one.participant);
    for (std::size_t j = i + 1; j < analysis.measurements.size(); ++j) {
      const PilotMeasurement& other = analysis.measurements[j];
      if (one.participant == other.participant || stated(one.participant, other.participant)) continue;
      if (on_same_stage(one.result, other.result) == SameStage::kYes)
        analysis.notes.push_back(fmt::format(
            "{} and {} measured on one stage ({}), and the protocol states no common part: they are taken as "
            "independent",
            one.participant, other.participant, one.result.stage));
      if (one.result.g_loc && other.result.g_loc && !one.result.g_loc_source.empty() &&
          one.result.g_loc_source == other.result.g_loc_source)
        analysis.notes.push_back(
            fmt::format("{} and {} have one source of gravity ({}), and the protocol states no common part: "
                        "they are taken as independent",
                        one.participant, other.participant, one.result.g_loc_source));
    }
  }
  if (!unknown.empty())
    analysis.notes.push_back(fmt::format(
        "the stage of {} is not named by the result: that it is none of the others is taken for granted",
        fmt::join(unknown, ", ")));
}

std::vector<ArtefactMeasurement> artefact_measurements(PilotAnalysis& analysis) {
  const ComparisonProtocol& protocol = analysis.protocol;
  std::vector<ArtefactMeasurement> list;
  std::vector<std::string> undated;
  for (const PilotMeasurement& one : analysis.measurements) {
    ArtefactMeasurement& measured = list.emplace_back();
    measured.participant = static_cast<std::size_t>(
        std::ranges::find(analysis.participants, one.participant) - analysis.participants.begin());
    measured.time = static_cast<double>(one.number - 1);
    if (protocol.drift_per_day) {
      const std::string& planned = protocol.schedule[one.number - 1].date;
      measured.time = days_since_epoch(one.result.date.empty() ? planned : one.result.date);
      if (!std::isfinite(measured.time))
        undated.push_back(
            fmt::format("measurement {} by {}: neither the result nor the protocol gives a date", one.number,
                        one.participant));
    }
    measured.values = chosen_values(protocol, one.result);
    measured.covariance = chosen_covariance(protocol, one.result);
    measured.repeatability =
        protocol.repeatability.empty()
            ? VectorXd::Zero(measured.values.size())
            : VectorXd(VectorXd::Map(protocol.repeatability.data(), measured.values.size()));
    if (!one.result.with_correlations)
      analysis.notes.push_back(fmt::format(
          "measurement {} by {} gives no correlations: they are taken as zero, as the protocol says",
          one.number, one.participant));
    for (const std::string& note : one.result.notes)
      analysis.notes.push_back(fmt::format("measurement {} by {}: {}", one.number, one.participant, note));
  }
  throw_problems(protocol.path + ": drift by day", undated);
  return list;
}

/// Finds the named participants among those that take part.
std::vector<std::size_t> places_of(const PilotAnalysis& analysis, const std::vector<std::string>& names) {
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < analysis.participants.size(); ++i)
    if (std::ranges::find(names, analysis.participants[i]) != names.end()) places.push_back(i);
  return places;
}

std::vector<SharedSource> shared_sources(const PilotAnalysis& analysis) {
  std::vector<SharedSource> sources;
  for (const ProtocolSource& one : analysis.protocol.shared) {
    SharedSource source{
        .name = one.name,
        .participants = places_of(analysis, one.participants),
        .u = VectorXd::Map(one.uncertainty.data(), static_cast<Index>(one.uncertainty.size())),
        .together = one.together};
    sources.push_back(std::move(source));
  }
  return sources;
}

/// The bounds of correlation between participants that take part.
std::vector<SharedSource> bounds_of_correlation(PilotAnalysis& analysis) {
  std::vector<SharedSource> bounds;
  for (const ProtocolBound& one : analysis.protocol.correlation_bounds) {
    SharedSource bound{.name = one.name,
                       .participants = places_of(analysis, one.participants),
                       .u = {},
                       .correlation = one.correlation};
    if (bound.participants.size() < 2) continue;
    for (const std::string& symbol : one.quantities)
      bound.quantities.push_back(analysis.protocol.place(symbol));
    bounds.push_back(std::move(bound));
    analysis.bound_statements.push_back(one.words());
  }
  return bounds;
}

Message verdict_of(const PilotAnalysis& analysis, const ComparisonOutcome& outcome) {
  if (outcome.transferred.step) return Message("The artefact changed: the results do not belong together.");
  if (outcome.agree(analysis.protocol.level))
    return Message("The participants agree within their uncertainties.");
  std::vector<std::string> names;
  for (const FaultyParticipant& fault : outcome.faulty) {
    names.push_back(analysis.participants[fault.participant]);
    if (fault.quantity)
      names.back() +=
          fmt::format(" ({})", analysis.protocol.quantities[static_cast<std::size_t>(*fault.quantity)]);
  }
  if (names.empty())
    return Message(
        "The participants do not agree within their uncertainties, and no single one is the cause.");
  return {"{participants} differs from the others, which agree.", fmt::format("{}", fmt::join(names, ", "))};
}

/// A difference whose claim is another one with the bounds; empty: it is the same.
std::string changed_claim(const std::string& about, const std::string& unit, const std::array<double, 2>& d,
                          const std::array<double, 2>& expanded) {
  const auto holds = [&](std::size_t k) { return std::abs(d[k]) <= expanded[k]; };
  if (holds(0) == holds(1)) return {};
  const auto words = [&](std::size_t k) {
    return fmt::format("{:.3g} with U = {:.2g} {}, {}", d[k], expanded[k], unit,
                       holds(k) ? "agrees" : "does not agree");
  };
  return fmt::format("{}: without correlation {}; with the bounds {}.", about, words(0), words(1));
}

/// States what differs between the outcomes without correlation and with its bounds.
void state_differences(PilotAnalysis& analysis) {
  const ComparisonOutcome& bounds = *analysis.at_bounds;
  std::vector<std::string> changed;
  if (verdict_of(analysis, analysis) != verdict_of(analysis, bounds))
    changed.push_back(analysis.verdict().english());
  if (analysis.reference.procedure != bounds.reference.procedure)
    changed.push_back(
        fmt::format("The reference value is that of procedure {} without correlation, and of {} "
                    "with the bounds.",
                    kReferenceProcedures.of(analysis.reference.procedure),
                    kReferenceProcedures.of(bounds.reference.procedure)));
  const std::vector<std::string>& names = analysis.participants;
  for (std::size_t i = 0; i < names.size(); ++i) {
    for (std::size_t q = 0; q < analysis.units.size(); ++q) {
      const Index at = analysis.place(i, q);
      changed.push_back(changed_claim(fmt::format("{}, D of {}", names[i], analysis.protocol.quantities[q]),
                                      analysis.units[q],
                                      {analysis.reference.differences(at), bounds.reference.differences(at)},
                                      {analysis.reference.expanded(at), bounds.reference.expanded(at)}));
    }
    for (std::size_t j = i + 1; j < names.size(); ++j) {
      const auto pair_of = [&](const ComparisonOutcome& outcome) {
        return pair_equivalence(outcome.transferred.results, static_cast<Index>(i), static_cast<Index>(j));
      };
      const PairEquivalence without = pair_of(analysis), with = pair_of(bounds);
      for (std::size_t q = 0; q < analysis.units.size(); ++q) {
        const auto at = static_cast<Index>(q);
        changed.push_back(
            changed_claim(fmt::format("{} minus {}, {}", names[i], names[j], analysis.protocol.quantities[q]),
                          analysis.units[q], {without.difference(at), with.difference(at)},
                          {without.expanded(at), with.expanded(at)}));
      }
    }
  }
  std::erase(changed, "");
  if (changed.empty())
    changed.emplace_back("No statement on agreement differs between correlation 0 and the bounds.");
  std::ranges::move(changed, std::back_inserter(analysis.bound_statements));
}

ReferenceOptions options_of(const ComparisonProtocol& protocol) {
  return {.procedure = protocol.procedure,
          .level = protocol.level,
          .draws = protocol.draws,
          .seed = protocol.seed,
          .groups = protocol.kinds()};
}

void take_other_procedures(PilotAnalysis& analysis) {
  ReferenceOptions options = options_of(analysis.protocol);
  for (const auto& row : kReferenceProcedures.rows) {
    if (row.value == ReferenceProcedure::kMeanOrMedian || row.value == analysis.reference.procedure) continue;
    options.procedure = row.value;
    try {
      analysis.others.push_back(reference_value(analysis.transferred.results, options));
    } catch (const std::invalid_argument& error) {
      analysis.notes.push_back(
          fmt::format("procedure {} gives no reference value: {}", row.name, error.what()));
    }
  }
}

void take_link(PilotAnalysis& analysis) {
  std::vector<LinkingParticipant> linking;
  for (const ProtocolLink& link : analysis.protocol.links) {
    const auto at = std::ranges::find(analysis.participants, link.participant);
    if (at == analysis.participants.end()) {
      analysis.notes.push_back(link.participant + " has no result left and does not link the comparisons");
      continue;
    }
    linking.push_back(
        {.participant = static_cast<Index>(at - analysis.participants.begin()),
         .difference = VectorXd::Map(link.differences.data(), static_cast<Index>(link.differences.size())),
         .u = VectorXd::Map(link.uncertainty.data(), static_cast<Index>(link.uncertainty.size()))});
  }
  if (!linking.empty())
    analysis.linked = linked_differences(analysis.transferred.results, analysis.reference, linking);
}

}  // namespace

ComparedResult read_pilot_result(const ComparisonProtocol& protocol, const std::string& participant,
                                 const std::filesystem::path& file) {
  std::vector<ComparedResult> loaded = load_compared({file.string()}, {}, ResultSource::kReadings);
  std::vector<std::string> problems;
  if (loaded.size() != 1)
    throw KeyComparisonError(
        fmt::format("{}: {} results; required: a file with one", file.string(), loaded.size()));
  ComparedResult& result = loaded.front();
  if (!result.item_serial_number.empty() && result.item_serial_number != protocol.item_serial_number)
    problems.push_back(fmt::format("is of the item with serial number {}; required: {}, the artefact",
                                   result.item_serial_number, protocol.item_serial_number));
  if (result.item_serial_number.empty())
    result.notes.push_back("names no serial number: that the item is the artefact is taken for granted");
  try {
    convert(protocol, result);
  } catch (const CompareError& error) {
    problems.emplace_back(error.what());
  }
  std::vector<std::string> missing;
  const std::vector<Index> places = protocol.positions();
  for (const Index q : places)
    if (!std::isfinite(result.values(q)) || !(result.covariance(q, q) > 0.0))
      missing.emplace_back(kIntrinsicSymbols[static_cast<std::size_t>(q)]);
  if (!missing.empty())
    problems.push_back(fmt::format(
        "does not give {} with an uncertainty; required: every quantity of the comparison ([comparison] "
        "quantities leaves some out for all)",
        fmt::join(missing, ", ")));
  if (!result.with_correlations && participant_of(protocol, participant).correlations_required)
    problems.emplace_back(
        "does not give the covariance of its quantities; required: a certificate with correlations, or "
        "correlations = \"taken as zero\" of this participant, agreed in the protocol");
  throw_problems(fmt::format("{} is no result of this comparison", file.string()), problems);
  return std::move(result);
}

std::string PilotAnalysis::step_words() const {
  if (!transferred.step) return {};
  const ArtefactStep& step = *transferred.step;
  const auto q = static_cast<std::size_t>(step.quantity);
  return fmt::format(
      "The artefact changed between the pilot's measurements {} and {}: {} by {:.2g} {} (standard "
      "uncertainty "
      "{:.1g}), which {} does not explain (probability {:.1g}). Results before and after do not belong to "
      "one "
      "artefact.",
      measurements[step.before].number, measurements[step.after].number, protocol.quantities[q], step.change,
      units[q], step.u, protocol.drift != DriftModel::kNone ? "a drift along a line" : "repeatability",
      step.test.probability);
}

Message PilotAnalysis::verdict() const {
  const Message without = verdict_of(*this, *this);
  const Message with = at_bounds ? verdict_of(*this, *at_bounds) : without;
  if (without == with) return without;
  return {"Without correlation: {without} With the bounds of correlation: {with}", without, with};
}

CertificateDoubt doubt_of_register(const std::string& location, Clock::UtcTime now) {
  if (location.empty()) return {};
  auto opened = std::make_shared<lab::Register>(lab::Register::open(location, now));
  return [opened](const std::string& number) -> std::string {
    const std::optional<lab::CertificateStatus> status = opened->status_of(number);
    if (!status) return {};
    if (status->withdrawn)
      return fmt::format("was withdrawn on {} ({})", status->withdrawn->date(), status->withdrawn->reason);
    return status->amended_by.empty() ? std::string() : "was replaced by " + status->amended_by;
  };
}

PilotAnalysis analyse_comparison(const std::filesystem::path& protocol_file,
                                 const std::string& register_location, Clock::UtcTime now) {
  const ComparisonProtocol protocol = read_comparison_protocol(protocol_file);
  return analyse_comparison(protocol, ComparisonChain(protocol), doubt_of_register(register_location, now));
}

PilotAnalysis analyse_comparison(const ComparisonProtocol& protocol, const ComparisonChain& chain,
                                 const CertificateDoubt& doubt) {
  chain.require_protocol();
  PilotAnalysis analysis;
  analysis.protocol = protocol;
  analysis.chain_head = chain.head();
  analysis.notes = chain.changes();
  load_measurements(chain, doubt, analysis);
  choose_participants(analysis);
  require_like_axes(analysis);
  const std::array<std::string, 9> units = units_of_properties(in_unit_of(protocol));
  for (const Index q : protocol.positions()) analysis.units.push_back(units[static_cast<std::size_t>(q)]);
  note_common(analysis);
  const std::vector<ArtefactMeasurement> measurements = artefact_measurements(analysis);
  std::vector<double> coverage_factors;
  for (const std::string& name : analysis.participants)
    coverage_factors.push_back(participant_of(protocol, name).coverage_factor);
  const auto pilot = static_cast<std::size_t>(std::ranges::find(analysis.participants, protocol.pilot) -
                                              analysis.participants.begin());
  const auto repeats = std::ranges::count(measurements, pilot, &ArtefactMeasurement::participant);
  if (protocol.drift == DriftModel::kLineOrWalk && repeats == 2)
    analysis.notes.emplace_back(
        "the pilot measured twice: its drift is taken as a line, because two results cannot show a walk");
  if (protocol.drift != DriftModel::kNone && repeats == 2)
    analysis.notes.emplace_back(
        "the pilot measured twice: a line goes through any two results, so that a step of the artefact "
        "between "
        "them would be taken for drift");
  if (protocol.drift == DriftModel::kNone && repeats == 1)
    analysis.notes.emplace_back("the pilot measured once: whether the artefact changed is not known");
  const auto outcome_of = [&](const std::vector<SharedSource>& sources) {
    ComparisonOutcome outcome;
    outcome.transferred =
        transferred_results(measurements, sources, coverage_factors, pilot, protocol.drift, kNamingLevel);
    const ParticipantResults& results = outcome.transferred.results;
    outcome.consistency = consistency_of_participants(results);
    outcome.reference = reference_value(results, options_of(protocol));
    outcome.claims = test_claims(results, outcome.reference);
    outcome.faulty = faulty_participants(results, kNamingLevel);
    return outcome;
  };
  std::vector<SharedSource> sources = shared_sources(analysis);
  static_cast<ComparisonOutcome&>(analysis) = outcome_of(sources);
  if (std::vector<SharedSource> bounds = bounds_of_correlation(analysis); !bounds.empty()) {
    std::ranges::move(bounds, std::back_inserter(sources));
    analysis.at_bounds = outcome_of(sources);
    state_differences(analysis);
  }
  analysis.detectable = detectable_faults(analysis.transferred.results, kNamingLevel, kNamingPower);
  take_other_procedures(analysis);
  take_link(analysis);
  for (const ChainEntry& entry : chain.entries())
    if (entry.act == "statement") analysis.statements.emplace_back(entry.participant, entry.text);
  return analysis;
}

}  // namespace abcal
