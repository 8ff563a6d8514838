#include "app/results/analysis/other_file.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <algorithm>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/formats/toml_reader.h"
#include "app/results/analysis/measurement_file.h"

namespace abcal {
namespace {

/// The file as TOML; nothing if it is none. A CSV fails at its header.
std::optional<toml::table> as_toml(const std::filesystem::path& path) {
  std::vector<Problem> problems;
  const std::string text = read_text_file(path.string(), "file", problems);
  if (!problems.empty()) return std::nullopt;
  toml::table table = parse_toml(text, path.string(), "TOML", problems);
  if (!problems.empty() || table.empty()) return std::nullopt;
  return table;
}

bool is_bench(const toml::table& table) {
  if (const auto schema = table["schema"].value<std::string>()) return schema->starts_with("abcal.bench/");
  return table.contains("stage") || table.contains("accelerometer");
}

[[noreturn]] void refuse(const std::filesystem::path& path, const char* what, const char* wanted,
                         const std::string& help) {
  throw std::runtime_error(fmt::format("{}: is {}; required: {}{}", path.string(), what, wanted, help));
}

}  // namespace

std::string beginning_of_file(const std::filesystem::path& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) return {};
  std::ifstream file(path, std::ios::binary);
  std::string start(4096, '\0');
  file.read(start.data(), static_cast<std::streamsize>(start.size()));
  start.resize(static_cast<std::size_t>(file.gcount()));
  if (start.starts_with("\xef\xbb\xbf")) start.erase(0, 3);
  return start.erase(0, std::min(start.find_first_not_of(" \t\r\n"), start.size()));
}

bool looks_like_xml(const std::filesystem::path& path) {
  return beginning_of_file(path).starts_with('<');
}

void refuse_other_file(const std::filesystem::path& path, const char* wanted) {
  const std::string start = beginning_of_file(path);
  if (start.empty()) return;
  if (start.starts_with('<'))
    refuse(path, "XML, such as a certificate", wanted, ". Only `abcal compare` reads certificates");
  if (looks_like_measurement(path))
    refuse(path, "a measurement of several runs", wanted,
           ", one of those that it names (docs/measurements.md lists the commands that take a measurement)");
  if (start.starts_with('{')) refuse(path, "JSON", wanted, ", not the JSON of a result");
  const bool is_named_toml = path.extension() == ".toml";
  // A text without "=" or a heading in brackets is not TOML: nothing is parsed.
  if (!is_named_toml && start.find('=') == std::string::npos && !start.starts_with('[')) return;
  const auto table = as_toml(path);
  if (table && is_bench(*table))
    refuse(path, "a bench file", wanted, fmt::format(". `abcal run {}` measures a run", path.string()));
  if (table || is_named_toml) refuse(path, "a TOML file", wanted, ". `abcal run BENCH` measures a run");
}

}  // namespace abcal
