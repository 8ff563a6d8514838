#include "protocol/uncertainty/type_a.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "protocol/estimators/measurement/stage_curves.h"
#include "protocol/estimators/shared/known_acs_sums.h"
#include "protocol/linear/products.h"
#include "protocol/linear/semidefinite_root.h"
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
  Eigen::Vector3d reading = Eigen::Vector3d::Zero();
  double weight = 1.0;

  /// Gravity with errors of the stage and a step error.
  Eigen::Vector3d gravity(const Eigen::VectorXd& state, double step_error) const {
    StageInputs inputs = StageInputs::Zero();
    for (const StageTerm& term : terms) inputs(term.input) += term.coefficient * state(term.place);
    inputs(moving_angle_input(stage.experiment)) += step_error;
    return gravity_alone(stage, inputs);
  }
};

MeasuredPose pose_of(const DwellRecord& dwell, const MeasuredAcs& measured) {
  const SinCos alpha = sincos(dwell.alpha);
  MeasuredPose pose{
      StagePose::of(dwell.experiment, dwell.face, alpha.sin, alpha.cos), {}, measured.step.rad(), dwell.mean};
  pose.terms = terms_at(measured.state, pose.stage);
  const Eigen::Index place = measured.state.place_of(visited_angle(dwell.experiment, dwell.alpha));
  if (place < 0) return pose;
  pose.terms.push_back({moving_angle_input(dwell.experiment), place, 1.0});
  pose.step_sd = measured.repeatability.rad();
  return pose;
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

namespace {

std::vector<MeasuredPose> poses_of(const RunRecord& record, const MeasuredAcs& measured) {
  std::vector<MeasuredPose> poses;
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
    weighted = weighted && dwell.u_mean && (dwell.u_mean->array() > 0.0).all();
    if (weighted)
      poses.back().weight = 3.0 / dwell.u_mean->squaredNorm();  // as linear_fit_given_acs weighs a record
  }
  if (!weighted)
    for (MeasuredPose& pose : poses) pose.weight = 1.0;
  return poses;
}

void write_outputs(const KnownAcsFit& fit, std::size_t count, std::size_t trial, double* out) {
  const OutputVector values = to_vector(outputs_of(fit.sensitivity_matrix, fit.offset));
  for (std::size_t k = 0; k < kStudyOutputs; ++k)
    out[k * count + trial] = values(static_cast<Eigen::Index>(k));
}

/// Number of the sums of a fit that depend on gravity: x^2, xy, xz, y^2, yz, z^2, x, y, z, and x, y, z times
/// each of the three readings.
constexpr Eigen::Index kSums = 18;
using Sums = Eigen::Matrix<double, kSums, 1>;

Sums varying(const KnownAcsSums& of) {
  Sums sums;
  Eigen::Index at = 0;
  for (Eigen::Index i = 0; i < 3; ++i)
    for (Eigen::Index k = i; k < 4; ++k) sums(at++) = of.normal(i, k);
  for (Eigen::Index i = 0; i < 3; ++i)
    for (Eigen::Index k = 0; k < 3; ++k) sums(at++) = of.right(i, k);
  return sums;
}

/// Sets the sums that depend on gravity; the others stay.
void set_varying(const Sums& sums, KnownAcsSums& to) {
  Eigen::Index at = 0;
  for (Eigen::Index i = 0; i < 3; ++i)
    for (Eigen::Index k = i; k < 4; ++k) to.normal(i, k) = to.normal(k, i) = sums(at++);
  for (Eigen::Index i = 0; i < 3; ++i)
    for (Eigen::Index k = 0; k < 3; ++k) to.right(i, k) = sums(at++);
}

/// The distribution of the sums of a trial's fit. The errors of the stage and the steps are linear in
/// independent standard normal numbers. Along each of them the sums are computed at -1, 0 and 1: half the
/// difference is their derivative, and half the second difference their mean change by its square.
class DrawnSums {
 public:
  DrawnSums(const std::vector<MeasuredPose>& poses, const Eigen::VectorXd& mean, const Eigen::MatrixXd& root)
      : readings_(poses.size()) {
    const auto sums_at = [&](const Eigen::VectorXd& state) {
      KnownAcsSums sums;
      for (const MeasuredPose& pose : poses) sums.add(pose.gravity(state, 0.0), pose.reading, pose.weight);
      return sums;
    };
    centre_ = sums_at(mean);
    const Sums at_mean = varying(centre_);
    mean_ = at_mean;
    Eigen::MatrixXd derivatives(root.cols() + static_cast<Eigen::Index>(poses.size()), kSums);
    const auto add = [&](Eigen::Index row, const Sums& below, const Sums& at, const Sums& above) {
      derivatives.row(row) = 0.5 * (above - below).transpose();
      mean_ += 0.5 * (above + below) - at;
    };
    for (Eigen::Index k = 0; k < root.cols(); ++k)
      add(k, varying(sums_at(mean - root.col(k))), at_mean, varying(sums_at(mean + root.col(k))));
    // A step error changes the gravity of its own pose alone.
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const MeasuredPose& pose = poses[i];
      const auto of_pose = [&](double step_error) {
        KnownAcsSums sums;
        sums.add(pose.gravity(mean, step_error), pose.reading, pose.weight);
        return varying(sums);
      };
      add(root.cols() + static_cast<Eigen::Index>(i), of_pose(-pose.step_sd), of_pose(0.0),
          of_pose(pose.step_sd));
    }
    const Eigen::MatrixXd covariance = transposed_product(derivatives, derivatives);
    // The sums have different units: the root is that of their correlation.
    const Eigen::VectorXd sd = covariance.diagonal().cwiseSqrt();
    const Eigen::VectorXd inverse = (sd.array() > 0.0).select(sd.cwiseInverse(), 0.0);
    root_ = scaled_rows(sd, semidefinite_root(scaled_on_both_sides(covariance, inverse)));
  }

  KnownAcsFit draw(RandomStream& stream) const {
    Sums normal;
    for (double& z : normal) z = stream.normal();
    KnownAcsSums sums = centre_;
    set_varying(mean_ + root_ * normal, sums);
    return fit_of_sums(sums, readings_);
  }

 private:
  std::size_t readings_;
  KnownAcsSums centre_;  ///< With all errors at their means.
  Sums mean_;
  Eigen::Matrix<double, kSums, kSums> root_;
};

