#pragma once

#include <cstdint>
#include <string>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// Flags of angles whose mean itself may be wrong. Lost and repeated readings leave a sound mean: they are
/// only counted, unless more than a quarter of all angles had to be repeated.
inline constexpr std::uint32_t kSuspectFlags = kFlagNotQuiet | kFlagClipped | kFlagStuck | kFlagNotFinite |
                                               kFlagOutsideWindow | kFlagTemperature | kFlagNorm;

/// The flags whose angles the estimators by least squares leave out.
inline constexpr std::uint32_t kLeftOutFlags = kFlagClipped | kFlagNotFinite;

/// Fills the flags and the number of flagged angles.
void count_flags(const RunRecord& record, Diagnostics& diagnostics);

/// "2 of 216 angles are flagged: stuck output", and whether more than a quarter had to be measured again;
/// empty if neither applies.
/// @param which  a part of kSuspectFlags
Message words_about_flags(const RunRecord& record, std::uint32_t which);

/// Makes a result doubtful where an angle that it uses has one of these flags, or where more than a quarter
/// had to be measured again.
void object_to_flags(const RunRecord& record, std::uint32_t which, CalibrationResult& result);

}  // namespace abcal
