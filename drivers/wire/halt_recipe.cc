#include "drivers/wire/halt_recipe.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <optional>
#include <system_error>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/reply_match.h"

namespace abcal::wire {
namespace {

constexpr std::chrono::milliseconds kBetweenStops{20};
/// Longest time for which the input of a port that never pauses is read when it is discarded.
constexpr std::chrono::milliseconds kLongestDiscard{100};

/// Splits the received bytes into replies: lines, pieces with the recipe's own terminator, or, for a binary
/// protocol, the newest bytes. Never keeps more than the longest reply and its terminator.
class ReplyInput {
 public:
  ReplyInput(const HaltRecipe& recipe, ByteStream& port, Clock& clock)
      : recipe_(recipe), port_(port), clock_(clock) {}

  /// The next reply that is neither empty nor too long; nullopt at the deadline. The port is read only once
  /// after the deadline, so that a stream that never pauses ends, too.
  std::optional<std::string> next(Clock::Instant deadline) {
    for (;;) {
      if (auto reply = recipe_.binary ? take_newest() : take_line()) return reply;
      if (last_look_ && *last_look_ >= deadline) return std::nullopt;
      last_look_ = clock_.now();
      chunk_ = port_.read_until(deadline).bytes;
      taken_ = 0;
      if (chunk_.empty()) return std::nullopt;
    }
  }

 private:
  std::optional<std::string> take_newest() {
    if (chunk_.empty()) return std::nullopt;
    reply_ += std::exchange(chunk_, {});
    if (reply_.size() > kLongestHaltReply) reply_.erase(0, reply_.size() - kLongestHaltReply);
    return reply_;
  }

  std::optional<std::string> take_line() {
    const std::size_t end_size = recipe_.reply_end.empty() ? 1 : recipe_.reply_end.size();
    while (taken_ < chunk_.size()) {
      reply_ += chunk_[taken_++];
      if (has_ended()) {
        std::string reply = std::exchange(reply_, {});
        reply.resize(reply.size() - end_size);
        if (!std::exchange(too_long_, false) && !reply.empty()) return reply;
      } else if (reply_.size() == kLongestHaltReply + end_size) {
        too_long_ = true;
        reply_.erase(0, kLongestHaltReply);  // The terminator may have begun.
      }
    }
    return std::nullopt;
  }

  bool has_ended() const {
    if (recipe_.reply_end.empty()) return reply_.back() == '\r' || reply_.back() == '\n';
    return reply_.ends_with(recipe_.reply_end);
  }

