#pragma once

#include <chrono>
#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <stop_token>
#include <string>

#include "app/console/run_index.h"

namespace abcal::console {

/// The runs that a console knows: files NAME.run that lie directly in one folder. A name from a page is only
/// compared with theirs, so that none can lead elsewhere. Reading and analysing take time: not for the thread
/// that serves the pages. Safe to use from several threads.
class RunLibrary {
 public:
  explicit RunLibrary(std::filesystem::path folder);

  /// The file of this name, if it is one of the runs.
  std::optional<std::filesystem::path> find(const std::string& name) const { return find_in(folder_, name); }
  /// The same for any folder, without reading its summaries.
  static std::optional<std::filesystem::path> find_in(const std::filesystem::path& folder,
                                                      const std::string& name);

  // Each of these is JSON as docs/console_programs.md describes it. A run in progress is read with the data
  // measured so far.

  /// All runs, newest first, with their state and progress. A file that cannot be read is listed with the
  /// reason; one for which `patience` left no time, as "not read yet": ask again.
  nlohmann::ordered_json list(std::chrono::milliseconds patience = kPatience);
  using PageAsked = RunIndex::Asked;
  /// One page of the runs that are found: `runs`; the numbers `found` of `all`, and `unread` so far;
  /// `verdicts` counts those found by verdict, `first_utc` and `last_utc` are the beginnings of the first and
  /// the last of them.
  nlohmann::ordered_json page(const PageAsked& asked);
  /// One run with the results of the three estimators (abcal.result/1 each), its angles and its events.
  /// @param item  from 1; 0: the first that was not left out
  /// @throws RunFileError
  nlohmann::ordered_json result(const std::filesystem::path& run, int item);
  /// The measured angles of an item, in columns: for charts of their means and residuals.
  /// @param item  as of result()
  static nlohmann::ordered_json angles(const std::filesystem::path& run, int item);
  /// Single readings of an item, at most some `columns` of them: of more, the lowest and the highest of equal
  /// parts in time, so that no outlier is lost.
  /// @param item  as of result()
  /// @param position  of an angle in the plan; absent: of all angles
  static nlohmann::ordered_json readings(const std::filesystem::path& run, int item,
                                         std::optional<std::size_t> position, std::size_t columns);
  /// The file of this name, if it is a measurement of several runs in the folder.
  std::optional<std::filesystem::path> find_measurement(const std::string& name) const;
  /// All measurements of several runs, newest first, with the verdict that was stored.
  nlohmann::ordered_json measurements();
  /// One measurement with its runs, and the joint result of one item (abcal.result/1).
  /// @param item  from 1; 0: the first
  /// @throws as analyse_file(); std::invalid_argument there is no such item
  nlohmann::ordered_json measurement(const std::filesystem::path& measurement, int item);
  /// The path of a run, or with its item: NAME#K is item K of NAME.
  std::optional<std::string> find_item(const std::string& name) const;
  /// Two results side by side (abcal.compare/1), also of different items. Each is a path that find_item()
  /// gave.
  /// @param shared_stage  both were measured on one stage: the common part of its errors is subtracted
  /// @throws as load_compared() and compare_results()
  static nlohmann::ordered_json compare(const std::string& first, const std::string& second,
                                        bool shared_stage);
  /// Whether a chart shows this property: s_u to O_w.
  static bool is_charted(const std::string& property);
  /// One charted property in every complete run of one item, by the estimator that the run declares, oldest
  /// first, with the limits of a control chart of single values.
  nlohmann::ordered_json history(const std::string& serial_number, const std::string& property,
                                 const std::stop_token& stop);

 private:
  static constexpr std::chrono::milliseconds kPatience{500};

  std::filesystem::path folder_;
  RunIndex index_;
};

}  // namespace abcal::console
