#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <stdexcept>

#include "app/results/logs/log_table.h"

namespace abcal {

std::string chosen_topic(const std::vector<std::string>& found, const std::string& asked,
                         const std::string& source, const std::string& what) {
  if (asked.empty() && found.size() == 1) return found.front();
  if (!asked.empty() && std::ranges::find(found, asked) != found.end()) return asked;
  const std::string has = found.empty() ? "none" : fmt::format("{}", fmt::join(found, ", "));
  throw std::runtime_error(fmt::format("{}: {}: found {}; required: {}", source, what, has,
                                       found.empty() ? "one" : "one of them as --topic"));
}

}  // namespace abcal
