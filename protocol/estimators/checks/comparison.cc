#include "protocol/estimators/checks/comparison.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/circle/sensitivity_matrix.h"
#include "protocol/linear/cholesky.h"
#include "protocol/linear/products.h"
#include "protocol/linear/singular_values.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

constexpr double kRadToDeg = 180.0 / 3.14159265358979323846;

Eigen::Matrix<double, 9, 1> by_rows(const Eigen::Matrix3d& m) {
  Eigen::Matrix<double, 9, 1> elements;
  for (int j = 0; j < 3; ++j) elements.segment<3>(3 * j) = m.row(j).transpose();
  return elements;
}

Eigen::Matrix3d unit_change(Eigen::Index element) {
  Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
  m(element / 3, element % 3) = 1.0;
  return m;
}

void require_full_rank(const Eigen::Matrix3d& m) {
  constexpr double kSmallestReciprocalCondition = 1e-6;
  const Eigen::Vector3d singular =
      m.allFinite() ? Eigen::Vector3d(singular_values(m)) : Eigen::Vector3d::Zero();
  if (!(singular(2) > kSmallestReciprocalCondition * singular(0))) {
    throw std::invalid_argument(
        "rotation between matrices: a sensitivity matrix is not of full rank; three independent axes are "
        "required");
  }
}

}  // namespace

const Quantity& intrinsic_property(const CalibrationResult& result, Eigen::Index i) {
  const auto j = static_cast<std::size_t>(i % 3);
  if (i < 3) return result.intrinsic_sensitivity[j];
  return i < 6 ? result.intrinsic_angle[j] : result.offset[j];
}

IntrinsicValues intrinsic_values(const CalibrationResult& result) {
  IntrinsicValues values;
  for (Eigen::Index i = 0; i < 9; ++i) values(i) = intrinsic_property(result, i).value;
  return values;
}

IntrinsicComparison compare_intrinsic(const IntrinsicValues& first, const Covariance9& covariance_1,
                                      const IntrinsicValues& second, const Covariance9& covariance_2,
                                      const Covariance9& shared) {
  IntrinsicComparison comparison;
  std::vector<Eigen::Index> given;
  for (Eigen::Index i = 0; i < 9; ++i) {
    if (std::isfinite(first(i)) && std::isfinite(second(i))) given.push_back(i);
  }
  const auto count = static_cast<Eigen::Index>(given.size());
  comparison.degrees_of_freedom = static_cast<int>(count);
  if (count == 0) return comparison;
  const Covariance9 covariance = covariance_1 + covariance_2 - shared - shared.transpose();
  Eigen::VectorXd difference(count);
  Eigen::MatrixXd correlation(count, count);
  for (Eigen::Index a = 0; a < count; ++a) {
    const Eigen::Index i = given[static_cast<std::size_t>(a)];
    const double variance = covariance(i, i);
    // Rounding of the subtraction must not be taken for the variance of a difference.
    if (!(variance > 1e-12 * (covariance_1(i, i) + covariance_2(i, i)))) {
      throw std::invalid_argument(
          fmt::format("comparison of {}: the difference has no uncertainty (variance {}); required: above 0",
                      kIntrinsicSymbols[static_cast<std::size_t>(i)], variance));
    }
    PropertyDifference& property = comparison.properties[static_cast<std::size_t>(i)];
    property.difference = second(i) - first(i);
    property.standard_uncertainty = std::sqrt(variance);
    property.zeta = property.difference / property.standard_uncertainty;
    property.e_n = property.zeta / 2.0;
    comparison.largest_e_n = std::max(comparison.largest_e_n, std::abs(property.e_n));
    difference(a) = property.zeta;
    for (Eigen::Index b = 0; b < count; ++b) {
      const Eigen::Index k = given[static_cast<std::size_t>(b)];
      correlation(a, b) = covariance(i, k) / std::sqrt(variance * covariance(k, k));
    }
  }
  // Differences in units of their uncertainties: angles, sensitivities and offsets have different units.
  const PivotedCholesky factor(correlation);
  if (factor.positive_semidefinite()) {
    const double chi2 = difference.dot(factor.solve_vector(difference));
    if (std::isfinite(chi2)) {
      comparison.chi2 = chi2;
      comparison.chi2_probability = chi2_tail(chi2, comparison.degrees_of_freedom);
    }
  }
  const double of_largest = chi2_tail(std::pow(2.0 * comparison.largest_e_n, 2), 1);
  comparison.joint_probability =
      comparison.chi2_probability.value_or(std::min(1.0, static_cast<double>(count) * of_largest));
  return comparison;
}

