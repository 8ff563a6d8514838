#include "protocol/uncertainty/type_a.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "protocol/estimators/measurement/stage_curves.h"
#include "protocol/estimators/shared/known_acs_fit.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/model/effects.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

namespace {

/// One reading as the trials need it.
struct MeasuredPose {
  StagePose stage;
  std::vector<StageTerm> terms;
  double step_sd = 0.0;  ///< radian
};

MeasuredPose pose_of(const DwellRecord& dwell, const MeasuredAcs& measured) {
  const SinCos alpha = sincos(dwell.alpha);
  MeasuredPose pose{
      StagePose::of(dwell.experiment, dwell.face, alpha.sin, alpha.cos), {}, measured.step.rad()};
  pose.terms = terms_at(measured.state, pose.stage);
  const Eigen::Index place = measured.state.place_of(visited_angle(dwell.experiment, dwell.alpha));
  if (place < 0) return pose;
  pose.terms.push_back({moving_angle_input(dwell.experiment), place, 1.0});
  pose.step_sd = measured.repeatability.rad();
  return pose;
}

/// R with R R' the covariance.
Eigen::MatrixXd root_of(const Eigen::MatrixXd& covariance) {
  constexpr double kRounding = 1e-9;
  if (covariance.size() == 0) return covariance;
  const SymmetricEigen eigen = symmetric_eigen(covariance);
  const double largest = eigen.values.maxCoeff(), least = eigen.values.minCoeff();
  if (!(std::isfinite(largest) && least >= -kRounding * std::max(largest, 0.0)))
    throw std::invalid_argument(fmt::format(
        "errors of the stage: the covariance has the eigenvalue {:.3g}; required: none below zero", least));
  return scaled_columns(eigen.vectors, eigen.values.cwiseMax(0.0).cwiseSqrt());
}

}  // namespace

MeasuredAcs MeasuredAcs::not_measured(const RunRecord& record) {
  MeasuredAcs measured;
  measured.step = measured.repeatability = record.tolerances.step;
  std::vector<double> sd;
  for (const StageEffect& effect : stage_effects()) {
    if (effect.face != 1 || effect.in_motion) continue;
    for (int i = 0; i < effect.count; ++i) {
      measured.state.names.push_back(unknown_name(effect, i));
      sd.push_back(effect.prior(record.tolerances));
    }
  }
  const auto size = static_cast<Eigen::Index>(sd.size());
  measured.state.mean = Eigen::VectorXd::Zero(size);
  measured.state.covariance =
      Eigen::Map<const Eigen::VectorXd>(sd.data(), size).cwiseAbs2().asDiagonal().toDenseMatrix();
  return measured;
}

MeasuredAcs MeasuredAcs::of(const StageRecord& record, double months) {
  MeasuredAcs measured;
  measured.state = state_after(record, months);
  const auto rms_of = [&](RepeatPart part) {
    return record.repeatabilities[static_cast<std::size_t>(part)].rms;
  };
  for (std::size_t i = 0; i < measured.state.names.size(); ++i) {
    const int part = repeat_part_of(measured.state.names[i]);
    const auto at = static_cast<Eigen::Index>(i);
    if (part >= 0) measured.state.covariance(at, at) += std::pow(rms_of(static_cast<RepeatPart>(part)), 2);
  }
  measured.repeatability = Angle::radians(rms_of(RepeatPart::kStep));
  measured.step = record.sizes.step;
  return measured;
}

MonteCarloResult run_type_a(const RunRecord& record, const MeasuredAcs& measured, std::uint64_t seed,
                            const MonteCarloOptions& options) {
  const Eigen::MatrixXd root = root_of(measured.state.covariance);
  std::vector<MeasuredPose> poses;
  std::vector<Eigen::Vector3d> readings;
  std::vector<double> weights;
  bool weighted = true;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.closing) continue;
    if (dwell.experiment < 1 || dwell.experiment > 3 || dwell.n < 1)
      throw std::invalid_argument(fmt::format("{}: a reading of experiment {}, n = {} has no place",
                                              record.source, dwell.experiment, dwell.n));
    poses.push_back(pose_of(dwell, measured));
    if (!(poses.back().step_sd >= 0.0 && std::isfinite(poses.back().step_sd)))
      throw std::invalid_argument(
          fmt::format("standard deviation of a step error = {:g} rad; required: finite, not negative",
                      poses.back().step_sd));
    readings.push_back(dwell.mean);
    weighted = weighted && dwell.u_mean && (dwell.u_mean->array() > 0.0).all();
    if (weighted)
      weights.push_back(3.0 / dwell.u_mean->squaredNorm());  // as linear_fit_given_acs weighs a record
  }
  if (!weighted) weights.clear();

  const TrialBlock block = [&](std::uint64_t first, std::size_t count, double* out) {
    std::vector<Eigen::Vector3d> gravity(poses.size());
    Eigen::VectorXd normal(root.cols());
    for (std::size_t t = 0; t < count; ++t) {
      RandomStream stream(seed, StreamPurpose::kTypeA, first + t);
      for (double& z : normal) z = stream.normal();
      const Eigen::VectorXd state = measured.state.mean + product_with_vector(root, normal);
      for (std::size_t i = 0; i < poses.size(); ++i) {
        const MeasuredPose& pose = poses[i];
        StageInputs inputs = StageInputs::Zero();
        for (const StageTerm& term : pose.terms) inputs(term.input) += term.coefficient * state(term.place);
        inputs(moving_angle_input(pose.stage.experiment)) += pose.step_sd * stream.normal();
        gravity[i] = gravity_alone(pose.stage, inputs);
      }
      const KnownAcsFit fit = linear_fit_given_acs(gravity, readings, weights);
      const OutputVector values = to_vector(outputs_of(fit.sensitivity_matrix, fit.offset));
      for (std::size_t k = 0; k < kStudyOutputs; ++k)
        out[k * count + t] = values(static_cast<Eigen::Index>(k));
    }
  };
  return run_monte_carlo(kStudyOutputs, block, options);
}

}  // namespace abcal
