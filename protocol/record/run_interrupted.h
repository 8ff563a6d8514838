#pragma once

#include <stdexcept>

namespace abcal {

/// The run was stopped by a person; the stage was halted and the run file can be resumed.
class RunInterrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace abcal
