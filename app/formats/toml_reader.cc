#include "app/formats/toml_reader.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <optional>
#include <sstream>

#include "app/formats/toml_mistake.h"
#include "app/system/nearest_word.h"
#include "app/system/output.h"

namespace abcal {
namespace {

// The part of a file that a message shows, in bytes: enough to find the place.
constexpr std::size_t kLongestShown = 200;
constexpr std::size_t kLongestRequired = 1000;
constexpr std::size_t kMostProblems = 50;
constexpr std::size_t kLongestExcerpt = 160;

constexpr std::size_t kLargestTomlFile = 16U << 20U;  // bytes
// Parts of one key, and brackets within each other. Our files are far below (3 and 2); tables within tables
// without end would exhaust the stack.
constexpr std::size_t kDeepestToml = 16;

constexpr std::string_view kFrom = "from", kName = "name";  // Keys of a reference to a record.

Problem shown_problem(const std::string& where, const std::string& found, const std::string& required) {
  return {shortened_text(where, kLongestShown), shortened_text(found, kLongestShown),
          shortened_text(required, kLongestRequired)};
}

/// One pass over a TOML text that recognises strings and comments only.
class NestingCheck {
 public:
  explicit NestingCheck(std::string_view text) : text_(text) {}

  /// The first line that nests too deeply; absent if none does.
  std::optional<std::size_t> line_too_deep() {
    while (position_ < text_.size()) {
      const char c = text_[position_];
      if (c == '#') {
        position_ = std::min(text_.find('\n', position_), text_.size());
        continue;
      }
      if (c == '"' || c == '\'') {
        skip_string(c);
        continue;
      }
      ++position_;
      count(c);
      if (dots_ >= kDeepestToml || brackets_ > kDeepestToml) return line_;
    }
    return std::nullopt;
  }

 private:
  void count(char c) {
    if (c == '.') ++dots_;
    if (c == '\n') ++line_;
    if (c == '[' || c == '{') ++brackets_;
    if ((c == ']' || c == '}') && brackets_ > 0) --brackets_;
    if (std::string_view("\n=,[]{}").find(c) != std::string_view::npos) dots_ = 0;
  }

  void skip_string(char quote) {
    const std::string triple(3, quote);
    const bool has_lines = text_.substr(position_, 3) == triple;
    position_ += has_lines ? 3 : 1;
    while (position_ < text_.size()) {
      const char c = text_[position_];
      if (c == '\n' && !has_lines) return;  // Not closed: the parser reports it.
      if (has_lines ? text_.substr(position_, 3) == triple : c == quote) {
        position_ += has_lines ? 3 : 1;
        return;
      }
      if (c == '\n') ++line_;
      position_ += c == '\\' && quote == '"' ? 2 : 1;
    }
  }

