#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "protocol/record/run_record.h"

namespace abcal {

/// The result of `abcal level`, as it is stored (JSON, schema abcal.level/1).
struct LevelFile {
  std::string utc;
  std::string program_version;
  std::string stage_serial_number;
  MeasuredAlignment alignment;
  MeasuredValue delta_z;     ///< 1
  MeasuredValue x_zero_deg;  ///< degree
};

nlohmann::ordered_json level_json(const LevelFile& level);
void write_level_file(const std::filesystem::path& path, const LevelFile& level);

/// @throws std::invalid_argument naming the file and its problem
LevelFile read_level_file(const std::filesystem::path& path);

}  // namespace abcal