bool are_small(const std::vector<MeasuredPose>& poses, const Eigen::MatrixXd& covariance) {
  const double most = Angle::degrees(kMostSummedTypeADegrees).rad();
  return (covariance.diagonal().array() <= most * most).all() &&
         std::ranges::all_of(poses, [&](const MeasuredPose& pose) { return pose.step_sd <= most; });
}

}  // namespace

MonteCarloResult run_type_a(const RunRecord& record, const MeasuredAcs& measured, std::uint64_t seed,
                            const MonteCarloOptions& options, TypeADraw draw) {
  const Eigen::MatrixXd root = root_of_covariance(measured.state);
  const std::vector<MeasuredPose> poses = poses_of(record, measured);
  if (draw == TypeADraw::kSums && are_small(poses, measured.state.covariance)) {
    const DrawnSums sums(poses, measured.state.mean, root);
    return run_monte_carlo(
        kStudyOutputs,
        [&](std::uint64_t first, std::size_t count, double* out) {
          for (std::size_t t = 0; t < count; ++t) {
            RandomStream stream(seed, StreamPurpose::kTypeA, first + t);
            write_outputs(sums.draw(stream), count, t, out);
          }
        },
        options);
  }
  const TrialBlock block = [&](std::uint64_t first, std::size_t count, double* out) {
    Eigen::VectorXd normal(root.cols());
    for (std::size_t t = 0; t < count; ++t) {
      RandomStream stream(seed, StreamPurpose::kTypeA, first + t);
      for (double& z : normal) z = stream.normal();
      const Eigen::VectorXd state = measured.state.mean + product_with_vector(root, normal);
      KnownAcsSums sums;
      for (const MeasuredPose& pose : poses)
        sums.add(pose.gravity(state, pose.step_sd * stream.normal()), pose.reading, pose.weight);
      write_outputs(fit_of_sums(sums, poses.size()), count, t, out);
    }
  };
  return run_monte_carlo(kStudyOutputs, block, options);
}

}  // namespace abcal
