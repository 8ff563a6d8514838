#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>

#include "protocol/record/run_record.h"

namespace abcal::console {

/// The words of the bits of DwellRecord::flags, from the lowest on.
inline nlohmann::ordered_json flag_words() {
  nlohmann::ordered_json words = nlohmann::ordered_json::array();
  for (std::uint32_t flag = 1; (flag & kAllFlags) != 0U; flag <<= 1U) words.push_back(describe_flags(flag));
  return words;
}

}  // namespace abcal::console
