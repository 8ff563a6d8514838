#include "app/measure/bench/stage_trial.h"

#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/state_folder.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr const char* kTrialSchema = "abcal.stage-trial/1";

/// Empty: it is not known.
std::filesystem::path folder_of(const std::string& sha256) {
  const std::filesystem::path folder = state_folder();
  return folder.empty() ? folder : folder / "stage-trials" / sha256;
}

}  // namespace

std::vector<StageTrial> find_stage_trials(const std::string& sha256) {
  std::vector<StageTrial> trials;
  const std::filesystem::path folder = folder_of(sha256);
  std::error_code ignored;
  if (folder.empty() || !std::filesystem::is_directory(folder, ignored)) return trials;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    try {
      const auto json = nlohmann::json::parse(read_file(entry.path()));
      if (json.at("schema") != kTrialSchema || json.at("sha256") != sha256) continue;
      trials.push_back({sha256, json.at("maker"), json.at("model"), json.at("serial_number"), json.at("utc"),
                        json.value("units_per_degree", std::map<std::string, double>{})});
    } catch (const nlohmann::json::exception&) {  // As if there were none: it is tried again.
    }
  }
  return trials;
}

void keep_stage_trial(const StageTrial& trial) {
  const std::filesystem::path folder = folder_of(trial.sha256);
  if (folder.empty())
    throw std::runtime_error("the trial cannot be kept: neither HOME nor XDG_STATE_HOME is set");
  std::filesystem::create_directories(folder);
  const nlohmann::ordered_json json{{"schema", kTrialSchema},
                                    {"sha256", trial.sha256},
                                    {"maker", trial.maker},
                                    {"model", trial.model},
                                    {"serial_number", trial.serial_number},
                                    {"utc", trial.utc},
                                    {"units_per_degree", trial.units_per_degree}};
  OutputFile(folder / (sha256_of(trial.stage()).substr(0, 16) + ".json")).write(json.dump(2) + "\n");
}

}  // namespace abcal
