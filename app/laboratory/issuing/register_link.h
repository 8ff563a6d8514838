#pragma once

#include <string>

#include "app/laboratory/register/register.h"
#include "app/witness/laboratory_link.h"

namespace abcal {

/// Answers the questions of a run from the register that the environment variable ABCAL_REGISTER names, if
/// any.
LaboratoryLink laboratory_link();

/// Has the witness of this computer (WitnessClient::find()) sign heads of a register's audit; empty: there is
/// none. It is asked on the first use.
/// @throws std::runtime_error if the witness that is configured cannot be reached
lab::HeadWitness head_witness(const std::string& register_identity);

}  // namespace abcal
