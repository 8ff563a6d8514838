#pragma once

#include <Eigen/Core>
#include <array>

namespace abcal {

/// Errors of a stage at one angle. Every effect of the stage is a linear combination of these
/// (protocol/model/effects.h). Angles in radian, axes in the LGCS; all zero: a perfect stage.
enum StageInput : int {
  kInputZx,  ///< Horizontal components of the Z axis at rest.
  kInputZy,
  kInputXz,      ///< Vertical component of the X axis.
  kInputAngleX,  ///< Angle of the X axis beyond its command.
  kInputAngleZ,
  kInputTiltXy,  ///< Turn of all that X carries about LGCS y, applied after the turn about X.
  kInputTiltXz,
  kInputTiltZx,  ///< Turn of the platform about the stage's x, applied after the turn about Z.
  kInputTiltZy,
  kInputTiltXyAtZero,  ///< The four tilts at the pose (0, 0), where s is defined.
  kInputTiltXzAtZero,
  kInputTiltZxAtZero,
  kInputTiltZyAtZero,
  kInputForceX,  ///< Specific force in addition to gravity, along x, y, z of the platter, as for g (g_loc).
  kInputForceY,
  kInputForceZ,
  kStageInputs,
};
using StageInputs = Eigen::Matrix<double, kStageInputs, 1>;

/// Harmonics that the effects need: 1 to kHarmonics.
constexpr int kHarmonics = 6;

/// sin(m a), cos(m a), m = 0 .. kHarmonics, of a commanded angle.
struct AngleHarmonics {
  std::array<double, kHarmonics + 1> sin{}, cos{};
  static AngleHarmonics of(double sin_a, double cos_a);
};

/// One commanded pose of the three experiments.
struct StagePose {
  int experiment = 1;  ///< 1 and 2: X moves; 3: Z moves.
  /// 2: the axis at rest is turned by half a turn more than in face 1 (protocol/plan/faces.h).
  int face = 1;
  /// Commanded angles of the axes; an axis at rest has 0 or -90 degrees, in face 2 180 or 90 degrees.
  AngleHarmonics x, z;
  // Motion of the moving axis, unless the stage is at rest.
  double rate_radps = 0.0;
  double acceleration_radps2 = 0.0;
  double mean_rate_radps = 0.0;  ///< The mean over its sweep, by which the filter of the item acts.

  /// The axis that turns, along x, y, z of the platter as it lies at the pose (0, 0).
  Eigen::Vector3d axis_in_platter() const;
  static StagePose of(int experiment, int face, double sin_alpha, double cos_alpha);
  bool about_x() const { return experiment != 3; }
  const AngleHarmonics& moving() const { return about_x() ? x : z; }
};

/// Gravity's reaction in the frame of the platter, as it lies at the pose (0, 0), and its derivatives.
struct GravityAt {
  Eigen::Vector3d g;                                ///< 1
  Eigen::Matrix<double, 3, kStageInputs> by_input;  ///< 1, or 1/radian
};

/// GravityAt::g without the derivatives.
Eigen::Vector3d gravity_alone(const StagePose& pose, const StageInputs& inputs);

/// The stage at one pose: rotation about the real X axis, then about the Z axis that it carries, each with
/// its tilts. Exact in the axes and the angles; tilts to their second order (3e-10 at 1 mrad), derivatives to
/// the first.
GravityAt gravity_at(const StagePose& pose, const StageInputs& inputs);

}  // namespace abcal