Covariance12 shared_type_b(const RunRecord& first, const RunRecord& second, AbcFormula formula) {
  const auto change = [formula](const OutputEffect& effect) -> const Eigen::Matrix<double, 12, 1>& {
    return formula == AbcFormula::kPublished ? effect.published_change : effect.change;
  };
  const bool same_angles = first.step == second.step && first.steps == second.steps;
  // An angle measured twice in one run has two step errors of the same name: the first pair is common.
  std::map<std::string, Eigen::Matrix<double, 12, 1>> in_second;
  for (const OutputEffect& effect : type_b_effects(second)) in_second.emplace(effect.name, change(effect));
  Covariance12 covariance = Covariance12::Zero();
  for (const OutputEffect& effect : type_b_effects(first)) {
    const bool of_one_angle = effect.name.starts_with("f_");
    // Effects of the item differ from run to run, or with its mounting.
    if (effect.of_item || (of_one_angle && !same_angles)) continue;
    if (formula == AbcFormula::kPublished && !in_published_protocol(effect.key)) continue;
    const auto common = in_second.find(effect.name);
    if (common == in_second.end()) continue;
    covariance += change(effect) * common->second.transpose();
    in_second.erase(common);
  }
  return covariance;
}

RotationBetween rotation_between(const Eigen::Matrix3d& first, const MatrixCovariance& covariance_1,
                                 const Eigen::Matrix3d& second, const MatrixCovariance& covariance_2,
                                 const MatrixCovariance& shared) {
  require_full_rank(first);
  require_full_rank(second);
  RotationBetween result;
  result.same_handedness = first.determinant() * second.determinant() > 0.0;
  if (!result.same_handedness) return result;
  const Eigen::Matrix3d m = second.transpose() * first;
  const SingularValues svd = singular_value_decomposition(m);
  // Both determinants have one sign, so that this is a rotation and no reflection.
  const Eigen::Matrix3d& t = result.rotation = product_transposed(svd.u, svd.v);
  result.residual = second * t - first;

  // T follows from M = S_2' S_1 = T P with P symmetric. A change dM turns T into T (1 + [w]x), where
  // (tr P - P) w is the vector of the antisymmetric T'dM - dM'T.
  const Eigen::Matrix3d p = t.transpose() * m;
  const Eigen::Matrix3d turning = (p.trace() * Eigen::Matrix3d::Identity() - p).inverse();
  Eigen::Matrix<double, 3, 18> rotation_jacobian;
  Eigen::Matrix<double, 9, 18> residual_jacobian;
  for (Eigen::Index i = 0; i < 18; ++i) {
    const Eigen::Matrix3d d_first = i < 9 ? unit_change(i) : Eigen::Matrix3d::Zero();
    const Eigen::Matrix3d d_second = i < 9 ? Eigen::Matrix3d::Zero() : unit_change(i - 9);
    const Eigen::Matrix3d n = t.transpose() * (d_second.transpose() * first + second.transpose() * d_first);
    const Eigen::Vector3d w =
        turning * Eigen::Vector3d(n(2, 1) - n(1, 2), n(0, 2) - n(2, 0), n(1, 0) - n(0, 1));
    rotation_jacobian.col(i) = w;
    residual_jacobian.col(i) = by_rows(d_second * t + second * t * cross_matrix(w) - d_first);
  }
  Eigen::Matrix<double, 18, 18> covariance;
  covariance << covariance_1, shared, shared.transpose(), covariance_2;
  const Eigen::Matrix3d turn_covariance = carried_covariance(rotation_jacobian, covariance);
  const Covariance9 residual_covariance = carried_covariance(residual_jacobian, covariance);
  for (int j = 0; j < 3; ++j) {
    for (int k = 0; k < 3; ++k) {
      const Eigen::Index i = s_index(j, k);
      result.residual_standard_uncertainty(j, k) = std::sqrt(std::max(0.0, residual_covariance(i, i)));
    }
  }

  const Eigen::AngleAxisd turn(t);
  const Eigen::Vector3d n = turn.axis();
  const double angle = turn.angle();
  const double angle_variance = n.dot(turn_covariance * n);
  result.angle_deg = angle * kRadToDeg;
  result.angle_standard_uncertainty_deg = std::sqrt(std::max(0.0, angle_variance)) * kRadToDeg;
  // Near zero the angle is the length of a vector that may point anywhere: the largest variance decides.
  const SymmetricEigen spread = symmetric_eigen(turn_covariance);
  if (angle > 2.0 * std::sqrt(std::max(0.0, spread.values(2))) && angle > 0.0) {
    result.axis = n;
    // The axis tilts by J_r^-1(angle n) w / angle across n; across n that is a turn about n by angle/2 and a
    // stretch by (angle/2)/sin(angle/2), so that the variance is that of w across n over (2 sin(angle/2))^2.
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - n * n.transpose();
    const SymmetricEigen tilt = symmetric_eigen(across * turn_covariance * across);
    result.axis_standard_uncertainty_deg =
        std::sqrt(std::max(0.0, tilt.values(2))) / (2.0 * std::sin(angle / 2.0)) * kRadToDeg;
  } else {
    result.angle_standard_uncertainty_deg = std::sqrt(std::max(0.0, spread.values(2))) * kRadToDeg;
  }
  return result;
}

}  // namespace abcal
