#include "protocol/record/import_csv.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <string_view>
#include <tuple>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "protocol/plan/faces.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/plan/run_config.h"
#include "protocol/record/imported_dwells.h"
#include "protocol/record/limits_entries.h"

namespace abcal {

namespace {

constexpr std::size_t kMostProblemsShown = 50;
constexpr std::array<std::string_view, 6> kRequired{"experiment", "n", "alpha_deg", "r_u", "r_v", "r_w"};
constexpr std::array<std::string_view, 3> kReadingColumns{"r_u", "r_v", "r_w"};
constexpr std::array<std::string_view, 3> kUncertaintyColumns{"u_u", "u_v", "u_w"};
constexpr std::array<std::string_view, 3> kSpreadColumns{"spread_u", "spread_v", "spread_w"};
constexpr std::array<std::string_view, 20> kKnown{"experiment",    "n",
                                                  "alpha_deg",     "r_u",
                                                  "r_v",           "r_w",
                                                  "u_u",           "u_v",
                                                  "u_w",           "time_s",
                                                  "count",         "flags",
                                                  "closing",       "temperature_degc",
                                                  "encoder_x_deg", "encoder_z_deg",
                                                  "spread_u",      "spread_v",
                                                  "spread_w",      "face"};

struct Row {
  int line = 0;
  std::vector<std::string> fields;
};

using pieces::trimmed;

// Shortens a text of an arbitrary file for a message.
std::string as_quoted(std::string_view text) {
  constexpr std::size_t kLongest = 40;
  std::string shown;
  for (const char c : text.substr(0, kLongest)) {
    const auto byte = static_cast<unsigned char>(c);
    shown += byte < 0x20 || byte == 0x7F ? '?' : c;
  }
  return text.size() > kLongest ? fmt::format("\"{}...\"", shown) : fmt::format("\"{}\"", shown);
}

char separator_of(std::string_view text, std::size_t header) {
  const std::string_view line = text.substr(header, text.find('\n', header) - header);
  return line.find(';') != std::string_view::npos ? ';' : ',';
}

/// The lines that are not empty and not comments, split into fields (RFC 4180), and the comments.
struct Table {
  struct Comment {
    int line = 0;
    std::string text;
  };
  std::vector<Row> rows;
  std::vector<Comment> comments;
  bool decimal_comma = false;
  std::optional<int> open_quote_line;
};

Table split(std::string_view text) {
  Table table;
  char separator = '\0';  // known from the header, the first line that is not a comment
  int line = 1;
  std::size_t at = 0;
  while (at < text.size()) {
    const std::size_t end_of_line = std::min(text.find('\n', at), text.size());
    const std::string_view whole = trimmed(text.substr(at, end_of_line - at));
    if (whole.empty() || whole.front() == '#') {
      if (!whole.empty()) table.comments.push_back({line, std::string(whole.substr(1))});
      at = end_of_line + 1;
      ++line;
      continue;
    }
    if (separator == '\0') {
      separator = separator_of(text, at);
      table.decimal_comma = separator == ';';
    }
    Row row;
    row.line = line;
    std::string field;
    bool in_quotes = false;
    bool was_quoted = false;
    const auto finish_field = [&] {
      row.fields.push_back(was_quoted ? field : std::string(trimmed(field)));
      field.clear();
      was_quoted = false;
    };
    for (;; ++at) {
      if (at >= text.size()) {
        if (in_quotes) table.open_quote_line = row.line;
        break;
      }
      const char c = text[at];
      if (c == '\n') ++line;
      if (in_quotes) {
        if (c != '"') {
          field += c;
        } else if (at + 1 < text.size() && text[at + 1] == '"') {
          field += '"';
          ++at;
        } else {
          in_quotes = false;
        }
      } else if (c == '"' && trimmed(field).empty() && !was_quoted) {
        field.clear();
        in_quotes = true;
        was_quoted = true;
      } else if (c == separator) {
        finish_field();
      } else if (c == '\n') {
        ++at;
        break;
      } else if (!was_quoted) {
        field += c;
      } else if (trimmed(std::string_view(&c, 1)).size() == 1) {
        field += c;  // text after a closing quote: left in, so that it is found not to be a number
      }
    }
    finish_field();
    table.rows.push_back(std::move(row));
  }
  return table;
}

std::optional<double> number_in(std::string_view text, bool decimal_comma) {
  std::string digits(trimmed(text));
  if (decimal_comma) std::replace(digits.begin(), digits.end(), ',', '.');
  return pieces::number<double>(std::string_view(digits).substr(digits.starts_with('+') ? 1 : 0));
}

class Importer {
 public:
  Importer(std::string text, std::string source) : text_(std::move(text)), source_(std::move(source)) {}

