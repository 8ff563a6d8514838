#pragma once

#include <condition_variable>
#include <deque>
#include <filesystem>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <thread>

#include "app/measure/guard/guard_packets.h"
#include "drivers/instrument/clock.h"

namespace abcal {

/// The log of the guards of a user: one JSON object per line, which records who moved what and when, what was
/// halted, and which program died. A thread of its own writes, so that a disk that hangs delays no halt;
/// another waits for the disk, so that an entry outlives this process as soon as it is written.
class GuardLog {
 public:
  /// Kinds of entries, as the member "what".
  static constexpr std::string_view kBegan = "began", kMoves = "moves", kAtRest = "at rest",
                                    kHalting = "halting", kHalted = "halted", kNotHalted = "not halted",
                                    kDied = "died", kEnded = "ended";

  GuardLog() = default;
  ~GuardLog();
  GuardLog(const GuardLog&) = delete;
  GuardLog& operator=(const GuardLog&) = delete;

  /// Entries go to this file from now on, those of before included. A file of more than 4 MiB is kept as
  /// FILE.1 first. Without a call they are dropped at the end.
  void open(std::filesystem::path file);
  /// @param json  further members: "owner", "text", and "axes" ("X", "Z"), those that the entry is about
  void add(std::string_view what, Clock::UtcTime utc, nlohmann::json json = nlohmann::json::object());

 private:
  void write(const std::stop_token& end);
  void sync(const std::stop_token& end);

  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::filesystem::path file_;
  std::deque<std::string> lines_;
  bool is_unsynced_ = false;  ///< Lines were written that may not be on the disk yet.
  std::jthread syncer_;       ///< Ends after the writer.
  std::jthread writer_;       ///< Last: it ends before the members that it uses.
};

/// The log of this user's guards; empty: there is no folder for it.
std::filesystem::path motion_log();

/// A bench, as a log knows it.
struct MotionRecord {
  AxesReport axes;  ///< After the latest entries; kUnknown: it was moving, and its guard runs no more.
  /// The end of the latest session if that did not end in order, in words for a person: who moved the bench,
  /// and how it was halted, or that an axis was moving when program and guard ended together. Empty if it
  /// ended in order or is still open, or if there is no log.
  std::string incident;
};

/// Reads a log, and the part of it that was put aside as FILE.1.
/// @param bench  only entries whose owner's words contain this
MotionRecord read_motion(const std::filesystem::path& file, std::string_view bench);

}  // namespace abcal
