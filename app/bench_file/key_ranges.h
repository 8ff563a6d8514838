#pragma once

#include "app/formats/key_visitor.h"

namespace abcal {

// Ranges that no laboratory exceeds: wide enough for every instrument, and narrow enough that no arithmetic
// of the program overflows.

/// R of one output, in any unit: from 1e-12 to the counts of a wide converter.
inline constexpr double kLeastResponse = 1e-12, kMostResponse = 1e12;
inline constexpr Range kResponse{-kMostResponse, kMostResponse};
inline constexpr Range kResponseSize{0.0, kMostResponse};
/// A range or a sensitivity, by which the program divides.
inline constexpr Range kPositiveResponse{kLeastResponse, kMostResponse};

/// Coefficients of the order n of a response, in 1/R^(n-1), for outputs of 1e-9 R and more.
inline constexpr Range kSecondOrder{-1e9, 1e9};
inline constexpr Range kThirdOrder{-1e18, 1e18};
inline constexpr Range kFourthOrder{-1e27, 1e27};
inline constexpr Range kFifthOrder{-1e36, 1e36};

/// Relative changes of a sensitivity, and their coefficients of temperature.
inline constexpr Range kRelativeChange{-1.0, 1.0};

/// Degrees. A stage that counts turns may be a hundred of them away from its zero.
inline constexpr Range kTurns{-36'000.0, 36'000.0};
inline constexpr Range kAngle{-360.0, 360.0};
inline constexpr Range kAngleSize{0.0, 360.0};
/// Degrees per second, and per second squared: slower, a run would not end.
inline constexpr Range kSpeed{1e-6, 1e6};
inline constexpr Range kAcceleration{1e-6, 1e9};

/// Seconds; 1e9 are 30 years.
inline constexpr Range kTime{0.0, 1e9, true};
inline constexpr Range kTimeOrZero{0.0, 1e9};
inline constexpr Range kFrequency{0.0, 1e6};  // Hz

inline constexpr Range kTorque{0.0, 1000.0};  // N m, of a fastener

/// Kelvin.
inline constexpr Range kHeating{0.0, 1000.0};
inline constexpr Range kTemperatureWidth{1e-6, 1000.0};
inline constexpr Range kTemperatureRate{-1e6, 1e6};  // per hour

/// [limits]: 1e9 means "never"; a stored run has it for a limit that the bench file does not give.
inline constexpr double kNoLimit = 1e9;
inline constexpr Range kLimit{0.0, kNoLimit, true};
inline constexpr Range kTemperatureLimit{-kNoLimit, kNoLimit};

}  // namespace abcal
