#include "protocol/uncertainty/drawn_readings.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/uncertainty/random_shapes.h"

namespace abcal {
namespace {

constexpr double kFewestDegrees = 3.0;

}  // namespace

Eigen::Vector3d degrees_of_dwell(const DwellRecord& dwell) {
  Eigen::Vector3d out = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  if (dwell.count < 2 || !dwell.u_mean) return out;
  for (Eigen::Index j = 0; j < 3; ++j) {
    const double u = (*dwell.u_mean)(j);
    if (!(u > 0.0)) continue;
    const double effective = std::min(static_cast<double>(dwell.count), std::pow(dwell.spread(j) / u, 2));
    out(j) = effective < 1.0 ? 0.0 : std::max(kFewestDegrees, effective - 1.0);
  }
  return out;
}

DrawnReadings::DrawnReadings(const ItemFit& own, const RunRecord& record)
    : own_(own),
      model_(*own.solution->model),
      sizes_(record.tolerances),
      units_(units_of_line(model_.unit())),
      result_(own.solution->fit.line) {
  for (const DwellRecord* dwell : own.data.dwells)
    degrees_.push_back(own.options.white_known
                           ? degrees_of_dwell(*dwell)
                           : Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity()));
}

std::size_t DrawnReadings::choose_noise(RandomStream& stream) const {
  const std::vector<double>& weights = own_.solution->weights;
  std::size_t chosen = 0;
  for (double left = stream.uniform(); chosen + 1 < weights.size(); ++chosen)
    if ((left -= weights[chosen]) < 0.0) break;
  return chosen;
}

void DrawnReadings::draw_noise(std::size_t number, RandomStream& stream, JointDraw& draw) const {
  const EffectSolution& solution = *own_.solution;
  const AssumedNoise& noise = solution.noises[number];
  Eigen::Vector3d white = noise.white;
  if (!own_.options.white_known) {
    // The posterior of a variance that nu residuals estimated.
    for (Eigen::Index j = 0; j < 3; ++j) {
      const double nu = std::max(kFewestDegrees, solution.white.redundancy(j));
      white(j) *= std::sqrt(nu / chi2_draw(nu, stream));
    }
  }
  const std::vector<NoiseAtAngle> angles = model_.stated_noise_at_angles(white);
  const NoiseProcess process = model_.process_of(noise.tau, noise.rho);
  draw.noise.resize(3 * static_cast<Eigen::Index>(angles.size()));
  Eigen::Vector3d state = Eigen::Vector3d::Zero();
  for (std::size_t n = 0; n < angles.size(); ++n) {
    const double decay = n > 0 ? std::exp(-angles[n].distance / noise.rho) : 0.0;
    for (Eigen::Index j = 0; j < 3; ++j) {
      const double nu = degrees_[n](j);
      const double z = nu > 0.0 ? student_t_draw(nu, stream) : standard_draw(Shape::kRectangular, stream);
      if (noise.tau > 0.0)
        state(j) = decay * state(j) + std::sqrt(1.0 - decay * decay) * process.tau(j) * stream.normal();
      draw.noise(3 * static_cast<Eigen::Index>(n) + j) = std::sqrt(angles[n].white(j)) * z + state(j);
    }
    draw.process_mean += state / static_cast<double>(angles.size());
  }
}

void DrawnReadings::draw_signs(RandomStream& stream, JointDraw& draw) const {
  const SignRule rule = stream.uniform() < 0.5 ? SignRule::kArrival : SignRule::kLastMotion;
  draw.came_from = model_.came_from_at(draw.value, draw.steps, rule);
}

Vector12 DrawnReadings::draw_voltmeter(RandomStream& stream) const {
  if (!states_voltmeter(sizes_)) return Vector12::Zero();
  Eigen::Matrix3d s;
  for (Eigen::Index j = 0; j < 3; ++j) s.row(j) = result_.segment<3>(3 * j).transpose();
  Vector12 out =
      effect_of_gain(s, result_.tail<3>(), sizes_) * standard_draw(sizes_.shape_of("voltmeter_gain"), stream);
  for (Eigen::Index j = 0; j < 3; ++j)
    out(9 + j) += sizes_.voltmeter_offset * s.row(j).norm() *
                  standard_draw(sizes_.shape_of("voltmeter_offset"), stream);
  return out;
}

Eigen::VectorXd DrawnReadings::readings_of(const JointDraw& draw) const {
  return model_.readings_at(draw.value, draw.steps, draw.came_from) + draw.noise;
}

std::vector<EffectReading> DrawnReadings::effect_readings_of(const JointDraw& draw) const {
  const Eigen::VectorXd made = readings_of(draw);
  std::vector<EffectReading> out = own_.data.readings;
  for (std::size_t n = 0; n < out.size(); ++n)
    out[n].value = made.segment<3>(3 * static_cast<Eigen::Index>(n)).cwiseProduct(model_.unit());
  return out;
}

}  // namespace abcal
