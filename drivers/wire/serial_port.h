#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/port_descriptor.h"

namespace abcal::wire {

/// Bytes of input that may wait for a slow reader before any are lost: six minutes of a full 115200 baud line
/// (11 520 bytes/s).
inline constexpr std::size_t kDefaultQueueBytes = std::size_t{4} * 1024 * 1024;

struct SerialSettings {
  std::string path;        ///< "/dev/ttyUSB0", a by-id link, a pseudo-terminal or a link to one.
  unsigned baud = 115200;  ///< 8 data bits, no parity, 1 stop bit always: every instrument here uses it.
  bool rts_cts = false;    ///< Hardware flow control.
};

/// A serial port or pseudo-terminal, raw and locked for this program alone.
///
/// A thread that all ports of the program share reads all the time into a bounded queue, with the times of
/// arrival, so that a reader busy with something else loses nothing; bytes that do not fit are counted in
/// dropped_bytes(). Any thread may write. Once the port has vanished, bytes that had arrived can still be
/// read; then every call throws kLinkLost.
class SerialPort final : public ByteStream, public PortDescriptor {
 public:
  /// Takes the lease of the device, opens, locks (flock; on real ports TIOCEXCL too, which on a
  /// pseudo-terminal would outlive a program that crashed), sets raw mode and discards bytes waiting in the
  /// kernel.
  /// @param clock Stamps the arrivals, in several threads; its Instants must be those of
  /// steady_clock.
  /// @param holder  who uses it, for other programs that want it (Lease)
  /// @throws PortHeld: another program uses this device. InstrumentError kCannotOpen with one sentence: does
  /// not exist (lists the existing ones), not permitted
  ///   (and which group is), held by another program (and which), not a serial port, setting not taken.
  SerialPort(const SerialSettings& settings, Clock& clock, std::size_t queue_bytes = kDefaultQueueBytes,
             const std::string& holder = {});
  ~SerialPort() override;

  void write(std::string_view bytes) override;  ///< Write deadline: 2 s.
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override;  ///< The path as given.
  int descriptor() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::wire
