#pragma once

#include <string>
#include <vector>

#include "app/measure/emulator/wire_log.h"
#include "sim/firmware/firmware.h"

namespace abcal {

/// How the simulated instrument's answer agrees with the real one's.
enum class Likeness {
  kEqual,          ///< Equal bytes, or both are silent.
  kNumbersDiffer,  ///< Text in which only numbers differ: other positions, readings, serial numbers.
  kSameLength,     ///< Binary data of the same length.
  kDifferent,
  kOnlyReal,       ///< The simulated one is silent.
  kOnlySimulated,  ///< The real one was silent.
};

/// "equal", "numbers differ", ...
std::string_view to_string(Likeness likeness);

/// Output of a host, and the bytes received before its next output.
struct ComparedExchange {
  double t_s = 0.0;
  std::string asked;  ///< Empty: before the host's first bytes.
  std::string real;
  std::string simulated;
  Likeness likeness = Likeness::kEqual;
};

/// Gives a simulated instrument the bytes of a logged host at their times, and compares its answers with
/// those of the real one. Writes of the host within 5 ms of each other without an answer count as one.
/// @param start  the time of the simulated instrument at which the log begins
std::vector<ComparedExchange> compare_firmware(const WireLog& log, sim::Firmware& firmware,
                                               Clock::Instant start);

}  // namespace abcal
