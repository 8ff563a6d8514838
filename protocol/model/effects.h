#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "drivers/text/message.h"
#include "protocol/model/stage_model.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

// The one table of effects (docs/theory): the deviations of a real stage and a real item from a perfect stage
// and a linear item. The joint and the norm fit estimate them, the type B of ABC, Monte Carlo and the budget
// take them from here. A new effect is one new entry, and its size in
// protocol/plan/effect_sizes.

/// An unknown of the stage moves one input, and perhaps a second one: coefficients at one pose.
struct StageShare {
  int input = 0;
  double value = 0.0;
  int second_input = 0;
  double second_value = 0.0;
};

/// An effect of the stage: `count` unknowns, shared by all outputs.
struct StageEffect {
  Term name;             ///< "wobble of X"
  std::string_view key;  ///< Key of its size in [stage_uncertainty].
  int count = 0;
  std::string_view unit;  ///< "1", "radian"
  /// Standard deviation of each unknown.
  double (*prior)(const EffectSizes&) = nullptr;
  /// Effect of unknown i at a pose.
  StageShare (*share)(const StagePose&, int i) = nullptr;
  std::string (*unknown_name)(int i) = nullptr;
  int face = 1;            ///< 2: only a run of two faces has this effect.
  bool in_motion = false;  ///< Only a run at a constant rate has this effect.
};

/// The name of an effect as a message; that of another one is the same in every language.
Message effect_words(std::string_view effect);

/// "wobble of X, cos 1/rev, direction 2": the name of an unknown of the stage.
std::string unknown_name(const StageEffect& effect, int index);

/// The item at one pose. Responses are relative: y = s.g / S_j.
struct ItemPoint {
  double t = 0.0;     ///< -1/2 to 1/2 over the run.
  Eigen::Vector3d y;  ///< Relative linear responses of u, v, w.
  /// Sign of the change of y since the previous pose in time, for each output; 0 at the first pose.
  Eigen::Vector3d came_from = Eigen::Vector3d::Zero();

  // Where the stage turns.
  double rate_radps = 0.0;                             ///< Rate of the axis that moves.
  double mean_rate_radps = 0.0;                        ///< Its mean over the sweep.
  Eigen::Vector3d by_angle = Eigen::Vector3d::Zero();  ///< Derivatives of y by its angle, 1/radian.
  /// y less its mean over the turn; of a response that bends, with what the bends add to it
  /// (EffectModel::bent_point).
  Eigen::Vector3d swing = Eigen::Vector3d::Zero();
  /// Derivatives of the responses of u, v, w (rows) by the position of their elements, 1/m.
  Eigen::Matrix3d by_position = Eigen::Matrix3d::Zero();

  /// Completes a point during motion of the stage.
  /// @param rows  of the linear responses: those of s, each relative to its S_j
  void turn(const StagePose& pose, const Eigen::Matrix3d& rows, const GravityAt& gravity);
};

/// The rate at which the relative sizes of the effects of motion are stated, radian/s (60 degrees/s).
inline constexpr double kReferenceRate = 1.0471975511965976;

/// Contribution of an unknown to a reading, relative to S_j, and its derivatives by the output's own y and by
/// those of the next two in the order u, v, w, u.
struct ItemShare {
  double value = 0.0;
  double by_y = 0.0;
  double by_next = 0.0;
  double by_last = 0.0;
};

/// Contribution of an unknown to the line response (the measurand): a relative change of the row, and an
/// offset relative to S_j.
struct LineShare {
  double scale = 0.0;
  double offset = 0.0;
};

/// The option of a fit on which an effect of the item depends.
enum class ItemEffectKind {
  kDrift,      ///< It depends on the time in the run.
  kCurvature,  ///< The non-linearity that is a result itself: k2 and k3.
  kOther,      ///< None: it is in every fit.
};

/// An effect of the item: `count` unknowns for each output.
struct ItemEffect {
  Term name;             ///< "drift"
  std::string_view key;  ///< Key of its size in [item_uncertainty].
  ItemEffectKind kind = ItemEffectKind::kOther;
  int count = 0;
  double (*prior)(const EffectSizes&) = nullptr;
  ItemShare (*share)(const ItemPoint&, int output, int i) = nullptr;
  /// @param rows  of the linear responses y: those of s, each relative to its S_j, near unit
  LineShare (*line)(const Eigen::Matrix3d& rows, int output, int i) = nullptr;
  std::string (*unknown_name)(int i) = nullptr;
  bool in_motion = false;  ///< Only a run at a constant rate has this effect.
};

/// The course of an error of the angle around the circle that the encoder samples of one sweep leave unknown:
/// its mean; sine and cosine of the orders 1 to kHarmonics; and a slope, without those orders. All but the
/// mean have a mean square of 1 (sine and cosine: 1/2, times the root of 2).
inline constexpr int kSweepUnknowns = 2 + 2 * kHarmonics;
/// The parts of this course at one angle, and their derivatives by the angle: where the angle is wrong, so
/// are its rate and its acceleration.
struct SweepShares {
  std::array<double, kSweepUnknowns> value{};
  std::array<double, kSweepUnknowns> slope{};
  std::array<double, kSweepUnknowns> curvature{};
};
/// @param turned_rad  since the middle of the sweep, -pi to pi
SweepShares sweep_shares(double turned_rad);

/// Whether a fit with or without drift and non-linearity estimates an effect: a size of zero leaves it out.
bool is_fitted(const ItemEffect& effect, const EffectSizes& sizes, bool drift, bool nonlinearity);

std::span<const StageEffect> stage_effects();
std::span<const ItemEffect> item_effects();

/// Standard deviation of the rate at which an output drifts by the stated effects where it is largest in the
/// run, relative to S_j, for the duration of the run as the unit of time.
double largest_drift_rate(const EffectSizes& sizes);

/// One unknown of the table.
struct EffectColumn {
  const StageEffect* stage = nullptr;  ///< This, or `item`.
  const ItemEffect* item = nullptr;
  int index = 0;    ///< Index among the effect's unknowns.
  int output = -1;  ///< For an effect of the item: 0, 1, 2.

  /// Contribution to the three readings at one pose, per unit of the unknown.
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
