#include "app/laboratory/pilot/comparison_protocol.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cstdint>
#include <set>
#include <span>
#include <stdexcept>

#include "app/formats/toml_reader.h"
#include "app/laboratory/certificate/laboratory_file.h"
#include "protocol/plan/run_config.h"
#include "protocol/quantities/output_names.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr std::size_t kFewestParticipants = 3;

std::vector<std::string> intrinsic_symbols() {
  return {kIntrinsicSymbols.begin(), kIntrinsicSymbols.end()};
}

/// A list with one number above 0 for each quantity of the protocol.
void read_list(TomlReader& keys, const std::string& key, std::vector<double>& list, Range range,
               std::size_t size) {
  keys.numbers(key, list, range);
  if (keys.has(key) && list.size() != size)
    keys.add_problem_at(keys.line(), keys.name(key), fmt::format("{} numbers", list.size()),
                        fmt::format("{}: one for each quantity of the comparison, in its order", size));
}

void read_comparison(TomlReader& keys, ComparisonProtocol& protocol) {
  keys.section("comparison");
  keys.required_text("name", protocol.name);
  keys.required_text("pilot", protocol.pilot);
  keys.required_text("item_serial_number", protocol.item_serial_number);
  keys.required_text("response_unit", protocol.response_unit);
  keys.texts("quantities", protocol.quantities, intrinsic_symbols());
  if (protocol.quantities.empty()) protocol.quantities = intrinsic_symbols();
  std::string procedure(kReferenceProcedures.of(protocol.procedure)), drift = "none";
  keys.text("procedure", procedure, kReferenceProcedures.all());
  protocol.procedure = kReferenceProcedures.value(procedure).value_or(protocol.procedure);
  keys.text(
      "drift", drift,
      {"none", "line per transfer", "line per day", "line or walk per transfer", "line or walk per day"});
  protocol.drift = drift == "none"                     ? DriftModel::kNone
                   : drift.starts_with("line or walk") ? DriftModel::kLineOrWalk
                                                       : DriftModel::kLine;
  protocol.drift_per_day = drift.ends_with("per day");
  keys.number("level", protocol.level, {0.001, 0.2});
  constexpr int kFewestDraws = 1000, kMostDraws = 1'000'000;
  keys.integer("draws", protocol.draws, kFewestDraws, kMostDraws);
  keys.seed("seed", protocol.seed);
  const std::size_t size = protocol.quantities.size();
  read_list(keys, "repeatability", protocol.repeatability, kPositive, size);
  read_list(keys, "sigma_pt", protocol.sigma_pt, kPositive, size);
}

void read_participants(TomlReader& keys, ComparisonProtocol& protocol) {
  keys.section("");
  keys.tables("participant", 0, [&](std::size_t) {
    ProtocolParticipant& one = protocol.participants.emplace_back();
    keys.required_text("name", one.name);
    keys.number("coverage_factor", one.coverage_factor, {1.0, 10.0});
    std::string correlations = "required";
    keys.text("correlations", correlations, {"required", "taken as zero"});
    one.correlations_required = correlations == "required";
    if (std::ranges::count(protocol.participants, one.name, &ProtocolParticipant::name) > 1)
      keys.add_problem_at(keys.line(), "participant.name", "\"" + one.name + "\" again",
                          "a name for each participant");
  });
  if (protocol.participants.size() < kFewestParticipants)
    keys.add_problem("participant", fmt::format("{} participants", protocol.participants.size()),
                     "three or more: of two that disagree nobody can say which is right, and `abcal compare` "
                     "says whether they agree");
}

/// A name that a participant of the protocol has.
void require_participant(TomlReader& keys, const ComparisonProtocol& protocol, const std::string& key,
                         const std::string& name) {
  if (name.empty() || std::ranges::find(protocol.participants, name, &ProtocolParticipant::name) !=
                          protocol.participants.end())
    return;
  keys.add_problem_at(keys.line(), keys.name(key), "\"" + name + "\"", "the name of a [[participant]]");
}

void read_schedule(TomlReader& keys, ComparisonProtocol& protocol) {
  keys.section("");
  keys.tables("measurement", 0, [&](std::size_t) {
    ScheduledMeasurement& one = protocol.schedule.emplace_back();
    keys.required_text("participant", one.participant);
    std::optional<Date> date;
    keys.date("date", date);
    if (date) one.date = format_date(*date);
    require_participant(keys, protocol, "participant", one.participant);
  });
  const auto count_of = [&](const std::string& name) {
    return std::ranges::count(protocol.schedule, name, &ScheduledMeasurement::participant);
  };
  for (const ProtocolParticipant& one : protocol.participants) {
    if (count_of(one.name) == 0)
      keys.add_problem("measurement", "none by " + one.name, "a [[measurement]] of each participant");
    if (count_of(one.name) > 1 && one.name != protocol.pilot)
      keys.add_problem("measurement", fmt::format("{} by {}", count_of(one.name), one.name),
                       "one; several by the pilot alone");
  }
  const auto repeats = count_of(protocol.pilot);
  if (protocol.drift != DriftModel::kNone && repeats < 2)
    keys.add_problem("comparison.drift", fmt::format("a drift, and {} measurement by the pilot", repeats),
                     "two measurements by the pilot; three show whether it is a line");
  if (repeats > 1 && protocol.repeatability.empty())
    keys.add_problem(
        "comparison.repeatability", "nothing, and several measurements by the pilot",
        "the standard uncertainty of the part that differs between its repeats, for each quantity");
}

