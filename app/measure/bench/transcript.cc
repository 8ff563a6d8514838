#include "app/measure/bench/transcript.h"

#include <fmt/format.h>

#include <utility>

#include "drivers/wire/recording_stream.h"
#include "drivers/wire/replay_stream.h"
#include "sim/sim_clock.h"

namespace abcal {
namespace {

using wire::WireEvent;

/// Role of the row that marks the stop of a run; it belongs to no stream.
constexpr std::string_view kOperator = "operator";
constexpr char kStopped = '^';

bool is_known(char kind) {
  switch (static_cast<WireEvent::Kind>(kind)) {
    case WireEvent::Kind::kOpened:
    case WireEvent::Kind::kWritten:
    case WireEvent::Kind::kReceived:
    case WireEvent::Kind::kDiscarded:
    case WireEvent::Kind::kDropped:
    case WireEvent::Kind::kFailed:
      return true;
  }
  return false;
}

}  // namespace

BenchStreams Transcript::streams() {
  BenchStreams streams;
  streams.wrap = [this](std::string_view role, BenchStreams::Stream opened, const Clock& clock) {
    if (!start_) start_ = {clock.now(), clock.utc_now()};
    return std::make_unique<wire::RecordingStream>(
        std::move(opened), clock,
        [this, role = std::string(role)](WireEvent&& event) { note(role, std::move(event)); });
  };
  return streams;
}

void Transcript::keep_in(RunFile& file) {
  file.keep_transcript(start_.value().utc, [this] { return remove_rows(); });
}

void Transcript::note(std::string_view role, WireEvent&& event) {
  const std::lock_guard lock(mutex_);
  const std::int64_t time_ns = (event.time - start_->instant).count();
  if (!stop_noted_ && stop_.stop_requested()) {
    stop_noted_ = true;
    rows_.push_back({std::string(kOperator), time_ns, std::nullopt, kStopped, {}});
  }
  std::optional<std::int64_t> arrival_ns;
  if (event.kind == WireEvent::Kind::kReceived) arrival_ns = (event.arrival - start_->instant).count();
  rows_.push_back(
      {std::string(role), time_ns, arrival_ns, static_cast<char>(event.kind), std::move(event.bytes)});
}

std::vector<WireRow> Transcript::remove_rows() {
  const std::lock_guard lock(mutex_);
  return std::exchange(rows_, {});
}

RecordedWire::RecordedWire(const std::filesystem::path& run) {
  std::optional<WireTranscript> transcript = RunFile::load_transcript(run);
  if (!transcript) {
    throw RunFileError(run.string() +
                       ": was measured without a recording, so it cannot be replayed; required: a run made "
                       "with `abcal run BENCH --record`");
  }
  start_ = transcript->start;
  for (WireRow& row : transcript->rows) {
    if (row.role == kOperator && row.kind == kStopped) {
      stopped_ = true;
      break;
    }
    if (!is_known(row.kind)) {
      throw RunFileError(
          fmt::format("{}: its recording contains a row of the unknown kind {:?}; update abcal", run.string(),
                      std::string_view(&row.kind, 1)));
    }
    const auto instant = [](std::int64_t ns) { return Clock::Instant(Clock::Duration(ns)); };
    events_[row.role].push_back({static_cast<WireEvent::Kind>(row.kind), instant(row.time_ns),
                                 instant(row.arrival_ns.value_or(0)), std::move(row.bytes)});
  }
}

BenchStreams RecordedWire::streams() {
  BenchStreams streams;
  streams.replay_clock = std::make_unique<sim::SimClock>(start_);
  streams.replay = [this](std::string_view role, Clock& clock) -> BenchStreams::Stream {
    const auto found = events_.find(role);
    return std::make_unique<wire::ReplayStream>(
        found == events_.end() ? std::vector<WireEvent>() : std::move(found->second), clock,
        [this] { ended_ = true; });
  };
  return streams;
}

}  // namespace abcal
