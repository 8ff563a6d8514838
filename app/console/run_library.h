#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <filesystem>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_file.h"

namespace abcal::console {

/// The runs that a console knows: files NAME.run that lie directly in one folder. A name from a page is only
/// compared with theirs, so that none can lead elsewhere. Reading and analysing take time: not for the thread
/// that serves the pages. Safe to use from several threads.
class RunLibrary {
 public:
  /// Summaries of closed runs are kept next to them (kSummaries), so that a list of many is read quickly.
  explicit RunLibrary(std::filesystem::path folder);

  static constexpr const char* kSummaries = ".abcal-summaries.json";

  /// The file of this name, if it is one of the runs.
  std::optional<std::filesystem::path> find(const std::string& name) const { return find_in(folder_, name); }
  /// The same for any folder, without reading its summaries.
  static std::optional<std::filesystem::path> find_in(const std::filesystem::path& folder,
                                                      const std::string& name);

  // Each of these is JSON as docs/console_programs.md describes it. A run in progress is read with the data
  // measured so far.

  /// All runs, newest first, with their state and progress. A file that cannot be read is listed with the
  /// reason; one for which `patience` left no time, as "not read yet": ask again.
  nlohmann::ordered_json list(std::chrono::milliseconds patience = std::chrono::milliseconds(500));
  /// A page of the list.
  struct PageAsked {
    std::string search;  ///< Words that a run's data must all have; capitals do not matter.
    std::string sort;    ///< A key of a run's data; empty: newest first.
    bool descending = false;
    std::string state;  ///< Only runs in this state; empty: in any.
    std::string item;   ///< Only runs of the item with this serial number; empty: of any.
    std::string bench;  ///< Only runs on the bench of this name; empty: on any.
    std::size_t from = 0, count = 100;
  };
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
  nlohmann::ordered_json history(const std::string& serial_number, const std::string& property);

 private:
  /// The properties that a chart shows, of one run: kept as numbers, as JSON takes several times the memory.
  struct Charted {
    struct Value {
      double value = 0.0, standard_uncertainty = 0.0;
      std::string unit;
    };
    std::string verdict;
    std::array<Value, 9> values;  ///< In the order of kCharted.
  };
  /// The data of a run in the list. Not kept as JSON, which takes several times the memory.
  struct Summary {
    std::string state, created_utc, item, maker, model, bench, operators, unit, simulated, verdict;
    std::string items;  ///< JSON: how far each was measured.
    std::size_t measured = 0, planned = 0;
    double duration_s = 0.0;
  };
  struct Entry {
    std::filesystem::file_time_type time;
    std::uintmax_t size = 0;
    Summary summary;
    bool closed = false;             ///< It will not change any more.
    std::map<int, Charted> charted;  ///< For the history, by item of the run, from 1.
    std::string estimator = {};      ///< Chosen for the run.
    std::optional<std::filesystem::file_time_type> results_time = {};  ///< mtime of the results last read.
  };

  std::vector<std::string> names() const;
  static Summary summary_of(const StoredRun& run);
  static std::vector<int> whole_items_of(const Summary& summary, const std::string& serial_number);
  static nlohmann::ordered_json to_json(const std::string& name, const Summary& summary);
  static Summary summary_from(const nlohmann::ordered_json& kept);
  static Charted charted_of(const CalibrationResult& result);
  static nlohmann::ordered_json to_json(const Charted& charted);
  static Charted charted_from(const nlohmann::ordered_json& kept);
  /// The points of property number `index`: one for each item of the run with this serial number, none if the
  /// run is not complete. Throws RunFileError.
  std::vector<nlohmann::ordered_json> points_of_chart(const std::string& name,
                                                      const std::string& serial_number, std::size_t index);
  Entry& entry(const std::string& name);
  void find_verdict(const std::string& name, Entry& known);
  bool is_known(const std::string& name) const;
  void read_summaries();
  void keep_summaries();

  std::filesystem::path folder_;
  std::mutex mutex_;
  std::map<std::string, Entry> known_;  ///< By name; closed runs are read once.
  bool have_new_ = false;               ///< Some summaries are not stored yet.
};

}  // namespace abcal::console
