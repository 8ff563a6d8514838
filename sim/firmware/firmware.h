#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/clock.h"
#include "sim/firmware/unserved_commands.h"

namespace abcal::sim {

/// The inside of a simulated instrument at byte level: the behaviour of the bytes in the maker's manual,
/// without a port. Time is handed in, so that the same firmware serves the jumping clock and real time. One
/// thread.
class Firmware {
 public:
  virtual ~Firmware() = default;

  /// The instrument's port took these bytes at `now`. Any split is allowed.
  virtual void receive(std::string_view bytes, Clock::Instant now) = 0;

  /// The bytes that the instrument has output since the last call and up to `now`.
  virtual std::string transmit(Clock::Instant now) = 0;

  /// Time of its next output if nothing more is received; absent: never. May be in the past.
  virtual std::optional<Clock::Instant> next_due() const = 0;

  /// Whether its plug is in: an emulator takes the port of an unplugged one away.
  virtual bool plugged_in() const { return true; }

  /// A client has connected over a network: half a command of an earlier client is forgotten, and so are
  /// pending answers to it. Motion, settings and the rest of the instrument's state continue. Not called on
  /// serial lines, where the half command stays.
  virtual void session_starts() {}

  /// Another connection to the same instrument while one is open, with its own commands and replies; null: it
  /// serves one client at a time.
  virtual std::shared_ptr<Firmware> another_session() { return nullptr; }
  /// Its supply fails (false) or is back (true): motion ends, volatile settings are lost, and it starts as
  /// its maker lets it start, streaming or not. Nothing is received in between, and output is lost.
  virtual void power(bool /*on*/, Clock::Instant /*now*/) {}

  /// The present speed of its serial port in Bd; absent: it has none (USB, network).
  virtual std::optional<unsigned> line_speed() const { return std::nullopt; }

  /// Commands from hosts that it does not carry out.
  virtual UnservedCommands& unserved() { return unserved_; }

 private:
  UnservedCommands unserved_;
};

/// A firmware whose inside is defined in its source, and not in its header.
class EncasedFirmware : public Firmware {
 public:
  void receive(std::string_view bytes, Clock::Instant now) override { inside_->receive(bytes, now); }
  std::string transmit(Clock::Instant now) override { return inside_->transmit(now); }
  std::optional<Clock::Instant> next_due() const override { return inside_->next_due(); }
  void session_starts() override { inside_->session_starts(); }
  void power(bool on, Clock::Instant now) override { inside_->power(on, now); }
  std::optional<unsigned> line_speed() const override { return inside_->line_speed(); }

 protected:
  /// Called by every constructor.
  void encase(std::unique_ptr<Firmware> inside) { inside_ = std::move(inside); }

 private:
  std::unique_ptr<Firmware> inside_;
};

}  // namespace abcal::sim
