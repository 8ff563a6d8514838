#pragma once

#include <stdexcept>

namespace abcal {

/// These data cannot be analysed: what they hold contradicts the analysis, or they do not determine what is
/// asked. what() says what was found and what is required. An estimator refuses data with this and nothing
/// else; any other exception that leaves it is a fault of the program.
class UnusableData : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace abcal
