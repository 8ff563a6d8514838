#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/serial_port.h"

namespace abcal::wire {

/// A TCP connection to an instrument (TCP_NODELAY: commands are short and each waits for its reply). Threads,
/// queue and faults as SerialPort.
class TcpStream final : public ByteStream, public PortDescriptor {
 public:
  /// @param clock As for SerialPort.
  /// @param holder  who uses it, for other programs that want it (Lease)
  /// @throws PortHeld: another program uses this address. InstrumentError kCannotOpen: unknown host,
  /// connection refused, no answer within `connect_timeout`
  ///   (the system's own look-up of a host name may take longer).
  TcpStream(const std::string& host, std::uint16_t port, Clock& clock,
            Clock::Duration connect_timeout = std::chrono::seconds(5),
            std::size_t queue_bytes = kDefaultQueueBytes, const std::string& holder = {});
  ~TcpStream() override;

  void write(std::string_view bytes) override;  ///< Write deadline: 2 s.
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override;  ///< "tcp:HOST:PORT"
  int descriptor() const override;
  std::vector<std::shared_ptr<Lease>> leases() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::wire
