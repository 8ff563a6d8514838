#include "protocol/estimators/joint/norm_agreement.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <map>
#include <vector>

#include "protocol/estimators/norm/norm_model.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/quantities/output_names.h"
#include "protocol/statistics/distributions.h"
#include "protocol/statistics/median.h"

namespace abcal {
namespace {

using Nine = Eigen::Matrix<double, 9, 1>;
using Nine3 = Eigen::Matrix<double, 9, 3>;

/// Share of the norm fit's covariance below which a direction of the difference is not tested.
constexpr double kTestedShare = 0.05;
/// Largest uncertainties from the norm alone at which both fits are still linear: an error of the angle
/// enters the norm with its square, 3e-6. Four angles in each experiment exceed them: these are six
/// directions, which hardly determine the angles between the axes.
constexpr double kLargestSensitivityU = 1e-3;  // relative
constexpr double kLargestAngleU = 0.1;         // degree

/// The model about the solution of the joint fit, at a perfect stage: errors of the stage would change the
/// derivatives by their own size only, 1e-4.
class ModelReadings {
 public:
  ModelReadings(std::span<const EffectReading> readings, const EffectFit& fit,
                const EffectFitOptions& options)
      : readings_(readings), fit_(fit), options_(options) {
    for (int j = 0; j < 3; ++j) line_.row(j) = fit.line.segment<3>(3 * j).transpose();
    rows_ = fit.unit.cwiseInverse().asDiagonal() * line_;
    std::vector<ReadingArrival> arrivals;
    for (std::size_t n = 0; n < readings.size(); ++n) {
      poses_.push_back(StagePose::of(readings[n].experiment, readings[n].face, readings[n].sin_alpha,
                                     readings[n].cos_alpha));
      gravity_.push_back(gravity_at(poses_.back(), StageInputs::Zero()));
      points_.push_back({readings[n].t, rows_ * gravity_.back().g, Eigen::Vector3d::Zero()});
      arrivals.push_back({readings[n].experiment, readings[n].face, readings[n].arrival});
      noise_.emplace_back(readings[n].u.cwiseProduct(fit.noise.white));
    }
    const double hysteresis = options.sizes.hysteresis;
    if (!(hysteresis > 0.0)) return;
    const std::vector<Eigen::Vector3d> signs = signs_by_sizes(std::move(arrivals), rows_, options.sizes);
    for (std::size_t n = 0; n < readings.size(); ++n) {
      points_[n].came_from = signs[n];
      const Eigen::Array3d left = (1.0 - signs[n].array().square()).max(0.0);
      noise_[n] = (noise_[n].array().square() + left * (hysteresis * fit.unit.array()).square()).sqrt();
    }
  }

  const Eigen::Matrix3d& line() const { return line_; }

  /// The readings as poses of the norm fit, scaled.
  std::vector<NormPose> poses(const Eigen::Vector3d& centre, double size) const {
    std::vector<NormPose> out;
    for (std::size_t n = 0; n < readings_.size(); ++n) {
      out.push_back({(readings_[n].value - centre) / size, Eigen::Vector3d(noise_[n] / size), readings_[n].t,
                     points_[n].came_from});
    }
    return out;
  }

  /// d V d', the covariance of the linear functions d (9 x 3 N) of the readings.
  Covariance9 covariance_of(const NormGain& d) const {
    Covariance9 out = Covariance9::Zero();
    add_noise(d, out);
    add_process(d, out);
    add_steps(d, out);
    add_stage(d, out);
    add_item(d, out);
    return out;
  }

 private:
  auto block(const NormGain& d, std::size_t n) const {
    return d.middleCols<3>(3 * static_cast<Eigen::Index>(n));
  }
  static void add(const Nine& column, double sd, Covariance9& out) {
    out.noalias() += (sd * sd) * (column * column.transpose());
  }

  void add_noise(const NormGain& d, Covariance9& out) const {
    for (std::size_t n = 0; n < readings_.size(); ++n) {
      const Nine3 scaled = block(d, n) * noise_[n].asDiagonal();
      out.noalias() += scaled * scaled.transpose();
    }
  }

