#pragma once

#include <chrono>
#include <string>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/halt.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::wire {

/// Halts the axes on a port without their driver: ends a half-written command, sends the stop, asks whether
/// the axes are at rest, and repeats this until they are. A chamber is stopped likewise; its commands are
/// among the questions. No one else may read from `port` meanwhile. Never throws.
/// @return false: not acknowledged by `deadline`; the axes may be moving, the chamber may be heating.
bool carry_out(const HaltRecipe& recipe, ByteStream& port, Clock& clock, Clock::Instant deadline) noexcept;

/// Ends a half-written command and sends the stop, once.
void stop_at_once(const HaltRecipe& recipe, ByteStream& port, Clock& clock);

/// The longest that one attempt to carry out a recipe takes: two replies, the gaps between the commands, and
/// a second more.
inline Clock::Duration longest_halt(const HaltRecipe& recipe) {
  return 2 * recipe.reply_time + (static_cast<int>(recipe.questions.size()) + 3) * recipe.gap +
         std::chrono::seconds(1);
}

/// An open descriptor (a serial port or a socket) as a stream, e.g. one that was inherited from a process
/// that died. Has no thread; does not close the descriptor, and does not change its flags. Real time only.
class DescriptorStream final : public ByteStream {
 public:
  /// `clock` must run in real time.
  DescriptorStream(int descriptor, std::string name, Clock& clock)
      : descriptor_(descriptor), name_(std::move(name)), clock_(clock) {}

  void write(std::string_view bytes) override;
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::string name() const override { return name_; }

 private:
  bool wait_for(short events, Clock::Instant deadline) const;

  const int descriptor_;
  const std::string name_;
  Clock& clock_;
};

}  // namespace abcal::wire
