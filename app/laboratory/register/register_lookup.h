#pragma once

#include "app/formats/record_lookup.h"

namespace abcal {

/// Finds the values that a bench file takes from records of the register (ABCAL_REGISTER): calibrations of
/// equipment in use that hold today. The register is opened when the first record is asked for, and not kept
/// open. Without a register each record is reported as a problem.
RecordLookup register_records();

}  // namespace abcal
