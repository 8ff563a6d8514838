#include "protocol/uncertainty/norm_trials.h"

#include <cmath>
#include <numbers>
#include <vector>

#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/uncertainty/random_shapes.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {
namespace {

constexpr Eigen::Index kBasic = 9;
constexpr double kDegrees = 180.0 / std::numbers::pi;

}  // namespace

NormTrials::NormTrials(const NormFit& fit, const EffectSizes& sizes, std::uint64_t seed)
    : fit_(fit), sizes_(sizes), seed_(seed) {}

/// The unknowns of an item that has the found ones where nothing is stated.
Eigen::VectorXd NormTrials::drawn_item(RandomStream& stream) const {
  Eigen::VectorXd item = fit_.solution.unknowns;
  const std::vector<NormUnknown> effects = norm_unknowns(fit_.model);
  Eigen::Index at = kBasic;
  for (int output = 0; output < 3; ++output)
    for (const NormUnknown& effect : effects)
      item(at++) = effect.prior * standard_draw(sizes_.shape_of(effect.key), stream);
  if (fit_.model.orthogonality > 0.0) {
    // The statement is of the axes without effects.
    Eigen::VectorXd linear = item;
    linear.tail(linear.size() - kBasic).setZero();
    Eigen::Matrix<double, 6, 1> intrinsic = norm_outputs(linear, fit_.model).head<6>();
    for (Eigen::Index k = 3; k < 6; ++k)
      intrinsic(k) = 90.0 + kDegrees * fit_.model.orthogonality *
                                standard_draw(sizes_.shape_of("orthogonality_deg"), stream);
    item.head<6>() = norm_triangle(intrinsic);
  }
  return item;
}

Eigen::Matrix<double, 9, 1> NormTrials::error(std::uint64_t trial) const {
  RandomStream stream(seed_, StreamPurpose::kEffects, trial);
  const Eigen::VectorXd item = drawn_item(stream);
  double scatter = std::sqrt(fit_.model.common_variance);
  if (std::isfinite(fit_.scatter_degrees))
    scatter *= std::sqrt(fit_.scatter_degrees / chi2_draw(fit_.scatter_degrees, stream));
  std::vector<NormPose> poses = fit_.poses;
  Eigen::VectorXd change(3 * static_cast<Eigen::Index>(poses.size()));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    NormPose& pose = poses[i];
    const Eigen::Vector3d& direction = fit_.solution.direction[i];
    const Eigen::Vector3d exact = norm_reading(pose, direction, item, fit_.model);
    pose.reading = norm_reading(pose, (1.0 + scatter * stream.normal()) * direction, item, fit_.model);
    if (pose.u)
      for (Eigen::Index j = 0; j < 3; ++j) pose.reading(j) += (*pose.u)(j)*stream.normal();
    change.segment<3>(3 * static_cast<Eigen::Index>(i)) = pose.reading - exact;
  }
  Eigen::Matrix<double, 9, 1> error;
  try {
    error = solve_norm(poses, fit_.model, item).intrinsic - norm_outputs(item, fit_.model);
  } catch (const UnusableData&) {
    ++not_converged_;
    error = fit_.solution.gain * change;
  }
  for (const Eigen::Index k : {0, 1, 2, 6, 7, 8}) error(k) *= fit_.size;
  return error;
}

void NormTrials::operator()(std::uint64_t first, std::size_t count, double* out) const {
  for (std::size_t t = 0; t < count; ++t) {
    const Eigen::Matrix<double, 9, 1> found = error(first + t);
    OutputVector outputs = OutputVector::Zero();
    outputs.segment<3>(kFirstIntrinsicSensitivity) = found.head<3>();
    outputs.segment<3>(kFirstIntrinsicAngle) = found.segment<3>(3);
    outputs.segment<3>(kFirstOffset) = found.tail<3>();
    for (Eigen::Index k = 0; k < kStudyOutputs; ++k)
      out[static_cast<std::size_t>(k) * count + t] = outputs(k);
  }
}

}  // namespace abcal
