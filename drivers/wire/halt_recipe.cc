#include "drivers/wire/halt_recipe.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <optional>
#include <regex>
#include <system_error>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal::wire {
namespace {

constexpr std::chrono::milliseconds kBetweenStops{20};
constexpr std::size_t kLongestHaltLine = 65536;
constexpr std::size_t kLongestBinary = 1024;

/// Splits the received bytes into replies: lines, pieces with the recipe's own terminator, or, for a binary
/// protocol, the hexadecimal digits of everything received.
class ReplyInput {
 public:
  ReplyInput(const HaltRecipe& recipe, ByteStream& port, Clock& clock)
      : recipe_(recipe), port_(port), clock_(clock) {}

  std::optional<std::string> next(Clock::Instant deadline) {
    for (;;) {
      if (auto reply = take()) {
        if (!reply->empty()) return reply;
        continue;
      }
      if (received_.size() > (recipe_.binary ? kLongestBinary : kLongestHaltLine))
        received_.clear();                              // Nothing that a controller says.
      const bool last_look = clock_.now() >= deadline;  // A stream that never pauses.
      const ReceivedBytes more = port_.read_until(deadline);
      received_ += more.bytes;
      fresh_ = !more.bytes.empty();
      if (!fresh_ || (last_look && end().first == std::string::npos && !recipe_.binary)) return std::nullopt;
    }
  }

 private:
  /// Where the first reply ends, and how many bytes its end has.
  std::pair<std::size_t, std::size_t> end() const {
    if (recipe_.reply_end.empty()) return {received_.find_first_of("\r\n"), 1};
    return {received_.find(recipe_.reply_end), recipe_.reply_end.size()};
  }

  std::optional<std::string> take() {
    if (recipe_.binary) {
      if (!std::exchange(fresh_, false)) return std::nullopt;
      return hexadecimal_digits(received_);
    }
    const auto [at, length] = end();
    if (at == std::string::npos) return std::nullopt;
    std::string reply = received_.substr(0, at);
    received_.erase(0, at + length);
    return reply;
  }

  const HaltRecipe& recipe_;
  bool fresh_ = false;
  ByteStream& port_;
  Clock& clock_;
  std::string received_;
};

bool fits(const HaltRecipe& recipe, const std::string& reply, const std::string& pattern) {
  const std::regex wanted(pattern);
  if (!recipe.binary) return std::regex_match(reply, wanted);
  for (auto at = reply.begin(); at < reply.end(); at += 2)  // At any byte.
    if (std::regex_search(at, reply.end(), wanted, std::regex_constants::match_continuous)) return true;
  return false;
}

/// Whether all that answers the question says that the axes stand still.
bool all_stand(const HaltRecipe& recipe, const HaltRecipe::Question& question, ByteStream& port, Clock& clock,
               Clock::Instant deadline) {
  ReplyInput replies(recipe, port, clock);
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

bool carry_out(const HaltRecipe& recipe, ByteStream& port, Clock& clock, Clock::Instant deadline) noexcept {
  try {
    port.write(recipe.end_partial + recipe.stop);
  } catch (...) {  // Tried again below, as far as there is time.
  }
  while (clock.now() < deadline) {
    try {
      port.write(recipe.stop);
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
  while (!read_until(clock_.now()).bytes.empty()) continue;
}

}  // namespace abcal::wire
