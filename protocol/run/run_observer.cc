#include "protocol/run/run_observer.h"

#include "drivers/text/names.h"

namespace abcal {

constexpr auto kPhases = names<RunPhase>({{RunPhase::kHoming, "homing"},
                                          {RunPhase::kWarmingUp, "warming up"},
                                          {RunPhase::kHolding, "held"},
                                          {RunPhase::kMoving, "moving"},
                                          {RunPhase::kSettling, "settling"},
                                          {RunPhase::kDwelling, "reading"},
                                          {RunPhase::kTemperature, "waiting for the temperature"},
                                          {RunPhase::kReconnecting, "waiting for a port to come back"},
                                          {RunPhase::kParking, "parking"}});

std::string_view to_string(RunPhase phase) {
  return kPhases.of(phase);
}

}  // namespace abcal