  std::string_view text_;
  std::size_t position_ = 0, line_ = 1, dots_ = 0, brackets_ = 0;
};

std::string words_of(const toml::node& node) {
  std::ostringstream text;
  if (const auto* string = node.as_string()) {
    text << '"' << string->get() << '"';
  } else if (node.is_table()) {
    text << "a table";
  } else if (node.is_array()) {
    text << "an array of " << node.as_array()->size();
  } else if (const auto number = node.as_floating_point()) {
    text << number->get();
  } else if (const auto whole = node.as_integer()) {
    text << whole->get();
  } else if (const auto truth = node.as_boolean()) {
    text << (truth->get() ? "true" : "false");
  } else if (const auto date = node.as_date()) {
    text << date->get();
  } else {
    text << "a time";
  }
  return text.str();
}

std::vector<std::string_view> lines_of(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    if (line.ends_with('\r')) line.remove_suffix(1);
    lines.push_back(line);
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

bool is_control(char c) {
  return static_cast<unsigned char>(c) < 0x20 || c == 0x7f;
}

/// A problem with its line, if that is short enough and has no character that moves a terminal's cursor.
/// @param column  in characters from 1
void show_line(Problem& problem, std::string_view line, std::size_t column, const std::string& corrected) {
  if (line.empty() || line.size() > kLongestExcerpt) return;
  problem.excerpt = line;
  std::ranges::replace_if(problem.excerpt, is_control, ' ');
  problem.column = column;
  problem.corrected = corrected;
  std::ranges::replace_if(problem.corrected, is_control, ' ');
}

/// Bytes before a column, which toml++ counts in characters from 1.
std::size_t bytes_before(std::string_view line, std::size_t column) {
  std::size_t at = 0;
  for (std::size_t k = 1; k < column && at < line.size(); ++k) {
    ++at;
    while (at < line.size() && (static_cast<unsigned char>(line[at]) & 0xc0U) == 0x80) ++at;
  }
  return at;
}

/// The key that a word may mean: the word with its unit behind it ("rate" for "rate_hz"), else the nearest
/// one.
std::string meant_key(std::string_view written, const std::set<std::string>& known) {
  static constexpr std::array<std::string_view, 14> kUnits{"hz",   "mps2", "s",         "ms",      "deg",
                                                           "degc", "v",    "mv_per_g",  "percent", "hpa",
                                                           "m",    "g",    "deg_per_s", "ohm"};
  for (const std::string_view unit : kUnits) {
    std::string with_unit = std::string(written) + "_" + std::string(unit);
    if (known.contains(with_unit)) return with_unit;
  }
  return nearest_word(written, {known.begin(), known.end()});
}

/// Whether a text is a number, a date or a boolean of TOML, which are written without quotes.
bool is_value_without_quotes(const std::string& text) {
  if (text.empty() || text.find_first_of("\"'\\\n") != std::string::npos) return false;
  try {
    const toml::table parsed = toml::parse("value = " + text);
    const toml::node* value = parsed.get("value");
    return parsed.size() == 1 && value != nullptr && value->is_value() && !value->is_string();
  } catch (const toml::parse_error&) {
    return false;
  }
}

std::string parent_of(const std::string& path) {
  const auto dot = path.rfind('.');
  return dot == std::string::npos ? std::string() : path.substr(0, dot);
}
std::string at(std::uint32_t line) {
  return line == 0 ? "" : fmt::format("line {}, ", line);
}
/// "[stage.x] sign" for "stage.x.sign".
std::string display(const std::string& name) {
  const std::string parent = parent_of(name);
  return parent.empty() ? name : "[" + parent + "] " + name.substr(parent.size() + 1);
}
std::optional<double> number_of(const toml::node& node) {
  if (const auto* real = node.as_floating_point()) return real->get();
  if (const auto* whole = node.as_integer()) return static_cast<double>(whole->get());
  return std::nullopt;
}

}  // namespace

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) {
    if (!word.empty()) text += (text.empty() ? "" : ", ") + ("\"" + word + "\"");
  }
  return text;
}

TomlReader::TomlReader(const toml::table& root, RecordLookup lookup, std::string_view text)
    : root_(root), lookup_(std::move(lookup)), lines_(lines_of(text)) {}

std::string_view TomlReader::line_at(std::uint32_t line) const {
  return line == 0 || line > lines_.size() ? std::string_view() : lines_[line - 1];
}

std::string TomlReader::written_value(const toml::source_region& place) const {
  if (place.begin.line != place.end.line) return {};
  const std::string_view line = line_at(place.begin.line);
  const std::size_t begin = bytes_before(line, place.begin.column);
  return std::string(line.substr(begin, bytes_before(line, place.end.column) - begin));
}

void TomlReader::section(const std::string& path) {
  path_ = path;
  table_ = &root_;
  std::istringstream parts(path);
  for (std::string part, so_far; std::getline(parts, part, '.');) {
    so_far += (so_far.empty() ? "" : ".") + part;
    known_[parent_of(so_far)].insert(part);
    if (table_ == nullptr) continue;
    const toml::node* node = table_->get(part);
    if (node != nullptr && !node->is_table() && reported_.insert(so_far).second) {
      problem(*node, so_far, words_of(*node), "a table [" + so_far + "]");
    }
    table_ = node == nullptr ? nullptr : node->as_table();
  }
  known_[path];
}

