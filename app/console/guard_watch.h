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

namespace abcal::console {

/// Asks the guards of the bench directly, past the process that holds it: what is known of each axis, and
/// Stop. A thread of its own waits for them.
class GuardWatch {
 public:
  /// State of the axes as the guards report it; without a guard nothing was moved.
  struct Known {
    nlohmann::json
        message;  ///< For pages: {"type": "guard", "axes": {"x": {"state", "since", "detail"}, "z"}, ...}
    bool is_at_rest = true;  ///< No axis may be moving, and none is unreachable.
  };

  /// @param lock_file  names the process that holds the bench
  /// @param notify  called from the thread of this object when the state has changed
  GuardWatch(std::filesystem::path lock_file, std::function<void(const Known&)> notify);
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

  const std::filesystem::path lock_file_;
  const std::function<void(const Known&)> notify_;
  std::set<pid_t> owners_;  ///< Processes that have held the bench and whose guards answer.
  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::optional<StopOrder> order_;
  std::jthread thread_;  ///< Last: it ends before the members that it uses.
};

}  // namespace abcal::console