  RunRecord import() {
    record_.source = source_;
    std::string_view body = text_;
    constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
    if (body.substr(0, kByteOrderMark.size()) == kByteOrderMark) body.remove_prefix(kByteOrderMark.size());
    table_ = split(body);
    if (table_.open_quote_line) {
      problem(fmt::format("line {}", *table_.open_quote_line), "a quoted field without an end",
              "a closing quote");
    }
    read_comments();
    if (read_header()) {
      for (std::size_t i = 1; i < table_.rows.size(); ++i) read_row(table_.rows[i]);
      refuse_radians();
      for (Problem& each : too_few_angles(record_.dwells)) problems_.push_back(std::move(each));
    }
    if (!has("closing")) mark_closing_angles(record_.dwells);
    read_row_order();
    infer_steps();
    if (!problems_.empty()) throw CsvError(source_, std::move(problems_));
    return std::move(record_);
  }

 private:
  void problem(std::string where, std::string found, std::string required) {
    problems_.push_back({std::move(where), std::move(found), std::move(required)});
  }

  // Reads the comments that `abcal report --csv` writes above the header, so that the analysis of the copy
  // gives the same numbers.
  void read_comments() {
    for (const auto& [line, comment] : table_.comments) {
      const std::size_t colon = comment.find(':');
      if (colon == std::string::npos) continue;
      const std::string key(trimmed(std::string_view(comment).substr(0, colon)));
      const std::string_view value = trimmed(std::string_view(comment).substr(colon + 1));
      if (value.empty() && !states_a_size(key)) continue;
      if (states_a_size(key) && metadata_.contains(key)) {
        problem(fmt::format("line {}, comment \"{}\"", line, key),
                fmt::format("the key again (first on line {})", metadata_line_.at(key)), "each key once");
        continue;
      }
      metadata_[key] = value;
      metadata_line_[key] = line;
    }
    if (const auto unit = metadata_.find("response_unit"); unit != metadata_.end())
      record_.response_unit = unit->second;
    const auto comment_text = [&](const std::string& key) -> std::optional<std::string> {
      const auto found = metadata_.find(key);
      return found == metadata_.end() ? std::nullopt : std::optional(found->second);
    };
    read_effect_sizes([&](const std::string& key, double most) { return metadata_number(key, 0.0, most); },
                      comment_text, record_.tolerances);
    check_effect_keys();
    read_limits_entries([&](const std::string& key) { return metadata_number(key, -1e9); }, comment_text,
                        record_.limits, record_.expected);
    if (const auto chosen = comment_text(std::string(kEstimatorLabel))) read_estimator(*chosen);
    if (const auto order = comment_text("protocol.axes_order")) record_.axes_order = axes_order_named(*order);
    if (const auto deg = metadata_number("protocol.approach_deg", 0.0, 45.0))
      record_.approach = Angle::degrees(*deg);
    record_.continuations = static_cast<int>(metadata_number("continuations", 0.0, 1e6).value_or(0.0));
    MeasuredAlignment& alignment = record_.measured_alignment;
    for (const auto& [name, measured] :
         {std::pair{"zx", &alignment.zx}, {"zy", &alignment.zy}, {"xz", &alignment.xz}}) {
      const auto value = metadata_number(std::string("alignment.") + name, -1.0, 1.0);
      const auto u =
          metadata_number(std::string("alignment.u_") + name, std::numeric_limits<double>::min(), 1.0);
      if (value && u) *measured = MeasuredValue{*value, *u};
    }
    if (const auto g = metadata_number("g_loc.value_mps2", 9.0, 10.5)) {
      record_.g_loc_known = true;
      record_.g_loc.value_mps2 = *g;
      record_.g_loc.expanded_uncertainty_mps2 =
          metadata_number("g_loc.expanded_uncertainty_mps2").value_or(0.0);
      record_.g_loc.coverage_factor = metadata_number("g_loc.coverage_factor", 1.0, 10.0).value_or(2.0);
      if (const auto source = metadata_.find("g_loc.source"); source != metadata_.end())
        record_.g_loc.source = source->second;
    }
  }

