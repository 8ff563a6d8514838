#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/serial_port.h"

namespace abcal::wire {

/// One end of a pair of connected stream sockets, at whose other end another process forwards the bytes of a
/// port. Threads and limits as those of SerialPort.
class SocketStream final : public ByteStream {
 public:
  /// Takes the descriptor over. @param name  of the port, for messages
  /// @throws InstrumentError kCannotOpen
  SocketStream(int descriptor, std::string name, Clock& clock, std::size_t queue_bytes = kDefaultQueueBytes);
  ~SocketStream() override;

  void write(std::string_view bytes) override;  ///< Write deadline: 2 s.
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::wire
