#pragma once

#include <functional>
#include <memory>
#include <mutex>

#include "drivers/wire/byte_stream.h"

namespace abcal::wire {

/// A stream whose port may vanish (a cable pulled, a hub reset) and be opened again. While it is gone all
/// calls throw kLinkLost, as those of its port did.
class ReopenableStream final : public ByteStream {
 public:
  /// Opens the port by the name in the bench file, so that one named by its USB identity is found again under
  /// any path. @throws InstrumentError kCannotOpen.
  using Open = std::function<std::unique_ptr<ByteStream>()>;

  /// Opens at once.
  explicit ReopenableStream(Open open);

  /// Opens the port again if it has vanished; bytes that it had received are lost. Any thread may write
  /// meanwhile.
  /// @throws InstrumentError kCannotOpen: not back yet, or held by another program.
  void reopen();

  void write(std::string_view bytes) override;
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override;

 private:
  std::shared_ptr<ByteStream> port() const;
  template <class Call>
  auto guarded(const Call& call);

  Open open_;
  std::string name_;
  mutable std::mutex mutex_;
  std::shared_ptr<ByteStream> port_;  ///< Null if it has vanished.
  std::string lost_because_;
  std::size_t dropped_before_ = 0;  ///< Bytes dropped by earlier ports.
};

}  // namespace abcal::wire
