#include "protocol/run/run_observer.h"

namespace abcal {

std::string_view to_string(RunPhase phase) {
  switch (phase) {
    case RunPhase::kHoming:
      return "homing";
    case RunPhase::kWarmingUp:
      return "warming up";
    case RunPhase::kHolding:
      return "held";
    case RunPhase::kMoving:
      return "moving";
    case RunPhase::kSettling:
      return "settling";
    case RunPhase::kDwelling:
      return "reading";
    case RunPhase::kTemperature:
      return "waiting for the temperature";
    case RunPhase::kReconnecting:
      return "waiting for a port to come back";
    case RunPhase::kParking:
      return "parking";
  }
  return "";
}

}  // namespace abcal
