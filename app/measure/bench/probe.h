#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/registry.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// The instrument that answered on a port.
struct ProbeAnswer {
  std::string driver;  ///< Name in the registry, for `driver` in a bench file; empty: none fits.
  bool stage = false;  ///< Else an accelerometer, or a chamber.
  std::string maker, model, serial_number, firmware;
  std::string said{};     ///< First line that it sent, if no driver fits; printable.
  std::size_t ports = 1;  ///< How many such instruments the driver needs.
  bool chamber = false;   ///< A thermal chamber.
  /// All axes on the line of a stage whose controllers may share one, as `axis` names them in a bench file.
  /// The identity is that of the controllers of the first two.
  std::vector<std::string> axes{};

  std::string role() const { return stage ? "stage" : chamber ? "chamber" : "accelerometer"; }
};

/// Opens the port that is probed with these serial settings.
using ProbeOpener = std::function<std::unique_ptr<wire::ByteStream>(const SerialDefaults&)>;

/// Identifies the instrument on one port: asks the drivers' questions (Recognition), each once, at the serial
/// settings of each, and lets the driver whose instrument answers identify it; nothing is written to the port
/// after that but by this driver. Nothing moves and no setting is stored; a sensor that streams may be
/// stopped.
/// @param trying  called with the name of each driver that is tried
/// @return nothing if no driver fits and no line of text was received
/// @throws InstrumentError kCannotOpen if the port cannot be opened at all, kLinkLost.
std::optional<ProbeAnswer> probe_port(const ProbeOpener& open, Clock& clock,
                                      const std::function<void(const std::string&)>& trying);

/// As above, for a port given by its name.
std::optional<ProbeAnswer> probe_port(const std::string& port, Clock& clock,
                                      const std::function<void(const std::string&)>& trying);

}  // namespace abcal
