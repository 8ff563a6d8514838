#include "protocol/record/table_comments.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "protocol/plan/rotation_plan.h"
#include "protocol/record/limits_entries.h"

namespace abcal {
namespace {

/// Reads the comments that `abcal report --csv` writes above the header, so that the analysis of the copy
/// gives the same numbers.
class CommentReader {
 public:
  CommentReader(TableReader& table, TableProblems& problems) : table_(table), problems_(problems) {
    for (const TableComment& comment : table.comments()) {
      if (comment.value.empty() && !states_a_size(comment.key)) continue;
      if (states_a_size(comment.key) && comments_.contains(comment.key)) {
        problems_.add(fmt::format("line {}, comment \"{}\"", comment.line, comment.key),
                      fmt::format("the key again (first on line {})", comments_.at(comment.key).line),
                      "each key once");
        continue;
      }
      comments_[comment.key] = comment;
    }
  }

  void read_into(RunRecord& record) {
    const auto text = [&](const std::string& key) -> std::optional<std::string> {
      const auto found = comments_.find(key);
      return found == comments_.end() ? std::nullopt : std::optional(found->second.value);
    };
    record.response_unit = text("response_unit").value_or(record.response_unit);
    read_effect_sizes([&](const std::string& key, double most) { return number(key, 0.0, most); }, text,
                      record.tolerances);
    check_effect_keys();
    read_limits_entries([&](const std::string& key) { return number(key, -1e9); }, text, record.limits,
                        record.expected);
    if (const auto chosen = text(std::string(kEstimatorLabel))) read_estimator(*chosen, record);
    if (const auto order = text("protocol.axes_order")) record.axes_order = axes_order_named(*order);
    if (const auto deg = number("protocol.approach_deg", 0.0, 45.0)) record.approach = Angle::degrees(*deg);
    record.continuations = static_cast<int>(number("continuations", 0.0, 1e6).value_or(0.0));
    read_alignment(record.measured_alignment);
    if (const auto u = number("pose_uncertainty_deg", 1e-9, 10.0)) record.u_up = Angle::degrees(*u);
    if (const auto g = number("g_loc.value_mps2", 9.0, 10.5)) {
      record.g_loc_known = true;
      record.g_loc.value_mps2 = *g;
      record.g_loc.expanded_uncertainty_mps2 = number("g_loc.expanded_uncertainty_mps2").value_or(0.0);
      record.g_loc.coverage_factor = number("g_loc.coverage_factor", 1.0, 10.0).value_or(2.0);
      record.g_loc.source = text("g_loc.source").value_or("");
    }
    read_steps(record);
    if (const auto order = text("row_order"); order && *order != "time")
      problems_.add(place_of("row_order"), as_quoted(*order),
                    "time: the rows are in the order of measurement");
    record.order_assumed = !text("row_order");
  }

 private:
  /// An empty value of such a key would silently leave the default in force.
  static bool states_a_size(const std::string& key) {
    return key.starts_with("stage_uncertainty.") || key.starts_with("item_uncertainty.") ||
           key.starts_with("tolerances.");
  }

  std::string place_of(const std::string& key) const {
    return fmt::format("line {}, comment \"{}\"", comments_.at(key).line, key);
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
    for (const auto& [key, comment] : comments_) {
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
        problems_.add(place_of(key), "an effect of this name", fmt::format("one of {}", known));
      } else if (of_source && !comments_.contains(of)) {
        problems_.add(place_of(key), "a source without a value",
                      fmt::format("a comment \"{}\" with a number from 0 to {:g}{}", of, most, unit_of(of)));
      } else if (of_source && comment.value.empty()) {
        problems_.add(place_of(key), "nothing", "the source of the value, as text");
      }
    }
  }

  void read_estimator(const std::string& chosen, RunRecord& record) {
    if (std::ranges::find(kEstimatorNames, chosen) != kEstimatorNames.end()) {
      record.estimator = chosen;
    } else {
      problems_.add(place_of(std::string(kEstimatorLabel)), as_quoted(chosen),
                    fmt::format("one of {}", fmt::join(kEstimatorNames, ", ")));
    }
  }

  void read_alignment(MeasuredAlignment& alignment) {
    for (const auto& [name, measured] :
         {std::pair{"zx", &alignment.zx}, {"zy", &alignment.zy}, {"xz", &alignment.xz}}) {
      const auto value = number(std::string("alignment.") + name, -1.0, 1.0);
      const auto u = number(std::string("alignment.u_") + name, std::numeric_limits<double>::min(), 1.0);
      if (value && u) *measured = MeasuredValue{*value, *u};
    }
  }

  void read_steps(RunRecord& record) {
    const auto steps = number("protocol.steps", 3.0, 1e6);
    const auto step = number("protocol.step_deg", -360.0, 360.0);
    if (!steps || !step) return;
    record.steps = static_cast<int>(*steps);
    record.step = Angle::degrees(*step);
  }

  /// The number behind a key in the comments; absent, and a problem is reported, if the text is not a number.
  std::optional<double> number(const std::string& key, double lowest = 0.0, double highest = 1e9) {
    const auto found = comments_.find(key);
    if (found == comments_.end()) return std::nullopt;
    const std::string& text = found->second.value;
    const std::optional<double> value = table_.number(text);
    if (value && *value >= lowest && *value <= highest) return value;
    problems_.add(place_of(key), text.empty() ? "nothing" : as_quoted(text),
                  fmt::format("a number from {:g} to {:g}{}", lowest, highest, unit_of(key)));
    return std::nullopt;
  }

  TableReader& table_;
  TableProblems& problems_;
  std::map<std::string, TableComment> comments_;
};

}  // namespace

void read_comments(TableReader& table, TableProblems& problems, RunRecord& record) {
  CommentReader(table, problems).read_into(record);
}

}  // namespace abcal
