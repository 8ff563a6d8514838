#pragma once

#include <string>
#include <vector>

namespace abcal {

/// One key of a bench file as docs/bench_file.md shows it. All texts are for people.
struct BenchKey {
  std::string section;    ///< "stage.x"; empty: the top of the file.
  bool repeated = false;  ///< The section is an array of tables, [[fault]].
  std::string key;
  std::string type;      ///< "number", "text", "3 numbers", ...
  std::string unit;      ///< Empty: none.
  std::string range;     ///< Accepted values; empty: any of the type.
  std::string fallback;  ///< The default as TOML; empty: none, the key may be absent.
  std::string meaning;   ///< Empty: not written yet (a test fails).
  bool required = false;
};

/// Every key, in the order of the file.
std::vector<BenchKey> bench_keys();

/// The page docs/bench_file.md in Markdown, as `abcal plan --keys` prints it.
std::string bench_file_page();

/// The meaning of a key, and its unit if the name does not end with it (`_deg`, `_s`). Empty if the key is
/// not listed.
struct KeyMeaning {
  std::string text;
  std::string unit;
  bool no_default = false;  ///< The value of an absent key is not used; the meaning states the effect.
};
/// @param path  "protocol.settle_s"; "stage.AXIS.sign" stands for both axes.
KeyMeaning bench_key_meaning(const std::string& path);

/// The introduction of a section; empty if it needs none.
std::string bench_section_text(const std::string& section);

}  // namespace abcal
