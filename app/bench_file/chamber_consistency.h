#pragma once

#include <vector>

#include "app/bench_file/bench_config.h"
#include "drivers/instrument/thermal_chamber.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// Problems of [chamber] and [temperature] that the file itself shows; `where` is a path such as
/// "temperature.soak_max_s".
std::vector<Problem> chamber_problems(const BenchConfig& config);

/// Demands of the series that the connected chamber cannot meet. To be called before anything heats.
std::vector<Problem> chamber_problems(const BenchConfig& config, const ChamberInfo& chamber);

/// Dew point of air, degC (Magnus, over water).
double dew_point_degc(double air_degc, double humidity_percent);

/// Dew point of the room's air, degC, which is assumed if the chamber measures no humidity.
double assumed_dew_point_degc(const BenchConfig& config);

}  // namespace abcal
