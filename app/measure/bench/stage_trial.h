#pragma once

#include <optional>
#include <string>

namespace abcal {

/// A trial of a description that was passed on a real port: with which text and with which stage.
struct StageTrial {
  std::string sha256;
  std::string maker, model, serial_number;
  std::string utc;
};

/// The trial with this text that was kept last in the folder of this user's logs; nothing if there is none.
std::optional<StageTrial> find_stage_trial(const std::string& sha256);
/// @throws std::runtime_error if it cannot be kept
void keep_stage_trial(const StageTrial& trial);

}  // namespace abcal
