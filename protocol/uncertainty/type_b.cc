#include "protocol/uncertainty/type_b.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>
#include <utility>

#include "protocol/linear/products.h"
#include "protocol/linear/semidefinite_root.h"
#include "protocol/model/forward_model.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/type_b_kernel.h"

namespace abcal {

namespace {

// The largest normal drawn is 8.49; 4 degrees keep Zx2 + Zy2 below 1 and every step error inside the series'
// range.
constexpr double kMostDegrees = 4.0;
constexpr double kMostHarmonicDegrees = 0.5;

void check_tolerance(const char* name, Angle tolerance, double most) {
  if (!(tolerance.deg() >= 0.0 && tolerance.deg() <= most)) {  // written so that NaN is a problem too
    throw std::invalid_argument(std::string(name) + " tolerance = " + std::to_string(tolerance.deg()) +
                                " degrees, it must lie between 0 and " + (most < 1.0 ? "0.5" : "4") +
                                " degrees");
  }
}

void check(const TypeBStudy& study) {
  check_tolerances(study.tolerances, study.step_errors);
  for (const RotationFit& fit : study.design.experiments()) {
    if (study.step_errors == StepErrorModel::kHarmonic && fit.alpha.size() / 2 > kMostHarmonics) {
      throw std::invalid_argument("step errors with a spectrum: " + std::to_string(fit.alpha.size()) +
                                  " angles in an experiment, at most " + std::to_string(2 * kMostHarmonics));
    }
  }
  if (!study.accelerometer.sensitivity_matrix.allFinite() || !study.accelerometer.offset.allFinite()) {
    throw std::invalid_argument("accelerometer: a sensitivity or an offset is not finite");
  }
  if (!(study.accelerometer_spread >= 0.0 && std::isfinite(study.accelerometer_spread))) {
    throw std::invalid_argument("accelerometer spread must be finite and not negative");
  }
  for (Eigen::Index j = 0; j < 3; ++j) {
    if (study.accelerometer_spread == 0.0 && study.accelerometer.sensitivity_matrix.row(j).norm() == 0.0) {
      throw std::invalid_argument("accelerometer: row " + std::to_string(j + 1) +
                                  " of the sensitivity matrix is zero, it has no direction");
    }
  }
}

/// The sums of an experiment's step errors f ~ N(0, step): sum over n of w_X(n) cos alpha(n) sin f(n), X = A,
/// B, C, and of w_X sin alpha sin f. A sine has the variance (1 - exp(-2 step^2))/2.
std::array<double, 36> root_of_sums(const RotationFit& fit, double step) {
  Eigen::MatrixXd rows(fit.weights.rows(), 6);
  for (Eigen::Index x = 0; x < 3; ++x) {
    rows.col(x) = fit.weights.col(x).cwiseProduct(fit.cos_alpha);
    rows.col(3 + x) = fit.weights.col(x).cwiseProduct(fit.sin_alpha);
  }
  const double variance = -0.5 * std::expm1(-2.0 * step * step);
  const Eigen::MatrixXd covariance = variance * transposed_product(rows, rows);
  // sin alpha cos alpha occurs twice, so that one sum follows from others.
  const Eigen::Matrix<double, 6, 6, Eigen::RowMajor> root = semidefinite_root(covariance);
  std::array<double, 36> out{};
  std::copy_n(root.data(), out.size(), out.begin());
  return out;
}

TypeBSampler::Plan plan_of(const TypeBStudy& study) {
  TypeBSampler::Plan plan;
  for (std::size_t i = 0; i < 3; ++i) {
    const RotationFit& fit = study.design.experiments()[i];
    const Eigen::Index n = fit.weights.rows();
    plan.angles[i] = static_cast<std::uint32_t>(n);
    plan.table[i].reserve(static_cast<std::size_t>(5 * n));
    for (Eigen::Index row = 0; row < n; ++row) {
      plan.table[i].insert(plan.table[i].end(), {fit.sin_alpha(row), fit.cos_alpha(row), fit.weights(row, 0),
                                                 fit.weights(row, 1), fit.weights(row, 2)});
    }
    for (Eigen::Index w = 0; w < 3; ++w) {
      plan.nominal[i][static_cast<std::size_t>(w)] = fit.weights.col(w).dot(fit.cos_alpha);
      plan.nominal[i][static_cast<std::size_t>(w + 3)] = fit.weights.col(w).dot(fit.sin_alpha);
    }
    if (study.step_errors == StepErrorModel::kHarmonic) {
      const auto harmonics = static_cast<int>(n / 2);
      for (Eigen::Index row = 0; row < n; ++row) {
        for (int m = 1; m <= harmonics; ++m) {
          const SinCos sc = sincos(fit.alpha[static_cast<std::size_t>(row)] * m);
          plan.spectrum[i].push_back(sc.sin);
          plan.spectrum[i].push_back(sc.cos);
        }
      }
    }
  }
  for (Eigen::Index j = 0; j < 3; ++j) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      plan.accelerometer[static_cast<std::size_t>(3 * j + k)] = study.accelerometer.sensitivity_matrix(j, k);
    }
    plan.accelerometer[static_cast<std::size_t>(9 + j)] = study.accelerometer.offset(j);
  }
  plan.spread = study.accelerometer_spread;
  plan.alignment = sincos(study.tolerances.alignment).sin;
  plan.step = study.tolerances.step.rad();
  plan.turn = study.tolerances.initial_turn.rad();
  plan.zero = study.tolerances.zero.rad();
  plan.harmonic = study.step_errors == StepErrorModel::kHarmonic;
  plan.by_sums = !plan.harmonic && !study.each_step && plan.step > 0.0 &&
                 study.tolerances.step.deg() <= kMostSummedDegrees;
  plan.mean_cosine = std::exp(-0.5 * plan.step * plan.step);
  for (std::size_t i = 0; i < 3 && plan.by_sums; ++i)
    plan.sum_root[i] = root_of_sums(study.design.experiments()[i], plan.step);
  plan.seed = study.seed;
  return plan;
}

}  // namespace