/// Reports a last bound whose correlation is not possible, and a pair of participants with a bound before:
/// bounds of one pair would add up, or cancel.
void check_bound(TomlReader& keys, const std::vector<ProtocolBound>& bounds) {
  const ProtocolBound& one = bounds.back();
  if (one.correlation == 0.0)
    keys.add_missing("correlation", "the largest correlation that is possible, from -1 to 1 and not 0");
  const double least = -1.0 / std::max(1.0, static_cast<double>(one.participants.size()) - 1.0);
  if (one.correlation >= 1.0 || one.correlation <= least)
    keys.add_problem_at(keys.line(), keys.name("correlation"), fmt::format("{:g}", one.correlation),
                        fmt::format("above {:g}, the least that {} results can have, and below 1", least,
                                    one.participants.size()));
  const auto common = [](const std::vector<std::string>& a, const std::vector<std::string>& b) {
    std::set<std::string> both;
    for (const std::string& name : a)
      if (std::ranges::find(b, name) != b.end()) both.insert(name);
    return both;
  };
  for (const ProtocolBound& other : std::span(bounds).first(bounds.size() - 1)) {
    const std::set<std::string> pair = common(one.participants, other.participants);
    if (pair.size() < 2 || common(one.quantities, other.quantities).empty()) continue;
    keys.add_problem_at(
        keys.line(), keys.name("participants"), fmt::format("{}", fmt::join(pair, ", ")),
        fmt::format(
            "one bound for them; \"{}\" is another: state the largest correlation of all their causes",
            other.name));
  }
}

void read_common(TomlReader& keys, ComparisonProtocol& protocol) {
  const std::size_t size = protocol.quantities.size();
  keys.section("");
  keys.tables("shared", 0, [&](std::size_t) {
    ProtocolSource& one = protocol.shared.emplace_back();
    keys.required_text("name", one.name);
    keys.texts("participants", one.participants);
    read_list(keys, "uncertainty", one.uncertainty, kNotNegative, size);
    keys.boolean("together", one.together);
    for (const std::string& name : one.participants)
      require_participant(keys, protocol, "participants", name);
    if (one.participants.size() < 2)
      keys.add_missing("participants", "the names of two participants or more");
    if (one.uncertainty.empty()) keys.add_missing("uncertainty", "one number for each quantity");
  });
  keys.section("");
  keys.tables("correlation_bound", 0, [&](std::size_t) {
    ProtocolBound& one = protocol.correlation_bounds.emplace_back();
    keys.required_text("name", one.name);
    keys.texts("participants", one.participants);
    keys.number("correlation", one.correlation, {-1.0, 1.0});
    keys.texts("quantities", one.quantities, protocol.quantities);
    if (one.quantities.empty()) one.quantities = protocol.quantities;
    for (const std::string& name : one.participants)
      require_participant(keys, protocol, "participants", name);
    if (std::set<std::string>(one.participants.begin(), one.participants.end()).size() < 2)
      keys.add_problem_at(keys.line(), keys.name("participants"),
                          fmt::format("{}", fmt::join(one.participants, ", ")),
                          "the names of two participants or more");
    check_bound(keys, protocol.correlation_bounds);
  });
  keys.section("link");
  keys.text("comparison", protocol.linked_comparison);
  keys.section("");
  keys.tables("linking_participant", 0, [&](std::size_t) {
    ProtocolLink& one = protocol.links.emplace_back();
    keys.required_text("participant", one.participant);
    require_participant(keys, protocol, "participant", one.participant);
    read_list(keys, "differences", one.differences, kAny, size);
    read_list(keys, "uncertainty", one.uncertainty, kPositive, size);
    if (one.differences.empty()) keys.add_missing("differences", "its earlier degrees of equivalence");
    if (one.uncertainty.empty()) keys.add_missing("uncertainty", "their standard uncertainties");
  });
}

}  // namespace

Message ProtocolBound::words() const {
  return {"{source}: the correlation of {participants} in {quantities} lies between 0 and {bound:g}.", name,
          fmt::format("{}", fmt::join(participants, ", ")), fmt::format("{}", fmt::join(quantities, " ")),
          correlation};
}

Eigen::Index ComparisonProtocol::place(const std::string& symbol) const {
  return std::ranges::find(quantities, symbol) - quantities.begin();
}

std::vector<Eigen::Index> ComparisonProtocol::positions() const {
  std::vector<Eigen::Index> places;
  for (const std::string& symbol : quantities)
    places.push_back(std::ranges::find(kIntrinsicSymbols, symbol) - kIntrinsicSymbols.begin());
  return places;
}

