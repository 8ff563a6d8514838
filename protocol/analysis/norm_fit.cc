#include "protocol/analysis/norm_fit.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "protocol/analysis/chi2_tail.h"
#include "protocol/analysis/intrinsic_properties.h"
#include "protocol/analysis/unusable_data.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr int kUnknowns = 9;
using Unknowns = Eigen::Matrix<double, kUnknowns, 1>;
using UnknownMatrix = Eigen::Matrix<double, kUnknowns, kUnknowns>;

/// Rows and columns of the six elements of the upper triangular B; unknowns 6..8 are the offset.
constexpr int kRow[6] = {0, 0, 0, 1, 1, 2};
constexpr int kColumn[6] = {0, 1, 2, 1, 2, 2};

/// Robust standard deviations at which a pose is taken to have been disturbed.
constexpr double kOutlier = 5.0;
/// Below this probability chi2 contradicts the model, as for the joint estimator.
constexpr double kChi2Level = kFalseAlarm;
/// A cap without poses of this radius (degrees) is named, and of the second makes the result doubtful: six
/// poses, one a face, leave 54.7 degrees.
constexpr double kNamedCap = 60.0;
constexpr double kDoubtfulCap = 75.0;
/// Reciprocal condition of the column-scaled design below which the nine unknowns are not told apart.
constexpr double kSingular = 1e-9;

Eigen::Matrix3d upper(const Unknowns& x) {
  Eigen::Matrix3d b = Eigen::Matrix3d::Zero();
  for (int i = 0; i < 6; ++i) b(kRow[i], kColumn[i]) = x(i);
  return b;
}

struct Fit {
  Unknowns x;
  UnknownMatrix cofactor;    ///< (J' W J)^-1
  Eigen::VectorXd residual;  ///< |a| - 1
  Eigen::VectorXd variance;  ///< Of the residual from the readings' uncertainty; 1 where that is unknown.
  double weighted_squares = 0.0;
  double reciprocal_condition = 0.0;
  std::vector<Eigen::Vector3d> direction;
};

/// Poses in scaled units: (r - centre) / size.
struct Scaled {
  std::vector<Eigen::Vector3d> reading;
  std::vector<Eigen::Vector3d> u;  ///< Empty: unknown.
};

/// The quadric (r - O)' M (r - O) = 1 by linear least squares: a start for the fit of the norm.
Unknowns start(const Scaled& poses) {
  const auto n = static_cast<Eigen::Index>(poses.reading.size());
  Eigen::MatrixXd design(n, kUnknowns);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector3d& r = poses.reading[static_cast<std::size_t>(i)];
    design.row(i) << r.x() * r.x(), r.y() * r.y(), r.z() * r.z(), 2.0 * r.x() * r.y(), 2.0 * r.x() * r.z(),
        2.0 * r.y() * r.z(), 2.0 * r.x(), 2.0 * r.y(), 2.0 * r.z();
  }
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(design);
  qr.setThreshold(kSingular);
  const auto undetermined = [&] {
    return UnusableData(fmt::format(
        "norm fit: {} poses do not determine the nine unknowns; poses all over the sphere are required", n));
  };
  if (qr.rank() < kUnknowns) throw undetermined();
  const Unknowns p = qr.solve(Eigen::VectorXd::Ones(n));
  Eigen::Matrix3d m;
  m << p(0), p(3), p(4), p(3), p(1), p(5), p(4), p(5), p(2);
  const Eigen::Vector3d offset = -m.partialPivLu().solve(p.tail<3>());
  const Eigen::Matrix3d unit = m / (1.0 + offset.dot(m * offset));
  const Eigen::LLT<Eigen::Matrix3d> llt(unit);
  if (llt.info() != Eigen::Success || !offset.allFinite()) throw undetermined();  // not an ellipsoid
  const Eigen::Matrix3d b = llt.matrixU();
  Unknowns x;
  for (int i = 0; i < 6; ++i) x(i) = b(kRow[i], kColumn[i]);
  x.tail<3>() = offset;
  return x;
}