  /// An empty value of such a key would silently leave the default in force.
  static bool states_a_size(const std::string& key) {
    return key.starts_with("stage_uncertainty.") || key.starts_with("item_uncertainty.") ||
           key.starts_with("tolerances.");
  }

  std::string place_of(const std::string& key) const {
    return fmt::format("line {}, comment \"{}\"", metadata_line_.at(key), key);
  }

  /// " degree": the unit of a number in the comments; empty where it has none.
  static std::string unit_of(const std::string& key) {
    for (const EffectSizeKey& of : effect_size_keys()) {
      if (of.unit != "1" && key.ends_with(fmt::format(".{}", of.key))) return fmt::format(" {}", of.unit);
    }
    return {};
  }

  /// A misspelt key would silently leave a default in force.
  void check_effect_keys() {
    for (const auto& [key, value] : metadata_) {
      const std::string section = key.substr(0, key.find('.'));
      if (section != "stage_uncertainty" && section != "item_uncertainty") continue;
      constexpr std::string_view kSource = ".source";
      const bool of_source = key.ends_with(kSource);
      const std::string of = of_source ? key.substr(0, key.size() - kSource.size()) : key;
      std::string known;
      bool found = false;
      double most = 0.0;
      for (const EffectSizeKey& each : effect_size_keys()) {
        if (each.section != section) continue;
        if (of == fmt::format("{}.{}", each.section, each.key)) {
          found = true;
          most = each.most;
        }
        known += fmt::format("{}{}", known.empty() ? "" : ", ", each.key);
      }
      if (!found) {
        problem(place_of(key), "an effect of this name", fmt::format("one of {}", known));
      } else if (of_source && !metadata_.contains(of)) {
        problem(place_of(key), "a source without a value",
                fmt::format("a comment \"{}\" with a number from 0 to {:g}{}", of, most, unit_of(of)));
      } else if (of_source && value.empty()) {
        problem(place_of(key), "nothing", "the source of the value, as text");
      }
    }
  }

  void read_estimator(const std::string& chosen) {
    if (std::find(kEstimatorNames.begin(), kEstimatorNames.end(), chosen) != kEstimatorNames.end()) {
      record_.estimator = chosen;
    } else {
      problem(place_of(std::string(kEstimatorLabel)), as_quoted(chosen),
              fmt::format("one of {}", fmt::join(kEstimatorNames, ", ")));
    }
  }

  /// The number behind a key in the comments; absent, and a problem is reported, if the text is not a number.
  std::optional<double> metadata_number(const std::string& key, double lowest = 0.0, double highest = 1e9) {
    const auto found = metadata_.find(key);
    if (found == metadata_.end()) return std::nullopt;
    const std::optional<double> value = number_in(found->second, false);
    if (value && *value >= lowest && *value <= highest) return value;
    problem(place_of(key), found->second.empty() ? "nothing" : as_quoted(found->second),
            fmt::format("a number from {:g} to {:g}{}", lowest, highest, unit_of(key)));
    return std::nullopt;
  }

  bool read_header() {
    if (table_.rows.empty()) {
      problem("the file", text_.empty() ? "nothing" : "no header line",
              fmt::format("a header line \"{}\"", fmt::join(kRequired, ",")));
      return false;
    }
    const Row& header = table_.rows.front();
    for (std::size_t i = 0; i < header.fields.size(); ++i) {
      const std::string name = pieces::lower(trimmed(header.fields[i]));
      if (std::find(kKnown.begin(), kKnown.end(), name) == kKnown.end()) continue;
      if (!columns_.emplace(name, i).second) {
        problem(fmt::format("line {}, {}", header.line, name), "the column twice", "each column once");
      }
    }
    const std::size_t problems_before = problems_.size();
    for (const std::string_view name : kRequired) require_column(header, name);
    require_one_item(header);
    with_u_ = std::any_of(kUncertaintyColumns.begin(), kUncertaintyColumns.end(),
                          [&](std::string_view name) { return columns_.count(std::string(name)) > 0; });
    if (with_u_) {
      for (const std::string_view name : kUncertaintyColumns) require_column(header, name);
    }
    return problems_.size() == problems_before;
  }

