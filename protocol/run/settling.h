#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "protocol/run/dwell.h"
#include "protocol/run/plausibility.h"
#include "protocol/run/reading_source.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// The spreads (R, of one reading) of the latest dwells, and their median: what noise usually does.
class SpreadHistory {
 public:
  /// An output that did not change at all is left out where another one spreads by more than two steps of the
  /// resolution (R; 0: not known): it is frozen and does not show its noise.
  void add(const Eigen::Vector3d& spread, double resolution);
  /// Nothing before the first; NaN for an output that was frozen so far.
  std::optional<Eigen::Vector3d> median() const;

 private:
  std::array<std::vector<double>, 3> spreads_;
  bool empty_ = true;
};

/// How far the mean of the first quarter of a dwell's readings lies from that of the others, over the
/// standard uncertainty of this difference, output by output. Its noise is that of the later half,
/// autocorrelation included. Of an item that is still coming to rest it has one sign. Nothing where a change
/// is below 1e-7 of the mean's norm.
Eigen::Vector3d creep_of(std::span<const Reading> readings, const AccelerometerInfo& info);

/// Learns from the dwells of a run how long the item needs. A creep that is too small to
/// be seen in one dwell goes with the direction of the last change of an output: so it adds up from angle to
/// angle, and noise does not.
class SettlingLesson {
 public:
  /// @param creep  of a dwell (creep_of)
  /// @param mean, spread  of its readings, R
  /// @return true: all dwells together creep; patience() has become twice as long
  bool add(const Eigen::Vector3d& creep, const Eigen::Vector3d& mean, const Eigen::Vector3d& spread);
  /// The dwell begins after so many times the time from which on the outputs showed no motion.
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

  /// One look, with the readings of a part of stability_s, at whether outputs and temperature have been
  /// stable for stability_s (0: at once).
  /// @param begin of the looks
  /// @throws InstrumentError kImplausible after stability_timeout_s more. RunInterrupted.
  bool is_stable_since(Clock::Instant begin);

  /// Measures the spread of readings while the stage is at rest: the reference for later angles.
  /// Waits for a ring-down of the last motion to end: until the spread of five windows is no longer below
  /// that of the five before. What was read before must be discarded.
  void learn_noise();

  /// Waits settle_s and then for the accelerometer to be quiet; with "auto" until nothing moves, and again as
  /// long: an exponential ring-down has then fallen below the noise by the factor by which it stood above it.
  /// @return false if it was not quiet after quiet_timeout_s.
  bool settle(Clock::Instant stopped);

  // The parts of settle(), for several items that settle at once.

  /// What arrives before this is discarded, then.
  Clock::Instant listens_from(Clock::Instant stopped) const;
  struct Rest {
    bool quiet = false;    ///< False: it was not quiet after quiet_timeout_s.
    Clock::Instant begin;  ///< Of the dwell; may lie ahead.
  };
  /// Reads until the accelerometer is quiet.
  Rest find_rest(Clock::Instant stopped);

  /// With "auto": drops the first quarter of a dwell's readings and reads as many more while they still
  /// creep (creep_of). Where settle_s is a number it begins when it begins: it is only looked at.
  /// @return false if they did so for quiet_timeout_s; with a number if they creep by more than noise does in
  /// 1e7 dwells (never said of fewer than 40 readings)
  bool read_until_at_rest(std::vector<Reading>& readings);

  /// Learns from the dwell that read_until_at_rest looked at, and tells the observer where the outputs creep:
  /// with "auto" the next dwells wait longer, otherwise a person is to state a longer settle_s.
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
  Eigen::Vector3d creep_ = Eigen::Vector3d::Zero();  ///< Of the latest dwell.
  SettlingLesson lesson_;
  bool told_ = false;                       ///< That settle_s is too short.
  std::vector<StabilityWindow> stability_;  ///< Of the looks so far.
};

}  // namespace abcal
