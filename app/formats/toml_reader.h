#pragma once

#include <toml++/toml.h>
#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/formats/key_visitor.h"
#include "app/formats/record_lookup.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// "a", "b", "c" in quotes, for messages; empty words are left out.
std::string joined(const std::vector<std::string>& words);

/// Reads requested keys from a TOML file, and keeps every problem with its line. An absent or wrong key
/// leaves the value unchanged.
class TomlReader final : public KeyVisitor {
 public:
  /// @param lookup  finds the record of `{ from = "RECORD" }`; empty: no register is configured
  /// @param text  the file: problems show their lines; empty: they do not
  explicit TomlReader(const toml::table& root, RecordLookup lookup = {}, std::string_view text = {});

  void section(const std::string& path) override;
  void text(const std::string& key, std::string& value,
            const std::vector<std::string>& choices = {}) override;
  void required_text(const std::string& key, std::string& value,
                     const std::vector<std::string>& choices = {}) override;
  void number(const std::string& key, double& value, Range range) override;
  void number(const std::string& key, std::optional<double>& value, Range range) override;
  void number_or_auto(const std::string& key, double& value, bool& automatic, Range range) override;
  void integer(const std::string& key, int& value, int min, int max) override;
  void integer(const std::string& key, std::optional<int>& value, int min, int max) override;
  void seed(const std::string& key, std::uint64_t& value) override;
  void boolean(const std::string& key, bool& value) override;
  void vector(const std::string& key, Eigen::Vector3d& value, Range range) override;
  void uncertainty(const std::string& key, StatedUncertainty& stated, double most,
                   const std::string& unit) override;
  void calibrated(const std::string& key, CalibratedNumber& number_of_key, Range range,
                  const std::string& unit) override;
  void matrix(const std::string& key, Eigen::Matrix3d& value, Range range) override;
  void numbers(const std::string& key, std::vector<double>& value, Range range) override;
  void integers(const std::string& key, std::array<int, 3>& value, int min, int max) override;
  void tables(const std::string& key, std::size_t size,
              const std::function<void(std::size_t)>& visit_entry) override;
  void table(const std::string& key, const std::function<void()>& visit_keys) override;
  bool is_list(const std::string& key) const override;
  bool gives(const std::string& path) const override;

  /// A date of TOML, without quotes: 2026-03-01.
  void date(const std::string& key, std::optional<std::chrono::year_month_day>& value);
  /// A list of texts.
  void texts(const std::string& key, std::vector<std::string>& value,
             const std::vector<std::string>& choices = {});
  /// Whether a key is in the section being visited.
  bool has(const std::string& key) const { return table_ != nullptr && table_->contains(key); }
  /// Reports a key of the section being visited, at its own line; nothing if it is wrong by itself.
  void refuse(const std::string& key, const std::string& found, const std::string& required);
  /// Reports a required key that is missing from the section being visited.
  void add_missing(const std::string& key, const std::string& required);
  /// The line of the section being visited; if it is absent that of the entry it should be in, or 0.
  std::uint32_t line() const { return table_ == nullptr ? entry_line_ : table_->source().begin.line; }

  /// The path of a key of the section being visited, for add_problem_at().
  std::string name(const std::string& key) const { return path_.empty() ? key : path_ + "." + key; }

  /// Keys and sections that no visit asked for.
  void report_unknown();
  std::vector<Problem> take_problems();
  /// A problem that only several keys together show; `where` is a path such as "stage.x.sign". Not reported
  /// for a key that has a problem of its own.
  void add_problem(const std::string& where, const std::string& found, const std::string& required);
  /// Like add_problem(), if only the line is known.
  void add_problem_at(std::uint32_t line, const std::string& where, const std::string& found,
                      const std::string& required);

 private:
  void problem(const toml::node& node, const std::string& where, const std::string& found,
               const std::string& required);
  /// Like problem(), with what the text of the value, or of the key, may have been meant to be.
  void problem_with_guess(const toml::source_region& place, const std::string& where, const Problem& words,
                          std::string_view written, const std::string& meant);
  /// The line of the file, if it is short enough to be shown.
  std::string_view line_at(std::uint32_t line) const;
  /// A value as written in the file.
  std::string written_value(const toml::source_region& place) const;
  const toml::node* find(const std::string& key);
  void read_text(const std::string& key, std::string& value, const std::vector<std::string>& choices,
                 bool required);
  void read_uncertainty_table(const toml::table& table, const std::string& where, StatedUncertainty& stated,
                              const Range& range, const std::string& unit);
  std::optional<RecordedValue> recorded(const toml::table& table, const std::string& key,
                                        const std::string& unit);
  std::optional<double> number_in_table(const toml::table& table, const std::string& where,
                                        const std::string& key, const Range& range, const std::string& words);
  void read_triple(const toml::node& node, const std::string& where, Eigen::Vector3d& value,
                   const Range& range);
  void report_unknown(const toml::table& table, const std::string& path);
  /// The sections that know a key of this name: "[stage.x] or [stage.z]".
  std::string sections_with(const std::string& key) const;

  const toml::table& root_;
  RecordLookup lookup_;
  std::vector<std::string_view> lines_;
  const toml::table* table_ = nullptr;
  std::string path_;
  std::uint32_t entry_line_ = 0;  ///< Line of the list entry whose table is being visited.
  std::map<std::string, std::set<std::string>> known_;
  std::set<std::string> wrong_;  ///< Keys that are wrong by themselves.
  std::set<std::string> reported_;
  std::vector<std::pair<std::uint32_t, Problem>> found_;
};

/// Parses a TOML file into its table. A line that is not TOML is added to the problems; if it is clear how
/// each such line is meant, the table is that of the corrected lines, so that the other problems of the file
/// can be found at the same time. Else, and for an empty file, the table is empty.
/// @param kind  the expected content: "a bench file; commented examples are in docs/examples"
toml::table parse_toml(std::string_view text, const std::string& source, const std::string& kind,
                       std::vector<Problem>& problems);

/// The whole of a file of a kind ("bench file"). A failure (absent, a folder, no permission) is
/// added to the problems.
std::string read_text_file(const std::string& path, const std::string& kind, std::vector<Problem>& problems);

}  // namespace abcal
