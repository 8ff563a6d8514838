#pragma once

#include <string>

#include "app/bench_file/bench_records.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// The text of a bench file with steps, step_deg, dwell_readings and faces of `protocol`. Everything else,
/// comments included, stays unchanged.
/// @param source  for messages
/// @param lookup  as read_bench() has it
/// @throws std::runtime_error if the changed text would not read back as meant (a value over several lines,
/// or [protocol] as an inline table): it is then to be changed by hand
std::string with_protocol(const std::string& bench_toml, const ProtocolConfig& protocol,
                          const std::string& source, const RecordLookup& lookup = {});

}  // namespace abcal
