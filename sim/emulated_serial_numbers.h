#pragma once

#include <string>
#include <vector>

namespace abcal::sim {

/// The serial numbers that the simulated instruments of a driver report unless a bench file gives them
/// another one. Empty for an instrument without a serial number. A real instrument does not report these.
std::vector<std::string> emulated_serial_numbers(const std::string& driver);

}  // namespace abcal::sim
