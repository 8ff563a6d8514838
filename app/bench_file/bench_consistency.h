#pragma once

#include "app/bench_file/bench_config.h"
#include "app/formats/toml_reader.h"

namespace abcal {

/// Reports every problem that only several keys of the bench file together show, and fills in the values that
/// follow from other keys (local gravity from latitude and height, the port of simulated instruments).
/// @param root  the file that `reader` reads
void check_together(TomlReader& reader, const toml::table& root, BenchConfig& config);

/// The problem of a simulated truth that does not fit the unit of its instrument: sensitivities in g/g_loc
/// for an output in m/s2, or vice versa; absent: it fits. For simulated and emulated accelerometers only.
std::optional<Problem> simulated_unit_problem(const BenchItemConfig& item);

}  // namespace abcal
