#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <vector>

#include "drivers/instrument/angle.h"

namespace abcal::sim {

/// One harmonic of a stage axis's error map (paper, Eq. 14): sin_coefficient * sin(order * theta)
/// + cos_coefficient * (cos(order * theta) - 1), so that the error is zero at the axis's zero.
struct ErrorHarmonic {
  int order = 1;
  Angle sin_coefficient;
  Angle cos_coefficient;
};

/// What one stage axis really does: actual angle = commanded angle + error(commanded angle). The error is a
/// map of the physical pose (commanded angle modulo 360 degrees) and zero at 0, where the axis has its zero.
struct AxisTruth {
  Angle mean_step_error;     ///< F_X or F_Z: added at every angle but 0 and -90 degrees.
  Angle initial_turn_error;  ///< The error at -90 degrees (d2 on Z, d3 on X), in place of all the others.
  Angle step_error_sd;       ///< Standard deviation of an error drawn once for each pose of both axes.
  std::vector<ErrorHarmonic> harmonics;  ///< Systematic part of the map.
  Angle backlash;  ///< Lag of the actual angle when a move ends in the negative direction.
  Angle travel_min = Angle::degrees(-360.0);
  Angle travel_max = Angle::degrees(360.0);
  double speed_deg_per_s = 20.0;
  double acceleration_deg_per_s2 = 80.0;
  Angle encoder_resolution = Angle::degrees(1e-4);
};

/// What the accelerometer and the room do: the part of the truth that may change while the world goes on
/// (SimBench::change). R is the response unit, g_loc the unit of acceleration.
struct OutputTruth {
  /// Rows u, v, w along the platter's x, y, z before the platter tilts with Z (docs/theory/model.md), in
  /// R/g_loc.
  Eigen::Matrix3d sensitivity_matrix = Eigen::Matrix3d::Identity();
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();           ///< R
  Eigen::Vector3d k2 = Eigen::Vector3d::Zero();               ///< 1/R: + k2 (l - O)^2, l the linear response.
  Eigen::Vector3d k3 = Eigen::Vector3d::Zero();               ///< 1/R^2: + k3 (l - O)^3.
  Eigen::Vector3d drift_per_hour = Eigen::Vector3d::Zero();   ///< R/h, zero at the start of the world's time.
  Eigen::Vector3d offset_per_degc = Eigen::Vector3d::Zero();  ///< R/degC, from the first temperature_degc on.
  double noise = 0.0;         ///< R, standard deviation of one reading, white.
  double quantisation = 0.0;  ///< R, step of the output; 0: none.
  double full_scale = std::numeric_limits<double>::infinity();  ///< R, where the output clips.

  double ring_down_amplitude = 0.0;  ///< R per deg/s of the speed of the move that ended.
  double ring_down_frequency_hz = 25.0;
  double ring_down_decay_s = 0.05;  ///< Time constant.
  double temperature_degc = 23.0;
  double temperature_per_hour = 0.0;  ///< degC/h
};

/// The truth of a simulated bench. A run never sees it.
struct BenchTruth : OutputTruth {
  std::uint64_t seed = 1;
  bool noise_seeded_by_angle = false;  ///< Noise restarts at each pose, so that a resumed run repeats it.

  // Stage.
  double zx = 0.0, zy = 0.0;  ///< Horizontal components of the Z axis at rest.
  double xz = 0.0;            ///< Vertical component of the X axis.
  AxisTruth x, z;
};

}  // namespace abcal::sim
