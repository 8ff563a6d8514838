#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"

namespace abcal::console {

/// Comparisons of laboratories that a console shows: protocols NAME.toml of schema abcal.comparison/1 that
/// lie directly in one of its folders. A name from a page is only compared with theirs. Reading and analysing
/// take time: not for the thread that serves the pages. Safe to use from several threads.
class Comparisons {
 public:
  /// @param register_location  for certificates that do not hold any more; empty: none
  Comparisons(std::vector<std::filesystem::path> folders, std::string register_location);

  /// The protocol of this name. Of several, that in the first folder.
  std::optional<std::filesystem::path> find(const std::string& name) const;
  /// Each with its `file` and its state as `abcal pilot status --json` prints it, which has no value of a
  /// result; or with `error`, the reason why it cannot be read.
  nlohmann::ordered_json list() const;
  /// Whether the participants agree (`agree`) and who does not (`verdict`).
  /// @throws as analyse_comparison(), e.g. before all results are in
  nlohmann::ordered_json outcome(const std::filesystem::path& protocol, Clock::UtcTime now) const;
  /// Draft A as a page.
  /// @throws as outcome()
  std::string draft(const std::filesystem::path& protocol, Clock::UtcTime now) const;

 private:
  std::vector<std::filesystem::path> files() const;

  const std::vector<std::filesystem::path> folders_;
  const std::string register_location_;
};

}  // namespace abcal::console
