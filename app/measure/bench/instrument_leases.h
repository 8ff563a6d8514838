#pragma once

#include <memory>
#include <string>
#include <vector>

#include "drivers/instrument/accelerometer.h"

namespace abcal {

/// The resources (wire::Lease) that represent an instrument on any port: one for each serial number that it
/// reports. Empty without a serial number, and for an emulated instrument, whose number is that of every
/// emulator.
std::vector<std::string> resources_of_instrument(const std::string& driver, const std::string& maker,
                                                 const std::string& model, const std::string& serial_number);

/// An accelerometer whose leases this program takes as soon as it has identified itself, and holds until
/// `accelerometer` is destroyed.
/// @param holder  as for wire::Lease
std::unique_ptr<Accelerometer> leased_accelerometer(std::unique_ptr<Accelerometer> accelerometer,
                                                    std::string driver, std::string holder);

}  // namespace abcal
