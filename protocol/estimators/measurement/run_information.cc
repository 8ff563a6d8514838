#include "protocol/estimators/measurement/run_information.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>

#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/linear/products.h"

namespace abcal {
namespace {

/// F' V^-1 F of the visits' step errors. With white noise it is diagonal.
Eigen::MatrixXd weight_of_visits(const EffectModel& model, const NoiseWhitener& whitener,
                                 const std::vector<NoiseAtAngle>& angles) {
  const auto count = static_cast<Eigen::Index>(angles.size());
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(count, count);
  if (whitener.white()) {
    for (Eigen::Index n = 0; n < count; ++n) {
      const auto at = static_cast<std::size_t>(n);
      out(n, n) = model.by_own_step(at).cwiseAbs2().cwiseQuotient(angles[at].white).sum();
    }
    return out;
  }
  ReadingRows weighted = ReadingRows::Zero(3 * count, count);
  for (Eigen::Index n = 0; n < count; ++n) {
    const auto at = static_cast<std::size_t>(n);
    weighted.block<3, 1>(3 * n, n) = model.by_own_step(at);
  }
  whitener.whiten(weighted);
  whitener.whiten_transposed(weighted);
  for (Eigen::Index n = 0; n < count; ++n) {
    const auto at = static_cast<std::size_t>(n);
    out.row(n) = model.by_own_step(at).transpose() * weighted.middleRows<3>(3 * n);
  }
  return out;
}

}  // namespace

Eigen::Matrix3d RunInformation::rows() const {
  Eigen::Matrix3d out;
  for (int j = 0; j < 3; ++j) out.row(j) = at.segment<3>(layout.own_count() * j).transpose();
  return out;
}

std::size_t best_noise(const EffectSolution& solution) {
  return static_cast<std::size_t>(std::max_element(solution.weights.begin(), solution.weights.end()) -
                                  solution.weights.begin());
}

ReadingsForm form_at(const EffectModel& model, const AssumedNoise& noise) {
  const Eigen::Index unknowns = model.layout().count();
  const auto visits = static_cast<Eigen::Index>(model.angles());
  const std::vector<NoiseAtAngle> angles = model.noise_at_angles(noise.white);
  const NoiseWhitener whitener(angles, 0.0, model.process_of(noise.tau, noise.rho));
  ReadingRows rows(3 * visits, unknowns + 1);
  rows.leftCols(unknowns) = model.jacobian();
  rows.rightCols<1>() = model.misfit();
  whitener.whiten(rows);
  const Eigen::MatrixXd products = products_of_columns(rows);
  whitener.whiten_transposed(rows);
  Eigen::MatrixXd by_visit(visits, unknowns + 1);
  for (Eigen::Index n = 0; n < visits; ++n) {
    const auto at = static_cast<std::size_t>(n);
    by_visit.row(n) = model.by_own_step(at).transpose() * rows.middleRows<3>(3 * n);
  }
  ReadingsForm out;
  out.weight.resize(unknowns + visits, unknowns + visits);
  out.weight << products.topLeftCorner(unknowns, unknowns), by_visit.leftCols(unknowns).transpose(),
      by_visit.leftCols(unknowns), weight_of_visits(model, whitener, angles);
  out.pull.resize(unknowns + visits);
  out.pull << products.col(unknowns).head(unknowns), by_visit.col(unknowns);
  out.squares = products(unknowns, unknowns);
  out.log_determinant = whitener.log_determinant();
  return out;
}

AssumedNoise mean_noise(const EffectSolution& solution) {
  AssumedNoise out = solution.noises[best_noise(solution)];
  Eigen::Vector3d white = Eigen::Vector3d::Zero();
  double process = 0.0, length = 0.0;
  for (std::size_t i = 0; i < solution.noises.size(); ++i) {
    const AssumedNoise& noise = solution.noises[i];
    const double weight = solution.weights[i];
    white += weight * noise.white.cwiseAbs2();
    process += weight * noise.tau * noise.tau;
    length += weight * noise.tau * noise.tau * noise.rho;
  }
  out.white = white.cwiseSqrt();
  out.tau = std::sqrt(process);
  if (process > 0.0) out.rho = length / process;
  return out;
}

RunInformation run_information(const CollectedReadings& data, const EffectSolution& solution,
                               RunNoise noise) {
  if (!solution.fit.converged || !solution.model)
    throw std::invalid_argument("information of a run: its own fit has no solution");
  const EffectModel& model = *solution.model;
  if (model.layout().maps > 0)
    throw std::invalid_argument("information of a run: its readings share step errors");
  RunInformation out;
  out.sizes = model.options().sizes;
  out.layout = model.layout();
  out.unknowns = model.unknowns();
  out.unit = model.unit();
  out.in_motion = model.layout().sweeps > 0;
  const Eigen::Index unknowns = model.layout().count();
  const auto visits = static_cast<Eigen::Index>(data.readings.size());
  out.at.resize(unknowns + visits);
  out.at.head(unknowns) = model.value();
  for (Eigen::Index n = 0; n < visits; ++n) {
    const auto at = static_cast<std::size_t>(n);
    const DwellRecord& dwell = *data.dwells[at];
    out.visits.push_back(visited_angle(dwell.experiment, dwell.alpha));
    out.experiments.push_back(dwell.experiment);
    out.step_factors.push_back(model.step_factor(at));
    out.at(unknowns + n) = model.step_factor(at) * model.steps()[at];
  }
  out.form =
      form_at(model, noise == RunNoise::kMean ? mean_noise(solution) : solution.noises[best_noise(solution)]);
  out.readings = 3 * static_cast<int>(visits);
  return out;
}

}  // namespace abcal
