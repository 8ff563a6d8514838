#pragma once

#include <atomic>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "app/measure/bench/make_bench.h"
#include "drivers/wire/wire_event.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// Records the bytes on the wires of a bench, for its run file (`abcal run --record`). Must outlive the
/// bench.
class Transcript {
 public:
  /// @param stop  its request is marked by a row: from then on two threads write to the stage, in an
  /// unpredictable order
  explicit Transcript(std::stop_token stop) : stop_(std::move(stop)) {}

  /// For make_bench().
  BenchStreams streams();

  /// False: nothing on the bench has bytes.
  bool has_streams() const { return start_.has_value(); }

  /// Everything recorded so far, and from now on, goes to `file`.
  void keep_in(RunFile& file);

 private:
  void note(std::string_view role, wire::WireEvent&& event);
  std::vector<WireRow> remove_rows();

  struct Start {
    Clock::Instant instant;
    Clock::UtcTime utc;
  };

  std::stop_token stop_;
  std::optional<Start> start_;
  std::mutex mutex_;
  std::vector<WireRow> rows_;
  bool stop_noted_ = false;
};

/// The bytes that a Transcript recorded, ready to be replayed.
class RecordedWire {
 public:
  /// @throws RunFileError if the run has no transcript, or one that cannot be understood.
  explicit RecordedWire(const std::filesystem::path& run);

  /// For make_bench(). May be asked once.
  BenchStreams streams();

  /// Whether the recorded run was stopped by a person; bytes after the stop are not replayed.
  bool stopped_by_operator() const { return stopped_; }
  /// Whether a stream was read beyond the end of its recording.
  bool has_ended() const { return ended_; }

 private:
  Clock::UtcTime start_;
  std::map<std::string, std::vector<wire::WireEvent>, std::less<>> events_;  ///< By role.
  bool stopped_ = false;
  std::atomic<bool> ended_ = false;
};

}  // namespace abcal
