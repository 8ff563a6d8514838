#pragma once

#include <map>
#include <string>

namespace abcal {

/// A label of a run ("item.serial_number", "operator.name"); empty where it was not stated.
inline std::string label_of(const std::map<std::string, std::string>& labels, const std::string& key) {
  const auto found = labels.find(key);
  return found == labels.end() ? std::string() : found->second;
}

}  // namespace abcal
