#pragma once

#include "app/ground/evidence/laboratory_link.h"

namespace abcal {

/// Answers the questions of a run from the register that the environment variable ABCAL_REGISTER names, if
/// any.
LaboratoryLink laboratory_link();

}  // namespace abcal
