#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/record/sqlite.h"

namespace abcal::console {

/// A file with this extension itself: a link would lead out of the folder.
bool is_own_file(const std::filesystem::path& path, std::string_view extension);

/// The verdict of an estimator as stored when a run was closed, or a measurement of several runs analysed;
/// empty: not analysed, or the results cannot be read.
std::string kept_verdict(const std::filesystem::path& path, const std::string& estimator);

/// The data of a run in a list, as docs/console_programs.md describes it, but for `analysed`.
nlohmann::ordered_json run_summary(const std::string& name, const StoredRun& run);

/// The list of the runs in a folder, in a database beside them, so that a page of it costs the rows that it
/// shows. A thread reads what is new or has changed, newest first. A row belongs to inode, size and times of
/// its file; those that a page shows are compared with their files then. The database is only a copy: one of
/// another format is made again, and one that cannot be written is in memory. Safe to use from several
/// threads.
class RunIndex {
 public:
  static constexpr const char* kFile = ".abcal-runs.sqlite";

  explicit RunIndex(std::filesystem::path folder);

  /// Runs that are asked for, newest first.
  struct Asked {
    std::string search;  ///< Words that a run's data must all have; capitals do not matter.
    std::string sort;    ///< A key of a run's data; empty: newest first.
    bool descending = false;
    std::string state;  ///< Only runs in this state; empty: in any.
    std::string item;   ///< Only runs of the item with this serial number; empty: of any.
    std::string bench;  ///< Only runs on the bench of this name; empty: on any.
    std::size_t from = 0, count = 100;
  };
  struct Page {
    std::vector<nlohmann::ordered_json> runs;
    std::int64_t all = 0, found = 0;
    std::int64_t unread = 0;              ///< Runs not read so far, among all.
    std::map<std::string, int> verdicts;  ///< How many of those found have each.
    std::string first_utc, last_utc;      ///< Beginnings of the first and the last of those found.
  };
  /// A file that cannot be read is listed with the reason; one that is not read after `patience`, as "not
  /// read yet".
  Page page(const Asked& asked, std::chrono::milliseconds patience);

  /// The data of one run as page() has them; null: there is none of this name. Waits for no other run.
  nlohmann::ordered_json summary(const std::string& name);

  /// A run as it was read.
  struct ReadRun {
    nlohmann::ordered_json summary;
    bool is_closed = false;  ///< It will not change any more.
    std::string estimator;   ///< That it declares.
  };

  /// A complete run with an item.
  struct RunOfItem {
    std::string name, contents, estimator, created_utc, simulated;
    std::vector<int> items;                         ///< Those with the serial number, measured to the end.
    std::map<int, nlohmann::ordered_json> charted;  ///< By item: what this version of abcal has kept.
  };
  /// Oldest first. Waits until all runs are read, or for the stop.
  std::vector<RunOfItem> runs_of_item(const std::string& serial_number, const std::stop_token& stop);
  /// Keeps what a chart shows of an item, unless the run has changed since.
  void keep_charted(const RunOfItem& run, int item, const nlohmann::ordered_json& charted);

 private:
  /// Finds new, changed and removed runs, and waits for the thread that reads them.
  void look(std::unique_lock<std::mutex>& lock, std::chrono::milliseconds patience,
            const std::stop_token& stop = {});
  void find_runs();
  /// @return whether it is new or has changed
  bool find_run(const std::string& name);
  void find_results(const std::string& name);
  void read_new(const std::stop_token& stop);
  /// Whether the files of a run, when they were last looked at, had these contents.
  bool has_contents(const std::string& name, const std::string& contents);
  void store(const std::string& name, const std::string& contents, const ReadRun& read);
  nlohmann::ordered_json known_summary(const std::string& name);
  Page page_of(const Asked& asked, std::unique_lock<std::mutex>& lock, std::chrono::milliseconds patience);
  std::vector<RunOfItem> complete_runs_of_item(const std::string& serial_number);
  std::vector<std::string> names(std::string_view query);
  std::vector<std::string> names_shown(const Asked& asked);
  /// Asks the database; where the disk does not give or take it any more, once more in memory.
  template <class Ask>
  auto on_disk_or_in_memory(const Ask& ask);

  const std::filesystem::path folder_;
  std::mutex mutex_;
  std::condition_variable_any was_read_;  ///< A run was read, or the thread has nothing left to read.
  SqliteDatabase database_;
  std::string folder_contents_;
  bool folder_has_changed_ = true;
  bool is_reading_ = false;
  std::jthread reader_;  ///< It ends before the members that it uses.
};

}  // namespace abcal::console
