#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

/// Family of voltmeters with the same commands, replies and errors.
enum class ScpiFamily {
  kKeysight34970a,  ///< Scanning: 34970A, 34972A, DAQ970A.
  kKeysight34401a,  ///< One channel: 34401A, 34465A.
  kKeithley2700,    ///< Scanning: 2700; 2000 and 2001 with channels 1, 2, 3.
};

struct ScpiVoltmeterSettings {
  ScpiFamily family = ScpiFamily::kKeysight34970a;
  /// Model within the family; empty: 34970A, 34465A or 2700. It decides on the identity, the layout of the
  /// status byte, and for a 2001 on the commands that count.
  std::string model = {};
  std::string identity = {};  ///< Reply to *IDN?; empty: that of the family, with `serial_number`.
  std::string serial_number = "MY44012345";
  std::array<int, 3> channels{101, 102, 103};  ///< Where u, v, w of the SimBench are wired.
  std::size_t single_channel = 0;              ///< The one that a 34401A is wired to: 0 u, 1 v, 2 w.
  double line_frequency_hz = 50.0;
  /// "CONF:VOLT:DC AUTO,AUTO,(@...)": not every model may [unverified against a device].
  bool accepts_second_auto = true;
  bool needs_remote = false;  ///< Refuses measurements before SYST:REM, as a 34401A on a serial line.
  Clock::Duration channel_overhead =
      std::chrono::milliseconds(4);  ///< Switching and settling of one channel.
  unsigned baud = 9600;              ///< Speed of its RS-232 port.
  Clock::Duration reply_delay = std::chrono::microseconds(500);
};

/// The settings of a model: 34970A, 34972A, DAQ970A, 34401A, 34460A, 34461A, 34465A, 34470A, 2000, 2001,
/// 2700, 2701 or 2750. @throws std::invalid_argument for another one
ScpiVoltmeterSettings scpi_model(const std::string& model);

/// A SCPI voltmeter (docs/protocols/scpi_voltmeters.md) that measures the outputs of a SimBench, whose
/// response unit R is then volt.
///
/// A measurement lasts as long as the integration of each channel (number of power line cycles, twice with
/// automatic zero) and its switching; each channel is measured at its own time. Commands that arrive during a
/// measurement wait, except those after INIT, which runs in the background. Short and long forms, any case,
/// several commands joined by ';'. Status registers according to IEEE 488.2. Commands that it does not know
/// are error -113, and noted (unserved()).
class ScpiVoltmeterFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument if a setting cannot be.
  explicit ScpiVoltmeterFirmware(std::shared_ptr<SimBench> bench, ScpiVoltmeterSettings settings = {});

 private:
  class Meter;
};

}  // namespace abcal::sim