  /// A CSV of all items of a run has the column "item".
  void require_one_item(const Row& header) {
    for (std::size_t i = 0; i < header.fields.size(); ++i) {
      if (trimmed(header.fields[i]) != "item") continue;
      for (const Row& row : table_.rows) {
        if (&row == &header || i >= row.fields.size() || row.fields[i] == table_.rows[1].fields[i]) continue;
        problem(fmt::format("line {}, item", row.line), as_quoted(row.fields[i]),
                "one item in the whole file: `abcal report RUN --item K --csv FILE` writes it");
        return;
      }
    }
  }

  void require_column(const Row& header, std::string_view name) {
    if (columns_.count(std::string(name)) > 0) return;
    std::string all;
    for (const std::string& field : header.fields) all += (all.empty() ? "" : ",") + field;
    problem(fmt::format("line {}, header", header.line), as_quoted(all), fmt::format("a column {}", name));
  }

  bool has(std::string_view name) const { return columns_.count(std::string(name)) > 0; }
  const std::string& field(const Row& row, std::string_view name) const {
    return row.fields[columns_.at(std::string(name))];
  }

  /// A finite number, or a problem and nothing.
  std::optional<double> number(const Row& row, std::string_view name, const char* required = "a number") {
    const std::string& text = field(row, name);
    const std::optional<double> value = number_in(text, table_.decimal_comma);
    if (value && std::isfinite(*value)) return value;
    problem(fmt::format("line {}, {}", row.line, name),
            text.empty() ? std::string("nothing") : as_quoted(text),
            value ? fmt::format("{} that is finite", required) : required);
    return std::nullopt;
  }

  std::optional<double> optional_number(const Row& row, std::string_view name) {
    if (!has(name) || trimmed(field(row, name)).empty()) return std::nullopt;
    return number(row, name);
  }

  std::optional<std::int64_t> whole_number(const Row& row, std::string_view name, double lowest,
                                           double highest, const char* required) {
    const std::size_t before = problems_.size();
    const std::optional<double> value = number(row, name, required);
    if (value && *value >= lowest && *value <= highest && *value == std::floor(*value)) {
      return static_cast<std::int64_t>(*value);
    }
    if (problems_.size() == before) {
      problem(fmt::format("line {}, {}", row.line, name), as_quoted(field(row, name)), required);
    }
    return std::nullopt;
  }

