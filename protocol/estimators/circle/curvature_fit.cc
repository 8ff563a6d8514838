#include "protocol/estimators/circle/curvature_fit.h"

#include <Eigen/LU>
#include <cmath>

#include "protocol/model/stage_model.h"

namespace abcal {
namespace {

/// A shape is not determined if less than this share (squared) is left after constant and first harmonic at
/// the angles.
constexpr double kDetermined = 1e-4;
/// Two shapes that differ by less than this share (squared) cannot be separated: k3 alone is fitted.
constexpr double kToldApart = 1e-3;
/// The slope of S y^3 over all directions of gravity.
constexpr double kLineSlope = 0.6;

}  // namespace

CurvatureFit::CurvatureFit(std::span<const DwellRecord* const> dwells, std::span<const ReadingSeries> series,
                           std::span<const HarmonicFit> fits, const AbcOutputs& outputs,
                           std::array<bool, 2> wanted) {
  const Eigen::Matrix3d s = sensitivity_matrix_of(outputs);
  const auto count = static_cast<Eigen::Index>(dwells.size());
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    shape_[at] = Eigen::Matrix2Xd::Zero(2, count);
    weights_[at] = Eigen::Matrix2Xd::Zero(2, count);
  }
  for (Eigen::Index n = 0; n < count; ++n) {
    const DwellRecord& dwell = *dwells[static_cast<std::size_t>(n)];
    const SinCos alpha = sincos(dwell.alpha);
    const Eigen::Vector3d g =
        gravity_alone(StagePose::of(dwell.experiment, dwell.face, alpha.sin, alpha.cos), StageInputs::Zero());
    for (int j = 0; j < 3; ++j) {
      const double size = s.row(j).norm();
      const double y = s.row(j).dot(g) / size;
      shape_[static_cast<std::size_t>(j)].col(n) << size * y * y, size * y * y * y;
    }
  }
  for (int j = 0; j < 3; ++j) fit_output(j, dwells, series, fits, wanted);
  for (int j = 0; j < 3; ++j) {
    // ABC result for each shape minus its line response: k2/3 in the offset, 3/5 k3 of the row.
    for (int m = 0; m < 2; ++m) {
      const Eigen::Index column = 2 * j + m;
      if (cofactor_(column, column) == 0.0) continue;
      AbcCoefficients coefficients = AbcCoefficients::Zero();
      for (int e = 0; e < 3; ++e) {
        const auto i = static_cast<std::size_t>(3 * e + j);
        Eigen::Vector3d change = Eigen::Vector3d::Zero();
        for (Eigen::Index n = 0; n < count; ++n) {
          const int place = series[i].place_of[static_cast<std::size_t>(n)];
          if (place >= 0) change += fits[i].estimator.col(place) * shape_[static_cast<std::size_t>(j)](m, n);
        }
        coefficients.segment<3>(static_cast<Eigen::Index>(3 * i)) << change(1), change(2), change(0);
      }
      correction_.col(column) = abc_outputs(coefficients);
      if (m == 0) {
        correction_(offset_index(j), column) -= s.row(j).norm() / 3.0;
      } else {
        correction_.block<3, 1>(3 * j, column) -= kLineSlope * s.row(j).transpose();
      }
    }
  }
}

