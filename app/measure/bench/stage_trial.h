#pragma once

#include <map>
#include <string>
#include <vector>

namespace abcal {

/// A trial of a description that was passed on a real port: with which text and with which stage.
struct StageTrial {
  std::string sha256;
  std::string maker, model, serial_number;
  std::string utc{};
  /// By the name of an axis, where the description leaves the scale to the bench file.
  std::map<std::string, double> units_per_degree{};

  /// In words: "RT RT-2 00412".
  std::string stage() const { return maker + " " + model + " " + serial_number; }
};

/// The trials with this text, in the folder of this user's logs: one for each stage.
std::vector<StageTrial> find_stage_trials(const std::string& sha256);
/// @throws std::runtime_error if it cannot be kept
void keep_stage_trial(const StageTrial& trial);

}  // namespace abcal
