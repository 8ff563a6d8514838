#pragma once

#include <sys/types.h>

#include <condition_variable>
#include <filesystem>
#include <functional>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <thread>

#include "app/measure/guard/guard_packets.h"

namespace abcal::console {

/// Knows each axis of the bench, past the process that holds it: asks the guards, and where none answers
/// reads their log. Takes Stop to the guards. A thread of its own waits for them.
class GuardWatch {
 public:
  struct Known {
    nlohmann::json message;   ///< For pages: {"type": "guard", "axes": to_json(AxesReport), "halted"}
    bool is_at_rest = false;  ///< Both axes are: AxisReport::is_at_rest().
    bool has_guard = false;   ///< A guard answers, which can halt them.
  };

  /// @param lock_file  names the process that holds the bench
  /// @param bench  the bench in the words of the log (bench_in_words()); empty: it cannot be told now
  /// @param notify  called from the thread of this object when the state has changed
  GuardWatch(std::filesystem::path lock_file, std::function<std::string()> bench,
             std::function<void(const Known&)> notify);
  ~GuardWatch();

  /// Has the guards halt the axes, unless they are confirmed at rest when `patience` is over: the process
  /// that holds the bench does so, if it lives. Returns at once.
  void stop(const std::string& by, std::chrono::milliseconds patience);

 private:
  struct StopOrder {
    std::string by;
    std::chrono::steady_clock::time_point at;
  };

  void watch(const std::stop_token& end);
  Known ask(const nlohmann::json& question);
  const AxesReport& logged();

  const std::filesystem::path lock_file_;
  const std::function<std::string()> bench_;
  const std::function<void(const Known&)> notify_;
  std::set<pid_t> owners_;  ///< Processes that have held the bench and whose guards answer.
  AxesReport logged_;       ///< By the log, as it was at that time.
  std::optional<std::filesystem::file_time_type> logged_at_;
  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::optional<StopOrder> order_;
  std::jthread thread_;  ///< Last: it ends before the members that it uses.
};

}  // namespace abcal::console