/// Weighted least squares of |B (r - O)| - 1 by Gauss-Newton. `extra` is a variance common to all poses.
Fit fit_norm(const Scaled& poses, const Unknowns& from, double extra) {
  const auto n = static_cast<Eigen::Index>(poses.reading.size());
  Fit fit;
  fit.x = from;
  fit.residual.resize(n);
  fit.variance.resize(n);
  fit.direction.resize(poses.reading.size());
  Eigen::MatrixXd jacobian(n, kUnknowns);
  bool converged = false;
  for (int iteration = 0; iteration < 50 && !converged; ++iteration) {
    const Eigen::Matrix3d b = upper(fit.x);
    Eigen::VectorXd right(n);
    fit.weighted_squares = 0.0;
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const Eigen::Vector3d d = poses.reading[at] - fit.x.tail<3>();
      const Eigen::Vector3d a = b * d;
      const double norm = a.norm();
      const Eigen::Vector3d e = a / norm;
      const Eigen::Vector3d gradient = b.transpose() * e;  // of the norm by the reading
      fit.direction[at] = e;
      fit.residual(i) = norm - 1.0;
      fit.variance(i) = poses.u.empty() ? 1.0 : gradient.cwiseProduct(poses.u[at]).squaredNorm() + extra;
      const double root = 1.0 / std::sqrt(fit.variance(i));
      for (int k = 0; k < 6; ++k) jacobian(i, k) = root * e(kRow[k]) * d(kColumn[k]);
      jacobian.row(i).tail<3>() = -root * gradient.transpose();
      right(i) = -root * fit.residual(i);
      fit.weighted_squares += right(i) * right(i);
    }
    const Unknowns scale = jacobian.colwise().norm().cwiseInverse();
    const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(jacobian * scale.asDiagonal());
    const auto r = qr.matrixR().topLeftCorner<kUnknowns, kUnknowns>().triangularView<Eigen::Upper>();
    fit.reciprocal_condition = std::abs(qr.matrixR()(kUnknowns - 1, kUnknowns - 1) / qr.matrixR()(0, 0));
    if (!(fit.reciprocal_condition > kSingular)) {
      throw UnusableData(fmt::format(
          "norm fit: {} poses do not determine the nine unknowns; poses all over the sphere are required",
          n));
    }
    const Unknowns change = scale.cwiseProduct(Unknowns(qr.solve(right)));
    // (J' J)^-1 = P R^-1 R^-T P', with the columns' scaling taken back.
    const UnknownMatrix r_inverse = r.solve(UnknownMatrix::Identity());
    const UnknownMatrix permuted = qr.colsPermutation() * r_inverse;
    fit.cofactor = scale.asDiagonal() * (permuted * permuted.transpose()) * scale.asDiagonal();
    fit.x += change;
    if (!fit.x.allFinite()) break;
    converged = change.norm() <= 1e-13 * fit.x.norm() * std::sqrt(static_cast<double>(kUnknowns)) ||
                (iteration > 3 && change.norm() <= 1e-11 * fit.x.norm());
  }
  if (!converged)
    throw UnusableData("norm fit: did not converge; the readings are not those of gravity alone");
  return fit;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Radius (degrees) and centre of the largest cap without a pose, on a grid of some 1.5 degrees.
std::pair<double, Eigen::Vector3d> largest_empty_cap(const std::vector<Eigen::Vector3d>& directions) {
  constexpr int kGrid = 4000;  // Fibonacci sphere
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  std::pair<double, Eigen::Vector3d> largest{2.0, Eigen::Vector3d::UnitZ()};  // cosine
  for (int i = 0; i < kGrid; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / kGrid;
    const double r = std::sqrt(1.0 - z * z);
    const Eigen::Vector3d centre(r * std::cos(golden * i), r * std::sin(golden * i), z);
    double nearest = -1.0;
    for (const Eigen::Vector3d& direction : directions) nearest = std::max(nearest, centre.dot(direction));
    if (nearest < largest.first) largest = {nearest, centre};
  }
  // A grid search: acos loses nothing that matters here.
  largest.first = std::acos(std::clamp(largest.first, -1.0, 1.0)) * 180.0 / std::numbers::pi;
  return largest;
}

Quantity type_a_quantity(double value, double variance, const std::string& unit) {
  Quantity out;
  out.value = value;
  out.standard_uncertainty = std::sqrt(variance);
  out.type_a = out.standard_uncertainty;
  out.unit = unit;
  return out;
}

