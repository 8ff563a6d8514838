#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "sim/axis_motion.h"
#include "sim/bench_truth.h"
#include "sim/body_motion.h"
#include "sim/drawn_stage.h"
#include "sim/fault_kinds.h"
#include "sim/slow_noise.h"
#include "sim/thermal_world.h"

namespace abcal::sim {

/// True properties that do not depend on the mounting of the accelerometer (docs/theory/model.md).
struct TrueIntrinsicProperties {
  Eigen::Vector3d sensitivity;  ///< Norms of the rows u, v, w, in R/g_loc.
  std::array<Angle, 3> angle;   ///< phi_uv, phi_vw, phi_wu.
  Eigen::Vector3d offset;       ///< R
};

/// The least-squares linear function through the noise-free outputs over all directions of gravity
/// (docs/effects.md): the measurand of a calibration.
struct TrueLineResponse {
  Eigen::Matrix3d
      sensitivity_matrix;  ///< Rows u, v, w along x, y, z of the LGCS, default orientation; R/g_loc.
  Eigen::Vector3d offset;  ///< R
};

/// One output of the simulated accelerometer.
struct SimOutput {
  Eigen::Vector3d value = Eigen::Vector3d::Zero();  ///< u, v, w in R, quantised and clipped.
  std::array<bool, 3> clipped{};                    ///< u, v, w.
  double temperature_degc = 0.0;
};

/// One world, shared by the simulated stage and the simulated accelerometer, so that a turn of the stage
/// changes the readings of the accelerometer. Angles are the protocol's: right-handed about X and Z, zero at
/// the default orientation.
///
/// Everything is a function of time and of the moves commanded so far: a query changes nothing, and may be
/// about the past (the last 4096 moves are kept). Results depend on the pose, the time and the sample
/// index, never on the order of calls; the only history a pose has is backlash and hysteresis. Moves must be
/// commanded in order of time.
///
/// Physics: docs/theory/model.md, docs/effects.md. DrawnStage has the stage's geometry and errors. Eigen
/// turns the vectors; no formula of the analysis is used here. Safe to use from several threads.
class SimBench {
 public:
  /// `start` is the zero of the world's time (drift, temperature).
  /// @throws std::invalid_argument if the truth has a number that cannot be.
  explicit SimBench(const BenchTruth& truth, Clock::Instant start = Clock::Instant{});
  SimBench(const ItemTruth& item, const StageTruth& stage, Clock::Instant start);

  /// The world of another item on the same stage. From now on it receives all commands to the stage and the
  /// chamber of this one; faults and changes are its own.
  /// @throws std::invalid_argument if the truth has a number that cannot be.
  std::shared_ptr<SimBench> add_item(ItemTruth item);

  const StageTruth& stage() const { return stage_.truth(); }
  const ItemTruth& item() const { return item_; }  ///< As at the start of the world's time.
  Clock::Instant start() const { return start_; }

  // The stage.

  /// Commands a move at `t`; it may replace one under way. The controller limits the travel, not the
  /// world.
  /// @throws std::invalid_argument if the target is not finite or `t` is before the last command.
  void move(StageAxis axis, Angle target, Clock::Instant t);
  /// Places an axis at rest at `angle` from `t` on, without a motion: follows a real stage (FollowedStage).
  /// @throws std::invalid_argument if the angle is not finite or `t` is before the last command.
  void place(StageAxis axis, Angle angle, Clock::Instant t);
  /// Decelerates to rest.
  void halt(StageAxis axis, Clock::Instant t);
  /// Speed and accelerations of the moves from now on; initially those of the truth.
  void set_motion_limits(StageAxis axis, const MotionLimits& limits);
  MotionLimits motion_limits(StageAxis axis) const;

