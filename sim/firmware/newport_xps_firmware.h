#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/firmware/reply_queue.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct NewportXpsSettings {
  /// Positioners of X and Z, "Group1.Pos", or n for "Groupn.Pos"; empty: not on this controller.
  std::array<std::string, 2> axis_names{"1", "2"};
  /// controller angle = zero + sign * protocol angle, once the axis has been homed
  std::array<int, 2> sign{+1, +1};
  std::array<Angle, 2> zero{};
  std::string serial_number{};  ///< The interface does not report it.
  std::string version = "XPS-C8 Firmware V2.6.0";
  double max_speed_deg_per_s = 720.0;
  double max_acceleration_deg_per_s2 = 1e5;
  Clock::Duration reply_delay = std::chrono::milliseconds(1);
};

/// One connection to a Newport XPS controller that turns the axes of a SimBench, each a single-axis group
/// (public XPS Programmer's Manual; [unverified against a device]). A motion blocks its connection: the reply
/// is sent when it has ended, and commands before that get error -1. A command ends with its closing bracket;
/// text that cannot be one ends with a line feed, too.
class NewportXpsFirmware final : public Firmware {
 public:
  /// The first connection to a new controller.
  /// @throws std::invalid_argument if a sign or the name of an axis is invalid.
  explicit NewportXpsFirmware(std::shared_ptr<SimBench> bench, NewportXpsSettings settings = {});
  ~NewportXpsFirmware() override;

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  /// A motion that the previous client commanded continues; its reply is dropped.
  void session_starts() override;
  std::shared_ptr<Firmware> another_session() override;
  UnservedCommands& unserved() override;

 private:
  class Controller;
  struct Motion {
    std::size_t axis;
    std::uint64_t number;  ///< Counts the motions of this axis.
  };
  explicit NewportXpsFirmware(std::shared_ptr<Controller> controller);
  void take_command(std::string_view text);
  void transmit_due(Clock::Instant now);
  void answer(int code, std::string_view values);

  std::shared_ptr<Controller> controller_;
  std::string received_;
  std::string blocking_;          ///< The command whose motion is waited for.
  std::optional<Motion> motion_;  ///< Its end is waited for.
  ReplyQueue replies_;
  Clock::Instant now_;
};

}  // namespace abcal::sim
