#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/firmware/reply_queue.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct WatlowF4Settings {
  bool f4t = true;           ///< False: an F4 (map 2).
  bool second_loop = false;  ///< F4: an F4D, which has a second set point (register 319).
  bool tcp = false;          ///< Modbus TCP frames, else RTU.
  int address = 1;
  bool fahrenheit = false;  ///< Factory setting of an F4T.
  int decimals = 1;         ///< F4: register 606.
  double least_set_degc = -70.0;
  double most_set_degc = 180.0;
  unsigned baud = 19200;
  int run_output = 1;    ///< Event output that starts the chamber.
  int pause_output = 2;  ///< Event output that pauses its compressor.
  int door_input = 1;    ///< F4: digital input of the door.
  Clock::Duration reply_delay = std::chrono::milliseconds(4);
};

/// A chamber with a Watlow F4 or F4T controller on Modbus (docs/protocols/watlow_f4.md; [unverified against a
/// device]), heating and cooling the air of a SimBench. A frame with a wrong checksum, of another unit or
/// protocol, or half a frame that is 50 ms old gets no answer.
class WatlowF4Firmware final : public Firmware {
 public:
  explicit WatlowF4Firmware(std::shared_ptr<SimBench> bench, WatlowF4Settings settings = {});

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override { return replies_.take(now); }
  std::optional<Clock::Instant> next_due() const override { return replies_.next_due(); }
  void session_starts() override;
  std::shared_ptr<Firmware> another_session() override;
  void power(bool on, Clock::Instant now) override;
  std::optional<unsigned> line_speed() const override {
    return settings_.tcp ? std::nullopt : std::optional(settings_.baud);
  }

 private:
  struct State {
    double set_degc = 23.0;
    std::int64_t clock_ahead_s = 0;          ///< Added to the clock that was never set.
    std::map<unsigned, std::uint16_t> kept;  ///< Registers that are kept and nothing else.
  };
  using Registers = std::optional<std::uint16_t>;

  void take_frames(Clock::Instant now);
  void take_tcp_frames(Clock::Instant now);
  void take_rtu_frames(Clock::Instant now);
  std::string answer_to(const std::string& pdu, Clock::Instant now);
  std::string carry_out(const std::string& pdu, Clock::Instant now);
  std::string read(unsigned first, unsigned count, Clock::Instant now);
  /// @return 0, or the code of an exception
  int write(unsigned address, const std::string& words, Clock::Instant now);
  int write_f4(unsigned address, std::uint16_t value, Clock::Instant now);
  int write_f4t(unsigned address, const std::string& words, Clock::Instant now);
  Registers value_of(unsigned address, Clock::Instant now) const;
  Registers f4_value(unsigned address, Clock::Instant now) const;
  Registers f4t_value(unsigned address, Clock::Instant now) const;
  Registers f4t_loop_value(unsigned address, Clock::Instant now) const;
  std::uint16_t kept(unsigned address, std::uint16_t otherwise) const;
  /// The clock as hour, minute, second, month, day, year; 0 to 5.
  std::uint16_t clock_part(std::size_t which, Clock::Instant now) const;
  int set_clock_part(std::size_t which, unsigned value, Clock::Instant now);
  bool controls_air() const;
  double power_percent(Clock::Instant now) const;
  double shown(double degc) const;
  double degc_of(double shown) const;
  std::uint16_t scaled(double degc) const;
  bool event_is_on(int number) const;
  unsigned event_register(int number) const;
  void command(Clock::Instant now);

  std::shared_ptr<SimBench> bench_;
  WatlowF4Settings settings_;
  std::shared_ptr<State> state_;
  ReplyQueue replies_;
  std::string received_;
  std::string request_;  ///< The one in hand, from its function on.
  Clock::Instant last_byte_{};
};

}  // namespace abcal::sim