void TomlReader::text(const std::string& key, std::string& value, const std::vector<std::string>& choices) {
  read_text(key, value, choices, false);
}
void TomlReader::required_text(const std::string& key, std::string& value,
                               const std::vector<std::string>& choices) {
  read_text(key, value, choices, true);
}

void TomlReader::number(const std::string& key, double& value, Range range) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  if (const auto found = number_of(*node); found && std::isfinite(*found) && range.contains(*found)) {
    value = *found;
  } else {
    problem(*node, name(key), words_of(*node), range.words());
  }
}

void TomlReader::number(const std::string& key, std::optional<double>& value, Range range) {
  if (find(key) == nullptr) return;
  double found = value.value_or(std::numeric_limits<double>::quiet_NaN());
  number(key, found, range);
  value = found;
}

void TomlReader::number_or_auto(const std::string& key, double& value, bool& automatic, Range range) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const auto* word = node->as_string();
  automatic = word != nullptr && word->get() == kAuto;
  if (automatic) return;
  if (const auto found = number_of(*node); found && range.contains(*found)) {
    value = *found;
  } else {
    problem(*node, name(key), words_of(*node), fmt::format("{}, or \"{}\"", range.words(), kAuto));
  }
}

void TomlReader::integer(const std::string& key, int& value, int min, int max) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const auto* whole = node->as_integer();
  if (whole != nullptr && whole->get() >= min && whole->get() <= max) {
    value = static_cast<int>(whole->get());
  } else {
    problem(*node, name(key), words_of(*node), fmt::format("a whole number from {} to {}", min, max));
  }
}

void TomlReader::integer(const std::string& key, std::optional<int>& value, int min, int max) {
  if (find(key) == nullptr) return;
  int found = value.value_or(min);
  integer(key, found, min, max);
  value = found;
}

void TomlReader::seed(const std::string& key, std::uint64_t& value) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const auto* whole = node->as_integer();
  if (whole != nullptr && whole->get() >= 0) {
    value = static_cast<std::uint64_t>(whole->get());
  } else {
    problem(*node, name(key), words_of(*node), "a whole number >= 0");
  }
}

void TomlReader::boolean(const std::string& key, bool& value) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  if (const auto* truth = node->as_boolean()) {
    value = truth->get();
  } else {
    problem(*node, name(key), words_of(*node), "true or false");
  }
}

void TomlReader::vector(const std::string& key, Eigen::Vector3d& value, Range range) {
  if (const toml::node* node = find(key)) read_triple(*node, name(key), value, range);
}

void TomlReader::uncertainty(const std::string& key, StatedUncertainty& stated, double most,
                             const std::string& unit) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const Range range{0.0, most};
  const std::string in_unit = unit.empty() || unit == "1" ? "" : " " + unit;
  if (const toml::table* table = node->as_table(); table != nullptr && table->contains(kFrom)) {
    const auto found = recorded(*table, key, unit);
    if (!found) return;
    // A known error is not corrected, so it counts as well (GUM F.2.4.5).
    const double u = std::hypot(found->value, found->expanded_uncertainty / found->coverage_factor);
    if (range.contains(u)) {
      stated = {u, found->source};
    } else {
      problem(*node, name(key),
              fmt::format("a standard uncertainty of {:g}{} ({})", u, in_unit, found->source),
              range.words() + in_unit);
    }
  } else if (table != nullptr) {
    read_uncertainty_table(*table, name(key), stated, range, in_unit);
  } else if (const auto found = number_of(*node); found && std::isfinite(*found) && range.contains(*found)) {
    stated = {*found, "stated"};
  } else {
    problem(*node, name(key), words_of(*node) + (found ? in_unit : ""),
            fmt::format("a standard uncertainty, {}{}, or a table with its source", range.words(), in_unit));
  }
}

void TomlReader::calibrated(const std::string& key, CalibratedNumber& number_of_key, Range range,
                            const std::string& unit) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const toml::table* table = node->as_table();
  if (table == nullptr || !table->contains(kFrom)) {
    number(key, number_of_key.value, range);
    return;
  }
  const auto found = recorded(*table, key, unit);
  if (!found) return;
  if (range.contains(found->value)) {
    number_of_key = {found->value, found->expanded_uncertainty, found->coverage_factor, found->source};
  } else {
    problem(*node, name(key), fmt::format("{:g} {} ({})", found->value, unit, found->source), range.words());
  }
}

