#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "protocol/run/reading_source.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// Readings in one window that is tested for slope and spread.
std::size_t quiet_window_size(const ProtocolConfig& protocol, double rate_hz);

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

/// Waits until the accelerometer is ready: warm and stable before the first angle, quiet after each move.
class Settling {
 public:
  /// Both must outlive this.
  Settling(RunContext& context, ReadingSource& readings) : context_(context), readings_(readings) {}

  /// Waits warm_up_s. @throws RunInterrupted
  void warm_up();

  /// Waits until outputs and temperature have been stable for stability_s.
  /// @throws InstrumentError kImplausible after stability_timeout_s more. RunInterrupted.
  void wait_until_stable();

  /// Measures the spread of readings while the stage is at rest: the reference for later angles.
  /// Waits for a ring-down of the last motion to end: until the spread of five windows is no longer below
  /// that of the five before.
  void learn_noise();

  /// Waits settle_s and then for the accelerometer to be quiet.
  /// @return false if it was not quiet after quiet_timeout_s.
  bool settle(Clock::Instant stopped);

  SpreadHistory& spreads() { return spreads_; }
  std::size_t window_size() const;

 private:
  RunContext& context_;
  ReadingSource& readings_;
  SpreadHistory spreads_;
};

}  // namespace abcal
