#pragma once

#include <string>
#include <vector>

#include "app/laboratory/register/register.h"
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

/// Calibrations that a run states as the register's, and the register does not have as they are stated.
/// @param calibrations_json  RegisteredStart::calibrations_json
/// @return numbers of their certificates
std::vector<std::string> unknown_calibrations(lab::Register& opened, const std::string& calibrations_json);

}  // namespace abcal