/// The value that `{ from = "RECORD" }` or `{ from = "RECORD", name = "VALUE" }` names; without `name` its
/// name is the key.
std::optional<RecordedValue> TomlReader::recorded(const toml::table& table, const std::string& key,
                                                  const std::string& unit) {
  const std::size_t problems_before = found_.size();
  const std::string where = name(key);
  std::string record, value = key;
  for (const auto& [word, node] : table) {
    const bool known = word.str() == kFrom || word.str() == kName;
    const auto* text = node.as_string();
    if (!known) {
      problem(node, where + "." + std::string(word.str()), "a key of this name",
              "from, the number of a calibration in the register, and name, that of the value in it");
    } else if (text == nullptr || text->get().empty()) {
      problem(node, where + "." + std::string(word.str()), words_of(node), "text in quotes");
    } else {
      (word.str() == kFrom ? record : value) = text->get();
    }
  }
  if (found_.size() != problems_before) return std::nullopt;
  try {
    if (!lookup_)
      throw RecordProblem(fmt::format("record \"{}\", but no register is configured", record),
                          "a register that has it, named by ABCAL_REGISTER");
    RecordedValue found = lookup_(record, value);
    const bool same = found.unit == unit || (unit == "degree" && found.unit == "deg") ||
                      (unit == "1" && found.unit.empty());
    if (!same)
      throw RecordProblem(fmt::format("a value in {}: {}", found.unit, found.source), "the unit " + unit);
    return found;
  } catch (const RecordProblem& error) {
    problem(table, where, error.what(), error.required());
    return std::nullopt;
  }
}

void TomlReader::read_uncertainty_table(const toml::table& table, const std::string& where,
                                        StatedUncertainty& stated, const Range& range,
                                        const std::string& unit) {
  static const std::map<std::string, double> kDivisors{{"rectangular", std::numbers::sqrt3},
                                                       {"triangular", std::sqrt(6.0)},
                                                       {"u-shaped", std::numbers::sqrt2}};
  static const std::set<std::string> kKnown{"value", "half_width", "distribution", "expanded_uncertainty",
                                            "k",     "source"};
  const std::size_t problems_before = found_.size();
  for (const auto& [key, node] : table) {
    if (const std::string word(key.str()); !kKnown.contains(word))
      problem(node, where + "." + word, "a key of this name",
              "one of " + joined({kKnown.begin(), kKnown.end()}));
  }
  const std::string words = range.words() + unit;
  const auto value = number_in_table(table, where, "value", range, words);
  const auto half_width = number_in_table(table, where, "half_width", range, words);
  const auto expanded = number_in_table(table, where, "expanded_uncertainty", range, words);
  const auto k = number_in_table(table, where, "k", {0.0, 100.0, true}, "a coverage factor above 0 to 100");
  const auto word_of = [&](const char* key, const char* required) -> std::string {
    const toml::node* node = table.get(key);
    if (node == nullptr) return {};
    const auto* word = node->as_string();
    if (word != nullptr && word->get().find_first_not_of(" \t\r\n") != std::string::npos) return word->get();
    problem(*node, where + "." + key, words_of(*node), required);
    return {};
  };
  std::string source = word_of("source", "the source of the value, as text in quotes");
  const std::string distribution = word_of("distribution", "\"rectangular\", \"triangular\" or \"u-shaped\"");
  const int given = (table.contains("value") ? 1 : 0) + (table.contains("half_width") ? 1 : 0) +
                    (table.contains("expanded_uncertainty") ? 1 : 0);
  const std::string one_of =
      "one of value (standard uncertainty), half_width with distribution, expanded_uncertainty with k: " +
      words;
  if (given != 1)
    problem(table, where,
            given == 0 ? (source.empty() ? "no value" : "a source without a value") : "several values",
            one_of);
  // A written file has the standard uncertainty of a half-width, with its distribution.
  if (half_width ? !table.contains("distribution") : expanded && table.contains("distribution")) {
    problem(table, where, half_width ? "half_width without distribution" : "distribution without half_width",
            one_of);
  } else if (!distribution.empty() && !kDivisors.contains(distribution)) {
    problem(*table.get("distribution"), where + ".distribution", "\"" + distribution + "\"",
            "\"rectangular\", \"triangular\" or \"u-shaped\"");
  }
  if (table.contains("expanded_uncertainty") != table.contains("k"))
    problem(table, where, expanded ? "expanded_uncertainty without k" : "k without expanded_uncertainty",
            one_of);
  if (found_.size() != problems_before) return;

  // A written file marks a default as such, so that it is a default again when it is read.
  if (value && source == kDefaultSource) {
    stated = {*value, ""};
    return;
  }
  if (source.empty()) source = "stated";
  if (value) {
    stated = {*value, source, distribution};
  } else if (half_width) {
    stated = {*half_width / kDivisors.at(distribution),
              fmt::format("{} ({}, half-width {:g}{})", source, distribution, *half_width, unit),
              distribution};
  } else {
    stated = {*expanded / *k, fmt::format("{} (U = {:g}{}, k = {:g})", source, *expanded, unit, *k)};
  }
}

