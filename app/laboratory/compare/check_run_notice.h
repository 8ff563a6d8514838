#pragma once

#include <string>
#include <vector>

#include "app/ground/evidence/laboratory_link.h"

namespace abcal {

/// What is to be said at the end of a run of a check standard: that its chart waits for it, with the command.
/// Tells the register (environment variable ABCAL_REGISTER), too, so that `abcal lab chart show` lists the
/// run. Nothing without a register or without a chart of this item on this bench. A register that cannot be
/// reached now is something to be said: the run is whole without it.
/// @param login  as in find_operator()
std::vector<std::string> check_run_notices(const EndedRun& run, const std::string& login);

}  // namespace abcal
