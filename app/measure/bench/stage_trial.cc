#include "app/measure/bench/stage_trial.h"

#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/state_folder.h"

namespace abcal {
namespace {

constexpr const char* kTrialSchema = "abcal.stage-trial/1";

/// Empty: the folder is not known.
std::filesystem::path trial_file(const std::string& sha256) {
  const std::filesystem::path folder = state_folder();
  return folder.empty() ? folder : folder / "stage-trials" / (sha256 + ".json");
}

}  // namespace

std::optional<StageTrial> find_stage_trial(const std::string& sha256) {
  const std::filesystem::path file = trial_file(sha256);
  std::error_code ignored;
  if (file.empty() || !std::filesystem::exists(file, ignored)) return std::nullopt;
  try {
    const auto json = nlohmann::json::parse(read_file(file));
    if (json.at("schema") != kTrialSchema || json.at("sha256") != sha256) return std::nullopt;
    return StageTrial{sha256, json.at("maker"), json.at("model"), json.at("serial_number"), json.at("utc")};
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;  // As if there were none: it is tried again.
  }
}

void keep_stage_trial(const StageTrial& trial) {
  const std::filesystem::path file = trial_file(trial.sha256);
  if (file.empty())
    throw std::runtime_error("the trial cannot be kept: neither HOME nor XDG_STATE_HOME is set");
  std::filesystem::create_directories(file.parent_path());
  const nlohmann::ordered_json json{{"schema", kTrialSchema},
                                    {"sha256", trial.sha256},
                                    {"maker", trial.maker},
                                    {"model", trial.model},
                                    {"serial_number", trial.serial_number},
                                    {"utc", trial.utc}};
  OutputFile(file).write(json.dump(2) + "\n");
}

}  // namespace abcal
