#include "app/measure/bench/kept_turns.h"

#include <fmt/format.h>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>

#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/state_folder.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr const char* kSchema = "abcal.stage-turns/1";

class KeptTurns final : public CountedTurns {
 public:
  void recall(const StageInfo& info) override {
    const std::filesystem::path folder = state_folder();
    if (folder.empty()) return;
    stage_ = fmt::format("{} {} {}", info.maker, info.model, info.serial_number);
    file_ = folder / "stage-turns" / (sha256_of(stage_).substr(0, 16) + ".json");
    std::error_code ignored;
    if (!std::filesystem::exists(file_, ignored)) return;
    try {
      const auto json = nlohmann::json::parse(read_file(file_));
      if (json.at("schema") != kSchema || json.at("stage") != stage_)
        throw std::invalid_argument("it is of another stage");
      for (const StageAxis axis : kStageAxes) {
        const auto& kept = json.at("controller_deg").at(index(axis));
        if (!kept.is_null()) targets_[index(axis)] = Angle::degrees(kept.get<double>());
      }
    } catch (const std::exception& error) {
      throw std::runtime_error(
          fmt::format("{}: keeps how far the cables of the stage {} are wound, and cannot be read ({}); "
                      "required: see that "
                      "they are not wound, then {}",
                      file_.string(), stage_, error.what(), remedy()));
    }
  }
  std::string remedy() const override {
    return file_.empty() ? CountedTurns::remedy() : "remove the file " + file_.string();
  }

 private:
  void keep() override {
    if (file_.empty()) return;
    nlohmann::ordered_json angles = nlohmann::ordered_json::array();
    for (const auto& target : targets_)
      angles.push_back(target ? nlohmann::ordered_json(target->deg()) : nlohmann::ordered_json());
    std::filesystem::create_directories(file_.parent_path());
    OutputFile(file_).write(
        nlohmann::ordered_json{{"schema", kSchema}, {"stage", stage_}, {"controller_deg", angles}}.dump() +
        "\n");
  }

  std::string stage_;
  std::filesystem::path file_;  ///< Empty: nothing is kept.
};

}  // namespace

std::shared_ptr<CountedTurns> make_kept_turns() {
  return std::make_shared<KeptTurns>();
}

}  // namespace abcal
