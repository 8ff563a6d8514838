#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"

namespace abcal {

/// Who answered on a port.
struct ProbeAnswer {
  std::string driver;  ///< Name in the registry, for `driver` in a bench file.
  bool stage = false;  ///< Else an accelerometer.
  std::string maker, model, serial_number, firmware;
};

/// Identifies the instrument on one port: tries one driver after the other with its usual settings. Sends
/// only what identify() sends, so nothing moves and nothing is stored; a sensor that streams may be stopped.
/// @param trying gets the name of each driver before it is tried.
/// @return nothing if no known instrument answers.
/// @throws InstrumentError kCannotOpen if the port cannot be opened at all.
std::optional<ProbeAnswer> probe_port(const std::string& port, Clock& clock,
                                      const std::function<void(const std::string&)>& trying);

}  // namespace abcal
