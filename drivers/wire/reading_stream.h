#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/reading_queue.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::wire {

/// From the bytes of an accelerometer that streams unasked, and neither counts nor times its readings, to
/// next(). One thread.
///
/// A reading is known to be lost if bytes came in its place: every stretch of bytes that came to no use, as
/// long as a reading is, was one, and a bad frame was at least one. What is lost without leaving a byte
/// behind is not known, and nothing is concluded from times of arrival: a late one would pass for a loss.
///
/// `Parser` finds frames in bytes that are split anyhow: feed(bytes); next(), the next frame, with its `size`
/// in bytes, or nothing; lose_track(), bytes are missing here; has_partial(); bad_frames() and
/// skipped_bytes(), which only grow.
template <class Parser>
class ReadingStream {
 public:
  using Frame = typename decltype(std::declval<Parser&>().next())::value_type;
  /// The reading in a frame, without arrival and number; nothing if it is a frame of something else. May
  /// throw.
  using Decode = std::function<std::optional<Reading>(const Frame&)>;

  /// `stream` must outlive this.
  ReadingStream(ByteStream& stream, Parser parser, Decode decode)
      : stream_(stream), parser_(std::move(parser)), decode_(std::move(decode)) {}

  /// Listens with a new parser to what comes from now on: whether it is what it should be, at which rate.
  void listen(Parser parser) {
    running_ = false;
    parser_ = std::move(parser);
    received_bytes_ = 0;
    first_bytes_.clear();
    dropped_ = stream_.dropped_bytes();
    restart_figures();
  }

  /// What it listens to is the stream: numbers and counts begin here. Keeps the place in the bytes.
  void start() {
    restart_figures();
    running_ = true;
  }

  /// The stream ends; its figures remain.
  void end() noexcept {
    running_ = false;
    readings_.close();
  }
  bool running() const { return running_; }

  /// Reads once and decodes what came. False: nothing has come by the deadline.
  bool receive(Clock::Instant deadline) {
    constexpr std::size_t kShownBytes = 32;
    const ReceivedBytes received = stream_.read_until(deadline);
    const std::size_t dropped = stream_.dropped_bytes();
    const bool ran_over = std::exchange(dropped_, dropped) != dropped;
    if (ran_over) parser_.lose_track();  // The gap lies before these bytes or behind them.
    received_bytes_ += received.bytes.size();
    first_bytes_ += received.bytes.substr(0, kShownBytes - std::min(kShownBytes, first_bytes_.size()));
    parser_.feed(received.bytes);
    while (const auto frame = parser_.next()) take(*frame, received.arrival);
    if (ran_over) parser_.lose_track();
    return !received.bytes.empty();
  }

  /// As Accelerometer::next().
  std::optional<Reading> next(Clock::Instant deadline) {
    while (readings_.empty() && receive(deadline)) continue;
    return readings_.pop();
  }

  /// As Accelerometer::discard_pending().
  void discard_pending(Clock::Instant now) {
    readings_.begin_discard();
    while (receive(now)) continue;
    readings_.end_discard(parser_.has_partial(), std::exchange(dropped_at_discard_, dropped_) != dropped_);
  }

  /// Readings per second, from the arrivals of those that come within `span` of the first and of two at
  /// least; nothing if there were not as many by the deadline.
  std::optional<double> measure_rate_hz(Clock::Duration span, Clock::Instant deadline) {
    std::optional<Clock::Instant> first;
    Clock::Instant last;
    unsigned later = 0;  // Without those that came together with the first: they may have waited.
    while (later < 2 || last - *first < span || !readings_.empty()) {
      const auto reading = next(deadline);
      if (!reading) return std::nullopt;
      if (!first) first = reading->arrival;
      if (reading->arrival > *first) ++later;
      last = reading->arrival;
    }
    return later / to_seconds(last - *first);
  }

  StreamHealth health() const {
    const Figures now = figures();
    return {.readings = readings_.readings(),
            .lost_readings = readings_.lost(),
            .bad_frames = now.bad_frames - at_start_.bad_frames,
            .skipped_bytes = now.unused_bytes - at_start_.unused_bytes};
  }

  // For messages: what has come since listen().
  std::uint64_t received_bytes() const { return received_bytes_; }
  const std::string& first_bytes() const { return first_bytes_; }
  const Parser& parser() const { return parser_; }
  Parser& parser() { return parser_; }

 private:
  struct Figures {
    std::uint64_t bad_frames = 0;
    std::uint64_t unused_bytes = 0;  ///< Skipped by the parser, or dropped by a full input queue.
  };
  Figures figures() const { return {parser_.bad_frames(), parser_.skipped_bytes() + dropped_}; }

  void restart_figures() {
    readings_.restart();
    at_start_ = at_last_reading_ = figures();
    framed_since_ = 0;
    dropped_at_discard_ = dropped_;
  }

  void take(const Frame& frame, Clock::Instant arrival) {
    framed_since_ += frame.size;
    std::optional<Reading> reading = decode_(frame);
    if (!reading) return;
    reading->arrival = arrival;
    readings_.push(std::move(*reading), 1 + lost_before());
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
  ReadingQueue readings_;
  Figures at_start_;
  Figures at_last_reading_;
  std::uint64_t framed_since_ = 0;  ///< Bytes of frames since the last reading.
  std::uint64_t received_bytes_ = 0;
  std::string first_bytes_;
  std::size_t dropped_ = 0;
  std::size_t dropped_at_discard_ = 0;
};

}  // namespace abcal::wire