void CurvatureFit::fit_output(int output, std::span<const DwellRecord* const> dwells,
                              std::span<const ReadingSeries> series, std::span<const HarmonicFit> fits,
                              std::array<bool, 2> wanted) {
  const auto j = static_cast<std::size_t>(output);
  const auto count = static_cast<Eigen::Index>(dwells.size());
  Eigen::Matrix2Xd left = Eigen::Matrix2Xd::Zero(2, count);  // the shapes after constant and first harmonic
  Eigen::VectorXd weight = Eigen::VectorXd::Zero(count);
  Eigen::VectorXd residual = Eigen::VectorXd::Zero(count);
  Eigen::Vector2d whole = Eigen::Vector2d::Zero();
  for (std::size_t e = 0; e < 3; ++e) {
    const ReadingSeries& of = series[3 * e + j];
    std::vector<double> shapes[2] = {std::vector<double>(of.readings.size()),
                                     std::vector<double>(of.readings.size())};
    for (Eigen::Index n = 0; n < count; ++n) {
      const int place = of.place_of[static_cast<std::size_t>(n)];
      for (int m = 0; place >= 0 && m < 2; ++m) shapes[m][static_cast<std::size_t>(place)] = shape_[j](m, n);
    }
    const HarmonicFit of_shape[2] = {fit_harmonics(of.alpha, shapes[0], of.u, 1, of.by_motion),
                                     fit_harmonics(of.alpha, shapes[1], of.u, 1, of.by_motion)};
    for (Eigen::Index n = 0; n < count; ++n) {
      const int place = of.place_of[static_cast<std::size_t>(n)];
      if (place < 0) continue;
      const double u = of.u.empty() ? 1.0 : of.u[static_cast<std::size_t>(place)];
      weight(n) = 1.0 / (u * u);
      residual(n) = fits[3 * e + j].residuals(place);
      for (int m = 0; m < 2; ++m) {
        left(m, n) = of_shape[m].residuals(place);
        whole(m) += weight(n) * shape_[j](m, n) * shape_[j](m, n);
      }
    }
  }
  const Eigen::Matrix2Xd weighted = left * weight.asDiagonal();
  Eigen::Matrix2d normal = weighted * left.transpose();
  std::array<bool, 2> use = wanted;
  for (std::size_t m = 0; m < 2; ++m) {
    const auto at = static_cast<Eigen::Index>(m);
    use[m] = use[m] && normal(at, at) > kDetermined * whole(at);
  }
  if (use[0] && use[1] && normal.determinant() < kToldApart * normal(0, 0) * normal(1, 1)) use[0] = false;
  Eigen::Matrix2d inverse = Eigen::Matrix2d::Zero();
  if (use[0] && use[1]) {
    inverse = normal.inverse();
  } else if (use[0]) {
    inverse(0, 0) = 1.0 / normal(0, 0);
  } else if (use[1]) {
    inverse(1, 1) = 1.0 / normal(1, 1);
  }
  weights_[j] = inverse * weighted;
  k_.segment<2>(2 * output) = weights_[j] * residual;
  cofactor_.block<2, 2>(2 * output, 2 * output) = inverse;
}

AbcOutputs CurvatureFit::at_zero(const AbcOutputs& line) const {
  AbcOutputs out = line;
  for (int j = 0; j < 3; ++j) {
    out.segment<3>(3 * j) /= 1.0 + kLineSlope * k_(2 * j + 1);
    out(offset_index(j)) -= out.segment<3>(3 * j).norm() * k_(2 * j) / 3.0;
  }
  return out;
}

CurvatureFit::Vector6 CurvatureFit::change_of_k(std::size_t first,
                                                std::span<const Eigen::Vector3d> change) const {
  Vector6 out = Vector6::Zero();
  for (std::size_t i = 0; i < change.size(); ++i) {
    for (int j = 0; j < 3; ++j) {
      out.segment<2>(2 * j) +=
          weights_[static_cast<std::size_t>(j)].col(static_cast<Eigen::Index>(first + i)) * change[i](j);
    }
  }
  return out;
}

std::array<ReadingSeries, 9> CurvatureFit::cleaned(std::span<const ReadingSeries> series) const {
  std::array<ReadingSeries, 9> out;
  for (std::size_t i = 0; i < 9; ++i) {
    out[i] = series[i];
    const auto j = static_cast<Eigen::Index>(i % 3);
    for (std::size_t n = 0; n < out[i].place_of.size(); ++n) {
      const int place = out[i].place_of[n];
      if (place < 0) continue;
      out[i].readings[static_cast<std::size_t>(place)] -=
          k_.segment<2>(2 * j).dot(shape_[i % 3].col(static_cast<Eigen::Index>(n)));
    }
  }
  return out;
}

}  // namespace abcal
