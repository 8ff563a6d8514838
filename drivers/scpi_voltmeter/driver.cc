#include <algorithm>
#include <array>
#include <initializer_list>
#include <string_view>
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

constexpr std::string_view kIdentityQuery = "*IDN?\r\n";

bool names_one_of(std::string_view received, std::initializer_list<std::string_view> models) {
  return std::any_of(models.begin(), models.end(), [received](std::string_view model) {
    return received.find(model) != std::string_view::npos;
  });
}

bool is_scanner(std::string_view received) {
  return names_one_of(received, {",34970A,", ",34972A,", ",DAQ970A,", "MODEL 2700,", "MODEL 2001,"});
}

bool is_single(std::string_view received) {
  return names_one_of(received, {",34401A,", ",34460A,", ",34461A,", ",34465A,", ",34470A,"});
}

}  // namespace

void register_scpi_voltmeter(DriverList& drivers) {
  drivers.accelerometers.push_back({.name = "scpi_voltmeter",
                                    .description = "analog accelerometers behind a scanning voltmeter: "
                                                   "Keysight 34970A, 34972A, DAQ970A, Keithley 2700, 2001",
                                    .serial = {9600, false},
                                    .make = make_accelerometer_of<ScpiScanningVoltmeter>,
                                    .example = kExample,
                                    .recognition = {std::string(kIdentityQuery), is_scanner}});
  drivers.accelerometers.push_back({.name = "scpi_single",
                                    .description = "analog accelerometers behind three single-channel "
                                                   "voltmeters: Keysight 34401A, 34465A and similar",
                                    .serial = {9600, false},
                                    .make = make_three_voltmeters,
                                    .ports = 3,
                                    .example = kExample,
                                    .recognition = {std::string(kIdentityQuery), is_single}});
  drivers.traits["scpi_voltmeter"] = {.reads_volts = true};
  drivers.traits["scpi_single"] = {.reads_volts = true};
}

}  // namespace abcal
