#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <map>
#include <string>

#include "abcal/record.h"

namespace abcal::v1 {
/// Errors of a stage of the published model. Angles in degrees.
struct StageErrors {
  double zx = 0.0, zy = 0.0;        ///< Horizontal components of the Z axis at rest (1).
  double xz = 0.0;                  ///< Vertical component of the X axis (1).
  double initial_turn_z_deg = 0.0;  ///< d2: error of the turn of Z before experiment 2.
  double initial_turn_x_deg = 0.0;  ///< d3: error of the turn of X before experiment 3.
  double mean_step_x_deg = 0.0;     ///< F_X
  double mean_step_z_deg = 0.0;     ///< F_Z
};

/// A triaxial accelerometer; j-th elements belong to u, v, w.
struct Item {
  Eigen::Matrix3d sensitivity_matrix = Eigen::Matrix3d::Identity();  ///< R/g_loc, rows u v w, columns x y z.
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();                  ///< R
  Eigen::Vector3d k2 = Eigen::Vector3d::Zero();                      ///< 1/R
  Eigen::Vector3d k3 = Eigen::Vector3d::Zero();                      ///< 1/R^2
};

/// Forward model: specific force at rest (g_loc) along the accelerometer's axes x, y, z, at the desired
/// angle of an experiment. @throws std::invalid_argument for an experiment other than 1, 2, 3
Eigen::Vector3d specific_force(int experiment, double alpha_deg, const StageErrors& errors = {});

/// Response (R) to a specific force (g_loc): l + k2 (l - O)^2 + k3 (l - O)^3, l = s . g + O.
Eigen::Vector3d response(const Item& item, const Eigen::Vector3d& specific_force_gloc);

/// A run in a simulated world: the published stage errors, and errors beyond them. Every size is the truth's,
/// not a stated uncertainty.
struct SimulatedWorld {
  Item item;
  StageErrors stage;
  double wobble_urad =
      0.0;  ///< Standard deviation of each coefficient of the axes' wobble, drawn from the seed.
  double step_deg = 0.0;         ///< Standard deviation of each step error, drawn from the seed.
  double smooth_step_deg = 0.0;  ///< Standard deviation of each coefficient of the smooth step errors.
  Eigen::Vector3d hysteresis = Eigen::Vector3d::Zero();  ///< R
  Eigen::Vector3d drift = Eigen::Vector3d::Zero();       ///< R over the run, linear.
  double noise = 1e-5;                                   ///< R, of a mean; stated with the readings.
  int steps = 72;                                        ///< Angles of each experiment.
  double angle_period_s = 12.0;                          ///< From one angle to the next.
  std::uint64_t seed = 1;
  std::string response_unit = "R";
  std::map<std::string, double> effects;  ///< Stated sizes, as RecordSettings::effects.
};

/// A simulated record, and the true values that a calibration should find.
struct SimulatedRecord {
  Record record;
  Eigen::Matrix3d true_sensitivity_matrix;  ///< Matrix of the line response, in the LGCS; R/g_loc.
  Eigen::Vector3d true_offset;              ///< R
};

/// @throws std::invalid_argument for a number that cannot be
SimulatedRecord simulate(const SimulatedWorld& world);

}  // namespace abcal::v1
