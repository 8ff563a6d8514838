#pragma once

#include <string>

#include "app/witness/laboratory_link.h"
#include "drivers/instrument/clock.h"

namespace abcal {

/// The operator of a bench: with a register (environment variable ABCAL_REGISTER) the person who is logged in
/// to it and may measure, else as the bench file states.
/// @param stated  [operator] name of the bench file; empty: none
/// @param login   login of a person at a console elsewhere; empty: that of the person logged in here
/// @throws std::runtime_error     if the register cannot be read, or nobody is logged in
/// @throws std::invalid_argument  if that person may not measure, or the bench file names another
RegisteredStart find_operator(const std::string& stated, Clock::UtcTime now, const std::string& login = {});

}  // namespace abcal
