#pragma once

#include "app/ground/bench_file/bench_config.h"
#include "app/ground/toml/toml_reader.h"

namespace abcal {

/// Reports every problem that needs more than one key of the bench file to be seen, and fills in what follows
/// from other keys (local gravity from latitude and height, the port of simulated instruments).
/// @param root  the file that `reader` reads
void check_together(TomlReader& reader, const toml::table& root, BenchConfig& config);

/// The simulated truth of an item does not fit the unit of its instrument: sensitivities in g/g_loc for one
/// that outputs m/s2, or the other way round. Matters where the accelerometer is simulated or emulated.
std::optional<Problem> simulated_unit_problem(const BenchItemConfig& item);

}  // namespace abcal
