#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/reading_queue.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::wire {

/// Content of a frame of a stream.
struct DecodedFrame {
  std::optional<Reading> reading{};  ///< Without arrival and number. Absent: another kind of frame.
  /// Readings made since the one before, this one included, by the instrument's own counter or clock. Absent:
  /// it has neither, and losses are inferred from the unusable bytes.
  std::optional<std::uint64_t> steps{};
  bool malformed = false;  ///< Framed and complete, but it cannot be true: counted as a bad frame.
};

/// Turns the bytes of a streaming accelerometer into readings for next(). One thread.
///
/// Where the instrument neither counts nor times its readings, a loss is recognised only by the bytes that
/// arrived in its place: every stretch of unusable bytes as long as a reading counts as one, and a bad frame
/// as at least one. A reading that is lost without leaving a byte cannot be counted. Times of arrival are not
/// used, because a late reading would count as a loss.
///
/// `Parser` finds frames in arbitrarily split bytes: feed(bytes); next(), the next frame or nullopt;
/// has_partial(); bad_frames() and skipped_bytes(), which only grow. Optional: lose_track(), bytes are
/// missing here; next_behind_partial(), a frame after an incomplete one. The size of a frame on the wire is
/// its member `size`, or wire_size(frame).
template <class Parser>
class ReadingStream {
 public:
  using Frame = typename decltype(std::declval<Parser&>().next())::value_type;
  /// Decodes a frame. May throw.
  using Decode = std::function<DecodedFrame(const Frame&)>;

  /// `stream` must outlive this.
  ReadingStream(ByteStream& stream, Parser parser, Decode decode)
      : stream_(stream), parser_(std::move(parser)), decode_(std::move(decode)) {}

  /// Listens with a new parser to the following bytes, to check their format and rate.
  void listen(Parser parser) {
    end();
    parser_ = std::move(parser);
    received_bytes_ = 0;
    first_bytes_.clear();
    dropped_ = stream_.dropped_bytes();
    restart_figures();
  }

  /// Begins the stream with the bytes that follow: numbers and counts restart. Keeps the place in the bytes.
  void start() {
    restart_figures();
    running_ = true;
  }

  /// The stream ends; its figures remain.
  void end() noexcept {
    if (running_) at_end_ = health();
    running_ = false;
    readings_.close();
  }
  bool running() const { return running_; }

  /// Reads once and passes the bytes to the parser, without decoding.
  ReceivedBytes fetch(Clock::Instant deadline) {
    bool gap = false;
    ReceivedBytes received = read(deadline, gap);
    if (!received.bytes.empty()) last_arrival_ = received.arrival;
    parser_.feed(received.bytes);
    if (gap) gap_behind_ = true;
    return received;
  }

  /// Reads once and decodes; each frame has the time of arrival of its last bytes. False if nothing arrived
  /// by the deadline.
  bool receive(Clock::Instant deadline) {
    bool gap = false;
    const ReceivedBytes received = read(deadline, gap);
    received.for_each_group([this](std::string_view bytes, Clock::Instant arrival) {
      if (!bytes.empty()) last_arrival_ = arrival;
      parser_.feed(bytes);
      take_waiting();
    });
    if (gap) lose_track();
    return !received.bytes.empty();
  }

  /// See Accelerometer::next().
  std::optional<Reading> next(Clock::Instant deadline) {
    take_waiting();  // Frames that arrived together with the last answer.
    while (readings_.empty() && receive_until(deadline)) continue;
    if (readings_.empty()) take_behind_partial();
    return readings_.pop();
  }

  /// See Accelerometer::discard_pending().
  void discard_pending(Clock::Instant now) {
    readings_.begin_discard();
    take_waiting();
    while (receive_until(now)) continue;
    readings_.end_discard(parser_.has_partial(), std::exchange(dropped_at_discard_, dropped_) != dropped_);
  }

  /// Readings per second, from the arrivals of those within `span` after the first, at least two; nullopt if
  /// there were fewer by the deadline.
  std::optional<double> measure_rate_hz(Clock::Duration span, Clock::Instant deadline) {
    std::optional<Clock::Instant> first;
    Clock::Instant last;
    unsigned later = 0;  // Without those that arrived together with the first: they may have waited.
    while (later < 2 || last - *first < span || !readings_.empty()) {
      const auto reading = next(deadline);
      if (!reading) return std::nullopt;
      if (!first) first = reading->arrival;
      if (reading->arrival > *first) ++later;
      last = reading->arrival;
    }
    return later / to_seconds(last - *first);
  }

