#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace abcal::console {

/// Something that a page can fetch of a run. This list is the only place to add one.
struct Download {
  std::string name;          ///< Last part of the path, and ending of the file's name: "readings.csv".
  std::string words;         ///< "Averaged readings (CSV)"
  std::string content_type;  ///< "text/csv; charset=utf-8"
  /// Called in the reading thread. What it throws is shown to the person.
  std::function<std::string(const std::filesystem::path& run)> make;
  /// Whether a run has it; null: each has.
  std::function<bool(const std::filesystem::path& run)> available;
};

const std::vector<Download>& downloads();

}  // namespace abcal::console
