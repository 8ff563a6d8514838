#include "protocol/estimators/circle/diagnostics.h"

#include <algorithm>
#include <cmath>

namespace abcal {

Eigen::VectorXd effect_on_fit(const InputEffect& effect, const ReadingSeries& series,
                              const HarmonicFit& fit) {
  Eigen::VectorXd change = Eigen::VectorXd::Zero(fit.coefficients.size());
  for (std::size_t i = 0; i < effect.effect.size(); ++i) {
    const int place = series.place_of[effect.first_reading + i];
    if (place >= 0) change += fit.estimator.col(place) * effect.effect[i](series.accelerometer);
  }
  return change;
}

ResidualTest test_residuals(const ReadingSeries& series, const HarmonicFit& fit,
                            const std::vector<InputEffect>& effects, double resolution) {
  ResidualTest test;
  const auto count = static_cast<Eigen::Index>(series.readings.size());
  if (fit.degrees_of_freedom() < 1) return test;
  const Eigen::MatrixXd& design = fit.design;
  const Eigen::MatrixXd gram = design.transpose() * design;

  // Independent part: one variance a reading. ||(I - H) e_k||^2 = 1 - 2 H_kk + g_k' A'A g_k, g_k = column of
  // the estimator.
  double largest = 0.0;
  for (const double r : series.readings) largest = std::max(largest, std::abs(r));
  const double round_off = 1e-15 * largest;
  Eigen::VectorXd variance =
      Eigen::VectorXd::Constant(count, resolution * resolution / 12.0 + round_off * round_off);
  for (std::size_t i = 0; i < series.u.size(); ++i)
    variance(static_cast<Eigen::Index>(i)) += series.u[i] * series.u[i];

  double expected = 0.0;
  double sum_squares = 0.0;
  const auto add = [&](double contribution) {
    expected += contribution;
    sum_squares += contribution * contribution;
  };
  for (const InputEffect& effect : effects) {
    if (effect.effect.size() == 1) {  // a step error: it belongs to one reading
      const int place = series.place_of[effect.first_reading];
      const double change = effect.effect[0](series.accelerometer) * effect.standard_uncertainty;
      if (place >= 0) variance(place) += change * change;
      continue;
    }
    Eigen::VectorXd change = Eigen::VectorXd::Zero(count);
    for (std::size_t i = 0; i < effect.effect.size(); ++i) {
      const int place = series.place_of[effect.first_reading + i];
      if (place >= 0) change(place) = effect.effect[i](series.accelerometer) * effect.standard_uncertainty;
    }
    add((change - design * (fit.estimator * change)).squaredNorm());
  }
  for (Eigen::Index k = 0; k < count; ++k) {
    const Eigen::VectorXd g = fit.estimator.col(k);
    const double left = 1.0 - 2.0 * design.row(k).dot(g) + g.dot(gram * g);
    add(variance(k) * std::max(left, 0.0));
  }
  test.expected_rms = std::sqrt(expected / static_cast<double>(count));
  if (!(expected > 0.0) || series.u.empty()) return test;

  const double degrees_of_freedom = expected * expected / sum_squares;
  const double spread = 2.0 / (9.0 * degrees_of_freedom);
  test.deviate = (std::cbrt(fit.residuals.squaredNorm() / expected) - (1.0 - spread)) / std::sqrt(spread);
  return test;
}

}  // namespace abcal
