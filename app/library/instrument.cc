#include "abcal/instrument.h"

#include <utility>

#include "drivers/add_driver.h"

namespace abcal::v1 {

std::vector<std::string> stage_driver_list() {
  std::vector<std::string> names;
  for (const ::abcal::StageDriver& driver : ::abcal::stage_drivers()) names.push_back(driver.name);
  return names;
}

std::vector<std::string> accelerometer_driver_list() {
  std::vector<std::string> names;
  for (const ::abcal::AccelerometerDriver& driver : ::abcal::accelerometer_drivers())
    names.push_back(driver.name);
  return names;
}

void add_stage_driver(StageDriver driver) {
  ::abcal::add_driver(std::move(driver));
}
void add_accelerometer_driver(AccelerometerDriver driver) {
  ::abcal::add_driver(std::move(driver));
}

}  // namespace abcal::v1
