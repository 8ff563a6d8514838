#include "app/bench_file/level_file.h"

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>

namespace abcal {
namespace {

nlohmann::ordered_json json_of(const MeasuredValue& measured, const char* unit) {
  return {{"value", measured.value}, {"standard_uncertainty", measured.standard_uncertainty}, {"unit", unit}};
}

MeasuredValue value_of(const nlohmann::ordered_json& json) {
  MeasuredValue measured{json.at("value").get<double>(), json.at("standard_uncertainty").get<double>()};
  if (!std::isfinite(measured.value) || !(measured.standard_uncertainty > 0.0)) {
    throw std::invalid_argument("a value that is not finite, or an uncertainty that is not greater than 0");
  }
  return measured;
}

}  // namespace

nlohmann::ordered_json level_json(const LevelFile& level) {
  return {{"schema", "abcal.level/1"},
          {"utc", level.utc},
          {"program_version", level.program_version},
          {"stage_serial_number", level.stage_serial_number},
          {"zx", json_of(level.alignment.zx.value(), "1")},
          {"zy", json_of(level.alignment.zy.value(), "1")},
          {"xz", json_of(level.alignment.xz.value(), "1")},
          {"delta_z", json_of(level.delta_z, "1")},
          {"x_zero", json_of(level.x_zero_deg, "degree")}};
}

void write_level_file(const std::filesystem::path& path, const LevelFile& level) {
  std::ofstream file(path);
  file << level_json(level).dump(2) << '\n';
  file.flush();
  if (!file) throw std::runtime_error(path.string() + ": cannot be written");
}

LevelFile read_level_file(const std::filesystem::path& path) {
  std::ifstream file(path);
  if (!file)
    throw std::invalid_argument(path.string() + ": cannot be read; required: a file made by `abcal level`");
  try {
    const auto json = nlohmann::ordered_json::parse(file);
    if (json.at("schema") != "abcal.level/1") throw std::invalid_argument("its schema is not abcal.level/1");
    LevelFile level;
    level.utc = json.at("utc");
    level.program_version = json.at("program_version");
    level.stage_serial_number = json.at("stage_serial_number");
    level.alignment = {value_of(json.at("zx")), value_of(json.at("zy")), value_of(json.at("xz"))};
    level.delta_z = value_of(json.at("delta_z"));
    level.x_zero_deg = value_of(json.at("x_zero"));
    return level;
  } catch (const std::exception& error) {
    throw std::invalid_argument(path.string() + ": not a level file of `abcal level`: " + error.what());
  }
}

}  // namespace abcal
