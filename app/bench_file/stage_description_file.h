#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/stage_description.h"
#include "protocol/plan/run_config.h"

namespace abcal {

struct StageConfig;

/// A description that is built into the program.
struct ShippedDescription {
  std::string_view name;  ///< As bench files name it.
  std::string_view text;
};
const std::vector<ShippedDescription>& shipped_descriptions();

/// Reads a description of a stage (schema abcal.stage/1, docs/drivers/described.md) and checks all that can
/// be checked without the stage. Every problem is added to the problems; the description is then incomplete.
/// @param source  names it in messages
StageDescription parse_stage_description(std::string_view text, const std::string& source,
                                         std::vector<Problem>& problems);

/// The text of a shipped description, or of a file.
std::string stage_description_text(const std::string& name_or_path, std::vector<Problem>& problems);

/// The description of a stage with the driver `described`: its kept text, or else the one that it names.
/// @throws std::invalid_argument with all its problems
StageDescription stage_description_of(const StageConfig& stage);

}  // namespace abcal
