#pragma once

#include <fmt/format.h>

#include <stdexcept>
#include <string>

namespace abcal::sim {

/// Refuses an impossible number of a simulated bench. @throws std::invalid_argument
[[noreturn]] inline void refuse(const std::string& what, const std::string& found,
                                const std::string& required) {
  throw std::invalid_argument(fmt::format("simulated bench: {} is {}, required: {}", what, found, required));
}

inline void require(bool holds, const std::string& what, double found, const std::string& required) {
  if (!holds) refuse(what, fmt::format("{}", found), required);
}

}  // namespace abcal::sim
