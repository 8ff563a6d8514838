#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "sim/faults.h"
#include "sim/firmware/firmware.h"

namespace abcal::sim {

/// A simulated instrument behind a link that is slow or goes wrong (FaultyStream), for an emulator. While it
/// is unplugged it receives nothing, and its output is lost.
class FaultyPort final : public Firmware {
 public:
  /// `clock` must be the clock of the instants that are passed in.
  FaultyPort(std::shared_ptr<Firmware> inner, Clock& clock, std::vector<WireFault> faults = {},
             std::uint64_t seed = 1, LinkTiming timing = {});

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  bool plugged_in() const override { return !stream_.unplugged(); }
  void session_starts() override { inner_->session_starts(); }
  /// Without the faults, which are those of the first connection.
  std::shared_ptr<Firmware> another_session() override { return inner_->another_session(); }
  std::optional<unsigned> line_speed() const override { return inner_->line_speed(); }
  UnservedCommands& unserved() override { return inner_->unserved(); }

  FaultyStream& link() { return stream_; }  ///< To add faults; safe from other threads.

 private:
  std::shared_ptr<Firmware> inner_;
  std::function<void(bool)> power_;
  FaultyStream stream_;
};

}  // namespace abcal::sim
