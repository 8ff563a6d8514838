#include "app/bench_file/key_reference.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_keys.h"
#include "app/formats/key_visitor.h"

namespace abcal {
namespace {

/// Beginning of the sections of one of several items, which have the keys of sections of the file.
constexpr std::string_view kOfAnItem = "item.";

/// "stage.z" and "stage.x" are "stage.AXIS"; a change has the keys of [simulation].
std::string meaning_path(const std::string& section, const std::string& key) {
  std::string path = section.starts_with(kOfAnItem) ? section.substr(kOfAnItem.size()) : section;
  for (const char* axis : {".x", ".z"}) {
    const std::size_t at = path.find(axis);
    if (at != std::string::npos) path.replace(at, 2, ".AXIS");
  }
  if (section == "change" && key != "at_s" && key != "item") path = "simulation";
  return path.empty() ? key : path + "." + key;
}

/// The unit that the ending of a name gives.
std::string unit_of_name(const std::string& key) {
  constexpr std::pair<const char*, const char*> kEndings[] = {{"_deg_per_s2", "degree/s2"},
                                                              {"_deg_per_s", "degree/s"},
                                                              {"_deg", "degree"},
                                                              {"_degc", "degC"},
                                                              {"_mps2", "m/s2"},
                                                              {"_hz", "Hz"},
                                                              {"_hpa", "hPa"},
                                                              {"_percent", "%"},
                                                              {"_urad", "urad"},
                                                              {"_s", "s"},
                                                              {"_m", "m"},
                                                              {"_v", "V"}};
  for (const auto& [ending, unit] : kEndings) {
    if (key.ends_with(ending)) return unit;
  }
  return {};
}

/// A limit that is not given is infinite or +-1e9, which is not shown as a default.
std::string real_text(double value) {
  return std::abs(value) < 1e9 ? fmt::format("{}", value) : std::string();
}

std::string triple_text(const Eigen::Vector3d& v) {
  return fmt::format("[{}, {}, {}]", v[0], v[1], v[2]);
}

std::string range_text(const Range& range) {
  if (range.min == -kInfinity && range.max == kInfinity) return {};
  if (range.max == kInfinity) return fmt::format("{} {:g}", range.min_excluded ? ">" : ">=", range.min);
  return fmt::format("{}{:g} to {:g}", range.min_excluded ? "above " : "", range.min, range.max);
}

std::string choices_text(const std::string& key, const std::vector<std::string>& choices) {
  // The drivers are listed by `abcal instruments`; a new one changes no page.
  if (key == "driver") return "a driver's name";
  std::vector<std::string> words;
  for (const std::string& choice : choices) words.push_back(choice.empty() ? "empty" : "`" + choice + "`");
  return fmt::format("{}", fmt::join(words, ", "));
}

/// Escapes bars, which would end the cell of a Markdown table.
std::string in_table_cell(std::string text) {
  for (std::size_t at = text.find('|'); at != std::string::npos; at = text.find('|', at + 2))
    text.insert(at, "\\");
  return text;
}

/// Collects every key that is visited, with its default.
class KeyCollector final : public KeyVisitor {
 public:
  void section(const std::string& path) override { section_ = path; }
  void text(const std::string& key, std::string& value, const std::vector<std::string>& choices) override {
    add(key, "text", choices_text(key, choices), "\"" + value + "\"");
  }
  void required_text(const std::string& key, std::string& /*value*/,
                     const std::vector<std::string>& choices) override {
    add(key, "text", choices_text(key, choices), {});
    found_.back().required = true;
  }
  void number(const std::string& key, double& value, Range range) override {
    add(key, "number", range_text(range), real_text(value));
  }
  void number(const std::string& key, std::optional<double>& value, Range range) override {
    add(key, "number", range_text(range), value ? real_text(*value) : std::string());
  }
  void number_or_auto(const std::string& key, double& value, bool& automatic, Range range) override {
    add(key, "number", range_text(range) + ", `\"auto\"`", automatic ? "\"auto\"" : real_text(value));
  }
  void integer(const std::string& key, int& value, int min, int max) override {
    add(key, "integer", fmt::format("{} to {}", min, max), std::to_string(value));
  }
  void integer(const std::string& key, std::optional<int>& value, int min, int max) override {
    add(key, "integer", fmt::format("{} to {}", min, max), value ? std::to_string(*value) : std::string());
  }
  void seed(const std::string& key, std::uint64_t& value) override {
    add(key, "integer", ">= 0", std::to_string(value));
  }
  void boolean(const std::string& key, bool& value) override {
    add(key, "boolean", "`true`, `false`", value ? "true" : "false");
  }
  void vector(const std::string& key, Eigen::Vector3d& value, Range range) override {
    add(key, "3 numbers", range_text(range), triple_text(value));
  }
  void uncertainty(const std::string& key, StatedUncertainty& stated, double most,
                   const std::string& unit) override {
    add(key, "uncertainty", range_text({0.0, most}), real_text(stated.value));
    found_.back().unit = unit;
    for (const EffectSizeKey& size : effect_size_keys()) {
      if (size.key == key)
        found_.back().meaning = "Standard uncertainty: " + in_table_cell(std::string(size.words)) + ".";
    }
  }
  void integers(const std::string& key, std::array<int, 3>& value, int min, int max) override {
    add(key, "3 integers", fmt::format("{} to {}", min, max),
        fmt::format("[{}, {}, {}]", value[0], value[1], value[2]));
  }
  void numbers(const std::string& key, std::vector<double>& value, Range range) override {
    add(key, "numbers", range_text(range), fmt::format("[{}]", fmt::join(value, ", ")));
  }
  void matrix(const std::string& key, Eigen::Matrix3d& value, Range range) override {
    add(key, "3 x 3 numbers", range_text(range),
        fmt::format("[{}, {}, {}]", triple_text(value.row(0)), triple_text(value.row(1)),
                    triple_text(value.row(2))));
  }
  void tables(const std::string& key, std::size_t size,
              const std::function<void(std::size_t)>& visit_entry) override {
    const std::string outer = std::exchange(section_, section_.empty() ? key : section_ + "." + key);
    repeated_ = true;
    visit_entry(size);
    repeated_ = false;
    section_ = outer;
  }
  void table(const std::string& key, const std::function<void()>& visit_keys) override {
    const std::string outer = std::exchange(section_, section_ + "." + key);
    const bool outer_repeated = std::exchange(repeated_, false);
    visit_keys();
    repeated_ = outer_repeated;
    section_ = outer;
  }
  bool shows_every_form() const override { return true; }
  std::vector<BenchKey> keys() { return std::move(found_); }

