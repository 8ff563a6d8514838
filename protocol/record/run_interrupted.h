#pragma once

#include <stdexcept>

#include "drivers/text/message.h"

namespace abcal {

/// The run was stopped by a person; the stage was halted and the run file can be resumed.
class RunInterrupted : public Telling<std::runtime_error> {
 public:
  using Telling::Telling;
};

}  // namespace abcal
