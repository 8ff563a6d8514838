#include "protocol/estimators/joint/line_response.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>

namespace abcal {
namespace {

constexpr std::array<const char*, 3> kStepGroups{"f_1", "f_2", "f_3"};

}  // namespace

ShareGroups share_groups(const EffectModel& model) {
  ShareGroups out;
  for (const EffectUnknown& unknown : model.unknowns()) {
    if (!std::isfinite(unknown.prior_sd)) {
      out.of_unknown.push_back(-1);
      continue;
    }
    const auto found = std::find_if(out.groups.begin(), out.groups.end(),
                                    [&](const EffectShare& share) { return share.effect == unknown.effect; });
    if (found == out.groups.end()) {
      out.of_unknown.push_back(static_cast<int>(out.groups.size()));
      out.groups.push_back({unknown.effect, unknown.key, 1, unknown.prior_sd, Covariance12::Zero()});
    } else {
      out.of_unknown.push_back(static_cast<int>(found - out.groups.begin()));
      ++found->unknowns;
    }
  }
  if (!(model.step_sd() > 0.0)) return out;
  out.first_step = static_cast<int>(out.groups.size());
  for (const char* name : kStepGroups)
    out.groups.push_back({name, "step_deg", 0, model.step_sd(), Covariance12::Zero()});
  for (std::size_t n = 0; n < model.angles(); ++n)
    ++out.groups[static_cast<std::size_t>(out.first_step + model.experiment_of(n) - 1)].unknowns;
  return out;
}

void add_share_of_signs(const EffectModel& model, const ShareGroups& groups, LineAtNoise& line) {
  const std::vector<Eigen::Index> hysteresis = model.hysteresis_unknowns();
  if (hysteresis.empty()) return;
  Covariance12& share =
      line.shares[static_cast<std::size_t>(groups.of_unknown[static_cast<std::size_t>(hysteresis.front())])];
  for (std::size_t n = 0; n < model.angles(); ++n) {
    for (Eigen::Index j = 0; j < 3; ++j) {
      const double variance = model.signs().variance[n](j);
      if (!(variance > 0.0)) continue;
      const Vector12 by_reading = line.gain.row(3 * static_cast<Eigen::Index>(n) + j).transpose();
      share += variance * by_reading * by_reading.transpose();
    }
  }
}

void average_line(const Vector12& base, ShareGroups groups, std::span<const LineAtNoise> lines,
                  std::span<const double> weights, EffectFit& fit) {
  Vector12 mean = Vector12::Zero();
  Covariance12 covariance = Covariance12::Zero();
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const double weight = weights[i];
    const LineAtNoise& line = lines[i];
    mean += weight * line.change;
    covariance += weight * line.covariance;
    for (std::size_t g = 0; g < groups.groups.size(); ++g)
      groups.groups[g].covariance += weight * line.shares[g];
  }
  Vector12 spread_of_variance = Vector12::Zero();
  const Vector12 variance = covariance.diagonal();
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const Vector12 off = lines[i].change - mean;
    covariance += weights[i] * off * off.transpose();
    spread_of_variance += weights[i] * (lines[i].covariance.diagonal() - variance).cwiseAbs2();
  }
  for (Eigen::Index i = 0; i < 12; ++i) {
    if (spread_of_variance(i) > 1e-12 * variance(i) * variance(i))
      fit.degrees_of_freedom(i) = 2.0 * variance(i) * variance(i) / spread_of_variance(i);
  }
  fit.line = base + mean;
  fit.covariance_line = covariance;
  fit.covariance_line_type_b.setZero();
  for (const EffectShare& share : groups.groups) fit.covariance_line_type_b += share.covariance;
  fit.shares = std::move(groups.groups);
}

void keep_stated_noise(const LineAtNoise& at_stated, EffectFit& fit) {
  fit.covariance_line.diagonal() +=
      (at_stated.covariance.diagonal() - fit.covariance_line.diagonal()).cwiseMax(0.0);
}

void add_degrees_of_estimated_noise(const EffectModel& model, const WhiteFound& found,
                                    const ReadingRows& gain, EffectFit& fit) {
  const std::vector<NoiseAtAngle> angles = model.stated_noise_at_angles(found.white);
  Eigen::Matrix<double, 12, 3> by_output = Eigen::Matrix<double, 12, 3>::Zero();
  for (std::size_t n = 0; n < angles.size(); ++n) {
    const auto three = gain.middleRows<3>(3 * static_cast<Eigen::Index>(n));
    for (int j = 0; j < 3; ++j) by_output.col(j) += angles[n].white(j) * three.row(j).transpose().cwiseAbs2();
  }
  for (Eigen::Index i = 0; i < 12; ++i) {
    const double variance2 = std::pow(fit.covariance_line(i, i), 2);
    double spread =
        std::isfinite(fit.degrees_of_freedom(i)) ? 2.0 * variance2 / fit.degrees_of_freedom(i) : 0.0;
    for (int j = 0; j < 3; ++j) spread += 2.0 * by_output(i, j) * by_output(i, j) / found.redundancy(j);
    if (spread > 0.0) fit.degrees_of_freedom(i) = 2.0 * variance2 / spread;
  }
}

Vector12 units_of_line(const Eigen::Vector3d& unit) {
  Vector12 units;
  for (int j = 0; j < 3; ++j) {
    units.segment<3>(3 * j).setConstant(unit(j));
    units(9 + j) = unit(j);
  }
  return units;
}

void restore_units(EffectFit& fit) {
  const Vector12 units = units_of_line(fit.unit);
  const auto in_units = [&](Covariance12& covariance) {
    covariance = units.asDiagonal() * covariance * units.asDiagonal();
  };
  for (Eigen::Index row = 0; row < fit.gain.rows(); ++row)
    fit.gain.row(row) = fit.gain.row(row).cwiseProduct(units.transpose()) / fit.unit(row % 3);
  fit.line = fit.line.cwiseProduct(units);
  in_units(fit.covariance_line);
  in_units(fit.covariance_line_type_b);
  for (EffectShare& share : fit.shares) in_units(share.covariance);
}

}  // namespace abcal
