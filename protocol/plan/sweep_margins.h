#pragma once

namespace abcal {

/// Time at the rate before the first step of a sweep, in which what the item shows of the acceleration and of
/// the lag of its filter dies away.
inline constexpr double kMarginBeforeS = 0.25;
/// The same after the last step, where only the encoder and the readings may lag.
inline constexpr double kMarginAfterS = 0.05;

}  // namespace abcal
