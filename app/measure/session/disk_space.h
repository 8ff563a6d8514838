#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "protocol/plan/run_config.h"

namespace abcal {

/// Figures from which the disk space of a run is estimated before it begins.
struct DiskNeed {
  std::size_t angles = 0;       ///< Angles of the plan.
  int readings_per_angle = 0;   ///< Readings that are averaged.
  double duration_s = 0.0;      ///< Duration of the whole run.
  double rate_hz = 0.0;         ///< Readings per second.
  bool with_recording = false;  ///< Every byte of the instruments is stored too.
};

/// Bytes that the files of a run may take: the run file, its write-ahead log and the results.
std::uintmax_t estimated_run_bytes(const DiskNeed& need);

/// Compares the free space with the estimate for a run.
/// @param free_bytes  nullopt if unknown: the run is not refused
/// @return a warning if less than three times the estimate is free.
/// @throws std::runtime_error if less than the estimate is free; its text names found and required.
std::optional<Message> check_disk_space(const std::filesystem::path& run_file, const DiskNeed& need,
                                        std::optional<std::uintmax_t> free_bytes);

/// Free space for this user on the file system that holds the folder of a file; nullopt if it is unknown.
std::optional<std::uintmax_t> free_disk_space(const std::filesystem::path& file);

}  // namespace abcal