std::optional<double> TomlReader::number_in_table(const toml::table& table, const std::string& where,
                                                  const std::string& key, const Range& range,
                                                  const std::string& words) {
  const toml::node* node = table.get(key);
  if (node == nullptr) return std::nullopt;
  const auto found = number_of(*node);
  if (found && std::isfinite(*found) && range.contains(*found)) return found;
  problem(*node, where + "." + key, words_of(*node), words);
  return std::nullopt;
}

void TomlReader::matrix(const std::string& key, Eigen::Matrix3d& value, Range range) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const toml::array* rows = node->as_array();
  if (rows == nullptr || rows->size() != 3) {
    problem(*node, name(key), words_of(*node),
            "three rows of three numbers, [[ux, uy, uz], [vx, ...], [wx, ...]]");
    return;
  }
  for (int j = 0; j < 3; ++j) {
    Eigen::Vector3d row = value.row(j);
    read_triple(*rows->get(static_cast<std::size_t>(j)), name(key), row, range);
    value.row(j) = row;
  }
}

void TomlReader::numbers(const std::string& key, std::vector<double>& value, Range range) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const toml::array* list = node->as_array();
  std::vector<double> found;
  bool good = list != nullptr;
  for (std::size_t i = 0; good && i < list->size(); ++i) {
    const auto number = list->get(i)->value<double>();
    good = number && range.contains(*number);
    if (good) found.push_back(*number);
  }
  if (good) {
    value = found;
  } else {
    problem(*node, name(key), words_of(*node), fmt::format("a list of numbers, each {}", range.words()));
  }
}

void TomlReader::integers(const std::string& key, std::array<int, 3>& value, int min, int max) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const toml::array* list = node->as_array();
  std::array<int, 3> found{};
  bool good = list != nullptr && list->size() == 3;
  for (std::size_t i = 0; good && i < 3; ++i) {
    const auto* whole = list->get(i)->as_integer();
    good = whole != nullptr && whole->get() >= min && whole->get() <= max;
    if (good) found[i] = static_cast<int>(whole->get());
  }
  if (good) {
    value = found;
  } else {
    problem(*node, name(key), words_of(*node),
            fmt::format("three whole numbers from {} to {}, [u, v, w]", min, max));
  }
}

void TomlReader::tables(const std::string& key, std::size_t,
                        const std::function<void(std::size_t)>& visit_entry) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  const toml::array* entries = node->as_array();
  if (entries == nullptr) {
    problem(*node, name(key), words_of(*node), "a list of tables [[" + name(key) + "]]");
    return;
  }
  const toml::table* outer = table_;
  const std::string outer_path = path_;
  std::size_t index = 0;
  for (const toml::node& entry : *entries) {
    path_ = outer_path.empty() ? key : outer_path + "." + key;
    table_ = entry.as_table();
    if (table_ == nullptr) {
      problem(entry, path_, words_of(entry), "a table [[" + path_ + "]]");
      continue;
    }
    visit_entry(index++);
    report_unknown(*table_, path_);
  }
  table_ = outer;
  path_ = outer_path;
}

