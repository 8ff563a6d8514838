#pragma once

namespace abcal {

// Average run lengths of control charts: how many points a chart shows on average until one is outside, for
// independent normal values. Limits, shifts and spreads are in the standard deviations that the chart was
// made with; `spread` is the true standard deviation in them. Two-sided charts throughout.

/// The process that a chart watches.
struct ChartedProcess {
  double shift = 0.0;   ///< Shift of the mean from the centre line.
  double spread = 1.0;  ///< > 0
};

/// Single values with limits at +-limit (Shewhart).
double shewhart_run_length(double limit, const ChartedProcess& process = {});

/// Exponentially weighted moving average from the centre line, with lasting limits at +-limit of its own
/// standard deviations. Integral equation of Crowder (Technometrics 29, 1987) at the nodes of Gauss and
/// Legendre.
/// @throws std::invalid_argument weight outside (0, 1]
double ewma_run_length(double weight, double limit, const ChartedProcess& process = {});

/// Two cumulative sums from zero, of the excess over `allowance` above and below, outside beyond `interval`.
/// Markov chain of Brook and Evans (Biometrika 59, 1972) for each; 1/ARL = 1/ARL+ + 1/ARL-.
double cusum_run_length(double allowance, double interval, const ChartedProcess& process = {});

}  // namespace abcal
