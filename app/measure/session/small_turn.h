#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <stop_token>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/session/run_bench.h"
#include "app/measure/session/session_events.h"
#include "drivers/instrument/angle.h"

namespace abcal {

/// Angle of the small turn of both axes.
inline constexpr double kSmallTurnDeg = 30.0;
/// Readings averaged at each pose of the small turn, at most.
inline constexpr int kMostTurnReadings = 200;

/// Readings of outputs u, v, w (R) at one pose of the stage.
struct PoseReading {
  Angle x, z;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d spread = Eigen::Vector3d::Zero();  ///< Standard deviation of single readings.
  Eigen::Vector3d u_mean = Eigen::Vector3d::Zero();  ///< Standard uncertainty of the mean; 0: not known.
  std::uint32_t flags = 0;                           ///< As DwellRecord::flags.
};

/// Specific force (g_loc) in the platter's frame at a pose of an ideal stage: Rot(X, x) Rot(Z, z) undone.
Eigen::Vector3d gravity_at(Angle x, Angle z);

/// The readings of one item in the small turn.
struct TurnedItem {
  Message missing;       ///< Why it took no part; empty: it did.
  std::string mounting;  ///< [item] mounting that was in force.
  std::vector<PoseReading> poses;
};

/// Turns X by 30 degrees from zero and then Z, on the side that the travel allows, homing an axis first that
/// is not homed. It is measured as a run whose file is removed, with the same watchdog and guard, but neither
/// warms up nor waits for stable outputs. The stage ends at zero, or halted.
/// @param identities  as the instruments reported
/// @param listener    receives the events of the run (RunBeganEvent without a file); may be empty
/// @return an entry for each item, in the order of the bench file
/// @throws RunInterrupted, InstrumentError, PlanError
std::vector<TurnedItem> measure_small_turn(Bench& bench, const BenchConfig& config,
                                           const Identities& identities, const SessionListener& listener,
                                           const std::stop_token& stop);

}  // namespace abcal
