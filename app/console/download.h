#pragma once

#include <filesystem>
#include <functional>
#include <stop_token>
#include <string>
#include <vector>

namespace abcal::console {

/// A run, or a measurement of several, and the number of one of its items.
struct ItemOfRun {
  std::filesystem::path run;
  int item = 1;
};

/// Something that a page can fetch of a run. This list is the only place to add one.
struct Download {
  std::string name;          ///< Last part of the path, and ending of the file's name: "readings.csv".
  std::string words;         ///< "Averaged readings (CSV)"
  std::string content_type;  ///< "text/csv; charset=utf-8"
  /// Called in a thread of a pool; `cancelled`: no client waits for it any more. The text of its exceptions
  /// is shown to the person.
  std::function<std::string(const ItemOfRun& of, const std::stop_token& cancelled)> make;
  /// Whether an item of a run, or of a measurement of several, has it; null: each has.
  std::function<bool(const ItemOfRun& of)> available;
  bool is_printed = false;  ///< Made by another program (abcal-pdf, WeasyPrint), in seconds.
};

const std::vector<Download>& downloads();

}  // namespace abcal::console
