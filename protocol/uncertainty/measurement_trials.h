#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "protocol/estimators/measurement/measurement_result.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/drawn_readings.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// Trials of a common fit for Monte Carlo (JCGM 101): of several items or runs, or with a record of the
/// stage. Each draws one truth of the whole measurement (MeasurementTruths), in which runs and items share
/// what they share on a bench, makes the readings of every item in every run by the whole model with noise
/// (DrawnReadings), and solves all of it in full: the own fit of each item in each run, then their common
/// fit. Errors are estimate minus the truth that was drawn. All trials depend on seed and number alone.
class MeasurementTrials {
 public:
  /// @param records  of the items of the common fit, run by run; they must outlive this
  /// @param places   of each record; items are numbered from 0 in the order of their first runs
  /// @param item     the one whose errors are wanted, by its number
  /// @throws UnusableData  as fit_each_run() and fit_measurement()
  MeasurementTrials(std::span<const RunRecord> records, std::span<const ItemInRun> places, int item,
                    std::uint64_t seed);

  /// A TrialBlock: errors of the 18 outputs of the item; angles in degrees.
  /// @throws std::runtime_error  a trial has no solution: it says so with its number
  void operator()(std::uint64_t first, std::size_t count, double* out) const;

 private:
  OutputVector error_of(std::uint64_t trial) const;

  std::span<const RunRecord> records_;
  std::size_t item_;
  std::uint64_t seed_;
  SeriesRuns each_;
  bool one_run_;
  double runs_of_item_;
  MeasurementOptions options_;
  std::vector<MeasuredItem> measured_;
  std::vector<DrawnReadings> draws_;
  MeasurementTruths truths_;
};

}  // namespace abcal
