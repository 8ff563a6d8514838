#pragma once

#include "app/bench/bench_config.h"
#include "app/toml/toml_reader.h"

namespace abcal {

/// Reports every problem that needs more than one key of the bench file to be seen, and fills in what follows
/// from other keys (local gravity from latitude and height, the port of simulated instruments).
/// @param root  the file that `reader` reads
void check_together(TomlReader& reader, const toml::table& root, BenchConfig& config);

/// The [simulation] does not fit the unit in which the instrument speaks: sensitivities in g/g_loc for one
/// that outputs m/s2, or the other way round. Matters where the accelerometer is simulated or emulated.
std::optional<Problem> simulated_unit_problem(const BenchConfig& config);

}  // namespace abcal
