#pragma once

// Instruments of drivers outside of the sources of abcal. A stage derives from RotationStage, an
// accelerometer from Accelerometer; both must keep the contract, which tests/contract/instrument_contract.h
// checks with GoogleTest. A driver that was added can be named in bench files.

#include <string>
#include <vector>

#include "abcal/export.h"
#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/registry.h"

namespace abcal::v1 {
/// Names of all drivers, including those that were added.
std::vector<std::string> stage_driver_list();
std::vector<std::string> accelerometer_driver_list();

/// Adds a driver, before the first bench file is read. With `connections` = 0 (`ports` = 0) abcal opens no
/// port: the driver reaches its instrument in its own way, e.g. by its maker's library; the bench file's
/// `port` is then a name.
/// @throws std::invalid_argument for a name that exists already
void add_stage_driver(StageDriver driver);
void add_accelerometer_driver(AccelerometerDriver driver);

}  // namespace abcal::v1