void TomlReader::table(const std::string& key, const std::function<void()>& visit_keys) {
  const toml::node* node = find(key);
  const toml::table* outer = table_;
  const std::string outer_path = path_;
  if (node != nullptr && !node->is_table())
    problem(*node, name(key), words_of(*node), "a table [" + name(key) + "]");
  entry_line_ = line();
  path_ = name(key);
  table_ = node == nullptr ? nullptr : node->as_table();
  visit_keys();
  if (table_ != nullptr) report_unknown(*table_, path_);
  table_ = outer;
  path_ = outer_path;
  entry_line_ = 0;
}

bool TomlReader::gives(const std::string& path) const {
  return root_.at_path(path).node() != nullptr;
}

bool TomlReader::is_list(const std::string& key) const {
  const toml::node* node = root_.get(key);
  return node != nullptr && node->is_array();
}

void TomlReader::date(const std::string& key, std::optional<std::chrono::year_month_day>& value) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  if (const auto* found = node->as_date()) {
    const toml::date day = found->get();
    value = std::chrono::year(day.year) / day.month / day.day;
  } else {
    problem(*node, name(key), words_of(*node), "a date without quotes, 2026-03-01");
  }
}

void TomlReader::texts(const std::string& key, std::vector<std::string>& value,
                       const std::vector<std::string>& choices) {
  const toml::node* node = find(key);
  if (node == nullptr) return;
  std::vector<std::string> found;
  const auto* list = node->as_array();
  bool good = list != nullptr;
  for (std::size_t i = 0; good && i < list->size(); ++i) {
    const auto* word = list->get(i)->as_string();
    good = word != nullptr && !word->get().empty() &&
           (choices.empty() || std::find(choices.begin(), choices.end(), word->get()) != choices.end());
    if (good) found.push_back(word->get());
  }
  if (good) {
    value = std::move(found);
  } else {
    problem(*node, name(key), words_of(*node),
            choices.empty() ? "a list of texts in quotes" : "a list of some of " + joined(choices));
  }
}

void TomlReader::refuse(const std::string& key, const std::string& found, const std::string& required) {
  if (const toml::node* node = find(key)) {
    problem_with_guess(node->source(), name(key), {{}, found, required}, {}, {});
  } else {
    add_problem_at(line(), name(key), found, required);
  }
}

void TomlReader::add_missing(const std::string& key, const std::string& required) {
  const std::uint32_t where = line();
  add_problem_at(where, name(key), "nothing", required);
}

void TomlReader::report_unknown() {
  report_unknown(root_, "");
  for (const auto& [path, keys] : known_) {
    if (path.empty()) continue;
    if (const toml::node* node = root_.at_path(path).node(); node != nullptr && node->is_table()) {
      report_unknown(*node->as_table(), path);
    }
  }
}

