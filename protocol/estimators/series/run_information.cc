#include "protocol/estimators/series/run_information.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>

#include "protocol/estimators/shared/reading_kernels.h"

namespace abcal {

Eigen::Matrix3d RunInformation::rows() const {
  Eigen::Matrix3d out;
  for (int j = 0; j < 3; ++j) out.row(j) = at.segment<3>(layout.own_count() * j).transpose();
  return out;
}

RunInformation run_information(const CollectedReadings& data, const EffectSolution& solution) {
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
  const Eigen::Index unknowns = model.layout().count();
  const auto visits = static_cast<Eigen::Index>(data.readings.size());
  out.at.resize(unknowns + visits);
  out.at.head(unknowns) = model.value();
  const auto best = static_cast<std::size_t>(
      std::max_element(solution.weights.begin(), solution.weights.end()) - solution.weights.begin());
  const AssumedNoise& noise = solution.noises[best];

  ReadingRows rows = ReadingRows::Zero(3 * visits, unknowns + visits + 1);
  rows.leftCols(unknowns) = model.jacobian();
  rows.rightCols<1>() = model.misfit();
  for (Eigen::Index n = 0; n < visits; ++n) {
    const auto at = static_cast<std::size_t>(n);
    const DwellRecord& dwell = *data.dwells[at];
    out.visits.push_back(visited_angle(dwell.experiment, dwell.alpha));
    const double factor = model.step_factor(at);
    out.at(unknowns + n) = factor * model.steps()[at];
    rows.block<3, 1>(3 * n, unknowns + n) = model.by_step(at) / factor;
  }
  NoiseWhitener(model.noise_at_angles(noise.white), 0.0, model.process_of(noise.tau, noise.rho)).whiten(rows);
  const Eigen::MatrixXd products = products_of_columns(rows);
  out.weight = products.topLeftCorner(unknowns + visits, unknowns + visits);
  out.pull = products.col(unknowns + visits).head(unknowns + visits);
  out.squares = products(unknowns + visits, unknowns + visits);
  out.readings = 3 * static_cast<int>(visits);
  return out;
}

}  // namespace abcal