  /// Counts of the running stream, or of the last one.
  StreamHealth health() const {
    if (!running_) return at_end_;
    const Figures now = figures();
    return {.readings = readings_.readings(),
            .lost_readings = readings_.lost(),
            .bad_frames = now.bad_frames - at_start_.bad_frames,
            .skipped_bytes = parser_.skipped_bytes() + dropped_ - at_start_.skipped_bytes};
  }

  Clock::Instant last_arrival() const { return last_arrival_; }

  // For messages: bytes received since listen().
  std::uint64_t received_bytes() const { return received_bytes_; }
  const std::string& first_bytes() const { return first_bytes_; }
  const Parser& parser() const { return parser_; }
  Parser& parser() { return parser_; }

 private:
  struct Figures {
    std::uint64_t bad_frames = 0;
    std::uint64_t skipped_bytes = 0;  ///< Skipped by the parser, or dropped by a full input queue.
    std::uint64_t unused_bytes = 0;   ///< These, and those of malformed frames.
  };
  Figures figures() const {
    const std::uint64_t skipped = parser_.skipped_bytes() + dropped_;
    return {parser_.bad_frames() + malformed_, skipped, skipped + malformed_bytes_};
  }

  void restart_figures() {
    readings_.restart();
    malformed_ = malformed_bytes_ = 0;
    at_start_ = at_last_reading_ = figures();
    framed_since_ = 0;
    dropped_at_discard_ = dropped_;
  }

  /// @param gap  set if bytes were dropped: before these, or behind them
  ReceivedBytes read(Clock::Instant deadline, bool& gap) {
    constexpr std::size_t kShownBytes = 32;
    ReceivedBytes received = stream_.read_until(deadline);
    const std::size_t dropped = stream_.dropped_bytes();
    gap = std::exchange(dropped_, dropped) != dropped;
    if (gap) lose_track();
    received_bytes_ += received.bytes.size();
    if (first_bytes_.size() < kShownBytes)
      first_bytes_ += received.bytes.substr(0, kShownBytes - first_bytes_.size());
    return received;
  }

  /// Like receive(). Also false if the last bytes arrived after the deadline, since the stream may never
  /// pause.
  bool receive_until(Clock::Instant deadline) { return receive(deadline) && last_arrival_ <= deadline; }

  void lose_track() {
    if constexpr (requires { parser_.lose_track(); }) parser_.lose_track();
  }

  void take_waiting() {
    while (const auto frame = parser_.next()) take(*frame);
    if (std::exchange(gap_behind_, false)) lose_track();
  }

  void take_behind_partial() {
    if constexpr (requires { parser_.next_behind_partial(); })
      while (const auto frame = parser_.next_behind_partial()) take(*frame);
  }

  static std::size_t size_of(const Frame& frame) {
    if constexpr (requires { frame.size; })
      return frame.size;
    else
      return wire_size(frame);
  }

  void take(const Frame& frame) {
    const std::size_t size = size_of(frame);  // Before it is decoded: that may end the stream.
    DecodedFrame decoded = decode_(frame);
    if (decoded.malformed) {
      ++malformed_;
      malformed_bytes_ += size;
      return;
    }
    framed_since_ += size;
    if (!decoded.reading) return;
    decoded.reading->arrival = last_arrival_;
    const std::uint64_t lost = lost_before();
    readings_.push(*std::move(decoded.reading), decoded.steps.value_or(1 + lost));
  }

  /// How many readings are known to have been lost since the last one that was not.
  std::uint64_t lost_before() {
    const Figures now = figures();
    const Figures last = std::exchange(at_last_reading_, now);
    const auto bytes_per_reading = static_cast<double>(std::exchange(framed_since_, 0));
    const auto unused = static_cast<double>(now.unused_bytes - last.unused_bytes);
    const auto by_length = static_cast<std::uint64_t>(std::round(unused / bytes_per_reading));
    return std::max<std::uint64_t>(by_length, now.bad_frames > last.bad_frames ? 1 : 0);
  }

  ByteStream& stream_;
  Parser parser_;
  Decode decode_;
  bool running_ = false;
  bool gap_behind_ = false;  ///< Bytes were dropped: behind those that the parser holds, or before them.
  ReadingQueue readings_;
  StreamHealth at_end_;
  Figures at_start_;
  Figures at_last_reading_;
  std::uint64_t malformed_ = 0;
  std::uint64_t malformed_bytes_ = 0;
  std::uint64_t framed_since_ = 0;  ///< Bytes of frames since the last reading.
  std::uint64_t received_bytes_ = 0;
  std::string first_bytes_;
  Clock::Instant last_arrival_;
  std::size_t dropped_ = 0;
  std::size_t dropped_at_discard_ = 0;
};

}  // namespace abcal::wire
