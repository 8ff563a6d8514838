#pragma once

#include <map>
#include <string>

namespace abcal {

/// A label of a run ("item.serial_number", "operator.name"); empty where it was not stated.
inline std::string label_of(const std::map<std::string, std::string>& labels, const std::string& key) {
  const auto found = labels.find(key);
  return found == labels.end() ? std::string() : found->second;
}

/// Labels of the run of one point of a series over temperature, by which it is found again.
inline constexpr const char* kPointLabel = "temperature.point";   ///< "3 of 15"
inline constexpr const char* kLegLabel = "temperature.leg";       ///< "up"
inline constexpr const char* kSetLabel = "temperature.set_degc";  ///< "-40"
inline constexpr const char* kSoakLabel = "temperature.soak";     ///< In words.
inline constexpr const char* kPlanLabel = "temperature.plan";  ///< Target of the plan search: "reach s=2e-5".

}  // namespace abcal
