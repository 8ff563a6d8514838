#include "drivers/iio/session.h"

#include <fmt/format.h>

#include <algorithm>
#include <system_error>
#include <utility>

#include "drivers/wire/readable_bytes.h"

namespace abcal::iio {
namespace {

constexpr std::chrono::seconds kAnswerTime{2};
constexpr int kTries = 2;
/// Bytes in which an answer to "VERSION" is looked for.
constexpr std::size_t kMostNoise = 65536;
constexpr std::string_view kVersionCommand = "VERSION\r\n";

}  // namespace

Session::Session(wire::ByteStream& stream, Clock& clock)
    : stream_(stream), clock_(clock), who_(fmt::format("accelerometer iio on {}", stream.name())) {}

void Session::fail(Fault fault, std::string_view detail) const {
  throw InstrumentError(who_, fault, detail);
}

void Session::refuse(std::string_view command, std::int64_t error, std::string_view advice) const {
  fail(Fault::kRefused, fmt::format("error {} ({}) to \"{}\"{}", error,
                                    std::generic_category().message(
                                        static_cast<int>(std::clamp<std::int64_t>(-error, 0, 4095))),
                                    command, advice));
}

/// Reads once; false if nothing arrived by the deadline.
bool Session::receive(Clock::Instant deadline) {
  const wire::ReceivedBytes more = stream_.read_until(deadline);
  if (more.bytes.empty()) return false;
  last_arrival_ = more.arrival;
  received_ += more.bytes;
  return true;
}

/// Drops late answers to a VERSION question that was asked twice.
void Session::skip_version_lines() {
  const std::string line = version_ + "\n";
  while (!version_.empty() && received_.starts_with(line)) {
    received_.erase(0, line.size());
    skipped_bytes_ += line.size();
  }
}

std::string Session::greet() {
  under_way_ = false;
  received_.clear();
  stream_.discard_input();
  std::size_t heard = 0;
  std::string first_bytes;
  for (int tries = 0; tries < kTries; ++tries) {
    stream_.write(kVersionCommand);
    const Clock::Instant deadline = clock_.now() + kAnswerTime;
    while (clock_.now() < deadline && received_.size() < kMostNoise && receive(deadline)) {
      if (const auto version = find_version(received_)) {
        version_ = version->text;
        received_.erase(0, version->end);
        out_of_step_ = false;
        return version_;
      }
    }
  }
  heard = received_.size();
  const std::string asked =
      fmt::format("no answer to \"VERSION\" within {} s, asked twice", kAnswerTime.count());
  if (heard == 0)
    fail(Fault::kNoReply, asked + ", and not one byte arrived: does iiod run there, and is the port right?");
  fail(Fault::kWrongIdentity, fmt::format("{}; {} bytes arrived that are no iiod's, beginning \"{}\"", asked,
                                          heard, wire::bytes_as_text(received_.substr(0, 24))));
}

/// Discards late replies.
void Session::catch_up() {
  stream_.write(kVersionCommand);
  const Clock::Instant deadline = clock_.now() + kAnswerTime;
  const std::string line = version_ + "\n";
  for (;;) {
    if (const std::size_t at = received_.find(line); at != std::string::npos) {
      skipped_bytes_ += at;
      received_.erase(0, at + line.size());
      out_of_step_ = false;
      return;
    }
    if (received_.size() > kMostNoise) {  // Keeps only the bytes that may hold the line's beginning.
      skipped_bytes_ += received_.size() - line.size();
      received_.erase(0, received_.size() - line.size());
    }
    if (clock_.now() >= deadline || !receive(deadline)) break;
  }
  fail(Fault::kNoReply,
       fmt::format("a reply was missing or damaged, and then \"VERSION\" was not answered within {} s",
                   kAnswerTime.count()));
}

/// The next reply; nullopt if none arrives by the deadline, or a damaged one: then it is out of step.
template <class Check>
std::optional<std::string> Session::await(Check check, Clock::Instant deadline) {
  bool last_look = false;  // A stream that never pauses must not hold us.
  for (;;) {
    skip_version_lines();
    const bool perhaps_version = !version_.empty() && version_.starts_with(received_);
    const wire::FrameVerdict verdict = perhaps_version ? wire::FrameVerdict{wire::FrameCheck::kNeedMore, 0}
                                                       : check(std::string_view(received_));
    if (verdict.check == wire::FrameCheck::kComplete) {
      std::string reply = received_.substr(0, verdict.length);
      received_.erase(0, verdict.length);
      return reply;
    }
    if (verdict.check == wire::FrameCheck::kInvalid) {
      out_of_step_ = true;
      return std::nullopt;
    }
    if (std::exchange(last_look, clock_.now() >= deadline)) return std::nullopt;
    if (!receive(std::max(deadline, clock_.now()))) return std::nullopt;
  }
}

std::string Session::ask(std::string_view command, std::string_view data, ReplyKind kind, bool may_repeat) {
  bool damaged = false;
  for (int tries = may_repeat ? 0 : 1; tries < kTries; ++tries) {
    if (out_of_step_) catch_up();
    stream_.write(fmt::format("{}\r\n{}", command, data));
    auto reply = await([kind](std::string_view bytes) { return check_reply(kind, bytes); },
                       clock_.now() + kAnswerTime);
    if (reply) return *std::move(reply);
    damaged = out_of_step_;
    out_of_step_ = true;
  }
  if (damaged)
    fail(Fault::kBadFrame, fmt::format("the reply to \"{}\" is damaged; what arrived begins \"{}\"", command,
                                       wire::bytes_as_text(received_.substr(0, 24))));
  fail(Fault::kNoReply, fmt::format("no whole reply to \"{}\" within {} s", command, kAnswerTime.count()));
}

std::int64_t Session::number(std::string_view command, std::string_view data, bool may_repeat) {
  return number_of(ask(command, data, ReplyKind::kNumber, may_repeat));
}

std::optional<std::string> Session::text(std::string_view command, std::int64_t* error, ReplyKind kind) {
  const std::string reply = ask(command, {}, kind, true);
  const std::int64_t number = number_of(reply);
  if (error != nullptr) *error = number;
  if (number < 0) return std::nullopt;
  return text_of(reply);
}

void Session::begin_block(std::string_view command, std::size_t wanted, std::string_view mask,
                          Clock::Duration patience) {
  if (out_of_step_) catch_up();
  stream_.write(fmt::format("{}\r\n", command));
  under_way_ = true;
  wanted_ = wanted;
  mask_ = mask;
  give_up_at_ = clock_.now() + patience + kAnswerTime;
}

Session::BlockEnd Session::await_block(Clock::Instant deadline, Samples& samples) {
  const auto reply = await([this](std::string_view bytes) { return check_samples(bytes, wanted_, mask_); },
                           std::min(deadline, give_up_at_));
  if (reply) {
    under_way_ = false;
    samples = samples_of(*reply, mask_);
    return BlockEnd::kComplete;
  }
  if (!out_of_step_ && clock_.now() < give_up_at_) return BlockEnd::kNotYet;
  under_way_ = false;
  return std::exchange(out_of_step_, true) ? BlockEnd::kDamaged : BlockEnd::kLost;
}

}  // namespace abcal::iio