  void read_row(const Row& row) {
    const std::size_t width = table_.rows.front().fields.size();
    if (row.fields.size() != width) {
      problem(fmt::format("line {}", row.line), fmt::format("{} fields", row.fields.size()),
              fmt::format("{}, as in the header", width));
      return;
    }
    DwellRecord dwell;
    const auto experiment =
        whole_number(row, "experiment", 0, 3, "experiment 1, 2 or 3, or 0 for a check pose");
    const auto n = whole_number(row, "n", 1, 1e6, "a whole number of at least 1");
    const auto alpha = number(row, "alpha_deg");
    for (std::size_t j = 0; j < 3; ++j) {
      if (const auto reading = number(row, kReadingColumns[j]))
        dwell.mean(static_cast<Eigen::Index>(j)) = *reading;
    }
    read_uncertainty(row, dwell);
    dwell.time_s = optional_number(row, "time_s");
    dwell.temperature_degc = optional_number(row, "temperature_degc");
    for (std::size_t j = 0; j < 3; ++j)
      if (has(kSpreadColumns[j]))
        dwell.spread(static_cast<Eigen::Index>(j)) = optional_number(row, kSpreadColumns[j]).value_or(0.0);
    if (has("count") && !trimmed(field(row, "count")).empty()) {
      dwell.count = whole_number(row, "count", 1, 1e15, "a whole number of at least 1").value_or(0);
    }
    if (has("flags") && !trimmed(field(row, "flags")).empty()) {
      dwell.flags = static_cast<std::uint32_t>(
          whole_number(row, "flags", 0, kAllFlags, "a sum of known flags").value_or(0));
    }
    if (has("closing")) dwell.closing = whole_number(row, "closing", 0, 1, "0 or 1").value_or(0) == 1;
    if (has("face") && !trimmed(field(row, "face")).empty())
      dwell.face = static_cast<int>(whole_number(row, "face", 1, kFaces, "face 1 or 2").value_or(1));
    if (!experiment || !n || !alpha) return;
    dwell.experiment = static_cast<int>(*experiment);
    dwell.n = static_cast<int>(*n);
    dwell.alpha = Angle::degrees(*alpha);
    if (dwell.experiment == 0) {
      read_check_pose(row, std::move(dwell));
      return;
    }
    // A closing angle may have the n of the angle that it repeats: its alpha distinguishes it.
    const auto [first, is_new] =
        line_of_.emplace(std::make_tuple(dwell.experiment, dwell.n, *alpha >= 360.0), row.line);
    if (!is_new) {
      problem(fmt::format("line {}", row.line),
              fmt::format("experiment {}, n = {} again (first on line {})", dwell.experiment, dwell.n,
                          first->second),
              "each angle once");
      return;
    }
    set_commanded_angles(dwell);
    take_turns_of_encoder(row, dwell);
    record_.dwells.push_back(dwell);
  }

  /// Moves the commanded angles by the whole turns of the encoder angles, if the file has them.
  void take_turns_of_encoder(const Row& row, DwellRecord& dwell) {
    const auto near = [&](const char* column, Angle& commanded) {
      if (!has(column)) return;
      const auto encoder_deg = optional_number(row, column);
      if (encoder_deg && std::isfinite(*encoder_deg))
        commanded += Angle::degrees(360.0 * std::round((*encoder_deg - commanded.deg()) / 360.0));
    };
    near("encoder_x_deg", dwell.commanded_x);
    near("encoder_z_deg", dwell.commanded_z);
  }

  void read_check_pose(const Row& row, DwellRecord dwell) {
    const std::array<CheckPose, kCheckPoses> poses = check_poses();
    if (dwell.n > kCheckPoses) {
      problem(fmt::format("line {}, n", row.line), fmt::format("check pose {}", dwell.n),
              "check pose 1 or 2");
      return;
    }
    const CheckPose& pose = poses[static_cast<std::size_t>(dwell.n - 1)];
    dwell.role = DwellRole::kCheck;
    dwell.commanded_x = pose.x;
    dwell.commanded_z = pose.z;
    take_turns_of_encoder(row, dwell);
    record_.check_poses.push_back({std::move(dwell), record_.dwells.size()});
  }

  void read_uncertainty(const Row& row, DwellRecord& dwell) {
    if (!with_u_) return;
    int given = 0;
    Eigen::Vector3d u = Eigen::Vector3d::Zero();
    for (std::size_t j = 0; j < 3; ++j) {
      const std::string_view name = kUncertaintyColumns[j];
      if (trimmed(field(row, name)).empty()) continue;
      ++given;
      constexpr const char* kRule = "a standard uncertainty >= 0";
      const std::optional<double> value = number(row, name, kRule);
      if (value && *value < 0.0)
        problem(fmt::format("line {}, {}", row.line, name), as_quoted(field(row, name)), kRule);
      u(static_cast<Eigen::Index>(j)) = value.value_or(0.0);
    }
    if (given == 3) dwell.u_mean = u;
    if (given == 1 || given == 2) {
      problem(fmt::format("line {}", row.line), fmt::format("{} of u_u, u_v, u_w", given),
              "all three or none");
    }
  }

