#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "protocol/model/stage_model.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

// The one table of effects (docs/theory): what a real stage and a real item do beyond a perfect stage and a
// linear item. The joint and the norm fit estimate them, the type B of ABC, Monte Carlo and the budget take
// them from here. To add an effect is to add one entry (and its size to effect_sizes.h).

/// An unknown of the stage moves one input, and perhaps a second one: coefficients at one pose.
struct StageShare {
  int input = 0;
  double value = 0.0;
  int second_input = 0;
  double second_value = 0.0;
};

/// An effect of the stage: `count` unknowns, shared by all outputs.
struct StageEffect {
  std::string_view name;  ///< "wobble of X"
  std::string_view key;   ///< Of its size, in [stage_uncertainty].
  int count = 0;
  std::string_view unit;  ///< "1", "radian"
  /// Standard deviation of each unknown.
  double (*prior)(const EffectSizes&) = nullptr;
  /// What unknown i does at a pose.
  StageShare (*share)(const StagePose&, int i) = nullptr;
  std::string (*unknown_name)(int i) = nullptr;
};

/// The item at one pose. Responses are relative: y = s.g / S_j.
struct ItemPoint {
  double t = 0.0;     ///< -1/2 to 1/2 over the run.
  Eigen::Vector3d y;  ///< Relative linear responses of u, v, w.
  /// Sign of the change of y since the previous pose in time, for each output; 0 at the first pose.
  Eigen::Vector3d came_from = Eigen::Vector3d::Zero();
};

/// What an unknown adds to a reading, relative to S_j, and how that changes with the output's own y.
struct ItemShare {
  double value = 0.0;
  double by_y = 0.0;
};

/// What an unknown adds to the line response (the measurand): a relative change of the row, and an offset
/// relative to S_j.
struct LineShare {
  double scale = 0.0;
  double offset = 0.0;
};

/// An effect of the item: `count` unknowns for each output.
struct ItemEffect {
  std::string_view name;  ///< "drift"
  std::string_view key;   ///< Of its size, in [item_uncertainty].
  int count = 0;
  double (*prior)(const EffectSizes&) = nullptr;
  ItemShare (*share)(const ItemPoint&, int output, int i) = nullptr;
  /// @param rows  of the linear responses y: those of s, each relative to its S_j, near unit
  LineShare (*line)(const Eigen::Matrix3d& rows, int output, int i) = nullptr;
  std::string (*unknown_name)(int i) = nullptr;
};

/// Whether an effect of the item depends on the time in the run.
bool is_drift(const ItemEffect& effect);

std::span<const StageEffect> stage_effects();
std::span<const ItemEffect> item_effects();

/// One unknown of the table.
struct EffectColumn {
  const StageEffect* stage = nullptr;  ///< This, or `item`.
  const ItemEffect* item = nullptr;
  int index = 0;    ///< Among the effect's unknowns.
  int output = -1;  ///< Of an item's effect: 0, 1, 2.

  /// What it adds to the three readings at one pose, for each unit of it.
  /// @param by_input  derivatives of the readings by the inputs of the stage
  /// @param unit  S_j in the unit of the readings
  Eigen::Vector3d at(const StagePose& pose, const ItemPoint& point,
                     const Eigen::Matrix<double, 3, kStageInputs>& by_input,
                     const Eigen::Vector3d& unit) const;
};

/// Signs of the changes of the relative responses from one pose to the next (ItemPoint::came_from); 0 where
/// both are the same.
Eigen::Vector3d signs_of_change(const Eigen::Vector3d& before, const Eigen::Vector3d& now);

/// The white step error f_i(n): one unknown an angle, of the axis that moves.
double step_prior(const EffectSizes& sizes);
int moving_angle_input(int experiment);

}  // namespace abcal
