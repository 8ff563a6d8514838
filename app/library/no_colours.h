#pragma once

#include <cstdio>

namespace abcal::v1 {

/// A stream that is not a terminal: texts for it have no colours.
inline std::FILE* no_colours() {
  static std::FILE* const stream = std::fopen("/dev/null", "we");
  return stream;
}

}  // namespace abcal::v1