  const HaltRecipe& recipe_;
  ByteStream& port_;
  Clock& clock_;
  std::optional<Clock::Instant> last_look_;
  std::string chunk_;      ///< The bytes that were read last.
  std::size_t taken_ = 0;  ///< Bytes of the chunk that are in `reply_` or in an earlier reply.
  std::string reply_;      ///< The beginning of the next reply.
  bool too_long_ = false;  ///< The next reply has lost its beginning.
};

bool fits(const HaltRecipe& recipe, const std::string& reply, const ReplyPattern& pattern) {
  return recipe.binary ? occurs_in(pattern, reply) : matches(pattern, reply);
}

/// Waits until the next command is not lost.
void keep_gap(const HaltRecipe& recipe, Clock& clock) {
  if (recipe.gap.count() > 0) clock.sleep_until(clock.now() + recipe.gap);
}

/// Sends the stop, which may be several commands.
void write_stop(const HaltRecipe& recipe, ByteStream& port, Clock& clock) {
  port.write(recipe.stop);
  for (const std::string& further : recipe.further_stops) {
    keep_gap(recipe, clock);
    port.write(further);
  }
}

/// Whether all answers to the question report standstill of the axes.
bool all_stand(const HaltRecipe& recipe, const HaltRecipe::Question& question, ByteStream& port, Clock& clock,
               Clock::Instant deadline) {
  ReplyInput replies(recipe, port, clock);
  keep_gap(recipe, clock);
  port.write(question.bytes);
  Clock::Instant until = std::min(deadline, clock.now() + recipe.reply_time);
  bool answered = false;
  while (const auto reply = replies.next(until)) {
    if (!fits(recipe, *reply, question.reply)) continue;
    if (!question.standing.empty() && !fits(recipe, *reply, question.standing)) return false;
    answered = true;
    if (question.listen.count() == 0) return true;
    until = std::min(deadline, clock.now() + question.listen);
  }
  return answered;
}

}  // namespace

void stop_at_once(const HaltRecipe& recipe, ByteStream& port, Clock& clock) {
  if (recipe.gap.count() == 0 && recipe.further_stops.empty())
    return port.write(recipe.end_partial + recipe.stop);
  if (!recipe.end_partial.empty()) {
    // The owner may have sent a command, or received a reply, just before.
    keep_gap(recipe, clock);
    port.write(recipe.end_partial);
  }
  keep_gap(recipe, clock);
  write_stop(recipe, port, clock);
}

bool carry_out(const HaltRecipe& recipe, ByteStream& port, Clock& clock, Clock::Instant deadline) noexcept {
  try {
    stop_at_once(recipe, port, clock);
  } catch (...) {  // Tried again below if there is time.
  }
  while (clock.now() < deadline) {
    try {
      keep_gap(recipe, clock);
      write_stop(recipe, port, clock);
      port.discard_input();
      const bool standing = std::all_of(recipe.questions.begin(), recipe.questions.end(),
                                        [&](const HaltRecipe::Question& question) {
                                          return all_stand(recipe, question, port, clock, deadline);
                                        });
      if (standing && !recipe.questions.empty()) return true;
    } catch (const InstrumentError& error) {
      if (error.fault() == Fault::kLinkLost) return false;
    } catch (...) {
      return false;
    }
    clock.sleep_until(std::min(clock.now() + kBetweenStops, deadline));
  }
  return false;
}

bool DescriptorStream::wait_for(short events, Clock::Instant deadline) const {
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - clock_.now());
    pollfd wait{.fd = descriptor_, .events = events, .revents = 0};
    const int ready = ::poll(&wait, 1, static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, 60'000)));
    if (ready > 0) return true;
    if (ready == 0 && clock_.now() >= deadline) return false;
    if (ready < 0 && errno != EINTR)
      throw InstrumentError(name_, Fault::kLinkLost, std::generic_category().message(errno));
  }
}

void DescriptorStream::write(std::string_view bytes) {
  constexpr std::chrono::seconds kWriteDeadline{2};
  const Clock::Instant deadline = clock_.now() + kWriteDeadline;
  while (!bytes.empty()) {
    if (!wait_for(POLLOUT, deadline))
      throw InstrumentError(name_, Fault::kNoReply, "took no bytes within 2 s");
    const ssize_t written = ::write(descriptor_, bytes.data(), bytes.size());
    if (written >= 0) {
      bytes.remove_prefix(static_cast<std::size_t>(written));
    } else if (errno != EINTR && errno != EAGAIN) {
      throw InstrumentError(name_, Fault::kLinkLost, std::generic_category().message(errno));
    }
  }
}

ReceivedBytes DescriptorStream::read_until(Clock::Instant deadline) {
  std::array<char, 4096> chunk{};
  for (;;) {
    if (!wait_for(POLLIN, deadline)) return {{}, clock_.now()};
    const ssize_t count = ::read(descriptor_, chunk.data(), chunk.size());
    if (count > 0) return {std::string(chunk.data(), static_cast<std::size_t>(count)), clock_.now()};
    if (count == 0) throw InstrumentError(name_, Fault::kLinkLost, "closed by the other side");
    if (errno != EINTR && errno != EAGAIN)
      throw InstrumentError(name_, Fault::kLinkLost, std::generic_category().message(errno));
  }
}

void DescriptorStream::discard_input() {
  const Clock::Instant deadline = clock_.now() + kLongestDiscard;
  while (clock_.now() < deadline && !read_until(clock_.now()).bytes.empty()) continue;
}

}  // namespace abcal::wire
