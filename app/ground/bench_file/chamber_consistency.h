#pragma once

#include <vector>

#include "app/ground/bench_file/bench_config.h"
#include "drivers/instrument/thermal_chamber.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// What is wrong with [chamber] and [temperature] as far as the file itself shows it; `where` is a path such
/// as "temperature.soak_max_s".
std::vector<Problem> chamber_problems(const BenchConfig& config);

/// What the chamber that answers cannot do of the series: to be known before anything heats.
std::vector<Problem> chamber_problems(const BenchConfig& config, const ChamberInfo& chamber);

/// Dew point of air, degC (Magnus, over water).
double dew_point_degc(double air_degc, double humidity_percent);

/// Where the chamber measures no humidity: the dew point that is reckoned with, of the room's air.
double assumed_dew_point_degc(const BenchConfig& config);

}  // namespace abcal