  bool moving(StageAxis axis, Clock::Instant t) const;
  /// When the motion under way at `t` ends (Instant::max() if it has stalled), or when the last one ended.
  Clock::Instant motion_end(StageAxis axis, Clock::Instant t) const;
  Angle target(StageAxis axis, Clock::Instant t) const;
  /// The commanded coordinate, exact.
  Angle commanded_angle(StageAxis axis, Clock::Instant t) const;
  /// commanded_angle() to the encoder's resolution. The encoder does not see the stage's errors.
  Angle encoder_angle(StageAxis axis, Clock::Instant t) const;
  /// The true angle: commanded angle + error (+ backlash).
  Angle actual_angle(StageAxis axis, Clock::Instant t) const;
  /// The error of an axis at rest, without backlash (DrawnStage::error).
  Angle stage_error(StageAxis axis, Angle commanded, Angle other_commanded) const;

  // The accelerometer.

  /// In g_loc, along the platter's x, y, z; at rest, aligned: (0, 0, +1) (reaction, up).
  Eigen::Vector3d specific_force(Clock::Instant t) const;
  /// The output made at `t`. Its noise is a function of the seed and of `sample_index`; with
  /// noise_seeded_by_angle of the pose and of the number of samples since the arrival, counted with
  /// `sample_period`.
  /// @throws std::invalid_argument if noise_seeded_by_angle and sample_period is not positive.
  SimOutput output(Clock::Instant t, std::uint64_t sample_index,
                   Clock::Duration sample_period = Clock::Duration::zero()) const;
  double temperature_degc(Clock::Instant t) const;

  // The chamber, if the bench has one. Until its first command the item has the temperature of the truth;
  // from then on that of the chamber.

  void command_chamber(const ChamberCommand& command, Clock::Instant t);
  bool chamber_in_use() const;  ///< It has received a command.
  ChamberCommand commanded_chamber() const;
  double chamber_set_point(Clock::Instant t) const;
  double chamber_air(Clock::Instant t) const;
  double chamber_humidity_percent(Clock::Instant t) const;

  /// The instrument's body, for sensors other than its accelerometer. Exact: without errors, bias and noise
  /// of its own; the earth does not turn. Wobble, sag and the tilt of the floor are in the attitude, and not
  /// in the rate.
  BodyMotion body_motion(Clock::Instant t) const;

  /// Changes the accelerometer and the room to `truth` from `at` on: a mounting slip, a jump of the
  /// temperature, vibration. The time of drift and temperature still counts from the start, and
  /// offset_per_degc from the first temperature.
  /// @throws std::invalid_argument if a number cannot be, or if `at` is before the last change.
  void change(const OutputTruth& truth, Clock::Instant at);
  OutputTruth output_truth(Clock::Instant t) const;  ///< The one in force at `t`.

  // Reference values for results: the truth at the start.

  /// Rows u, v, w along x, y, z of the LGCS at the default orientation, already tilted: RRF(s_j, E, Theta_E);
  /// R/g_loc.
  Eigen::Matrix3d true_sensitivity_matrix() const;
  TrueIntrinsicProperties true_intrinsic_properties() const;
  /// With drift, creep, tilt, slow noise and non-linearity as they are at `t`; without hysteresis. The
  /// default orientation is the true pose (0, 0), wobble and sag included. White noise is left out.
  TrueLineResponse true_line_response(Clock::Instant t) const;

  // Faults.

  /// @throws std::invalid_argument if it is a fault of the wire.
  void inject(const WorldFault& fault);
  /// Ends all faults in force at `t` and removes later ones.
  void clear_faults(Clock::Instant t);
  std::vector<WorldFault> faults_at(Clock::Instant t) const;  ///< In force at `t`.
  /// The fault of this kind in force at `t`, if any (stage faults: of this axis).
  std::optional<WorldFault> fault_at(FaultKind kind, Clock::Instant t, StageAxis axis = StageAxis::kX) const;

 private:
  /// The stage that all items share, and its temperature: that of the first item.
  struct Platter {
    std::shared_ptr<const DrawnStage> stage;
    double temperature_degc = 23.0;     ///< At the start.
    double temperature_per_hour = 0.0;  ///< Without a chamber.
  };
  SimBench(ItemTruth item, Platter platter, Clock::Instant start);