/// The estimate from checked poses; everything of the result but where the poses came from.
void estimate(std::span<const Pose> poses, CalibrationResult& result) {
  // Shift and scale to readings of about 1: the columns of the design are then alike in LSB and in volts.
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const Pose& pose : poses) centre += pose.reading / static_cast<double>(poses.size());
  double size = 0.0;
  for (const Pose& pose : poses) size += (pose.reading - centre).squaredNorm();
  size = std::sqrt(size / static_cast<double>(poses.size()));
  if (!(size > 1e-12 * centre.norm())) throw UnusableData("norm fit: all poses read the same");

  const bool u_known =
      std::all_of(poses.begin(), poses.end(), [](const Pose& pose) { return pose.u.has_value(); });
  Scaled used;
  for (const Pose& pose : poses) {
    used.reading.push_back((pose.reading - centre) / size);
    if (u_known) used.u.push_back(*pose.u / size);
  }

  Fit fit = fit_norm(used, start(used), 0.0);
  int left_out = 0;
  const auto most = static_cast<int>(poses.size() / 4);
  bool too_many = false;
  for (int round = 0; round < 10; ++round) {
    std::vector<double> deviations;
    for (Eigen::Index i = 0; i < fit.residual.size(); ++i) {
      deviations.push_back(std::abs(fit.residual(i)) / std::sqrt(fit.variance(i)));
    }
    // 1.4826: from the median of |x| to the standard deviation of a normal distribution. The residuals of
    // nine unknowns are smaller than the scatter by the root of the degrees of freedom.
    const double dof = static_cast<double>(deviations.size()) - kUnknowns;
    if (dof < 1.0) break;
    const double scale =
        1.4826 * median(deviations) * std::sqrt(static_cast<double>(deviations.size()) / dof);
    // Residuals at the level of rounding (noise-free poses) are no outliers.
    const double limit = std::max(kOutlier * scale, 1e-13 / std::sqrt(fit.variance.minCoeff()));
    Scaled kept;
    for (std::size_t i = 0; i < used.reading.size(); ++i) {
      if (deviations[i] > limit) continue;
      kept.reading.push_back(used.reading[i]);
      if (u_known) kept.u.push_back(used.u[i]);
    }
    const auto dropped = static_cast<int>(used.reading.size() - kept.reading.size());
    if (dropped == 0) break;
    if (left_out + dropped > most || kept.reading.size() < kUnknowns) {
      too_many = true;
      break;
    }
    left_out += dropped;
    used = std::move(kept);
    fit = fit_norm(used, fit.x, 0.0);
  }

  const auto n = static_cast<int>(used.reading.size());
  const int dof = n - kUnknowns;
  std::vector<std::string> contradictions;
  std::string about_scatter;
  double factor = 1.0;  // from cofactor to covariance
  Diagnostics& diagnostics = result.diagnostics;
  const double rms = std::sqrt(fit.residual.squaredNorm() / n);
  if (u_known) {
    diagnostics.chi2 = fit.weighted_squares;
    if (dof > 0) {
      const double probability = chi2_tail(fit.weighted_squares, dof);
      diagnostics.chi2_probability = probability;
      about_scatter = fmt::format("chi2 {:.4g} for {} degrees of freedom (probability {:.2g})",
                                  fit.weighted_squares, dof, probability);
      if (!(probability >= kChi2Level)) {
        // A variance common to all poses that makes chi2 equal its expectation (Paule and Mandel).
        double low = 0.0;
        double high = std::max(1e-30, fit.residual.squaredNorm());
        for (int i = 0; i < 60; ++i) {
          const double middle = 0.5 * (low + high);
          fit = fit_norm(used, fit.x, middle);
          (fit.weighted_squares > dof ? low : high) = middle;
        }
        contradictions.push_back(about_scatter +
                                 fmt::format(": the norm is not constant within the readings' uncertainties; "
                                             "a scatter of {:.2g} g_loc was "
                                             "added to them",
                                             std::sqrt(high)));
      }
    } else {
      contradictions.push_back("nine poses for nine unknowns: nothing tests them");
    }
  } else if (dof > 0) {
    factor = fit.weighted_squares / dof;
    about_scatter =
        fmt::format("uncertainties from the scatter of the norm, {:.2g} g_loc", std::sqrt(factor));
  } else {
    factor = std::numeric_limits<double>::quiet_NaN();
    contradictions.push_back("nine poses for nine unknowns: neither tested nor with uncertainties");
  }

  const Eigen::Matrix3d b = upper(fit.x);
  const Eigen::Matrix3d s = b.triangularView<Eigen::Upper>().solve(Eigen::Matrix3d::Identity());
  // s = B^-1: ds = -s dB s, and the offset follows its own unknowns.
  Eigen::Matrix<double, 12, kUnknowns> by_unknown = Eigen::Matrix<double, 12, kUnknowns>::Zero();
  for (int i = 0; i < 6; ++i) {
    const Eigen::Matrix3d change = -s.col(kRow[i]) * s.row(kColumn[i]);
    for (int j = 0; j < 3; ++j) by_unknown.block<3, 1>(3 * j, i) = change.row(j).transpose();
  }
  by_unknown.bottomRightCorner<3, 3>().setIdentity();
  const Eigen::Matrix<double, 9, kUnknowns> jacobian = intrinsic_jacobian(s) * by_unknown;
  Covariance9 covariance = factor * (jacobian * fit.cofactor * jacobian.transpose());
  Eigen::Matrix<double, 9, 1> units = Eigen::Matrix<double, 9, 1>::Constant(size);
  units.segment<3>(3).setOnes();  // angles
  covariance = units.asDiagonal() * covariance * units.asDiagonal();

  const IntrinsicProperties intrinsic = intrinsic_properties(s);
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    result.intrinsic_sensitivity[at] =
        type_a_quantity(size * intrinsic.sensitivity(j), covariance(j, j), result.response_unit + "/g_loc");
    result.intrinsic_angle[at] = type_a_quantity(intrinsic.angle_deg(j), covariance(3 + j, 3 + j), "degree");
    result.offset[at] =
        type_a_quantity(centre(j) + size * fit.x(6 + j), covariance(6 + j, 6 + j), result.response_unit);
  }
  result.covariance_intrinsic = covariance;
  result.covariance_intrinsic_type_a = covariance;

  diagnostics.degrees_of_freedom = dof;
  diagnostics.reciprocal_condition = fit.reciprocal_condition;
  diagnostics.rank = kUnknowns;
  diagnostics.angles_used = n;

  NormResult& norm = result.norm.emplace();
  norm.poses = n;
  norm.poses_left_out = left_out;
  norm.norm_rms = rms;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& direction : fit.direction) scatter += direction * direction.transpose() / n;
  norm.sphere_coverage =
      std::clamp(3.0 * Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter).eigenvalues()(0), 0.0, 1.0);
  const auto [radius, cap] = largest_empty_cap(fit.direction);
  if (radius > kNamedCap) {
    norm.coverage_words =
        fmt::format("no pose within {:.0f} degrees of the direction (u, v, w) = ({:.1f}, {:.1f}, {:.1f})",
                    radius, cap.x(), cap.y(), cap.z());
    diagnostics.notes.push_back(norm.coverage_words);
  }
  if (radius > kDoubtfulCap) contradictions.push_back(norm.coverage_words);
  if (too_many) {
    contradictions.push_back(fmt::format(
        "more than a quarter of the poses are far from the others ({} robust standard deviations)",
        kOutlier));
  }
  if (left_out > 0) {
    diagnostics.notes.push_back(
        fmt::format("{} of {} poses left out: their norm is {} robust standard deviations off", left_out,
                    poses.size(), kOutlier));
  }
  if (contradictions.empty()) {
    result.verdict = Verdict::kUsable;
    result.why = fmt::format("{} poses, norm constant to {:.2g} (rms); {}", n, rms, about_scatter);
  } else {
    result.verdict = Verdict::kDoubtful;
    result.why = fmt::format("{}", fmt::join(contradictions, "; "));
  }
}

