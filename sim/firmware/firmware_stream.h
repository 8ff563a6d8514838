#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "drivers/wire/byte_stream.h"
#include "sim/firmware/firmware.h"

namespace abcal::sim {

/// The port of a simulated instrument inside the program: waiting for bytes advances the clock to the instant
/// at which the firmware outputs them, or to the deadline, never further. Several streams may share a clock
/// and a world: output that arrives while another one's wait advances the clock is kept here, in a bounded
/// buffer whose oldest bytes are dropped and counted when it is full.
class FirmwareStream final : public wire::ByteStream {
 public:
  static constexpr std::size_t kDefaultCapacity = std::size_t{1} << 20;

  FirmwareStream(std::shared_ptr<Firmware> firmware, Clock& clock, std::string name = "simulated",
                 std::size_t capacity = kDefaultCapacity);

  void write(std::string_view bytes) override;
  wire::ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override { return name_; }

  /// Calls Firmware::power() of the instrument now; pending output is lost.
  void power(bool on);

 private:
  /// Takes the output up to `now`. @return Firmware::next_due() after that
  std::optional<Clock::Instant> collect(Clock::Instant now);

  std::shared_ptr<Firmware> firmware_;
  Clock& clock_;
  std::string name_;
  std::size_t capacity_;
  wire::ReceivedBytes waiting_;
  Clock::Instant last_arrival_;
  std::size_t dropped_ = 0;
  mutable std::mutex mutex_;
};

}  // namespace abcal::sim