  static constexpr int kPlays = 4;
  using Plays = Eigen::Array<double, 3, kPlays>;  ///< Positions of the plays of u, v, w (R).

  struct Epoch {  ///< The time from one command to the next.
    Clock::Instant start;
    Clock::Instant settled;  ///< When both axes have arrived, as planned.
    std::array<AxisMotion, 2> motion;
    std::array<double, 2> error_from_deg{};  ///< At `start`; the error changes evenly until `settled`.
    std::array<double, 2> error_to_deg{};
    std::array<bool, 2> backlash{};       ///< The last move of the axis ended in the negative direction.
    std::array<std::uint64_t, 2> pose{};  ///< Canonical targets.
    Eigen::Vector3d force_before = Eigen::Vector3d::Zero();  ///< At rest, before the motion; zero: none yet.
    mutable std::optional<Eigen::Vector3d> force_at_rest{};
    std::optional<Plays> plays{};  ///< At `start`.
    mutable std::optional<Plays> plays_at_rest{};
  };

  const Epoch& epoch_at(Clock::Instant t) const;
  const OutputTruth& truth_at(Clock::Instant t) const;
  void command(StageAxis axis, AxisMotion motion, Clock::Instant t);
  double position_deg(const Epoch& epoch, std::size_t axis, Clock::Instant t) const;
  Eigen::Matrix3d forces_by_turning(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d linear_response(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d bent_response(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d filtered_response(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d direction_at(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d filtered_direction(const OutputTruth& truth, Clock::Instant t) const;
  Plays plays_at(const OutputTruth& truth, const Epoch& epoch, Clock::Instant t) const;
  Eigen::Array3d hysteresis_at(const OutputTruth& truth, const Epoch& epoch, Clock::Instant t) const;
  double rate_over_reference(const Epoch& epoch, Clock::Instant t) const;
  double error_deg(const Epoch& epoch, std::size_t axis, Clock::Instant t) const;
  double shift_deg(FaultKind kind, std::size_t axis, Clock::Instant t) const;
  Eigen::Vector3d force(const Epoch& epoch, Clock::Instant t) const;
  struct Turn {  ///< Angles of both axes, rad.
    std::array<double, 2> actual{};
    std::array<double, 2> commanded{};
  };
  Turn turn_at(const Epoch& epoch, Clock::Instant t) const;
  Eigen::Vector3d axis_z(Clock::Instant t) const;
  Eigen::Matrix3d floor_tilt(Clock::Instant t) const;
  Eigen::Vector3d up_in_base(Clock::Instant t) const;
  double span_time(Clock::Instant t) const;
  double item_temperature(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d thermal_gain(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d thermal_offset(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d gain(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d slow_offset(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Matrix3d mounted_matrix(const OutputTruth& truth, Clock::Instant t) const;
  Eigen::Array3d bend(const OutputTruth& truth, const Eigen::Array3d& linear) const;
  const WorldFault* find_fault(FaultKind kind, Clock::Instant t, StageAxis axis) const;
  SimOutput output_without_faults(const Epoch& epoch, Clock::Instant t, std::uint64_t sample_index,
                                  Clock::Duration sample_period) const;

  std::vector<std::shared_ptr<SimBench>> followers() const;

  ItemTruth item_;
  Platter platter_;
  const DrawnStage& stage_;  ///< platter_.stage
  std::vector<std::shared_ptr<SimBench>> followers_;
  Clock::Instant start_;
  ThermalWorld thermal_, platter_thermal_;
  mutable MarkovNoise random_walk_, correlated_;
  FlickerNoise flicker_;
  std::array<MotionLimits, 2> limits_;
  std::deque<Epoch> epochs_;
  std::vector<WorldFault> faults_;
  struct Change {
    Clock::Instant at;
    OutputTruth truth;
  };
  std::vector<Change> changes_;  ///< In order of time.
  mutable std::mutex mutex_;
};

}  // namespace abcal::sim
