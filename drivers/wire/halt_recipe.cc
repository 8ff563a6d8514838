#include "drivers/wire/halt_recipe.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <optional>
#include <regex>
#include <system_error>

#include "drivers/instrument/instrument_error.h"

namespace abcal::wire {
namespace {

constexpr std::chrono::milliseconds kBetweenStops{20};
constexpr std::size_t kLongestHaltLine = 65536;

/// The lines of what comes, ended by CR, LF or both.
class LineInput {
 public:
  LineInput(ByteStream& port, Clock& clock) : port_(port), clock_(clock) {}

  std::optional<std::string> next(Clock::Instant deadline) {
    for (;;) {
      const std::size_t end = received_.find_first_of("\r\n");
      if (end != std::string::npos) {
        std::string line = received_.substr(0, end);
        received_.erase(0, end + 1);
        if (!line.empty()) return line;
        continue;
      }
      if (received_.size() > kLongestHaltLine) received_.clear();  // Nothing that a controller says.
      const bool last_look = clock_.now() >= deadline;             // A stream that never pauses.
      const ReceivedBytes more = port_.read_until(deadline);
      received_ += more.bytes;
      if (more.bytes.empty() || (last_look && received_.find_first_of("\r\n") == std::string::npos))
        return std::nullopt;
    }
  }

 private:
  ByteStream& port_;
  Clock& clock_;
  std::string received_;
};

bool is_whole(const std::string& line, const std::string& pattern) {
  return std::regex_match(line, std::regex(pattern));
}

/// Whether all that answers the question says that the axes stand still.
bool all_stand(const HaltRecipe::Question& question, std::chrono::milliseconds reply_time, ByteStream& port,
               Clock& clock, Clock::Instant deadline) {
  LineInput lines(port, clock);
  port.write(question.bytes);
  Clock::Instant until = std::min(deadline, clock.now() + reply_time);
  bool answered = false;
  while (const auto line = lines.next(until)) {
    if (!is_whole(*line, question.reply)) continue;
    if (!question.standing.empty() && !is_whole(*line, question.standing)) return false;
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
      const bool standing = std::all_of(
          recipe.questions.begin(), recipe.questions.end(), [&](const HaltRecipe::Question& question) {
            return all_stand(question, recipe.reply_time, port, clock, deadline);
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
