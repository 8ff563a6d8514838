#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <vector>

#include "drivers/instrument/angle.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal::sim {

/// One harmonic of a stage axis's error map (paper, Eq. 14): sin_coefficient * sin(order * theta)
/// + cos_coefficient * (cos(order * theta) - 1), so that the error is zero at the axis's zero.
struct ErrorHarmonic {
  int order = 1;
  Angle sin_coefficient;
  Angle cos_coefficient;

  bool operator==(const ErrorHarmonic&) const = default;
};

/// One harmonic of an axis's wobble: for the commanded angle a the platform is turned by
/// (cos_1 cos(order a) + sin_1 sin(order a)) about direction 1 and likewise about direction 2. Direction 1 is
/// perpendicular to the axis: horizontal for X, nearest to x for Z; direction 2 is the axis times
/// direction 1.
struct WobbleHarmonic {
  int order = 1;
  double cos_1_urad = 0.0, sin_1_urad = 0.0;
  double cos_2_urad = 0.0, sin_2_urad = 0.0;

  bool operator==(const WobbleHarmonic&) const = default;
};

/// True behaviour of one stage axis: actual angle = commanded angle + error(commanded angle). The error is a
/// map of the physical pose (commanded angle modulo 360 degrees) and zero at 0, where the axis has its zero.
struct AxisTruth {
  Angle mean_step_error;     ///< F_X or F_Z: added at every angle but 0 and -90 degrees.
  Angle initial_turn_error;  ///< The error at -90 degrees (d2 on Z, d3 on X), in place of all the others.
  Angle step_error_sd;       ///< Standard deviation of an error drawn once for each pose of both axes.
  std::vector<ErrorHarmonic> harmonics;  ///< Systematic part of the map.
  Angle smooth_error_sd;  ///< Standard deviation of each coefficient of six harmonics drawn from the seed.
  /// Standard deviation of an error drawn once for each angle of this axis, wherever the other one is.
  Angle fine_map_sd;
  // Parts that do not repeat, of which the seed draws others for each run (StageTruth::run).
  Angle step_repeatability_sd;    ///< Drawn for each pose of both axes but where the axis is at 0 degrees.
  Angle homing_repeatability_sd;  ///< Drawn once: moves all angles of the axis alike.
  /// Standard deviation of the change of each value of the fine map after one month; it grows with the root
  /// of StageTruth::age_months.
  Angle growth_sd;
  Angle knock_sd;  ///< Standard deviation of a change of each value of the fine map from knock_from_run on.
  std::vector<WobbleHarmonic> wobble;
  double wobble_sd_urad = 0.0;  ///< Standard deviation of each coefficient of three orders, from the seed.
  Angle backlash;               ///< Lag of the actual angle when a move ends in the negative direction.
  Angle travel_min = Angle::degrees(-360.0);
  Angle travel_max = Angle::degrees(360.0);
  double speed_deg_per_s = 20.0;
  double acceleration_deg_per_s2 = 80.0;
  /// 1: standard deviation of each coefficient of six harmonics of the rate while the axis turns; the encoder
  /// sees them.
  double rate_ripple = 0.0;
  Angle encoder_resolution = Angle::degrees(1e-4);

  bool operator==(const AxisTruth&) const = default;
};

/// True behaviour of the accelerometer and the room: the part of the truth that may change during a
/// simulation (SimBench::change). R is the response unit, g_loc the unit of acceleration.
struct OutputTruth {
  /// Rows u, v, w along the platter's x, y, z before the platter tilts with Z (docs/theory/model.md), in
  /// R/g_loc.
  Eigen::Matrix3d sensitivity_matrix = Eigen::Matrix3d::Identity();
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();           ///< R
  Eigen::Vector3d k2 = Eigen::Vector3d::Zero();               ///< 1/R: + k2 (l - O)^2, l the linear response.
  Eigen::Vector3d k3 = Eigen::Vector3d::Zero();               ///< 1/R^2: + k3 (l - O)^3.
  Eigen::Vector3d drift_per_hour = Eigen::Vector3d::Zero();   ///< R/h, zero at the start of the world's time.
  Eigen::Vector3d offset_per_degc = Eigen::Vector3d::Zero();  ///< R/degC, from the first temperature_degc on.

