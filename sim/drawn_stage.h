#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "drivers/instrument/angle.h"
#include "drivers/instrument/rotation_stage.h"
#include "sim/bench_truth.h"

namespace abcal::sim {

/// The target of an axis as an integer, so that one pose reached by different sums is the same pose.
std::uint64_t canonical_pose(Angle angle);

/// Radians of an angle in degrees that is reduced first, so that whole turns cost no digits.
double reduced_rad(double deg);

/// The rotation about the direction of a vector by its norm, rad.
Eigen::Matrix3d turned_by(const Eigen::Vector3d& rotation_vector);

/// The geometry of the stage with its random errors drawn from the seed. It is made once for a bench and
/// shared by all items, so that all of them are on the same stage. Immutable.
///
/// The platter's orientation is Rot(X, thetaX) Rot(Z, thetaZ), each followed by the wobble of its axis,
/// applied to its orientation at rest, tilted with Z; then it bends under its load.
class DrawnStage {
 public:
  /// @throws std::invalid_argument if the truth has a number that cannot be.
  explicit DrawnStage(StageTruth truth);

  const StageTruth& truth() const { return truth_; }

  // In the LGCS, all axes at zero.
  const Eigen::Vector3d& axis_x() const { return axis_x_; }  ///< Unit vector.
  const Eigen::Vector3d& axis_z() const { return axis_z_; }  ///< Unit vector.
  const Eigen::Matrix3d& platter_at_rest() const {
    return R_LP_rest_;
  }  ///< Platter to LGCS: the tilt with Z.

  /// The error of an axis at rest, without backlash (bench_truth.h, AxisTruth); keyed by the seed and the
  /// angles of both axes to a millionth of a degree, modulo 360 degrees.
  Angle error(StageAxis axis, Angle commanded, Angle other_commanded) const;

  /// The error of an axis while it turns, with the other at a pose: between those of whole degrees.
  double error_on_the_way_deg(StageAxis axis, double position_deg, Angle other_commanded) const;

  /// How far an axis that turns at a constant rate is ahead of its mean motion, in degrees.
  /// @param direction  1 or -1
  double ripple_deg(StageAxis axis, double position_deg, int direction) const;

  /// Tilt of the base about x, y, z of the LGCS in this run, without its change over the span, rad.
  const Eigen::Vector3d& floor_of_run() const { return floor_of_run_; }

  /// Platter to base, of X and Z turned by these angles.
  /// @param axis_z  where the Z axis points by now: axis_z(), or turned by the temperature
  Eigen::Matrix3d orientation(const std::array<double, 2>& actual_rad,
                              const std::array<double, 2>& commanded_rad,
                              const Eigen::Vector3d& axis_z) const;

 private:
  Eigen::Matrix3d wobble(std::size_t axis, double turn_rad) const;
  /// The error of an axis at an angle wherever the other axis is, other than its harmonics.
  double fine_map_deg(std::size_t axis, std::uint64_t pose) const;

  StageTruth truth_;
  Eigen::Vector3d axis_x_, axis_z_;
  Eigen::Matrix3d R_LP_rest_;
  Eigen::Vector3d floor_of_run_ = Eigen::Vector3d::Zero();
  std::array<Angle, 2> homing_;                          ///< Drawn for the run.
  std::array<std::vector<ErrorHarmonic>, 2> harmonics_;  ///< Given and drawn.
  std::array<std::vector<WobbleHarmonic>, 2> wobble_;    ///< Given and drawn.
  /// By axis; of turning up and of turning down.
  std::array<std::array<std::vector<ErrorHarmonic>, 2>, 2> ripple_;
};

}  // namespace abcal::sim