void check_tolerances(const Tolerances& tolerances, StepErrorModel step_errors) {
  check_tolerance("alignment", tolerances.alignment, kMostDegrees);
  check_tolerance("step", tolerances.step,
                  step_errors == StepErrorModel::kHarmonic ? kMostHarmonicDegrees : kMostDegrees);
  check_tolerance("initial-turn", tolerances.initial_turn, kMostDegrees);
  check_tolerance("zero", tolerances.zero, kMostDegrees);
}

AccelerometerUnderTest table_2_accelerometer() {
  AccelerometerUnderTest accelerometer;
  accelerometer.sensitivity_matrix << 1.084557444843417, -0.047097516966133, 0.037216463393415,  //
      0.369246379560599, 0.920196068359764, 0.285771705579544,                                   //
      -0.117336380485872, 0.263805007662141, 0.819879210182046;
  accelerometer.offset << 0.053766713954610, 0.183388501459509, -0.225884686100365;
  return accelerometer;
}

Tolerances paper_tolerances() {
  Tolerances tolerances = without_further_effects({});
  tolerances.k2 = tolerances.k3 = 0.0;
  tolerances.alignment = tolerances.step = Angle::degrees(0.008);
  tolerances.initial_turn = tolerances.zero = Angle::degrees(0.0);
  tolerances.drift = 0.0;
  return tolerances;
}

std::array<Eigen::MatrixX3d, 3> simulated_readings(const AbcDesign& design,
                                                   const AccelerometerUnderTest& accelerometer,
                                                   const AcsErrors& errors) {
  const Eigen::Matrix3d s = tilted(accelerometer.sensitivity_matrix, errors.alignment);
  std::array<Eigen::MatrixX3d, 3> readings;
  for (int i = 0; i < 3; ++i) {
    const auto index = static_cast<std::size_t>(i);
    const std::vector<Angle>& alpha = design.experiments()[index].alpha;
    const GravityCircle circle = gravity_circle(i + 1, errors);
    readings[index].resize(static_cast<Eigen::Index>(alpha.size()), 3);
    for (std::size_t n = 0; n < alpha.size(); ++n) {
      const Angle actual = alpha[n] + errors.rotation_error(i + 1, static_cast<int>(n) + 1);
      readings[index].row(static_cast<Eigen::Index>(n)) =
          (s * circle.at(actual) + accelerometer.offset).transpose();
    }
  }
  return readings;
}