  // Beyond the published model (docs/effects.md). "Span" is StageTruth::span_s, t its time from -1/2 to 1/2.
  Eigen::Vector3d k4 = Eigen::Vector3d::Zero();  ///< 1/R^3: + k4 (l - O)^4.
  Eigen::Vector3d k5 = Eigen::Vector3d::Zero();  ///< 1/R^4: + k5 (l - O)^5.
  /// 1: + asymmetry |l - O|: the scale for + and for - differ by twice this.
  Eigen::Vector3d asymmetry = Eigen::Vector3d::Zero();
  /// 1: cross terms S (ab y_a y_b + ac y_a y_c + bc y_b y_c + bb y_b^2 + cc y_c^2), y = (l - O) / S, S the
  /// norm of the row; a is the output itself, b and c are the next two in the order u, v, w, u.
  Eigen::Vector3d cross_ab = Eigen::Vector3d::Zero(), cross_ac = Eigen::Vector3d::Zero(),
                  cross_bc = Eigen::Vector3d::Zero(), cross_bb = Eigen::Vector3d::Zero(),
                  cross_cc = Eigen::Vector3d::Zero();
  /// R: times the sign of the change of l over the last motion that changed it.
  Eigen::Vector3d hysteresis = Eigen::Vector3d::Zero();
  /// R: 0, or the hysteresis follows the response as play does, independent of the motions: it reverses
  /// gradually while the response changes by this much. For readings at rest; there is no hysteresis while an
  /// axis moves.
  double hysteresis_width = 0.0;
  /// R: times half the Legendre polynomials of 2t of order 1, 2, 3.
  Eigen::Vector3d drift_1 = Eigen::Vector3d::Zero(), drift_2 = Eigen::Vector3d::Zero(),
                  drift_3 = Eigen::Vector3d::Zero();
  Eigen::Vector3d exponential_drift = Eigen::Vector3d::Zero();  ///< R: times exp(-time / time constant).
  double exponential_drift_s = 600.0;
  Eigen::Vector3d sinusoidal_drift = Eigen::Vector3d::Zero();  ///< R, amplitude.
  double sinusoidal_drift_period_s = 3600.0;
  Angle sinusoidal_drift_phase;                                 ///< At the start of the world's time.
  Eigen::Vector3d sensitivity_drift = Eigen::Vector3d::Zero();  ///< 1 over the span, zero at its middle.
  Eigen::Vector3d gain_step = Eigen::Vector3d::Zero();          ///< 1: from gain_step_at_s on.
  double gain_step_at_s = 0.0;
  double random_walk = 0.0;          ///< R, standard deviation at the end of the span.
  double flicker_noise = 0.0;        ///< R, standard deviation of noise with a spectrum of 1/frequency.
  double correlated_noise = 0.0;     ///< R, standard deviation of noise with an exponential correlation.
  double correlated_noise_s = 60.0;  ///< Its correlation time.
  /// The mount turns by this about x, y, z of the platter, times 1 - exp(-time / time constant).
  Eigen::Vector3d mount_creep_urad = Eigen::Vector3d::Zero();
  double mount_creep_s = 1200.0;

  double noise = 0.0;         ///< R, standard deviation of one reading, white.
  double quantisation = 0.0;  ///< R, step of the output; 0: none.
  double full_scale = std::numeric_limits<double>::infinity();  ///< R, where the output clips.

  // Behaviour of the item where it turns.
  double low_pass_hz = 0.0;          ///< Corner of a low-pass behind all bends of the outputs; 0: none.
  int low_pass_order = 1;            ///< 1, or 2: two such filters, one behind the other.
  double group_delay_s = 0.0;        ///< Further delay of all outputs.
  double time_stamp_jitter_s = 0.0;  ///< Readings arrive late by this times |normal|.
  Eigen::Vector3d rate_offset = Eigen::Vector3d::Zero();  ///< R at 60 deg/s about either axis.
  /// Positions of the elements of u, v, w on the platter, mm: x, y from the Z axis, z from the X axis.
  Eigen::Vector3d position_u_mm = Eigen::Vector3d::Zero(), position_v_mm = Eigen::Vector3d::Zero(),
                  position_w_mm = Eigen::Vector3d::Zero();

  double ring_down_amplitude = 0.0;  ///< R per deg/s of the speed of the move that ended.
  double ring_down_frequency_hz = 25.0;
  double ring_down_decay_s = 0.05;  ///< Time constant.
  double temperature_degc = 23.0;
  double temperature_per_hour = 0.0;  ///< degC/h