void analyse_into(std::span<const Pose> poses, CalibrationResult& result) {
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Pose& pose = poses[i];
    if (!pose.reading.allFinite()) {
      throw UnusableData(fmt::format("norm fit: pose {}: the reading is not a finite number", i + 1));
    }
    if (pose.u && (!pose.u->allFinite() || !(pose.u->minCoeff() > 0.0))) {
      throw UnusableData(
          fmt::format("norm fit: pose {}: the uncertainty is not a finite number greater than zero", i + 1));
    }
  }
  try {
    if (poses.size() < kUnknowns) {
      throw UnusableData(fmt::format("norm fit: {} poses; nine or more are required", poses.size()));
    }
    estimate(poses, result);
  } catch (const UnusableData& error) {
    result.verdict = Verdict::kNotUsable;
    result.why = error.what();
  }
}

}  // namespace

CalibrationResult analyse_norm(std::span<const Pose> poses) {
  CalibrationResult result;
  result.estimator = "norm";
  result.g_loc.unit = "m/s2";
  analyse_into(poses, result);
  return result;
}

CalibrationResult analyse_norm(const RunRecord& record) {
  CalibrationResult result;
  result.estimator = "norm";
  result.source = record.source;
  result.response_unit = record.response_unit;
  result.g_loc.unit = "m/s2";
  if (record.g_loc_known) {
    result.g_loc.value = record.g_loc.value_mps2;
    result.g_loc.standard_uncertainty = record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor;
    result.g_loc.type_b = result.g_loc.standard_uncertainty;
    result.g_loc_source = record.g_loc.source;
  }
  std::vector<Pose> poses;
  int clipped = 0;
  int not_finite = 0;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.flags != kFlagNone) ++result.diagnostics.angles_flagged;
    if ((dwell.flags & kFlagNotFinite) != 0U && !dwell.mean.allFinite()) {
      ++not_finite;
      continue;
    }
    if ((dwell.flags & kFlagClipped) != 0U) {
      ++clipped;
      continue;
    }
    Pose pose{.reading = dwell.mean, .u = {}};
    // An uncertainty of zero says that it is not known (a dwell without any scatter).
    if (dwell.u_mean && !(dwell.u_mean->minCoeff() <= 0.0)) pose.u = dwell.u_mean;
    poses.push_back(pose);
  }
  if (clipped > 0) result.diagnostics.notes.push_back(fmt::format("{} clipped poses left out", clipped));
  if (not_finite > 0) {
    result.diagnostics.notes.push_back(fmt::format("{} poses without finite readings left out", not_finite));
  }
  analyse_into(poses, result);
  return result;
}

}  // namespace abcal
