#include "app/results/logs/table_mapping.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <toml++/toml.h>
#include <array>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "app/formats/toml_reader.h"
#include "app/formats/toml_writer.h"
#include "app/system/output_file.h"
#include "protocol/record/table_time.h"

namespace abcal {
namespace {

constexpr const char* kSchema = "abcal.mapping/1";

/// Statements of a mapping, with their keys.
constexpr std::array<std::pair<std::string_view, std::string TableOptions::*>, 4> kStatements{
    {{"columns", &TableOptions::columns},
     {"unit", &TableOptions::unit},
     {"time_unit", &TableOptions::time_unit},
     {"topic", &TableOptions::topic}}};

std::vector<std::string> choices_of(std::string_view key) {
  if (key != "time_unit") return {};
  std::vector<std::string> names;
  for (const UnitOfTime& unit : kUnitsOfTime) names.emplace_back(unit.name);
  return names;
}

TableOptions read_mapping(const std::filesystem::path& path) {
  std::vector<Problem> problems;
  const std::string text = read_text_file(path.string(), "mapping of a table", problems);
  TableOptions stated;
  if (problems.empty()) {
    const toml::table root =
        parse_toml(text, path.string(),
                   "a mapping of a table, which --keep-mapping writes; docs/your_file.md", problems);
    if (!root.empty()) {
      TomlReader keys(root, {}, text);
      std::string schema;
      keys.section("");
      keys.required_text("schema", schema, {kSchema});
      for (const auto& [key, statement] : kStatements)
        keys.text(std::string(key), stated.*statement, choices_of(key));
      keys.report_unknown();
      for (Problem& problem : keys.take_problems()) problems.push_back(std::move(problem));
    }
  }
  if (!problems.empty())
    throw std::runtime_error(fmt::format("mapping {}: {} problem{}{}", path.string(), problems.size(),
                                         problems.size() == 1 ? "" : "s", list_of(problems)));
  return stated;
}

}  // namespace

std::filesystem::path mapping_path(const std::filesystem::path& table) {
  return table.string() + ".mapping.toml";
}

TableOptions with_mapping(const std::filesystem::path& table, const TableOptions& options,
                          std::string& words) {
  const std::filesystem::path path = mapping_path(table);
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return options;
  const TableOptions stated = read_mapping(path);
  TableOptions all = options;
  std::vector<std::string> taken;
  for (const auto& [key, statement] : kStatements) {
    if (!(all.*statement).empty() || (stated.*statement).empty()) continue;
    all.*statement = stated.*statement;
    taken.emplace_back(key);
    const std::string by = fmt::format("{}, {}", path.filename().string(), key);
    if (key == "columns") all.columns_by = by;
    if (key == "time_unit") all.time_unit_by = by;
  }
  if (!taken.empty())
    words = fmt::format("{} as {} states", fmt::join(taken, ", "), path.filename().string());
  return all;
}

void keep_mapping(const std::filesystem::path& table, TableOptions options) {
  TomlWriter writer;
  std::string schema = kSchema;
  writer.text("schema", schema);
  bool states = false;
  // By the name that a mapping has for it: "ms" of "millis".
  if (const UnitOfTime* unit = unit_of_time(options.time_unit)) options.time_unit = unit->name;
  for (const auto& [key, statement] : kStatements) {
    if ((options.*statement).empty()) continue;
    states = true;
    writer.text(std::string(key), options.*statement);
  }
  if (!states)
    throw std::invalid_argument(
        fmt::format("--keep-mapping: nothing is stated of {}; required: --columns, --unit, --time-unit or "
                    "--topic as well",
                    table.string()));
  OutputFile(mapping_path(table)).write(writer.take_text());
}

}  // namespace abcal
