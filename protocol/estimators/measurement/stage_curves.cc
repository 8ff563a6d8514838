#include "protocol/estimators/measurement/stage_curves.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/model/effects.h"

namespace abcal {
namespace {

/// A pose at which an axis that moves is at an angle.
StagePose pose_at(char axis, double angle_deg) {
  const SinCos angle = sincos(Angle::degrees(angle_deg));
  return StagePose::of(axis == 'X' ? 1 : 3, 1, angle.sin, angle.cos);
}

/// Derivatives of an input of the stage at a pose by the unknowns of a state.
Eigen::RowVectorXd input_row(const StageState& state, const StagePose& pose, int input) {
  Eigen::RowVectorXd row = Eigen::RowVectorXd::Zero(state.size());
  for (const StageTerm& term : terms_at(state, pose))
    if (term.input == input) row(term.place) += term.coefficient;
  return row;
}

std::vector<StageCurvePoint> less_mean(const StageState& state, Eigen::MatrixXd rows,
                                       const std::vector<double>& angles) {
  const Eigen::RowVectorXd mean = rows.colwise().mean();
  rows.rowwise() -= mean;
  const Eigen::VectorXd values = product_with_vector(rows, state.mean);
  const Eigen::MatrixXd carried = product(rows, state.covariance);
  std::vector<StageCurvePoint> out;
  for (Eigen::Index i = 0; i < rows.rows(); ++i)
    out.push_back({angles[static_cast<std::size_t>(i)], values(i),
                   std::sqrt(std::max(0.0, carried.row(i).dot(rows.row(i))))});
  return out;
}

}  // namespace

Eigen::MatrixXd root_of_covariance(const StageState& state) {
  constexpr double kRounding = 1e-9;
  if (state.covariance.size() == 0) return state.covariance;
  const SymmetricEigen eigen = symmetric_eigen(state.covariance);
  const double largest = eigen.values.maxCoeff(), least = eigen.values.minCoeff();
  if (!(std::isfinite(largest) && least >= -kRounding * std::max(largest, 0.0)))
    throw std::invalid_argument(fmt::format(
        "errors of the stage: the covariance has the eigenvalue {:.3g}; required: none below zero", least));
  return scaled_columns(eigen.vectors, eigen.values.cwiseMax(0.0).cwiseSqrt());
}

std::vector<StageTerm> terms_at(const StageState& state, const StagePose& pose) {
  std::vector<StageTerm> terms;
  for (const StageEffect& effect : stage_effects()) {
    for (int i = 0; i < effect.count; ++i) {
      const Eigen::Index place = state.place_of(unknown_name(effect, i));
      if (place < 0) continue;
      const StageShare share = effect.share(pose, i);
      if (share.value != 0.0) terms.push_back({share.input, place, share.value});
      if (share.second_value != 0.0) terms.push_back({share.second_input, place, share.second_value});
    }
  }
  return terms;
}

std::vector<StageCurvePoint> angle_error(const StageState& state, char axis) {
  std::vector<double> angles;
  std::vector<Eigen::Index> places;
  for (const AxisAngle& angle : state.angles) {
    if (angle.axis != axis || angle.microdegrees == 0) continue;
    angles.push_back(angle.degrees());
    places.push_back(state.place_of(angle));
  }
  if (angles.empty()) return {};
  Eigen::MatrixXd rows(static_cast<Eigen::Index>(angles.size()), state.size());
  for (std::size_t i = 0; i < angles.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    rows.row(at) = input_row(state, pose_at(axis, angles[i]), axis == 'X' ? kInputAngleX : kInputAngleZ);
    rows(at, places[i]) += 1.0;
  }
  return less_mean(state, std::move(rows), angles);
}

std::vector<StageCurvePoint> wobble(const StageState& state, char axis, int direction) {
  constexpr int kStep = 5;
  const int input = (axis == 'X' ? kInputTiltXy : kInputTiltZx) + direction - 1;
  std::vector<double> angles;
  Eigen::MatrixXd rows(360 / kStep, state.size());
  for (int angle = 0; angle < 360; angle += kStep) {
    rows.row(angle / kStep) = input_row(state, pose_at(axis, angle), input);
    angles.push_back(angle);
  }
  return less_mean(state, std::move(rows), angles);
}

}  // namespace abcal