  /// Drift, hysteresis and slow noise depend on the order of measurement.
  void read_row_order() {
    constexpr const char* kKey = "row_order";
    const bool timed = std::ranges::all_of(record_.dwells,
                                           [](const DwellRecord& dwell) { return dwell.time_s.has_value(); });
    const auto stated = metadata_.find(kKey);
    record_.order_assumed = !timed && stated == metadata_.end();
    if (stated != metadata_.end() && stated->second != "time")
      problem(place_of(kKey), as_quoted(stated->second), "time: the rows are in the order of measurement");
  }

  /// Angles of whole circles that are parts of 2 pi are radians: read as degrees, they would look like
  /// missed steps.
  void refuse_radians() {
    std::vector<double> angles;
    for (const DwellRecord& dwell : record_.dwells) angles.push_back(std::abs(dwell.alpha.deg()));
    std::ranges::sort(angles);
    constexpr double kTurn = 2.0 * std::numbers::pi;
    // A circle of N angles ends at 2 pi (N - 1) / N, or at its closing angle.
    if (angles.empty() || angles.back() < 0.6 * kTurn || angles.back() > 1.01 * kTurn) return;
    constexpr double kWritten = 5e-3;  // Angles are often written with two decimals.
    double step = kTurn;
    for (std::size_t i = 1; i < angles.size(); ++i)
      if (const double apart = angles[i] - angles[i - 1]; apart > 2.0 * kWritten)
        step = std::min(step, apart);
    step = kTurn / std::round(kTurn / step);
    const bool parts_of_turn = std::ranges::all_of(angles, [&](double angle) {
      return std::abs(angle - step * std::round(angle / step)) <= 1.01 * kWritten;
    });
    const bool whole_degrees =
        std::ranges::all_of(angles, [](double angle) { return angle == std::round(angle); });
    if (!parts_of_turn || whole_degrees) return;
    constexpr double kDegrees = 360.0 / kTurn;
    problem(
        "column alpha_deg",
        fmt::format("angles from 0 to {:.4g}, {:.4g} apart: parts of 2 pi, so they are radians; {:.4g} is "
                    "{:.4g} degrees",
                    angles.back(), step, angles.back(), kDegrees * angles.back()),
        "degrees: multiply every angle by 180/pi");
  }

  void infer_steps() {
    const auto steps = metadata_number("protocol.steps", 3.0, 1e6);
    const auto step = metadata_number("protocol.step_deg", -360.0, 360.0);
    if (steps && step) {
      record_.steps = static_cast<int>(*steps);
      record_.step = Angle::degrees(*step);
      return;
    }
    abcal::infer_steps(record_);
  }

  std::string text_;
  std::string source_;
  Table table_;
  std::map<std::string, std::size_t> columns_;
  std::map<std::string, std::string> metadata_;  // of the comments
  std::map<std::string, int> metadata_line_;
  std::map<std::tuple<int, int, bool>, int> line_of_;
  bool with_u_ = false;
  std::vector<Problem> problems_;
  RunRecord record_;
};

std::string all_problems(const std::string& source, const std::vector<Problem>& problems) {
  std::string text;
  for (std::size_t i = 0; i < std::min(problems.size(), kMostProblemsShown); ++i) {
    text += fmt::format("{}{}: {}", i == 0 ? "" : "\n", source, to_string(problems[i]));
  }
  if (problems.size() > kMostProblemsShown) {
    text += fmt::format("\n{}: and {} problems more", source, problems.size() - kMostProblemsShown);
  }
  return text;
}

}  // namespace

CsvError::CsvError(const std::string& source, std::vector<Problem> problems)
    : std::runtime_error(all_problems(source, problems)), problems_(std::move(problems)) {}

RunRecord import_csv(std::istream& input, const std::string& source) {
  std::string text(std::istreambuf_iterator<char>(input), {});
  if (input.bad()) throw std::runtime_error(fmt::format("cannot read {}", source));
  return Importer(std::move(text), source).import();
}

RunRecord import_csv(const std::filesystem::path& path) {
  errno = 0;
  std::ifstream file(path, std::ios::binary);
  if (!file || std::filesystem::is_directory(path)) {
    const char* reason = std::filesystem::is_directory(path) ? "it is a folder" : std::strerror(errno);
    throw std::runtime_error(fmt::format("cannot read {}: {}", path.string(), reason));
  }
  return import_csv(file, path.string());
}

}  // namespace abcal