 private:
  void add(const std::string& key, const std::string& type, const std::string& range,
           const std::string& fallback) {
    const KeyMeaning meaning = bench_key_meaning(meaning_path(section_, key));
    BenchKey entry;
    entry.section = section_;
    entry.repeated = repeated_;
    entry.key = key;
    entry.type = type;
    entry.unit = meaning.unit.empty() ? unit_of_name(key) : meaning.unit;
    entry.range = range;
    const bool as_before = section_ == "change" && key != "at_s" && key != "item";
    if (!as_before && !meaning.no_default) entry.fallback = fallback;
    entry.meaning = meaning.text;
    found_.push_back(entry);
  }

  std::string section_;
  bool repeated_ = false;
  std::vector<BenchKey> found_;
};

std::string section_heading(const BenchKey& key) {
  if (key.section.empty()) return "Top of the file";
  return key.repeated ? "[[" + key.section + "]]" : "[" + key.section + "]";
}

std::string table_row(const BenchKey& key) {
  std::string fallback = key.required ? "required" : "-";
  if (!key.fallback.empty()) fallback = "`" + key.fallback + "`";
  return fmt::format("| `{}` | {} | {} | {} | {} | {} |\n", key.key, key.type, key.unit, key.range, fallback,
                     key.meaning);
}

/// The text in place of a table whose keys are those of another section; empty: the page has the table.
std::string words_for_same_keys(const BenchKey& key) {
  if (key.section == "item" && key.repeated) return "The keys of `[item]`.\n";
  if (!key.section.starts_with(kOfAnItem)) return {};
  const std::string same = key.section.substr(kOfAnItem.size());
  if (same == "accelerometer") return "The keys of `[accelerometer]`.\n";
  if (same == "simulation")
    return "The keys of `[simulation]` that concern the accelerometer, along the item's own axes: its "
           "mounting turns it. Default: as `[simulation]`.\n";
  if (same == "emulator")
    return "The keys of `[emulator]` that concern the accelerometer. Default: as `[emulator]`.\n";
  return "The keys of `[" + same + "]`, for this item. Default: as `[" + same + "]`.\n";
}

/// Whether the section is the second of two with the same keys: "stage.z" after "stage.x".
bool second_axis(const std::string& section) {
  return section.find(".z") != std::string::npos;
}

constexpr const char* kPageTop =
    R"(# The bench file: every key

A bench file (TOML, schema `abcal.bench/2`) describes stage, accelerometer, environment, local gravity and the
measurement. `abcal init` finds the instruments, asks five questions and writes one
([first run](tutorial.md#your-own-instruments)); commented examples are in `docs/examples`. `abcal plan BENCH`
reports every mistake in a file with its line number. `abcal plan --keys` makes this page; do not edit it.

- *Default*: the value if the key is absent, as TOML. `-`: no value; the meaning states what happens then.
- *Range*: empty if any value of the type is accepted. Numbers must be finite.
- Type *uncertainty*: a standard uncertainty as a number, or a table with its source
  ([effects](effects.md#how-sizes-are-stated)). "6/rev" means 6 periods per revolution.
- R is the response unit of the accelerometer (V, g, m/s2, LSB ...); other symbols: [notation](notation.md).
- Unknown keys and sections are mistakes.
)";

/// Section and name of the keys that every bench file with instruments states.
constexpr std::pair<const char*, const char*> kCommonKeys[] = {{"bench", "g_loc_mps2"},
                                                               {"item", "model"},
                                                               {"item", "serial_number"},
                                                               {"operator", "name"},
                                                               {"stage", "driver"},
                                                               {"stage", "port"},
                                                               {"stage.x", "axis"},
                                                               {"stage.x", "sign"},
                                                               {"stage.x", "travel_min_deg"},
                                                               {"stage.x", "travel_max_deg"},
                                                               {"accelerometer", "driver"},
                                                               {"accelerometer", "port"},
                                                               {"accelerometer", "rate_hz"},
                                                               {"accelerometer", "response_unit"},
                                                               {"accelerometer", "full_scale"}};

std::string common_keys(const std::vector<BenchKey>& keys) {
  std::string table =
      "\n## The keys that everyone has\n\n"
      "Everything else has a default. The keys of `[stage.x]` stand under `[stage.z]` too.\n\n"
      "| section | key | meaning |\n|---|---|---|\n";
  for (const auto& [section, name] : kCommonKeys) {
    const auto key = std::ranges::find_if(
        keys, [&](const BenchKey& each) { return each.section == section && each.key == name; });
    if (key != keys.end()) table += fmt::format("| `[{}]` | `{}` | {} |\n", section, name, key->meaning);
  }
  return table;
}

}  // namespace

std::vector<BenchKey> bench_keys() {
  BenchConfig defaults;
  KeyCollector collector;
  visit_bench_file(collector, defaults);
  return collector.keys();
}

std::string bench_file_page() {
  const std::vector<BenchKey> keys = bench_keys();
  std::string page = kPageTop + common_keys(keys);
  std::string section = "none yet";
  bool repeated = false;
  for (const BenchKey& key : keys) {
    const std::string same_keys = words_for_same_keys(key);
    if (key.section != section || key.repeated != repeated) {
      section = key.section;
      repeated = key.repeated;
      page += "\n## " + section_heading(key) + "\n\n";
      const std::string text = bench_section_text(section == "item" && repeated ? "[[item]]" : section);
      if (!text.empty()) page += text + "\n\n";
      if (!same_keys.empty()) {
        page += same_keys;
      } else if (second_axis(section)) {
        std::string first = section_heading(key);
        first.replace(first.find(".z"), 2, ".x");
        page += "The keys of `" + first + "`" +
                (section == "stage.z" ? ", for the inner axis; the default of `axis` is `\"2\"`.\n"
                                      : ", for the inner axis.\n");
      } else {
        page += "| key | type | unit | range | default | meaning |\n|---|---|---|---|---|---|\n";
      }
    }
    if (same_keys.empty() && !second_axis(section)) page += table_row(key);
  }
  return page;
}

}  // namespace abcal
