#include "app/results/planner/write_plan.h"

#include <fmt/format.h>
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
  // A file that does not name the faces has one.
  if (protocol.faces != 1 || root.at_path("protocol.faces"))
    values.emplace_back("faces", std::to_string(protocol.faces));
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
  wanted.protocol.steps = protocol.steps;
  wanted.protocol.step = protocol.step;
  wanted.protocol.faces = protocol.faces;
  wanted.simulation.stands_in_second_face = protocol.faces == 2;
  wanted.protocol.dwell_readings = protocol.dwell_readings;
  bool as_meant = false;
  try {
    as_meant = parse_bench(changed, source, lookup).is_same_bench(wanted);
  } catch (const std::exception&) {
    as_meant = false;  // Reported below.
  }
  if (!as_meant) {
    throw std::runtime_error(
        fmt::format("{} cannot be changed by the program; set under [protocol]: steps = {}, step_deg = {}, "
                    "dwell_readings = {}, faces = {}",
                    source, protocol.steps, protocol.step.deg(), protocol.dwell_readings, protocol.faces));
  }
  return changed;
}

}  // namespace abcal
