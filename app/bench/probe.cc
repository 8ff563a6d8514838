#include "app/bench/probe.h"

#include "drivers/instrument/instrument_error.h"
#include "drivers/registry.h"
#include "drivers/wire/open_stream.h"

namespace abcal {
namespace {

std::unique_ptr<wire::ByteStream> open(const std::string& port, const SerialDefaults& defaults,
                                       Clock& clock) {
  wire::SerialSettings settings;
  settings.baud = defaults.baud;
  settings.rts_cts = defaults.rts_cts;
  return wire::open_stream(port, settings, clock);
}

ProbeAnswer answer(const std::string& driver, bool stage, const auto& info) {
  return {driver, stage, info.maker, info.model, info.serial_number, info.firmware};
}

/// What an instrument that is not this driver's makes of its questions: silence, or an answer that it does
/// not know.
bool is_another_instrument(const InstrumentError& error) {
  return error.fault() != Fault::kCannotOpen && error.fault() != Fault::kLinkLost;
}

}  // namespace

std::optional<ProbeAnswer> probe_port(const std::string& port, Clock& clock,
                                      const std::function<void(const std::string&)>& trying) {
  const auto ask = [&](const auto& driver, bool stage, const auto& make) -> std::optional<ProbeAnswer> {
    trying(driver.name);
    auto stream = open(port, driver.serial, clock);
    try {
      return answer(driver.name, stage, make(std::move(stream))->identify());
    } catch (const InstrumentError& error) {
      if (!is_another_instrument(error)) throw;
      return std::nullopt;
    }
  };
  for (const StageDriver& driver : stage_drivers()) {
    const auto make = [&](auto stream) { return driver.make(std::move(stream), clock, StageSettings{}); };
    if (auto found = ask(driver, true, make)) return found;
  }
  for (const AccelerometerDriver& driver : accelerometer_drivers()) {
    if (driver.ports != 1) continue;  // one port does not identify an instrument of several
    const auto make = [&](auto stream) {
      std::vector<std::unique_ptr<wire::ByteStream>> streams;
      streams.push_back(std::move(stream));
      return driver.make(std::move(streams), clock, AccelerometerSettings{});
    };
    if (auto found = ask(driver, false, make)) return found;
  }
  return std::nullopt;
}

}  // namespace abcal
