#pragma once

#include <fmt/format.h>

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/frame.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal::wire {

/// Questions to an instrument that only answers, one frame for each, where replies do not name their
/// question. Commands use it too, if repeating one has no further effect.
///
/// Once a reply is missing or garbled, nothing else is asked before a question whose answer is known has been
/// answered (Manner::sync_request): replies before that answer belong to earlier questions.
class QueryExchange {
 public:
  struct Manner {
    std::string who;           ///< For messages.
    Clock::Duration patience;  ///< For a reply.
    std::function<FrameVerdict(std::string_view)> check;
    std::string sync_request{};  ///< Empty: the exchange needs none, because replies name their question.
    std::function<bool(const std::string& frame)> is_sync{};
  };

  QueryExchange(std::unique_ptr<ByteStream> stream, Clock& clock, Manner manner)
      : stream_(std::move(stream)), clock_(clock), manner_(std::move(manner)) {}

  ByteStream& stream() { return *stream_; }
  Manner& manner() { return manner_; }

  /// Asks at most twice. `parse` returns the value of a frame, or nullopt if the frame is not an answer.
  /// @throws InstrumentError kNoReply, kBadFrame
  template <class Parse>
  auto ask(std::string_view request, std::string_view shown, Parse parse) {
    std::string garbled;
    for (int attempt = 1; attempt <= 2; ++attempt) {
      if (!in_step_) resynchronise(shown);
      const std::optional<std::string> frame = exchange(request);
      if (frame)
        if (auto value = parse(*frame)) return *std::move(value);
      in_step_ = manner_.sync_request.empty();
      garbled = frame ? *frame : heard_;
    }
    if (garbled.empty()) throw silence(shown);
    throw InstrumentError(manner_.who, Fault::kBadFrame,
                          fmt::format("{} bytes came that are no answer to \"{}\", asked twice: {}",
                                      garbled.size(), shown, bytes_in_hex(garbled.substr(0, 32))));
  }

  /// Discards received bytes, sends the request, and waits for one frame.
  std::optional<std::string> exchange(std::string_view request) {
    stream_->discard_input();
    buffer_.clear();
    heard_.clear();
    stream_->write(request);
    return take(clock_.now() + manner_.patience);
  }

 private:
  InstrumentError silence(std::string_view shown) const {
    return {manner_.who, Fault::kNoReply,
            fmt::format(
                "no answer to \"{}\" within {} s; is it switched on, and are cable, address and speed right?",
                shown, to_seconds(manner_.patience))};
  }

  std::optional<std::string> take(Clock::Instant deadline) {
    constexpr std::size_t kMost = 65536;
    bool last_look = false;  // A stream that never pauses must not hold us.
    while (true) {
      while (!buffer_.empty()) {
        const FrameVerdict verdict = manner_.check(buffer_);
        if (verdict.check == FrameCheck::kNeedMore) break;
        if (verdict.check == FrameCheck::kInvalid) {
          buffer_.erase(0, 1);
          continue;
        }
        std::string frame = buffer_.substr(0, verdict.length);
        buffer_.erase(0, verdict.length);
        return frame;
      }
      if (last_look || heard_.size() > kMost) return std::nullopt;
      last_look = clock_.now() >= deadline;
      const ReceivedBytes received = stream_->read_until(deadline);
      if (received.bytes.empty()) return std::nullopt;
      buffer_ += received.bytes;
      heard_ += received.bytes;
    }
  }

  void resynchronise(std::string_view unanswered) {
    const Clock::Instant deadline = clock_.now() + manner_.patience;
    stream_->discard_input();
    buffer_.clear();
    heard_.clear();
    stream_->write(manner_.sync_request);
    while (const auto frame = take(deadline)) {
      if (manner_.is_sync(*frame)) {
        in_step_ = true;
        return;
      }
      if (clock_.now() >= deadline) break;
    }
    throw silence(unanswered);
  }

  std::unique_ptr<ByteStream> stream_;
  Clock& clock_;
  Manner manner_;
  std::string buffer_;
  std::string heard_;  ///< Since the last request.
  bool in_step_ = true;
};

}  // namespace abcal::wire
