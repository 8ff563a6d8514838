#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "protocol/run/dwell.h"
#include "protocol/run/reading_plausibility.h"
#include "protocol/run/reading_source.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// The spreads (R, of one reading) of the latest dwells, and their median: the usual noise.
class SpreadHistory {
 public:
  /// An output that did not change at all is left out where another one spreads by more than two steps of the
  /// resolution (R; 0: not known): it is frozen and does not show its noise.
  void add(const Eigen::Vector3d& spread, double resolution);
  /// Absent before the first dwell; NaN for an output that was frozen so far.
  std::optional<Eigen::Vector3d> median() const;

 private:
  std::array<std::vector<double>, 3> spreads_;
  bool empty_ = true;
};

/// Mean of the first quarter of a dwell's readings minus that of the others, over the standard uncertainty of
/// this difference, output by output. The noise is taken from the later half, autocorrelation included. For
/// an item that still settles it has one sign. Zero where the difference is below 1e-7 of the mean's norm.
/// @param drift_per_s  standard deviation of the rate of the stated drift (RunContext::drift_per_s), which
/// is part of the uncertainty: drift is not settling
Eigen::Vector3d creep_of(std::span<const Reading> readings, const AccelerometerInfo& info,
                         double drift_per_s = 0.0);

/// Learns from the dwells of a run how long the item needs to settle. A creep that is too small to be
/// detected in one dwell follows the direction of the last change of an output: it adds up from angle to
/// angle, and noise does not.
class SettlingLesson {
 public:
  /// @param creep  of a dwell (creep_of)
  /// @param mean, spread  of its readings, R
  /// @return true: all dwells together creep; patience() is doubled
  bool add(const Eigen::Vector3d& creep, const Eigen::Vector3d& mean, const Eigen::Vector3d& spread);
  /// Time from the stop to the dwell, as a multiple of the time after which the outputs showed no motion.
  double patience() const { return patience_; }

 private:
  double patience_ = kSettlingPatience;
  std::optional<Eigen::Vector3d> previous_mean_;
  double sum_ = 0.0;
  int count_ = 0;
};

/// Waits until the accelerometer is ready: warm and stable before the first angle, quiet after each move.
class Settling {
 public:
  /// Both must outlive this.
  Settling(RunContext& context, ReadingSource& readings) : context_(context), readings_(readings) {}

  /// Waits warm_up_s. @throws RunInterrupted
  void warm_up();

  /// Reads one window, a part of stability_s, and returns whether outputs and temperature have been stable
  /// for stability_s (0: true at once).
  /// @param begin  of the first window
  /// @throws InstrumentError kImplausible after stability_timeout_s more. RunInterrupted.
  bool is_stable_since(Clock::Instant begin);

  /// Measures the spread of readings while the stage is at rest: the reference for later angles.
  /// Waits for a ring-down of the last motion to end: until the spread of five windows is no longer below
  /// that of the five before. Discard the pending readings before the call.
  void learn_noise();

  /// Waits settle_s and then for the accelerometer to be quiet; with "auto" until nothing moves, and then for
  /// the same time again: an exponential ring-down is then as far below the noise as it was above it.
  /// @return false if it was not quiet after quiet_timeout_s.
  bool settle(Clock::Instant stopped);

  // The parts of settle(), for several items that settle at once.

  /// Time at which the readings pending so far are discarded.
  Clock::Instant listens_from(Clock::Instant stopped) const;
  struct Rest {
    bool quiet = false;    ///< False: it was not quiet after quiet_timeout_s.
    Clock::Instant begin;  ///< Begin of the dwell; may be in the future.
  };
  /// Reads until the accelerometer is quiet.
  Rest find_rest(Clock::Instant stopped);

  /// With "auto": drops the first quarter of a dwell's readings and reads as many more while they still
  /// creep (creep_of). Where settle_s is a number, the readings are tested, but not replaced.
  /// @return false if they creep for quiet_timeout_s; where settle_s is a number, if they creep by more than
  /// noise does once in 1e7 dwells (always true for fewer than 40 readings)
  bool read_until_at_rest(std::vector<Reading>& readings);

  /// Learns from the dwell that read_until_at_rest() tested, and notifies the observer if the outputs creep:
  /// with "auto" the next dwells wait longer, otherwise the operator has to state a longer settle_s.
  void learn(const DwellStatistics& statistics);

  SpreadHistory& spreads() { return spreads_; }
  const SpreadHistory& spreads() const { return spreads_; }
  std::size_t window_size() const;

 private:
  Rest find_rest_by_outputs(Clock::Instant stopped);
  bool is_quiet_window(std::span<const Reading> window) const;
  double resolution() const { return context_.accelerometer_info.resolution.value_or(0.0); }

  RunContext& context_;
  ReadingSource& readings_;
  SpreadHistory spreads_;
  Eigen::Vector3d creep_ = Eigen::Vector3d::Zero();  ///< Creep of the latest dwell.
  SettlingLesson lesson_;
  bool told_ = false;                       ///< settle_s was reported as too short.
  std::vector<StabilityWindow> stability_;  ///< Windows read so far.
};

}  // namespace abcal
