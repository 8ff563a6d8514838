#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "app/measure/bench/make_firmware.h"
#include "drivers/instrument/clock.h"
#include "sim/faults.h"
#include "sim/firmware/unserved_commands.h"
#include "sim/sim_bench.h"

namespace abcal {

/// Requests of `abcal emulate --control`: one line of JSON, one line back (docs/emulate.md).
class EmulatorControl {
 public:
  /// Requests of hosts that an instrument did not fulfil, by the instrument's name.
  using Unserved = std::map<std::string, const sim::UnservedCommands*>;

  /// `links` are the links of the instruments by name, as [[fault]] calls them; all must outlive this object.
  EmulatorControl(SimWorlds worlds, const Clock& clock, std::map<std::string, sim::FaultyStream*> links,
                  Unserved unserved = {});

  /// @return {"ok": true, ...} or {"ok": false, "error": "..."}; never throws because of a request.
  std::string answer(const std::string& line);

 private:
  SimWorlds worlds_;
  sim::SimBench& world_;  ///< The first, with the stage.
  const Clock& clock_;
  std::map<std::string, sim::FaultyStream*> links_;
  Unserved unserved_;
};

/// Serves an EmulatorControl on a TCP port of the loopback interface, in a thread of its own. Several
/// clients; a line may have 64 KiB.
class ControlServer {
 public:
  /// @throws std::runtime_error if the port is not available. Port 0: any free one.
  ControlServer(EmulatorControl& control, std::uint16_t port);
  ~ControlServer();
  std::uint16_t port() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal
