#pragma once

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "protocol/analysis/analyse_tray.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// A run of several items: each as it was loaded, and all of them analysed.
struct TrayRun {
  std::vector<StoredRun> items;
  TrayResult tray;
};

/// Whether the run holds more than one item.
bool has_several_items(const StoredRun& run);

/// The only item of a run, or the first of several that was not dropped; all were: the first.
int first_whole_item(const StoredRun& run);

/// How many items a run file has; 1 for whatever else it is.
std::size_t items_of_file(const std::filesystem::path& path);

/// The item of a run file, or of a CSV with its one item, that a command is about.
/// @param asked  from 1; 0: none was asked for, which only a file of one item allows
/// @throws std::invalid_argument an item that the file does not have, or none of several
int chosen_item(const std::filesystem::path& path, int asked);

/// Loads every item of a run file and analyses them together.
/// @throws RunFileError
TrayRun analyse_tray_run(const std::filesystem::path& path);
/// The same of items that are loaded.
TrayRun analyse_tray_run(std::vector<StoredRun> items);

/// Results of item k (from 0) by every estimator, as analyse_all() gives them; the joint one is that of the
/// common fit.
std::vector<CalibrationResult> results_of_item(const TrayRun& run, std::size_t k);

/// "2: Analog Devices ADXL355, serial number 17".
std::string item_words(const RunItem& item);

/// The whole tray as one JSON object, schema abcal.tray/1 (docs/several_items_results.md).
nlohmann::ordered_json tray_json(const TrayRun& run);

/// Verdict, a line for each item, the stage, and the differences between the items. Colours as `stream`
/// allows.
std::string tray_text(const TrayRun& run, std::FILE* stream);

}  // namespace abcal