std::vector<Problem> TomlReader::take_problems() {
  std::stable_sort(found_.begin(), found_.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<Problem> problems;
  for (auto& [line, problem] : found_) {
    if (problems.size() == kMostProblems) {
      problems.push_back({"the file", fmt::format("{} further problems", found_.size() - kMostProblems),
                          "the problems above corrected first"});
      break;
    }
    problems.push_back(std::move(problem));
  }
  return problems;
}

void TomlReader::add_problem(const std::string& where, const std::string& found,
                             const std::string& required) {
  if (wrong_.contains(where)) return;
  const toml::node* node = root_.at_path(where).node();
  add_problem_at(node == nullptr ? 0 : node->source().begin.line, where, found, required);
}

void TomlReader::add_problem_at(std::uint32_t line, const std::string& where, const std::string& found,
                                const std::string& required) {
  // Problems without a line are at the end.
  found_.emplace_back(line == 0 ? std::numeric_limits<std::uint32_t>::max() : line,
                      shown_problem(at(line) + display(where), found, required));
}

void TomlReader::problem(const toml::node& node, const std::string& where, const std::string& found,
                         const std::string& required) {
  // A number, a date or a truth in quotes, where none belong.
  const auto* text = node.as_string();
  const bool is_value = text != nullptr && is_value_without_quotes(text->get());
  problem_with_guess(node.source(), where, {where, found, required},
                     is_value ? '"' + text->get() + '"' : std::string(),
                     is_value ? text->get() : std::string());
}

void TomlReader::problem_with_guess(const toml::source_region& place, const std::string& where,
                                    const Problem& words, std::string_view written,
                                    const std::string& meant) {
  const std::uint32_t line = place.begin.line;
  wrong_.insert(where);
  Problem shown = shown_problem(at(line) + display(where), words.found, words.required);
  const std::string_view text = line_at(line);
  std::string corrected;
  const std::size_t begin = bytes_before(text, place.begin.column);
  if (!meant.empty() && text.substr(begin).starts_with(written))
    corrected = std::string(text).replace(begin, written.size(), meant);
  show_line(shown, text, place.begin.column, corrected);
  found_.emplace_back(line, std::move(shown));
}

const toml::node* TomlReader::find(const std::string& key) {
  known_[path_].insert(key);
  return table_ == nullptr ? nullptr : table_->get(key);
}

void TomlReader::read_text(const std::string& key, std::string& value,
                           const std::vector<std::string>& choices, bool required) {
  const std::string wanted = choices.empty() ? "text in quotes" : "one of " + joined(choices);
  const toml::node* node = find(key);
  if (node == nullptr) {
    if (required) add_missing(key, wanted);
    return;
  }
  const auto* string = node->as_string();
  const bool allowed = string != nullptr && (choices.empty() || std::find(choices.begin(), choices.end(),
                                                                          string->get()) != choices.end());
  if (allowed && !(required && string->get().find_first_not_of(" \t\r\n") == std::string::npos)) {
    value = string->get();
  } else {
    const auto quoted = [](const std::string& word) { return word.empty() ? word : '"' + word + '"'; };
    if (string != nullptr) {
      problem_with_guess(node->source(), name(key), {{}, words_of(*node), wanted}, quoted(string->get()),
                         quoted(string->get().empty() ? "" : nearest_word(string->get(), choices)));
    } else {  // A number or a truth without its quotes.
      const bool is_plain = node->is_value() && choices.empty();
      const std::string written = is_plain ? written_value(node->source()) : "";
      problem_with_guess(node->source(), name(key), {{}, words_of(*node), wanted}, written, quoted(written));
    }
  }
}

void TomlReader::read_triple(const toml::node& node, const std::string& where, Eigen::Vector3d& value,
                             const Range& range) {
  const toml::array* list = node.as_array();
  Eigen::Vector3d found;
  bool finite = list != nullptr && list->size() == 3;
  for (int j = 0; finite && j < 3; ++j) {
    const auto number = number_of(*list->get(static_cast<std::size_t>(j)));
    finite = number && std::isfinite(*number);
    if (finite) found[j] = *number;
  }
  if (!finite) {
    problem(node, where, words_of(node), "three finite numbers, [u, v, w]");
  } else if (!std::all_of(found.begin(), found.end(), [&](double each) { return range.contains(each); })) {
    problem(node, where, fmt::format("[{:g}, {:g}, {:g}]", found[0], found[1], found[2]),
            "three numbers, [u, v, w], each " + range.words());
  } else {
    value = found;
  }
}

std::string TomlReader::sections_with(const std::string& key) const {
  std::vector<std::string> sections;
  for (const auto& [path, keys] : known_)
    if (!path.empty() && keys.contains(key)) sections.push_back("[" + path + "]");
  return fmt::format("{}", fmt::join(sections, " or "));
}

void TomlReader::report_unknown(const toml::table& table, const std::string& path) {
  const std::set<std::string>& known = known_[path];
  for (const auto& [key, node] : table) {
    const std::string word(key.str());
    if (known.contains(word)) continue;
    const std::string meant = meant_key(std::string_view(word).substr(0, kLongestShown), known);
    const std::string elsewhere = sections_with(word);
    problem_with_guess(key.source(), path.empty() ? word : path + "." + word,
                       {{},
                        node.is_table() ? "a section of this name" : "a key of this name",
                        !meant.empty()       ? "a known key: did you mean \"" + meant + "\"?"
                        : !elsewhere.empty() ? "this key under " + elsewhere
                                             : "one of " + joined({known.begin(), known.end()})},
                       word, meant);
  }
}

namespace {

/// The text as a table, after each line that is not TOML has been replaced by what it may mean.
/// @return nullopt if one of them is not clear
std::optional<toml::table> parse_with_corrections(std::string_view text, const std::string& source,
                                                  std::vector<Problem>& problems) {
  std::vector<std::string> lines;
  for (const std::string_view line : lines_of(text)) lines.emplace_back(line);
  std::set<std::size_t> corrected_lines;
  while (problems.size() < kMostProblems) {
    try {
      return toml::parse(fmt::format("{}\n", fmt::join(lines, "\n")), source);
    } catch (const toml::parse_error& error) {
      const toml::source_position place = error.source().begin;
      const std::size_t index =
          std::min<std::size_t>(std::max(place.line, 1U), std::max<std::size_t>(lines.size(), 1)) - 1;
      std::string& line = lines.at(index);
      const bool is_second = error.description().find("redefine") != std::string_view::npos;
      const TomlMistake mistake = explain_toml_mistake(line, bytes_before(line, place.column), is_second);
      Problem problem = shown_problem(fmt::format("line {}", index + 1), mistake.found, mistake.required);
      std::ranges::replace_if(problem.found, is_control, ' ');
      const bool is_removed = mistake.corrected == " ";
      show_line(problem, line, is_removed ? 0 : place.column, is_removed ? "" : mistake.corrected);
      problems.push_back(std::move(problem));
      if (mistake.corrected.empty() || !corrected_lines.insert(index).second) return std::nullopt;
      line = mistake.corrected;
    }
  }
  return std::nullopt;
}

}  // namespace

toml::table parse_toml(std::string_view text, const std::string& source, const std::string& kind,
                       std::vector<Problem>& problems) {
  if (text.find_first_not_of(" \t\r\n") == std::string_view::npos) {
    problems.push_back({"the file", "nothing in it", kind});
    return {};
  }
  if (text.starts_with("SQLite format 3")) {
    problems.push_back({"the file", "a run file, or another file of SQLite",
                        kind + ". `abcal analyse` gives the result of a run, `abcal resume` continues it"});
    return {};
  }
  if (const auto line = NestingCheck(text).line_too_deep()) {
    problems.push_back(
        {fmt::format("line {}", *line), "tables or lists nested too deeply",
         fmt::format("at most {} parts of a key and {} nested brackets", kDeepestToml, kDeepestToml)});
    return {};
  }
  return parse_with_corrections(text, source, problems).value_or(toml::table{});
}

std::string read_text_file(const std::string& path, const std::string& kind, std::vector<Problem>& problems) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) {
    problems.push_back({"the file", "no such file", "an existing " + kind});
    return {};
  }
  if (std::filesystem::is_directory(path, error)) {
    problems.push_back({"the file", "a folder", "a " + kind});
    return {};
  }
  if (!std::filesystem::is_regular_file(path, error)) {  // Opening a pipe would wait for a writer.
    problems.push_back({"the file", "not a file", "a " + kind});
    return {};
  }
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    problems.push_back({"the file", "it cannot be opened", "a file that this user may read"});
    return {};
  }
  std::string text;
  std::array<char, 65536> chunk{};
  while (text.size() <= kLargestTomlFile && file.read(chunk.data(), chunk.size()).gcount() > 0)
    text.append(chunk.data(), static_cast<std::size_t>(file.gcount()));
  if (text.size() > kLargestTomlFile) {
    problems.push_back({"the file", fmt::format("more than {} MiB", kLargestTomlFile >> 20U), "a " + kind});
    return {};
  }
  return text;
}

}  // namespace abcal
