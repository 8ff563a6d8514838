#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "app/bench_file/bench_config.h"
#include "app/formats/record_lookup.h"

namespace abcal {

/// Reads a bench file that may name records of the laboratory as sources (`{ from = "RECORD" }`). The
/// configuration then holds their values and sources, so that nothing is looked up again.
/// @throws BenchError also for a record that is missing, does not hold today, or lacks the value
BenchConfig read_bench(const std::filesystem::path& path, const RecordLookup& lookup);

/// As above, from text; `source` names it in messages.
BenchConfig parse_bench(std::string_view toml, const std::string& source, const RecordLookup& lookup);

}  // namespace abcal