StudyOutput abc_analysis(const AbcDesign& design, const std::array<Eigen::MatrixX3d, 3>& readings) {
  // Rows A, B, C; columns u, v, w.
  std::array<Eigen::Matrix3d, 3> fit;
  for (std::size_t i = 0; i < 3; ++i) fit[i] = design.experiments()[i].weights.transpose() * readings[i];
  const auto coefficient = [&](int row, int experiment) -> Eigen::RowVector3d {
    return fit[static_cast<std::size_t>(experiment - 1)].row(row);
  };
  constexpr int kA = 0, kB = 1, kC = 2;
  Eigen::Matrix3d s;
  s.col(0) = (-(coefficient(kA, 2) + coefficient(kA, 3)) / 2.0).transpose();
  s.col(1) = ((coefficient(kA, 1) - coefficient(kB, 3)) / 2.0).transpose();
  s.col(2) = ((coefficient(kB, 1) + coefficient(kB, 2)) / 2.0).transpose();
  const Eigen::Vector3d offset =
      ((coefficient(kC, 1) + coefficient(kC, 2) + coefficient(kC, 3)) / 3.0).transpose();
  return outputs_of(s, offset);
}

StudyOutput true_outputs(const AccelerometerUnderTest& accelerometer, const Alignment& alignment) {
  return outputs_of(tilted(accelerometer.sensitivity_matrix, alignment), accelerometer.offset);
}

StudyOutput abc_errors(const AbcDesign& design, const AccelerometerUnderTest& accelerometer,
                       const AcsErrors& errors) {
  const StudyOutput found = abc_analysis(design, simulated_readings(design, accelerometer, errors));
  return to_output(to_vector(found) - to_vector(true_outputs(accelerometer, errors.alignment)));
}

TypeBDraw type_b_draw(const TypeBStudy& study, std::uint64_t trial) {
  check(study);
  const RandomStream stream(study.seed, StreamPurpose::kTypeB, trial);
  std::uint32_t pair = 0;
  const auto next = [&] { return stream.normal_pair(pair++); };
  TypeBDraw draw;
  const double alignment = sincos(study.tolerances.alignment).sin;
  const std::array<double, 2> z = next();
  const std::array<double, 2> x_and_turn = next();
  const std::array<double, 2> turn_and_zero = next();
  const std::array<double, 2> zero = next();
  draw.errors.alignment = {alignment * z[0], alignment * z[1], alignment * x_and_turn[0]};
  draw.errors.d2 = study.tolerances.initial_turn * x_and_turn[1];
  draw.errors.d3 = study.tolerances.initial_turn * turn_and_zero[0];
  draw.errors.mean_step_x = study.tolerances.zero * turn_and_zero[1];
  draw.errors.mean_step_z = study.tolerances.zero * zero[0];
  for (std::size_t i = 0; i < 3; ++i) {
    const std::vector<Angle>& alpha = study.design.experiments()[i].alpha;
    std::vector<Angle>& f = draw.errors.step_errors[i];
    if (study.step_errors == StepErrorModel::kIndependent) {
      for (std::size_t n = 0; n < alpha.size(); n += 2) {
        const std::array<double, 2> normals = next();
        f.push_back(study.tolerances.step * normals[0]);
        if (n + 1 < alpha.size()) f.push_back(study.tolerances.step * normals[1]);
      }
    } else {
      f.assign(alpha.size(), Angle());
      for (int m = 1; m <= static_cast<int>(alpha.size() / 2); ++m) {
        const std::array<double, 2> d_and_e = next();
        for (std::size_t n = 0; n < alpha.size(); ++n) {
          const SinCos sc = sincos(alpha[n] * m);
          f[n] += study.tolerances.step * (d_and_e[0] * sc.sin + d_and_e[1] * sc.cos);
        }
      }
    }
  }
  draw.accelerometer = study.accelerometer;
  if (study.accelerometer_spread > 0.0) {
    RandomStream accelerometers(study.seed, StreamPurpose::kAccelerometers, trial);
    for (Eigen::Index k = 0; k < 9; ++k) {
      draw.accelerometer.sensitivity_matrix(k / 3, k % 3) +=
          study.accelerometer_spread * accelerometers.normal();
    }
    for (Eigen::Index j = 0; j < 3; ++j) {
      draw.accelerometer.offset(j) += study.accelerometer_spread * accelerometers.normal();
    }
  }
  return draw;
}

TypeBSampler::TypeBSampler(TypeBStudy study) : study_(std::move(study)) {
  check(study_);
  plan_ = plan_of(study_);
}

void TypeBSampler::operator()(std::uint64_t first, std::size_t count, double* out) const {
  type_b_trials(plan_, first, count, out);
}

MonteCarloResult run_type_b(const TypeBStudy& study, const MonteCarloOptions& options) {
  const TypeBSampler sampler(study);
  return run_monte_carlo(
      kStudyOutputs, [&](std::uint64_t first, std::size_t count, double* out) { sampler(first, count, out); },
      options);
}

}  // namespace abcal
