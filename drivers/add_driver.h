#pragma once

#include "drivers/registry.h"

namespace abcal {

/// Adds a driver from outside of these folders. Call before any list is used, from one thread. With
/// `connections` = 0 (`ports` = 0) abcal opens no port for it.
/// @throws std::invalid_argument for a name that exists already
void add_driver(StageDriver driver);
void add_driver(AccelerometerDriver driver);

}  // namespace abcal
