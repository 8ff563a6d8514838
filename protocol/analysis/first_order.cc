#include "protocol/analysis/first_order.h"

#include <fmt/format.h>

#include <array>
#include <stdexcept>

namespace abcal {

namespace {

// Central differences: the error of the slope is h^2/6 (second derivatives of sines and cosines are of order
// 1), the round-off 1e-16/h. Both are below 1e-9 of the slope here.
constexpr double kAxisStep = 1e-5;
constexpr Angle kAngleStep = Angle::degrees(1e-3);

std::array<GravityCircle, 3> circles_of(const AcsErrors& errors) {
  return {gravity_circle(1, errors), gravity_circle(2, errors), gravity_circle(3, errors)};
}

Eigen::Vector3d at_dwell(const std::array<GravityCircle, 3>& circles, const DwellRecord& dwell,
                         const AcsErrors& errors, Angle extra) {
  return circles[static_cast<std::size_t>(dwell.experiment - 1)].at(
      dwell.alpha + errors.rotation_error(dwell.experiment, dwell.n) + extra);
}

}  // namespace

std::vector<InputEffect> first_order_effects(std::span<const DwellRecord* const> dwells,
                                             std::span<const double> time_fractions,
                                             const AccelerometerModel& accelerometer,
                                             const Tolerances& tolerances, const std::string& response_unit) {
  if (dwells.size() != time_fractions.size()) {
    throw std::invalid_argument(
        fmt::format("first-order effects: {} dwells, {} times; one of each is required", dwells.size(),
                    time_fractions.size()));
  }
  const Eigen::Matrix3d& s = accelerometer.sensitivity_matrix;
  std::vector<InputEffect> effects;
  effects.reserve(10 + dwells.size());

  const auto add_whole_run = [&](const char* name, const char* unit, double standard_uncertainty, double step,
                                 auto set_input) {
    AcsErrors above;
    AcsErrors below;
    set_input(above, step);
    set_input(below, -step);
    const std::array<GravityCircle, 3> circles_above = circles_of(above);
    const std::array<GravityCircle, 3> circles_below = circles_of(below);
    InputEffect effect{name, unit, standard_uncertainty, 0, {}};
    effect.effect.reserve(dwells.size());
    for (const DwellRecord* dwell : dwells) {
      effect.effect.push_back(s * ((at_dwell(circles_above, *dwell, above, Angle()) -
                                    at_dwell(circles_below, *dwell, below, Angle())) /
                                   (2.0 * step)));
    }
    effects.push_back(std::move(effect));
  };

  const double alignment = sincos(tolerances.alignment).sin;
  add_whole_run("Zx", "1", alignment, kAxisStep, [](AcsErrors& e, double v) { e.alignment.zx = v; });
  add_whole_run("Zy", "1", alignment, kAxisStep, [](AcsErrors& e, double v) { e.alignment.zy = v; });
  add_whole_run("Xz", "1", alignment, kAxisStep, [](AcsErrors& e, double v) { e.alignment.xz = v; });
  const double step = kAngleStep.deg();
  const double turn = tolerances.initial_turn.deg();
  add_whole_run("d2", "degree", turn, step, [](AcsErrors& e, double v) { e.d2 = Angle::degrees(v); });
  add_whole_run("d3", "degree", turn, step, [](AcsErrors& e, double v) { e.d3 = Angle::degrees(v); });
  const double zero = tolerances.zero.deg();
  add_whole_run("F_X", "degree", zero, step,
                [](AcsErrors& e, double v) { e.mean_step_x = Angle::degrees(v); });
  add_whole_run("F_Z", "degree", zero, step,
                [](AcsErrors& e, double v) { e.mean_step_z = Angle::degrees(v); });

  for (Eigen::Index j = 0; j < 3; ++j) {
    constexpr std::array<const char*, 3> kNames{"drift u", "drift v", "drift w"};
    InputEffect effect{
        kNames[static_cast<std::size_t>(j)], response_unit, tolerances.drift * s.row(j).norm(), 0, {}};
    effect.effect.reserve(dwells.size());
    for (const double t : time_fractions) effect.effect.push_back(t * Eigen::Vector3d::Unit(j));
    effects.push_back(std::move(effect));
  }

  const AcsErrors perfect;
  const std::array<GravityCircle, 3> circles = circles_of(perfect);
  for (std::size_t k = 0; k < dwells.size(); ++k) {
    const Eigen::Vector3d slope = (at_dwell(circles, *dwells[k], perfect, kAngleStep) -
                                   at_dwell(circles, *dwells[k], perfect, -kAngleStep)) /
                                  (2.0 * step);
    effects.push_back({fmt::format("f_{}({})", dwells[k]->experiment, dwells[k]->n),
                       "degree",
                       tolerances.step.deg(),
                       k,
                       {Eigen::Vector3d(s * slope)}});
  }
  return effects;
}

}  // namespace abcal
