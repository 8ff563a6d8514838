#pragma once

#include <string>
#include <vector>

#include "app/witness/laboratory_link.h"

namespace abcal {

/// Sentences for the end of a run of a check standard: its chart waits for the run, with the command. Reports
/// the run to the register (environment variable ABCAL_REGISTER), too, so that `abcal lab chart show` lists
/// it. Empty without a register or without a chart of this item on this bench. If the register cannot be
/// reached, a sentence says so and nothing is thrown: the run is complete without it.
/// @param login  as in find_operator()
std::vector<std::string> check_run_notices(const EndedRun& run, const std::string& login);

}  // namespace abcal
