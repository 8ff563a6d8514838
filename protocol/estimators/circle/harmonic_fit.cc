#include "protocol/estimators/circle/harmonic_fit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "protocol/linear/pivoted_qr.h"
#include "protocol/linear/products.h"
#include "protocol/linear/singular_values.h"

namespace abcal {

namespace {

constexpr double kSmallestReciprocalCondition = 1e-8;
constexpr int kRefinements = 2;

double modulo_turn(Angle alpha) {
  const double reduced = std::remainder(alpha.deg(), 360.0);
  return reduced < 0.0 ? reduced + 360.0 : reduced;
}

int count_distinct(std::span<const Angle> alpha) {
  std::vector<double> reduced;
  reduced.reserve(alpha.size());
  for (const Angle a : alpha) reduced.push_back(modulo_turn(a));
  std::sort(reduced.begin(), reduced.end());
  const auto end = std::unique(reduced.begin(), reduced.end());
  return static_cast<int>(end - reduced.begin());
}

std::string coefficients_in_words(int harmonics) {
  return fmt::format("the {} coefficients of a constant and {} harmonic{}", 2 * harmonics + 1, harmonics,
                     harmonics == 1 ? "" : "s");
}

void require_sound(std::span<const Angle> alpha, std::span<const double> readings, std::span<const double> u,
                   int harmonics) {
  if (harmonics < 1) {
    throw std::invalid_argument(fmt::format("harmonic fit: {} harmonics; required: 1 or more", harmonics));
  }
  if (alpha.size() != readings.size() || (!u.empty() && u.size() != readings.size())) {
    throw std::invalid_argument(fmt::format(
        "harmonic fit: {} angles, {} readings, {} uncertainties; one of each is required at every angle",
        alpha.size(), readings.size(), u.size()));
  }
  for (std::size_t i = 0; i < readings.size(); ++i) {
    if (!std::isfinite(alpha[i].deg()) || !std::isfinite(readings[i])) {
      throw std::invalid_argument(
          fmt::format("harmonic fit: reading {} at {} degrees; finite numbers are required", readings[i],
                      alpha[i].deg()));
    }
    if (!u.empty() && !(u[i] > 0.0 && std::isfinite(u[i]))) {
      throw std::invalid_argument(
          fmt::format("harmonic fit: standard uncertainty {} at {} degrees; a finite number > 0 is required",
                      u[i], alpha[i].deg()));
    }
  }
}

}  // namespace

HarmonicFit fit_harmonics(std::span<const Angle> alpha, std::span<const double> readings,
                          std::span<const double> u, int harmonics, const Eigen::MatrixXd& further) {
  require_sound(alpha, readings, u, harmonics);
  const auto rows = static_cast<Eigen::Index>(readings.size());
  const Eigen::Index own = 2 * harmonics + 1;
  const int distinct = count_distinct(alpha);
  if (distinct < own) {
    throw UndeterminedFit(fmt::format("{} distinct angle{} cannot determine {}; at least {} are required",
                                      distinct, distinct == 1 ? "" : "s", coefficients_in_words(harmonics),
                                      own));
  }
  std::vector<Eigen::Index> used;
  for (Eigen::Index c = 0; c < further.cols(); ++c)
    if (!further.col(c).isZero(0.0)) used.push_back(c);
  const Eigen::Index columns = own + static_cast<Eigen::Index>(used.size());

  HarmonicFit fit;
  Eigen::MatrixXd& design = fit.design;
  design.resize(rows, columns);
  for (Eigen::Index c = own; c < columns; ++c)
    design.col(c) = further.col(used[static_cast<std::size_t>(c - own)]);
  Eigen::VectorXd weight = Eigen::VectorXd::Ones(rows);  // 1/u: square roots of the usual weights
  const double u_smallest = u.empty() ? 1.0 : *std::min_element(u.begin(), u.end());
  for (Eigen::Index i = 0; i < rows; ++i) {
    const auto index = static_cast<std::size_t>(i);
    design(i, 0) = 1.0;
    for (int k = 1; k <= harmonics; ++k) {
      const SinCos sc = sincos(alpha[index] * k);
      design(i, 2 * k - 1) = sc.sin;
      design(i, 2 * k) = sc.cos;
    }
    if (!u.empty()) weight(i) = u_smallest / u[index];
  }
  const Eigen::MatrixXd weighted_design = scaled_rows(weight, design);
  const Eigen::VectorXd column_scale = weighted_design.colwise().norm().cwiseInverse();
  const PivotedQr qr(scaled_columns(weighted_design, column_scale));
  const Eigen::VectorXd of_scaled = singular_values(qr.upper());

  fit.harmonics = harmonics;
  fit.weighted = !u.empty();
  fit.rank = static_cast<int>(qr.rank());
  fit.reciprocal_condition = of_scaled(columns - 1) / of_scaled(0);
  if (fit.rank < columns || !(fit.reciprocal_condition >= kSmallestReciprocalCondition)) {
    throw UndeterminedFit(fmt::format(
        "{} angles cannot determine {}: rank {}, reciprocal condition {:.1e}; a rank of {} and "
        "{:.0e} are required ({})",
        readings.size(), coefficients_in_words(harmonics), fit.rank, fit.reciprocal_condition, columns,
        kSmallestReciprocalCondition,
        used.empty() ? "spread the angles over the circle"
                     : "one rate does not tell what the rotation adds: sweep each circle at two"));
  }

  // scaled * P = Q R, hence estimator = D P R^-1 Q' W and cofactor = (D P R^-1) (D P R^-1)'.
  const Eigen::MatrixXd q_weighted = scaled_rows(weight, qr.orthonormal());
  fit.estimator = scaled_rows(column_scale, qr.solve_upper(q_weighted.transpose()));
  fit.cofactor = covariance_of_root(scaled_rows(column_scale, qr.cofactor_root()));
  if (fit.weighted) fit.cofactor *= u_smallest * u_smallest;

  // Residuals are taken in long double and fitted again: with noise-free readings the result is then good to
  // the last digit or two of double, which the paper's own check of its analysis asks for (1e-15).
  Eigen::VectorXd x = Eigen::VectorXd::Zero(columns);
  fit.residuals.resize(rows);
  for (int pass = 0;; ++pass) {
    for (Eigen::Index i = 0; i < rows; ++i) {
      long double residual = static_cast<long double>(readings[static_cast<std::size_t>(i)]);
      for (Eigen::Index c = 0; c < columns; ++c) {
        residual -= static_cast<long double>(design(i, c)) * static_cast<long double>(x(c));
      }
      fit.residuals(i) = static_cast<double>(residual);
    }
    if (pass > kRefinements) break;
    x += product_with_vector(fit.estimator, fit.residuals);
  }
  fit.coefficients = x;
  const Eigen::VectorXd weighted_residuals = weight.cwiseProduct(fit.residuals) / u_smallest;
  fit.residual_sum_squares = weighted_residuals.squaredNorm();
  if (!fit.coefficients.allFinite() || !fit.cofactor.allFinite()) {
    throw UndeterminedFit("the coefficients are not finite: the readings are too large for double precision");
  }
  return fit;
}

Eigen::MatrixXd columns_of_motion(const HarmonicFit& of_sine, std::span<const double> rate_radps) {
  const Eigen::VectorXd rate =
      Eigen::Map<const Eigen::VectorXd>(rate_radps.data(), static_cast<Eigen::Index>(rate_radps.size()));
  const Eigen::VectorXd sine = of_sine.design.col(1), cosine = of_sine.design.col(2);
  const double s = of_sine.coefficients(1), c = of_sine.coefficients(2);
  Eigen::MatrixXd out(rate.size(), 3);
  out.col(0) = rate.cwiseAbs2();
  out.col(1) = rate.cwiseAbs2().cwiseProduct(s * sine + c * cosine);
  out.col(2) = rate.cwiseProduct(s * cosine - c * sine);
  return out;
}

}  // namespace abcal