  /// An Ornstein-Uhlenbeck process: sums over all pairs by one pass in the order of time.
  void add_process(const NormGain& d, Covariance9& out) const {
    if (!(fit_.noise.tau > 0.0)) return;
    const double intervals = static_cast<double>(std::max<std::size_t>(readings_.size(), 2) - 1);
    for (int j = 0; j < 3; ++j) {
      std::vector<double> u;
      for (const EffectReading& at : readings_) u.push_back(at.u(j));
      const double variance = std::pow(fit_.noise.tau * median(std::move(u)), 2);
      Nine sum = Nine::Zero();
      for (std::size_t n = 0; n < readings_.size(); ++n) {
        const double distance =
            n == 0 ? 0.0 : std::max(0.0, (readings_[n].t - readings_[n - 1].t) * intervals);
        const Nine here = d.col(3 * static_cast<Eigen::Index>(n) + j);
        sum = here + std::exp(-distance / fit_.noise.rho) * sum;
        out.noalias() +=
            variance * (here * sum.transpose() + sum * here.transpose() - here * here.transpose());
      }
    }
  }

  Eigen::Vector3d by_input(std::size_t n, int input) const { return line_ * gravity_[n].by_input.col(input); }

  void add_steps(const NormGain& d, Covariance9& out) const {
    const double sd = step_prior(options_.sizes);
    std::map<int, Nine> shared;
    for (std::size_t n = 0; n < readings_.size(); ++n) {
      const Nine column = block(d, n) * by_input(n, moving_angle_input(readings_[n].experiment));
      if (const int map = readings_[n].map; map >= 0) {
        shared.try_emplace(map, Nine::Zero()).first->second += column;
      } else {
        add(column, sd, out);
      }
    }
    for (const auto& [map, column] : shared) add(column, sd, out);
  }

  /// A measured alignment has the uncertainty of its measurement.
  double prior_of(const StageEffect& effect, int i) const {
    for (const EffectUnknown& unknown : fit_.unknowns) {
      if (unknown.effect == effect.name && i-- == 0) return unknown.prior_sd;
    }
    return 0.0;  // Not in the fit.
  }

  void add_stage(const NormGain& d, Covariance9& out) const {
    for (const StageEffect& effect : stage_effects()) {
      for (int i = 0; i < effect.count; ++i) {
        const double prior = prior_of(effect, i);
        if (!(prior > 0.0)) continue;
        Nine column = Nine::Zero();
        for (std::size_t n = 0; n < readings_.size(); ++n) {
          const StageShare share = effect.share(poses_[n], i);
          if (share.value == 0.0 && share.second_value == 0.0) continue;
          column.noalias() += block(d, n) * (share.value * by_input(n, share.input) +
                                             share.second_value * by_input(n, share.second_input));
        }
        add(column, prior, out);
      }
    }
  }

  void add_item(const NormGain& d, Covariance9& out) const {
    for (const ItemEffect& effect : item_effects()) {
      const bool fitted = std::any_of(fit_.unknowns.begin(), fit_.unknowns.end(),
                                      [&](const EffectUnknown& u) { return u.effect == effect.name; });
      if (!fitted) continue;
      for (int j = 0; j < 3; ++j) {
        for (int i = 0; i < effect.count; ++i) {
          Nine column = Nine::Zero();
          for (std::size_t n = 0; n < readings_.size(); ++n)
            column += (effect.share(points_[n], j, i).value * fit_.unit(j)) *
                      d.col(3 * static_cast<Eigen::Index>(n) + j);
          add(column, effect.prior(options_.sizes), out);
        }
      }
    }
  }

