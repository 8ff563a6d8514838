#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "drivers/wire/byte_stream.h"

namespace abcal::wire {

/// Operations of the kernel's USBTMC driver on a device file; a seam for tests. On failure all of them return
/// the negative of errno.
class UsbtmcDevice {
 public:
  virtual ~UsbtmcDevice() = default;
  /// Sends one message.
  virtual long write(std::string_view message) = 0;
  /// Fetches (part of) one reply. An instrument that is asked for a reply which it has not calls that an
  /// error, and may hang: see status_byte().
  virtual long read(char* buffer, std::size_t size) = 0;
  /// The status byte of IEEE 488.2, which an instrument gives at any time. Bit 4 (MAV): a reply waits.
  virtual int status_byte() = 0;
};

/// A measuring instrument on USB (class USBTMC with subclass USB488), by the device file of the Linux driver
/// usbtmc: /dev/usbtmc0. Each write is one message, so a command and its LF must be written at once.
///
/// Waits by asking for the status byte every 2 ms, and reads only when a reply is there: so a deadline is
/// kept to within one exchange on the bus, and a long scan is not disturbed. (poll() does not help: it
/// reports service requests, not replies.)
///
/// Written from the kernel's interface (linux/usb/tmc.h) and tested against a substitute; it has not been
/// used with a real instrument yet.
class UsbtmcStream final : public ByteStream {
 public:
  /// Takes the lease of the device, opens and locks (flock).
  /// @param holder  who uses it, for other programs that want it (Lease)
  /// @throws InstrumentError kCannotOpen with one sentence: does not exist (lists the existing ones), not
  /// permitted
  ///   (and which group is), held by another program (and which), no USBTMC instrument, no status byte.
  UsbtmcStream(const std::string& path, Clock& clock, const std::string& holder = {});
  /// With an open device.
  UsbtmcStream(std::unique_ptr<UsbtmcDevice> device, std::string name, Clock& clock);

  void write(std::string_view bytes) override;  ///< Write deadline: 1 s; 5 s before Linux 4.20.
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::string name() const override { return name_; }

 private:
  std::string read_what_waits();
  [[noreturn]] void lose(int error);
  void throw_if_lost() const;

  std::unique_ptr<UsbtmcDevice> device_;
  const std::string name_;
  Clock& clock_;
  std::mutex mutex_;  ///< Held for one exchange.
  std::string lost_because_;
};

}  // namespace abcal::wire
