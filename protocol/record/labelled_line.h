#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace abcal {

/// Labels and numbers of a line that names each of its numbers, as microcontrollers print them: "AcX = 4995 |
/// AcY = -161 | AcZ = 14608", "X: 0.1 Y: 0.2 Z: 9.8 m/s^2", {"ax":0.1,"ay":0.2,"az":9.8}. The time of day
/// that a serial monitor writes before "->" has the label "time". Nothing for a line with fewer than three
/// such numbers.
std::optional<std::vector<std::pair<std::string, std::string>>> labelled_numbers(std::string_view line);

}  // namespace abcal
