#pragma once

#include <string_view>
#include <vector>

namespace abcal::console {

/// A file of the page, built into the program: nothing is read from the disk or loaded from elsewhere.
struct Asset {
  std::string_view path;  ///< "/style.css"
  std::string_view body;
};

const std::vector<Asset>& assets();

}  // namespace abcal::console
