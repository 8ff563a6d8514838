#pragma once

#include <string>

#include "drivers/instrument/clock.h"
#include "protocol/record/run_operator.h"

namespace abcal {

/// What the register says before a run begins. Nothing is asked of it later: losing it neither stops nor
/// delays a run.
struct RegisteredStart {
  RunOperator who;
  std::string calibrations_json;  ///< Calibrations of equipment in use that hold today; empty: no register.
};

/// The operator of a bench: with a register (environment variable ABCAL_REGISTER) the person who is logged in
/// there and may measure, else as the bench file states.
/// @param stated  [operator] name of the bench file; empty: none
/// @param login   of a person who is logged in elsewhere, at a console; empty: whoever is logged in here
/// @throws std::runtime_error     if the register cannot be read, or nobody is logged in
/// @throws std::invalid_argument  if that person may not measure, or the bench file names another
RegisteredStart find_operator(const std::string& stated, Clock::UtcTime now, const std::string& login = {});

/// The private key (PEM) with which this bench signs its runs, from the file that the environment variable
/// ABCAL_SIGNING_KEY names; empty: none is configured.
/// @throws std::invalid_argument if the file is no such key, or others can read it
std::string read_signing_key();

}  // namespace abcal
