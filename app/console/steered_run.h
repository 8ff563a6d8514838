#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <stop_token>
#include <string>

#include "app/console/console_session.h"

namespace abcal::console {

/// How a run ended, as the bench reported it.
struct RunEnd {
  std::string file;       ///< Name of the run file in the folder of the runs; empty: there is none.
  bool complete = false;  ///< All angles are measured, and the file is closed.
  std::string why;        ///< Why it is not; empty if it is.
  bool instrument_failed = false;
};

/// The process that holds a bench (BenchService), and a run there that this program starts by the same
/// request as a page and follows by the same messages, so that every page shows it. The calls are for one
/// thread.
class SteeredRun {
 public:
  /// Called with each message of the bench (docs/console_programs.md), in a thread of its own, until close().
  using Listener = std::function<void(const nlohmann::json& message)>;

  /// Finds or starts the process, and waits until it answers.
  /// @throws std::runtime_error if it does not, RunInterrupted at `stop`
  SteeredRun(const Session::Options& bench, Listener listener, const std::stop_token& stop);
  ~SteeredRun();  ///< As close().
  SteeredRun(const SteeredRun&) = delete;
  SteeredRun& operator=(const SteeredRun&) = delete;

  /// Starts a run as the bench file states it, and waits for its end.
  /// @param who  for the event log of the run
  /// @throws std::runtime_error if the bench refuses the run or its process dies, RunInterrupted at `stop`,
  ///         with the run still in progress
  RunEnd measure(const std::string& who, const std::stop_token& stop);

  /// Stops what is in progress, halts the stage, and ends the process; waits for that.
  void close() noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::console
