#pragma once

#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct XsensMtiSettings {
  /// Hexadecimal, 8 digits (or 16 of the MTi-600 series [unverified against a device]).
  std::string device_id = "037003F8";
  /// "MTi-G...", "MTi-680...": with the outputs of a GNSS receiver, which sees no satellite.
  std::string product_code = "MTi-30-2A8G4";
  unsigned hardware_version = 0x0105;
  std::array<unsigned, 3> firmware_version{1, 8, 2};
  unsigned firmware_build = 63;
  unsigned baud = 115200;        ///< One of the maker's.
  unsigned base_rate_hz = 400;   ///< Highest output rate; the others are whole fractions of it.
  bool just_switched_on = true;  ///< WakeUp at the start of the world's time; else it is measuring then.
  Clock::Duration reply_delay = std::chrono::milliseconds(1);
  /// Silence after Reset [unverified against a device].
  Clock::Duration reset_time = std::chrono::milliseconds(300);
};

/// An Xsens (Movella) MTi that speaks Xbus (docs/protocols/xbus.md), reading the world of a SimBench. Its
/// output unit R is m/s2: a truth of about 9.8 R per g_loc makes an ideal one. Samples lie on the grid of its
/// base rate, from the start of the world's time. Gyroscope, magnetometer and orientation show the motion of
/// the platter (SimBench::body_motion), in the frame that the data id names.
///
/// Switched on, it sends WakeUp and begins to measure 500 ms later unless a command says otherwise, with its
/// last output configuration. A new baud rate holds from the next reset on. Messages that it does not know
/// are error 04, and noted (unserved()).
class XsensMtiFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument for a device id, product code, baud rate or base rate that cannot be.
  explicit XsensMtiFirmware(std::shared_ptr<SimBench> bench, XsensMtiSettings settings = {});

 private:
  class Device;
};

}  // namespace abcal::sim
