#include "app/bench_file/bench_config.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <functional>
#include <nlohmann/json.hpp>

#include "app/bench_file/bench_consistency.h"
#include "app/bench_file/bench_keys.h"
#include "app/bench_file/bench_records.h"
#include "app/formats/toml_reader.h"
#include "app/formats/toml_writer.h"
#include "drivers/instrument/driver_catalogue.h"

namespace abcal {
BenchError::BenchError(const std::string& file, std::vector<Problem> problems)
    : std::runtime_error([&] {
        std::string text = fmt::format("bench file {}: {} problem{}", file, problems.size(),
                                       problems.size() == 1 ? "" : "s");
        text += list_of(problems);
        return text;
      }()),
      problems_(std::move(problems)) {}

bool BenchConfig::turned_by_hand() const {
  return !stage.split() && stage.driver != "simulated" &&
         !find_in(driver_catalogue().stages, stage.driver).has_port;
}

BenchConfig parse_bench(std::string_view text, const std::string& source) {
  return parse_bench(text, source, {});
}

namespace {

/// @param edit  changes the table before it is read
BenchConfig parse(std::string_view text, const std::string& source, const RecordLookup& lookup,
                  const std::function<void(toml::table&)>& edit) {
  std::vector<Problem> unreadable;
  toml::table root =
      parse_toml(text, source, "a bench file; commented examples are in docs/examples", unreadable);
  if (root.empty() && !unreadable.empty()) throw BenchError(source, std::move(unreadable));
  edit(root);
  BenchConfig config;
  TomlReader reader(root, lookup, text);
  visit_bench_file(reader, config);
  check_together(reader, root, config);
  reader.report_unknown();
  // The table of a file that is not TOML is that of its corrected lines: other mistakes are reported at the
  // same time.
  for (Problem& problem : reader.take_problems()) unreadable.push_back(std::move(problem));
  if (!unreadable.empty()) throw BenchError(source, std::move(unreadable));
  return config;
}

}  // namespace

BenchConfig parse_bench(std::string_view text, const std::string& source, const RecordLookup& lookup) {
  return parse(text, source, lookup, [](toml::table&) {});
}

BenchConfig parse_drawn_bench(std::string_view text, const std::string& source, std::uint64_t seed) {
  return parse(text, source, {}, [seed](toml::table& root) {
    root.insert("simulation", toml::table{});
    toml::table* simulation = root["simulation"].as_table();
    if (simulation == nullptr) return;  // The reader reports it.
    simulation->insert_or_assign("draw", kDrawStated);
    simulation->insert_or_assign("seed", static_cast<std::int64_t>(seed));
  });
}

BenchConfig read_bench(const std::filesystem::path& path) {
  return read_bench(path, {});
}

BenchConfig read_bench(const std::filesystem::path& path, const RecordLookup& lookup) {
  std::vector<Problem> unreadable;
  const std::string text = read_text_file(path.string(), "bench file", unreadable);
  if (!unreadable.empty()) throw BenchError(path.string(), std::move(unreadable));
  return parse_bench(text, path.string(), lookup);
}

namespace {

/// JSON as TOML, so that one reader checks both.
toml::table table_from(const nlohmann::json& json);
toml::array array_from(const nlohmann::json& json);

void insert(const nlohmann::json& value, const auto& put) {
  if (value.is_boolean()) {
    put(value.get<bool>());
  } else if (value.is_number_integer()) {
    put(value.get<std::int64_t>());
  } else if (value.is_number()) {
    put(value.get<double>());
  } else if (value.is_string()) {
    put(value.get<std::string>());
  } else if (value.is_array()) {
    put(array_from(value));
  } else if (value.is_object()) {
    put(table_from(value));
  }  // null: as if the key were absent
}

toml::table table_from(const nlohmann::json& json) {
  toml::table table;
  for (const auto& [key, value] : json.items()) {
    insert(value, [&, name = key](auto&& v) { table.insert_or_assign(name, std::move(v)); });
  }
  return table;
}

toml::array array_from(const nlohmann::json& json) {
  toml::array array;
  for (const nlohmann::json& entry : json) insert(entry, [&](auto&& v) { array.push_back(std::move(v)); });
  return array;
}

/// Reads one table with `visit_entry`; every problem at once.
void parse_one(const nlohmann::json& object, const std::function<void(KeyVisitor&)>& visit_entry) {
  if (!object.is_object()) throw BenchError("line", {{"the line", "no JSON object", "a JSON object"}});
  const toml::table table = table_from(object);
  TomlReader reader(table);
  reader.section("");
  visit_entry(reader);
  reader.report_unknown();
  if (auto problems = reader.take_problems(); !problems.empty())
    throw BenchError("line", std::move(problems));
}

}  // namespace

FaultConfig parse_fault(const nlohmann::json& json) {
  FaultConfig fault;
  parse_one(json, [&](KeyVisitor& keys) { visit_fault(keys, fault); });
  if (const auto problem = problem_of(fault))
    throw BenchError("line", {{"instrument", *problem, "one of both"}});
  return fault;
}

ChangeConfig parse_change(const nlohmann::json& json, const sim::OutputTruth& now) {
  ChangeConfig change{0.0, now};
  parse_one(json, [&](KeyVisitor& keys) { visit_change(keys, change); });
  return change;
}

std::string write_bench(const BenchConfig& config) {
  BenchConfig copy = config;
  TomlWriter writer;
  visit_bench_file(writer, copy);
  return writer.take_text();
}

}  // namespace abcal
