#pragma once

#include <span>
#include <vector>

namespace abcal {

/// One-way analysis of variance of repeated results (GUM H.5; ISO 5725-2): how much results scatter within a
/// group (one mounting, one day, one operator) and how much more from group to group. All in the unit of the
/// values, or its square.
struct OneWayAnova {
  int groups = 0;
  int observations = 0;
  double mean = 0.0;  ///< Mean of all observations.
  double between_sum_squares = 0.0;
  double within_sum_squares = 0.0;
  int between_degrees_of_freedom = 0;
  int within_degrees_of_freedom = 0;
  double f = 0.0;  ///< Mean square between over mean square within; infinite if nothing scatters within.
  double f_probability = 0.0;  ///< P(F >= f) if the groups do not differ.
  double repeatability = 0.0;  ///< s_r: standard deviation within a group.
  /// s_L: standard deviation from group to group beyond the scatter of the means that the scatter within
  /// groups causes; 0 if not detected.
  double between = 0.0;
  double reproducibility = 0.0;  ///< s_R = sqrt(s_r^2 + s_L^2): scatter of one observation of a new group.
  double mean_standard_uncertainty = 0.0;  ///< From both scatters (GUM H.5.2).

  double between_mean_square() const { return between_sum_squares / between_degrees_of_freedom; }
  double within_mean_square() const { return within_sum_squares / within_degrees_of_freedom; }
};

/// Groups may differ in size.
/// @throws std::invalid_argument fewer than two groups, an empty group, no group with two observations, or a
/// value that is not finite
OneWayAnova one_way_anova(std::span<const std::vector<double>> groups);

/// Scatter of the results of several runs beyond the scatter of the readings within each run.
struct RunSpread {
  int runs = 0;
  double mean = 0.0;
  double standard_deviation = 0.0;  ///< s of the runs' values.
  double within = 0.0;              ///< Root mean square of the type A uncertainties.
  /// Standard deviation from run to run that type A does not explain, sqrt(s^2 - within^2): remounting,
  /// drift, the stage's homing. 0 if not detected. The uncertainty of a single run must contain it.
  double between = 0.0;
  double chi2 = 0.0;  ///< chi2 of the values about their weighted mean, with the type A uncertainties.
  double chi2_probability =
      0.0;  ///< P(chi2 >= found) if type A is all there is; runs - 1 degrees of freedom.
  double mean_standard_uncertainty = 0.0;  ///< sqrt((between^2 + within^2) / runs); no type B.
};

/// @param values  the same quantity from each run
/// @param type_a  its type A standard uncertainty in each run, > 0
/// @throws std::invalid_argument fewer than two runs, unequal lengths, a value that is not finite, an
/// uncertainty that is not above 0
RunSpread spread_between_runs(std::span<const double> values, std::span<const double> type_a);

}  // namespace abcal
