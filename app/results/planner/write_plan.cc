#include "app/results/planner/write_plan.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include <sstream>
#include <stdexcept>
#include <utility>
#include <vector>

#include "app/bench_file/bench_config.h"

namespace abcal {
namespace {

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

/// Replaces the value of a key of [protocol], or adds the key below the heading.
void set_value(std::vector<std::string>& lines, const toml::table& protocol, const std::string& key,
               const std::string& value) {
  if (const toml::node* node = protocol.get(key)) {
    const toml::source_region& at = node->source();
    std::string& line = lines.at(at.begin.line - 1);
    if (at.begin.line == at.end.line)
      line.replace(at.begin.column - 1, at.end.column - at.begin.column, value);
    return;
  }
  // Behind the heading and on its line, so that the numbers of the other lines stay.
  lines.at(protocol.source().begin.line - 1) += fmt::format("\n{} = {}", key, value);
}

}  // namespace

std::string with_protocol(const std::string& bench_toml, const ProtocolConfig& protocol,
                          const std::string& source, const RecordLookup& lookup) {
  std::vector<std::pair<std::string, std::string>> values{
      {"steps", std::to_string(protocol.steps)},
      {"step_deg", fmt::format("{}", protocol.step.deg())},
      {"dwell_readings", std::to_string(protocol.dwell_readings)}};
  const toml::table root = toml::parse(bench_toml, source);
  // A file that does not name the faces has one; one that does not name the motion measures in steps.
  if (protocol.faces != 1 || root.at_path("protocol.faces"))
    values.emplace_back("faces", std::to_string(protocol.faces));
  if (protocol.is_constant_rate() || root.at_path("protocol.motion"))
    values.emplace_back("motion", fmt::format("\"{}\"", protocol.motion));
  if (protocol.is_constant_rate()) {
    values.emplace_back("rate_deg_per_s", fmt::format("[{}]", fmt::join(protocol.rate_deg_per_s, ", ")));
    values.emplace_back("sweeps", std::to_string(protocol.sweeps));
    values.emplace_back("stops", std::to_string(protocol.stops));
    values.emplace_back("acceleration_deg_per_s2", fmt::format("{}", protocol.acceleration_deg_per_s2));
  }
  std::vector<std::string> lines = lines_of(bench_toml);
  if (const toml::table* table = root["protocol"].as_table()) {
    for (const auto& [key, value] : values) set_value(lines, *table, key, value);
  } else {
    lines.emplace_back("\n[protocol]");
    for (const auto& [key, value] : values) lines.push_back(fmt::format("{} = {}", key, value));
  }
  std::string changed;
  for (const std::string& line : lines) changed += line + "\n";

  BenchConfig wanted = parse_bench(bench_toml, source, lookup);
  ProtocolConfig& planned = wanted.protocol;
  planned.steps = protocol.steps;
  planned.step = protocol.step;
  planned.faces = protocol.faces;
  planned.dwell_readings = protocol.dwell_readings;
  planned.motion = protocol.motion;
  if (protocol.is_constant_rate()) {
    planned.rate_deg_per_s = protocol.rate_deg_per_s;
    planned.sweeps = protocol.sweeps;
    planned.stops = protocol.stops;
    planned.acceleration_deg_per_s2 = protocol.acceleration_deg_per_s2;
  }
  bool as_meant = false;
  try {
    BenchConfig found = parse_bench(changed, source, lookup);
    // Effects that only turning brings in, and the truth of a simulated bench, follow from the plan.
    for (BenchConfig* each : {&found, &wanted})
      for (BenchItemConfig& item : each->items) item.tolerances = with_effects_of_motion(item.tolerances);
    wanted.simulation = found.simulation;
    for (std::size_t k = 0; k < wanted.items.size() && k < found.items.size(); ++k)
      wanted.items[k].simulation = found.items[k].simulation;
    as_meant = found.is_same_bench(wanted);
  } catch (const std::exception&) {
    as_meant = false;  // Reported below.
  }
  if (!as_meant) {
    std::vector<std::string> keys;
    for (const auto& [key, value] : values) keys.push_back(fmt::format("{} = {}", key, value));
    throw std::runtime_error(fmt::format("{} cannot be changed by the program; set under [protocol]: {}",
                                         source, fmt::join(keys, ", ")));
  }
  return changed;
}

}  // namespace abcal
