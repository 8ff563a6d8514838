#include "protocol/uncertainty/norm_trials.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <map>
#include <numbers>

#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/uncertainty/random_shapes.h"

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

std::vector<Eigen::Vector3d> NormTrials::drawn_directions(double scatter, RandomStream& stream) const {
  if (!fit_.solution.orientation) return fit_.solution.direction;
  double variance = fit_.model.turn_variance;
  if (std::isfinite(fit_.turn_degrees)) {
    variance *= fit_.turn_degrees / chi2_draw(fit_.turn_degrees, stream);
  } else {
    variance += scatter * scatter - fit_.model.common_variance;
  }
  const Eigen::Matrix3d& turn = fit_.solution.orientation->turn;
  std::map<std::array<double, 3>, Eigen::Vector3d> drawn;
  std::vector<Eigen::Vector3d> directions;
  for (const NormPose& pose : fit_.poses) {
    const Eigen::Vector3d& up = *pose.up;
    const auto [place, is_new] = drawn.try_emplace({up.x(), up.y(), up.z()});
    if (is_new) {
      const Eigen::Vector3d angles(stream.normal(), stream.normal(), stream.normal());
      place->second = turn.transpose() * (up + std::sqrt(variance) * angles.cross(up)).normalized();
    }
    directions.push_back(place->second);
  }
  return directions;
}

OutputVector NormTrials::error(std::uint64_t trial) const {
  RandomStream stream(seed_, StreamPurpose::kEffects, trial);
  const Eigen::VectorXd item = drawn_item(stream);
  double scatter = std::sqrt(fit_.model.common_variance);
  if (std::isfinite(fit_.scatter_degrees))
    scatter *= std::sqrt(fit_.scatter_degrees / chi2_draw(fit_.scatter_degrees, stream));
  const std::vector<Eigen::Vector3d> directions = drawn_directions(scatter, stream);
  std::vector<NormPose> poses = fit_.poses;
  Eigen::VectorXd change(3 * static_cast<Eigen::Index>(poses.size()));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    NormPose& pose = poses[i];
    const Eigen::Vector3d exact = norm_reading(pose, directions[i], item, fit_.model);
    pose.reading = norm_reading(pose, (1.0 + scatter * stream.normal()) * directions[i], item, fit_.model);
    if (pose.u)
      for (Eigen::Index j = 0; j < 3; ++j) pose.reading(j) += (*pose.u)(j)*stream.normal();
    change.segment<3>(3 * static_cast<Eigen::Index>(i)) = pose.reading - exact;
  }
  OutputVector out = OutputVector::Zero();
  Eigen::Matrix<double, 9, 1> error;
  try {
    const NormSolution solution = solve_norm(poses, fit_.model, item);
    error = solution.intrinsic - norm_outputs(item, fit_.model);
    if (solution.orientation) {
      const Eigen::Matrix3d truth =
          norm_line_sensitivity(item, fit_.model) * fit_.solution.orientation->turn.transpose();
      const Eigen::Matrix3d by_column = fit_.size * (solution.line_sensitivity - truth).transpose();
      out.head<kFirstOffset>() = by_column.reshaped();
    }
  } catch (const UnusableData&) {
    ++not_converged_;
    error = fit_.solution.gain * change;
  }
  out.segment<3>(kFirstIntrinsicSensitivity) = fit_.size * error.head<3>();
  out.segment<3>(kFirstIntrinsicAngle) = error.segment<3>(3);
  out.segment<3>(kFirstOffset) = fit_.size * error.tail<3>();
  return out;
}

void NormTrials::operator()(std::uint64_t first, std::size_t count, double* out) const {
  for (std::size_t t = 0; t < count; ++t) {
    const OutputVector outputs = error(first + t);
    for (Eigen::Index k = 0; k < kStudyOutputs; ++k)
      out[static_cast<std::size_t>(k) * count + t] = outputs(k);
  }
}

}  // namespace abcal
