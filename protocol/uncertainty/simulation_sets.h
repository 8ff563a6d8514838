#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/uncertainty/monte_carlo.h"
#include "protocol/uncertainty/study_output.h"
#include "protocol/uncertainty/type_b.h"

namespace abcal {

/// Settings of the paper's simulation sets that a user may change. Absent: as in the paper.
struct SimulationOptions {
  std::optional<std::uint64_t> trials;
  std::uint64_t seed = 1;
  unsigned threads = 0;  ///< 0: as many as the machine has.
  std::optional<AccelerometerUnderTest> accelerometer;
  std::optional<Angle> alignment, step, initial_turn, zero;
  bool resolution =
      false;           ///< The stage's resolution of 0.001 degrees in place of its accuracy of 0.008 degrees.
  bool scale = false;  ///< Sets 3 to 6: also at a tenth and at ten times the misalignment.
  std::stop_token stop;
  std::function<void(std::uint64_t done, std::uint64_t planned)> progress;
};

/// Readings of one simulated calibration with the residuals of the fit (Figures 1 to 4). [i - 1] is N x 3,
/// columns u v w.
struct SimulatedReadings {
  std::array<std::vector<Angle>, 3> alpha;
  std::array<Eigen::MatrixX3d, 3> readings;   ///< R
  std::array<Eigen::MatrixX3d, 3> residuals;  ///< Simulated minus recalculated from the fit, R.
};

/// One case of a set: a single simulation (`error`) or many (`monte_carlo`).
struct StudyCase {
  std::string name;
  bool one_of_many = false;          ///< One of many alike, summed up by another case: text leaves it out.
  std::optional<StudyOutput> error;  ///< Estimate minus truth.
  std::optional<StudyOutput> truth;  ///< Truth of a single simulation.
  std::optional<MonteCarloResult> monte_carlo;  ///< Statistics of the errors.
  std::string table;                            ///< "Table 5": the table with the printed numbers; empty: not
                                                ///< printed.
  std::optional<StudyOutput> published;         ///< Printed error, or mean of the errors.
  std::optional<StudyOutput> published_standard_deviation;
  std::optional<StudyOutput> published_truth;  ///< Table 2.
  std::string note;                            ///< Remark for the reader, e.g. on slips of the paper.
  std::optional<SimulatedReadings> readings;
  /// Largest coefficient of harmonics 2 to 5 of the five-harmonic fit (R).
  std::optional<double> largest_higher_harmonic;
  /// Monte Carlo: how many means of the nine elements (Table 3) and of the nine others (Table 4) differ from
  /// zero at 95 % (|mean| > t u / sqrt(trials)).
  std::optional<std::array<int, 2>> means_not_zero;
};

struct StudyResult {
  std::string set;
  std::string title;
  std::uint64_t trials = 0;  ///< Asked for, of each case.
  std::uint64_t seed = 1;
  bool interrupted = false;
  std::vector<StudyCase> cases;
  std::vector<std::string> notes;
};

/// The sets that run_simulation_set knows: 1 2 3 4 5 6 abc1 abc1-harmonic abc2.
const std::vector<std::string>& simulation_set_names();

/// Runs one set of the paper.
/// @throws std::invalid_argument for an unknown set, 0 trials, tolerances outside their range, options that
/// the set
///         does not have (scale outside of sets 3 to 6)
StudyResult run_simulation_set(std::string_view set, const SimulationOptions& options);

/// An accelerometer as the paper draws it: diagonal N(1, 0.1), the others and the offset N(0, 0.1).
AccelerometerUnderTest random_accelerometer(std::uint64_t seed, std::uint64_t number);

/// Outputs whose mean over the trials differs from zero at 95 % (Student's t).
std::array<bool, kStudyOutputs> means_that_are_not_zero(const MonteCarloResult& result);

}  // namespace abcal