  // Over the item's temperature, d degC from the first temperature_degc on (with offset_per_degc).
  Eigen::Vector3d offset_per_degc2 = Eigen::Vector3d::Zero(),
                  offset_per_degc3 = Eigen::Vector3d::Zero();  ///< R/degC^2, R/degC^3
  /// The sensitivity is multiplied by 1 + a d + b d^2 + c d^3.
  Eigen::Vector3d sensitivity_per_degc = Eigen::Vector3d::Zero(),
                  sensitivity_per_degc2 = Eigen::Vector3d::Zero(),
                  sensitivity_per_degc3 = Eigen::Vector3d::Zero();
  /// Half the width of the loop: added after warming, subtracted after cooling.
  Eigen::Vector3d offset_thermal_hysteresis = Eigen::Vector3d::Zero(),  ///< R
      sensitivity_thermal_hysteresis = Eigen::Vector3d::Zero();         ///< 1

  bool operator==(const OutputTruth&) const = default;
};

/// The simulated chamber and the item in it.
struct ChamberTruth {
  double air_lag_s = 180.0;             ///< Time constant of the air behind the set point.
  double item_lag_s = 600.0;            ///< Time constant of the item behind the air.
  double self_heating_degc = 0.0;       ///< Final excess of the item's temperature over the air.
  double dew_point_degc = -60.0;        ///< Dew point of the air inside: dry gas.
  double hysteresis_width_degc = 10.0;  ///< The loop of the thermal hysteresis closes within this.

  bool operator==(const ChamberTruth&) const = default;
};

/// The stage and its surroundings, which all items of a bench share. DrawnStage draws its random errors.
struct StageTruth {
  std::uint64_t seed = 1;  ///< Seed of the stage's errors; item_seed() derives those of the items from it.
  /// Number of the run on this stage. The noise, and all that the stage does not repeat, follow from the seed
  /// and from this number, all else from the seed alone.
  std::uint64_t run = 0;
  double age_months = 0.0;           ///< Time since the stage was as its seed draws it (growth_sd).
  std::uint64_t knock_from_run = 0;  ///< First run after a knock (knock_sd); 0: none.
  /// Standard deviation of the tilt of the base about x and about y of the LGCS, drawn once for each run.
  double floor_repeatability_urad = 0.0;
  ChamberTruth chamber;
  bool noise_seeded_by_angle = false;  ///< Noise restarts at each pose, so that a resumed run repeats it.

  double zx = 0.0, zy = 0.0;  ///< Horizontal components of the Z axis at rest.
  double xz = 0.0;            ///< Vertical component of the X axis.
  double zx_per_degc = 0.0;   ///< Change of zx with the temperature on the platter, from temperature_degc on.
  AxisTruth x, z;
  double axes_distance_mm = 0.0;   ///< From the X axis to the Z axis, along y where Z is at 0.
  double encoder_latency_s = 0.0;  ///< An encoder reports where its axis was this long ago,
  double encoder_jitter_s = 0.0;   ///< and further by this times |normal|.
  /// The axes also rest at 90 and at 180 degrees (protocol of two faces): there AxisTruth::step_error_sd is
  /// drawn once for the pose of the axis, independent of the other axis.
  bool stands_in_second_face = false;
  double span_s = 3600.0;  ///< Time of the effects that act "over the span", from the start on.
  /// Tilt of the base about x and y of the LGCS over the span, linear in time, zero at its middle.
  double floor_tilt_x_urad = 0.0, floor_tilt_y_urad = 0.0;
  /// Bending under the load of the platform: it turns by (direction of up) x sag, all in platter coordinates;
  /// the direction of sag is from where the axes cross to the load's centre of mass.
  Eigen::Vector3d sag_urad = Eigen::Vector3d::Zero();

  const AxisTruth& axis(StageAxis which) const { return which == StageAxis::kX ? x : z; }
  bool operator==(const StageTruth&) const = default;
};

/// One item on the stage, without the errors of the stage (StageTruth).
struct ItemTruth : OutputTruth {
  std::uint64_t seed = 1;  ///< Seed of its noise.
};

/// The seed of the noise of one of several items (counted from 1) on a stage.
constexpr std::uint64_t item_seed(std::uint64_t stage_seed, int item) {
  // Odd and far from any number that people choose: no item has the seed of another bench.
  constexpr std::uint64_t kBetweenItems = 0x9E3779B97F4A7C15;
  return stage_seed + static_cast<std::uint64_t>(item) * kBetweenItems;
}

/// The seed of what differs from run to run.
constexpr std::uint64_t seed_of_run(std::uint64_t seed, std::uint64_t run) {
  constexpr std::uint64_t kBetweenRuns = 0xD1B54A32D192ED03;  // As far from any number as kBetweenItems.
  return seed + run * kBetweenRuns;
}

/// The truth of a simulated bench with one item. A run never sees it.
struct BenchTruth : OutputTruth, StageTruth {};

}  // namespace abcal::sim