  std::span<const EffectReading> readings_;
  const EffectFit& fit_;
  const EffectFitOptions& options_;
  Eigen::Matrix3d line_, rows_;
  std::vector<StagePose> poses_;
  std::vector<GravityAt> gravity_;
  std::vector<ItemPoint> points_;
  std::vector<Eigen::Vector3d> noise_;  ///< R, with what the signs of the hysteresis leave unknown.
};

double autocorrelation_of(const NormSolution& norm) {
  const Eigen::ArrayXd e = norm.residual.array() / norm.variance.array().sqrt();
  const Eigen::Index pairs = e.size() - 1;
  if (pairs < 1) return 0.0;
  return ((e.head(pairs) * e.tail(pairs)).sum() - norm.successive_products) /
         std::sqrt(static_cast<double>(pairs));
}

}  // namespace

NormAgreement compare_norm_with_joint(std::span<const EffectReading> readings, const EffectFit& fit,
                                      const EffectFitOptions& options) {
  NormAgreement out;
  if (!options.sweeps.empty()) {
    out.why_not = Message("where the stage turns, centripetal acceleration and delays add to the norm");
    return out;
  }
  const ModelReadings model(readings, fit, options);
  const double size = fit.unit.mean();
  const Eigen::Vector3d centre = fit.line.tail<3>();
  NormSolution norm;
  try {
    const NormModel assumed{.sizes = options.sizes,
                            .drift = options.drift,
                            .nonlinearity = options.nonlinearity,
                            .orthogonality = 0.0,
                            .common_variance = 0.0};
    norm = solve_norm(model.poses(centre, size), assumed);
  } catch (const UnusableData& error) {
    out.why_not = error.message();
    return out;
  }
  Nine units = Nine::Constant(size);
  units.segment<3>(3).setOnes();                               // angles
  const Nine u_norm = norm.covariance.diagonal().cwiseSqrt();  // for readings of about 1
  if (!(u_norm.head<3>().maxCoeff() < kLargestSensitivityU &&
        u_norm.segment<3>(3).maxCoeff() < kLargestAngleU)) {
    out.why_not = Message(
        "{angles} angles determine the intrinsic outputs only to {sensitivity:.2g} (sensitivities) and "
        "{degrees:.2g} degrees by the norm alone",
        readings.size(), u_norm.head<3>().maxCoeff(), u_norm.segment<3>(3).maxCoeff());
    return out;
  }
  Nine of_norm = units.cwiseProduct(norm.intrinsic);
  of_norm.tail<3>() += centre;
  const IntrinsicProperties intrinsic = intrinsic_properties(model.line());
  Nine of_joint;
  of_joint << intrinsic.sensitivity, intrinsic.angle_deg, fit.line.tail<3>();
  out.difference = of_norm - of_joint;

  const NormGain gain_difference =
      scaled_rows(units, norm.gain) / size - product(intrinsic_jacobian(model.line()), fit.gain.transpose());
  const Covariance9 of_difference = model.covariance_of(gain_difference);
  const Covariance9 covariance_norm = scaled_on_both_sides(norm.covariance, units);
  out.standard_uncertainty = of_difference.diagonal().cwiseMax(0.0).cwiseSqrt();
  // Each output in units of its own uncertainty, so that degrees and counts are comparable.
  const Nine scale = covariance_norm.diagonal().cwiseSqrt().cwiseInverse();
  const SymmetricEigen eigen = generalized_eigen(scaled_on_both_sides(of_difference, scale),
                                                 scaled_on_both_sides(covariance_norm, scale));
  const Nine scaled = scale.cwiseProduct(out.difference);
  for (Eigen::Index k = 0; k < 9; ++k) {
    const double share = eigen.values(k);
    if (!(share > kTestedShare)) continue;
    const double along = eigen.vectors.col(k).dot(scaled);
    out.statistic += along * along / share;
    ++out.degrees_of_freedom;
  }
  out.done = true;
  const int free = static_cast<int>(readings.size()) - 9;
  if (free > 0) out.norm_probability = chi2_tail(norm.weighted_squares, free);
  out.norm_autocorrelation = autocorrelation_of(norm);
  // Two of the three readings at each angle show the noise: the third determines the step error.
  const double of_noise = fit.noise.white_estimated
                              ? std::max(1.0, 2.0 * static_cast<double>(readings.size()) - 12.0)
                              : std::numeric_limits<double>::infinity();
  if (out.degrees_of_freedom > 0) out.probability = f_tail(out.statistic, out.degrees_of_freedom, of_noise);
  return out;
}

Message words_of(const NormAgreement& test, const std::string& response_unit) {
  std::vector<Message> sizes;
  for (Eigen::Index i = 0; i < 9; ++i) {
    const double u = test.standard_uncertainty(i);
    if (!(std::abs(test.difference(i)) > 3.0 * u)) continue;
    const std::string unit = i < 3 ? response_unit + "/g_loc" : i < 6 ? "degree" : response_unit;
    sizes.push_back(
        Message("{output} by {difference:+.2g} {unit} ({times:.1f} times what the model explains)",
                kIntrinsicSymbols[static_cast<std::size_t>(i)], test.difference(i), unit,
                std::abs(test.difference(i)) / u));
  }
  if (sizes.empty())
    return {
        "the stage has errors that the model does not have: the norm fit, which uses no angles, differs from "
        "the joint fit (probability {probability:.1g})",
        test.probability};
  return {
      "the stage has errors that the model does not have: the norm fit, which uses no angles, differs from "
      "the joint fit in {outputs} (probability {probability:.1g})",
      in_sequence(sizes, ", "), test.probability};
}

}  // namespace abcal
