#include "drivers/iio/accelerometer.h"
#include "drivers/registry.h"

namespace abcal {
namespace {

/// Nothing else answers the question of voltmeters with an error of the system. A question of its own would
/// cost every other port time.
bool is_error_of_the_system(std::string_view received) {
  constexpr std::string_view kInvalidArgument = "-22\n";
  if (!received.starts_with(kInvalidArgument)) return false;
  while (received.starts_with(kInvalidArgument)) received.remove_prefix(kInvalidArgument.size());
  return received.empty();
}

}  // namespace

void register_iio(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "iio",
       .description = "accelerometers of Linux (Industrial I/O) by their machine's iiod, output in m/s2",
       .serial = {115200, false},
       .make = make_accelerometer_of<iio::IioAccelerometer>,
       .output_unit = "m/s2",
       .recognition = {"*IDN?\r\n", is_error_of_the_system}});
  // "Linux IIO" is a framework; its name of a device is that of the sensor inside the item.
  drivers.traits["iio"] = {.names_device = true, .reports_maker = false, .reports_model = false};
}

}  // namespace abcal
