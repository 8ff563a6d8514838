#include <array>
#include <utility>

#include "drivers/registry.h"
#include "drivers/scpi_voltmeter/accelerometer.h"

namespace abcal {
namespace {

// Rates that a scan of three channels can keep up with.
constexpr const char* kExample = "rate_hz = 20.0\nintegration_plc = 0.02\n";

std::unique_ptr<Accelerometer> make_three_voltmeters(std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                                     Clock& clock, const AccelerometerSettings& settings) {
  std::array<std::unique_ptr<wire::ByteStream>, 3> three;
  for (std::size_t j = 0; j < 3; ++j) three[j] = std::move(streams.at(j));
  return std::make_unique<ScpiSingleVoltmeters>(std::move(three), clock, settings);
}

}  // namespace

void register_scpi_voltmeter(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "scpi_voltmeter",
       .description = "analog accelerometers behind a scanning voltmeter: Keysight 34970A, 34972A, DAQ970A, "
                      "Keithley 2700, 2001",
       .serial = {9600, false},
       .make = make_accelerometer_of<ScpiScanningVoltmeter>,
       .example = kExample});
  drivers.accelerometers.push_back(
      {.name = "scpi_single",
       .description = "analog accelerometers behind three voltmeters of one channel: Keysight 34401A, 34465A "
                      "and their like",
       .serial = {9600, false},
       .make = make_three_voltmeters,
       .ports = 3,
       .example = kExample});
}

}  // namespace abcal