std::size_t ComparisonProtocol::participant(const std::string& participant_name) const {
  const auto found = std::ranges::find(participants, participant_name, &ProtocolParticipant::name);
  if (found == participants.end()) throw std::out_of_range(participant_name);
  return static_cast<std::size_t>(found - participants.begin());
}

std::vector<std::vector<Eigen::Index>> ComparisonProtocol::kinds() const {
  std::vector<std::vector<Eigen::Index>> kinds;
  for (const char* first : {"s", "p", "O"}) {
    std::vector<Eigen::Index> kind;
    for (std::size_t q = 0; q < quantities.size(); ++q)
      if (quantities[q].starts_with(first)) kind.push_back(static_cast<Eigen::Index>(q));
    if (!kind.empty()) kinds.push_back(std::move(kind));
  }
  return kinds;
}

ComparisonProtocol parse_comparison_protocol(std::string_view text, const std::string& source) {
  ComparisonProtocol protocol;
  protocol.path = source;
  protocol.sha256 = sha256_of(text);
  std::vector<Problem> problems;
  const toml::table root = parse_toml(
      text, source, "a protocol of a comparison; `abcal pilot init FILE` writes an example", problems);
  if (!(root.empty() && !problems.empty())) {
    TomlReader keys(root, {}, text);
    std::string schema(kComparisonSchema);
    keys.section("");
    keys.text("schema", schema, {schema});
    read_comparison(keys, protocol);
    read_participants(keys, protocol);
    keys.section("comparison");
    require_participant(keys, protocol, "pilot", protocol.pilot);
    read_schedule(keys, protocol);
    read_common(keys, protocol);
    keys.report_unknown();
    for (Problem& problem : keys.take_problems()) problems.push_back(std::move(problem));
  }
  if (!problems.empty())
    throw KeyComparisonError(fmt::format("protocol {}: {} problem{}{}", source, problems.size(),
                                         problems.size() == 1 ? "" : "s", list_of(problems)));
  return protocol;
}

ComparisonProtocol read_comparison_protocol(const std::filesystem::path& path) {
  std::vector<Problem> unreadable;
  const std::string text = read_text_file(path.string(), "protocol of a comparison", unreadable);
  if (!unreadable.empty())
    throw KeyComparisonError(fmt::format("protocol {}:{}", path.string(), list_of(unreadable)));
  return parse_comparison_protocol(text, path.string());
}

std::string example_protocol() {
  return R"(# Protocol of a comparison of triaxial accelerometers. All participants agree on it before the first measurement.
schema = "abcal.comparison/1"

[comparison]
name = "Comparison of three laboratories"
pilot = "LAB1"                  # measures at the start, between, and at the end
item_serial_number = "17"       # of the artefact
response_unit = "V"             # sensitivities are per m/s2, angles in degrees, offsets in this unit
procedure = "A-or-B"            # or "A", "B", "subset", "subset-per-quantity", "random-effects"
drift = "line per transfer"     # or "none", "line per day", "line or walk per transfer", "line or walk per day"
# Standard uncertainty of the part that differs between the pilot's repeats: s_u s_v s_w, phi_uv phi_vw phi_wu, O_u O_v O_w.
repeatability = [1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 2e-6, 2e-6, 2e-6]

[[participant]]
name = "LAB1"

[[participant]]
name = "LAB2"
coverage_factor = 2.0           # k of its expanded uncertainties for 95 %

[[participant]]
name = "LAB3"
correlations = "required"       # or "taken as zero", for a certificate that states none

# The schedule: one measurement after the other.
[[measurement]]
participant = "LAB1"
date = 2026-02-02

[[measurement]]
participant = "LAB2"
date = 2026-03-02

[[measurement]]
participant = "LAB1"
date = 2026-04-06

[[measurement]]
participant = "LAB3"
date = 2026-05-04

[[measurement]]
participant = "LAB1"
date = 2026-06-01

# What participants have in common: the record of a stage, a value of gravity, a check standard.
# [[shared]]
# name = "polygon P-3"
# participants = ["LAB2", "LAB3"]
# uncertainty = [0, 0, 0, 1e-4, 1e-4, 1e-4, 0, 0, 0]
# together = false              # true: one effect that moves all quantities at the same time, such as gravity

# A correlation of certificates that is possible and not known: the comparison is analysed without it and with this bound.
# [[correlation_bound]]
# name = "gravity network"
# participants = ["LAB2", "LAB3"]
# correlation = 0.5             # the largest one that is possible, between -1 and 1
# quantities = ["s_u", "s_v", "s_w"]  # default: all of the comparison

# Link to an earlier comparison by participants of both.
# [link]
# comparison = "its name"
# [[linking_participant]]
# participant = "LAB1"
# differences = [0, 0, 0, 0, 0, 0, 0, 0, 0]
# uncertainty = [1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 2e-6, 2e-6, 2e-6]
)";
}

}  // namespace abcal
