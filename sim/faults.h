#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/byte_stream.h"
#include "sim/fault_kinds.h"

namespace abcal::sim {

/// A byte stream on which scripted faults happen. Repeats exactly: its random bytes come from `seed`.
class FaultyStream final : public wire::ByteStream {
 public:
  FaultyStream(std::unique_ptr<wire::ByteStream> inner, Clock& clock, std::vector<WireFault> faults,
               std::uint64_t seed = 1, LinkTiming timing = {});

  void write(std::string_view bytes) override;
  wire::ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override { return inner_->dropped_bytes(); }
  std::string name() const override { return inner_->name(); }

  /// `power` is called when kPowerCycle begins (false) and ends (true), in the thread that uses the stream;
  /// with both at the next use, if the stream was not used meanwhile. A stream without `power` treats
  /// kPowerCycle as kUnplug.
  void on_power(std::function<void(bool on)> power);

  void add(WireFault fault);
  void clear();                                       ///< Removes all faults, present and future.
  std::size_t writes() const;                         ///< How many there have been.
  bool unplugged() const;                             ///< Or without power.
  std::vector<FaultKind> active() const;              ///< In force now.
  std::optional<Clock::Instant> next_due() const;     ///< When held bytes are released; nullopt if none are
                                                      ///< held.
  std::optional<Clock::Instant> next_change() const;  ///< When a fault begins or ends next by its time.

 private:
  struct Held {
    Clock::Instant due;
    std::string bytes;
  };
  const WireFault* active(FaultKind kind) const;
  void hold(std::string bytes, Clock::Instant arrival);
  void throw_if_unplugged();
  void follow_power();
  std::string distort(std::string bytes);
  std::uint64_t draw();

  std::unique_ptr<wire::ByteStream> inner_;
  Clock& clock_;
  std::vector<WireFault> faults_;
  std::uint64_t seed_;
  LinkTiming timing_;
  std::uint64_t draws_ = 0;
  std::size_t writes_ = 0;
  std::size_t replaced_for_write_ = 0;
  std::vector<Held> held_;
  std::function<void(bool)> power_;
  bool powered_ = true;
  Clock::Instant last_look_;  ///< At the power.
  mutable std::recursive_mutex mutex_;
};

}  // namespace abcal::sim
