#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/results/planner/wanted.h"
#include "protocol/estimators/joint/planned_fit.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/uncertainty/budget.h"

namespace abcal {

/// Rows of length 1, turned from the stage's axes by 0.3 to 0.6 degrees, as items and mounts usually are. An
/// item that stands straight to the bit would be the worst case: the sign of its hysteresis is unknown
/// wherever an output is along the axis that turns.
Eigen::Matrix3d usual_directions();

/// The item as far as it is known before the run; by default one of the usual directions, without offset. All
/// values are relative to the sensitivity of each output (1, that is g_loc).
struct KnownItem {
  double noise = 0.0;                                       ///< Standard deviation of one reading, white.
  Eigen::Matrix3d sensitivity_matrix = usual_directions();  ///< Rows of length 1: angles and mounting.
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
};

/// Knowledge before the first angle.
struct PlanningBench {
  BenchConfig config;
  std::array<AxisTravel, 2> travel;
  std::array<AxisSpeed, 2> speed;
  KnownItem item;
  /// The record of the stage that a run would use, taken about a stage without errors.
  StageRecordInUse stage_record = {};
};

/// The circles of a run and the angles of each: "3 x 72"; in two faces "6 x 36"; at a constant rate "3 x 2
/// sweeps".
std::string circles_and_angles(const ProtocolConfig& protocol);

/// The largest contribution to an uncertainty.
struct LargestPart {
  Message name;        ///< Name in the budget: "noise of the readings", "wobble of X".
  double share = 0.0;  ///< Share of the variance, 0 to 1.
};

/// A plan, how long it takes, and the standard uncertainties that its result will state.
struct PlanPrediction {
  ProtocolConfig protocol;
  PlanDuration duration;
  PlannedValues u{};                                ///< The worst output of each group.
  std::array<LargestPart, kPlannedOutputs> limits;  ///< Largest contribution to that output.
};

/// The plans with one set of circles, whatever their dwells; at a constant rate that is a single plan.
class PlannedCircles {
 public:
  /// @param bench  must outlive this
  /// @param protocol  the dwells are not read
  /// @throws PlanError if the stage cannot reach an angle
  PlannedCircles(const PlanningBench& bench, const ProtocolConfig& protocol);

  /// The angles are measured in dwells, whose length is to be chosen. At a constant rate it is not: the
  /// numbers of readings below have no effect.
  bool has_dwells() const { return !protocol_.is_constant_rate(); }
  int faces() const { return protocol_.faces; }
  /// @param readings  [protocol] dwell_readings
  ProtocolConfig protocol(int readings) const;
  PlanDuration duration(int readings) const;
  /// The standard uncertainties by Fisher information (PlannedFit), in about a millisecond; those of the ABC
  /// estimator, and of others than the joint one, as predict_plan() has them.
  /// @throws std::invalid_argument as predict_plan()
  const PlannedValues& u(int readings);

 private:
  PlannedValues fisher_u(const ProtocolConfig& protocol);
  const PlanningBench& bench_;
  ProtocolConfig protocol_;
  std::vector<PlannedAngle> plan_;
  std::optional<PlannedFit> fit_;       ///< Made where it is asked for.
  std::map<int, PlannedValues> known_;  ///< By the number of readings.
};

/// The stated uncertainty depends on the noise that the estimator finds in its readings, so predictions are
/// means over this number of runs.
inline constexpr int kCheckedRuns = 3;

/// The uncertainties follow from the estimator itself: it analyses simulated runs of the item, as far as it
/// is known, on an ideal stage, whose means state the uncertainty that its noise gives them, with the bench's
/// sizes of all effects. The uncertainties include differences that a bench's real errors would cause, but
/// not noise that is not white.
/// @throws PlanError if the stage cannot reach an angle; std::invalid_argument if the estimator refuses the
/// plan
PlanPrediction predict_plan(const PlanningBench& bench, const ProtocolConfig& protocol);

/// The budget of one of these simulated runs. @throws as predict_plan()
Budget predict_budget(const PlanningBench& bench, const ProtocolConfig& protocol);

}  // namespace abcal
