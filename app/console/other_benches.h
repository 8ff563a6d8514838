#pragma once

#include <chrono>
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <vector>

namespace abcal::console {

/// Asks the processes that hold benches (BenchService) with a socket in these folders for their state, and
/// steers nothing. Each bench has `bench` (its name), `folder`, `state` ("answers", "silent",
/// "not running"), and where it answers `activity`, `phase`, `item`, `file`, `simulated`, `progress`, `fault`
/// and `ended`, as in a snapshot.
/// @param patience  for each bench
nlohmann::ordered_json other_benches(const std::vector<std::filesystem::path>& folders,
                                     std::chrono::milliseconds patience);

}  // namespace abcal::console
