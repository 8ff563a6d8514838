#include "protocol/estimators/joint/analyse_joint.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <stdexcept>
#include <string_view>
#include <vector>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/model/forward_model.h"
#include "tests/protocol/estimators/made_record.h"

namespace abcal {
namespace {

using ::testing::HasSubstr;

constexpr double kRadian = std::numbers::pi / 180.0;

AccelerometerModel some_accelerometer() {
  AccelerometerModel aut;
  aut.sensitivity_matrix << 1.05, -0.08, 0.03, 0.11, 0.93, -0.05, -0.02, 0.07, 1.01;
  aut.offset = {0.05, -0.12, 0.2};
  return aut;
}

AcsErrors some_errors(std::mt19937_64& engine, int steps = 72) {
  std::normal_distribution<double> normal(0.0, 0.008);
  AcsErrors acs;
  acs.alignment = {std::sin(normal(engine) * kRadian), std::sin(normal(engine) * kRadian),
                   std::sin(normal(engine) * kRadian)};
  acs.d2 = Angle::degrees(normal(engine));
  acs.d3 = Angle::degrees(normal(engine));
  acs.mean_step_x = Angle::degrees(normal(engine));
  acs.mean_step_z = Angle::degrees(normal(engine));
  for (auto& list : acs.step_errors) {
    for (int n = 0; n < steps; ++n) list.push_back(Angle::degrees(normal(engine)));
  }
  return acs;
}

RunRecord noisy_record(const AccelerometerModel& aut, unsigned seed, double noise, int steps = 72) {
  std::mt19937_64 engine(seed);
  RunRecord record = test::made_record(aut, some_errors(engine, steps), steps, Angle::degrees(360.0 / steps));
  test::add_noise(record, noise, engine);
  return record;
}

/// Three circles, one angle of which is not a multiple of the others, read by some accelerometer on a stage
/// whose errors are all stated.
struct ModelCase {
  std::vector<EffectReading> readings =
      collect_readings(noisy_record(some_accelerometer(), 3, 1e-5, 7)).readings;
  EffectFitOptions options;
  EffectModel model{readings, options};

  Eigen::Index place_of(std::string_view effect, int output = -1, int index = 0) const {
    for (std::size_t i = 0; i < model.unknowns().size(); ++i) {
      const EffectUnknown& unknown = model.unknowns()[i];
      if (unknown.effect == effect && unknown.output == output && index-- == 0)
        return static_cast<Eigen::Index>(i);
    }
    throw std::invalid_argument("no such unknown");
  }
};

/// Standard uncertainties between estimate and truth.
double deviation(const Quantity& found, double truth) {
  return (found.value - truth) / found.standard_uncertainty;
}

TEST(JointModelTest, DerivativesAreThoseOfCentralDifferences) {
  ModelCase at;
  Eigen::VectorXd value = at.model.value();
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal(0.0, 5e-3);
  for (double& one : value) one += normal(engine);
  const std::vector<double> steps(at.readings.size(), 0.002);
  at.model.move_to(value, steps);
  const ReadingRows jacobian = at.model.jacobian();
  const std::vector<NoiseAtAngle> angles = at.model.noise_at_angles(Eigen::Vector3d::Ones());
  // Truncation h^2/6 times a third derivative of about 1; round-off 1e-16/h.
  constexpr double kStep = 1e-5;
  constexpr double kTolerance = 1e-9;
  for (Eigen::Index i = 0; i < value.size(); ++i) {
    const auto misfit = [&](double step) {
      Eigen::VectorXd there = value;
      there(i) += step;
      at.model.move_to(there, steps);
      return at.model.misfit();
    };
    const Eigen::VectorXd difference = (misfit(-kStep) - misfit(kStep)) / (2.0 * kStep);
    EXPECT_LT((jacobian.col(i) - difference).cwiseAbs().maxCoeff(), kTolerance)
        << at.model.unknowns()[static_cast<std::size_t>(i)].name;
  }
  const auto misfit = [&](double step) {
    at.model.move_to(value, std::vector<double>(steps.size(), steps.front() + step));
    return at.model.misfit();
  };
  const Eigen::VectorXd difference = (misfit(-kStep) - misfit(kStep)) / (2.0 * kStep);
  for (std::size_t n = 0; n < angles.size(); ++n)
    EXPECT_LT(
        (angles[n].by_step - difference.segment<3>(3 * static_cast<Eigen::Index>(n))).cwiseAbs().maxCoeff(),
        kTolerance);
}

TEST(JointModelTest, ReadingsAreThoseOfTheForwardModel) {
  AccelerometerModel aut = some_accelerometer();
  aut.drift = {2e-4, -1e-4, 3e-4};
  aut.k2 = {3e-3, -2e-3, 1e-3};
  aut.k3 = {-4e-3, 5e-3, 2e-3};
  AcsErrors acs;
  acs.alignment = {0.011, -0.007, 0.013};
  acs.d2 = Angle::radians(0.004);
  acs.d3 = Angle::radians(-0.006);
  acs.mean_step_x = Angle::radians(0.009);
  acs.mean_step_z = Angle::radians(-0.003);
  for (auto& list : acs.step_errors) list.assign(7, Angle::degrees(0.1));
  ModelCase at;
  RunRecord record = test::made_record(aut, acs, 7, Angle::degrees(360.0 / 7.0));
  for (DwellRecord& dwell : record.dwells) dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
  at.readings = collect_readings(record).readings;
  at.model = EffectModel(at.readings, at.options);
  Eigen::VectorXd value = Eigen::VectorXd::Zero(at.model.value().size());
  for (int j = 0; j < 3; ++j) {
    const double unit = at.model.unit()(j);
    value.segment<3>(at.place_of("s", j)) = aut.sensitivity_matrix.row(j).transpose() / unit;
    value(at.place_of("O", j)) = aut.offset(j) / unit;
    value(at.place_of("drift", j)) = aut.drift(j) / unit;
    value(at.place_of("k2", j)) = aut.k2(j) * unit;
    value(at.place_of("k3", j)) = aut.k3(j) * unit * unit;
  }
  value(at.place_of("Zx")) = acs.alignment.zx;
  value(at.place_of("Zy")) = acs.alignment.zy;
  value(at.place_of("Xz")) = acs.alignment.xz;
  value(at.place_of("d2")) = acs.d2.rad();
  value(at.place_of("d3")) = acs.d3.rad();
  value(at.place_of("F_X")) = acs.mean_step_x.rad();
  value(at.place_of("F_Z")) = acs.mean_step_z.rad();
  at.model.move_to(value, std::vector<double>(at.readings.size(), 0.1 * kRadian));
  EXPECT_LT(at.model.misfit().cwiseAbs().maxCoeff(), 4e-15);  // a few ulp of 1
}

TEST(JointFitTest, EliminationGivesTheSolutionAndCovarianceOfTheWholeSystem) {
  const RunRecord record = noisy_record(some_accelerometer(), 3, 1e-5, 12);
  const std::vector<EffectReading> readings = collect_readings(record).readings;
  EffectFitOptions options;
  options.noise_process = false;
  const EffectFit fit = effect_fit(readings, options);
  ASSERT_TRUE(fit.converged);

  // All unknowns and 36 step errors at once, at the solution.
  EffectModel model(readings, options);
  model.move_to(fit.value, fit.step_error);
  const Eigen::Index own = fit.value.size();
  const auto n = static_cast<Eigen::Index>(readings.size());
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(3 * n, own + n);
  rows.leftCols(own) = model.jacobian();
  Eigen::VectorXd weight(3 * n), prior(own + n), from_prior(own + n);
  prior << model.prior_weight(), Eigen::VectorXd::Constant(n, 1.0 / (model.step_sd() * model.step_sd()));
  from_prior << model.from_prior(), Eigen::Map<const Eigen::VectorXd>(fit.step_error.data(), n);
  const std::vector<NoiseAtAngle> angles = model.noise_at_angles(Eigen::Vector3d::Ones());
  for (Eigen::Index i = 0; i < n; ++i) {
    const NoiseAtAngle& angle = angles[static_cast<std::size_t>(i)];
    rows.block<3, 1>(3 * i, own + i) = angle.by_step;
    weight.segment<3>(3 * i) = angle.white.cwiseInverse();
  }
  Eigen::MatrixXd normal = rows.transpose() * weight.asDiagonal() * rows;
  normal.diagonal() += prior;
  const Eigen::VectorXd gradient =
      rows.transpose() * weight.cwiseProduct(model.misfit()) - prior.cwiseProduct(from_prior);
  // The unknowns differ by many orders of magnitude: with the diagonal scaled to 1.
  const Eigen::VectorXd scale = normal.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Eigen::MatrixXd> solver(
      Eigen::MatrixXd(scale.asDiagonal() * normal * scale.asDiagonal()));
  const Eigen::MatrixXd covariance =
      scale.asDiagonal() * solver.solve(Eigen::MatrixXd::Identity(own + n, own + n)) * scale.asDiagonal();
  const Eigen::VectorXd change = covariance * gradient;
  for (Eigen::Index i = 0; i < own + n; ++i) {
    const double u = std::sqrt(covariance(i, i));
    EXPECT_LT(std::abs(change(i)), 1e-3 * u) << "unknown " << i << " is not at the minimum";
    const double found =
        i < own ? std::sqrt(fit.covariance(i, i)) : fit.u_step_error[static_cast<std::size_t>(i - own)];
    // Second-order terms of one step are of relative size 1e-4.
    EXPECT_NEAR(found, u, 3e-4 * u) << "unknown " << i;
    if (i >= own) continue;
    for (Eigen::Index k = 0; k < i; ++k)
      EXPECT_NEAR(fit.covariance(i, k), covariance(i, k), 1e-3 * u * std::sqrt(covariance(k, k)));
  }
}

TEST(JointFitTest, RecoversWhatTheRunWasMadeWith) {
  AccelerometerModel aut = some_accelerometer();
  aut.k2 = {1e-3, -5e-4, 8e-4};
  aut.k3 = {-6e-4, 1e-3, 4e-4};
  aut.drift = {2e-5, -3e-5, 1e-5};
  std::mt19937_64 engine(5);
  const AcsErrors acs = some_errors(engine);
  RunRecord record = test::made_record(aut, acs);
  test::add_noise(record, 1e-5, engine);
  const CalibrationResult result = analyse_joint(record);
  ASSERT_EQ(result.verdict, Verdict::kUsable) << result.why;
  ASSERT_TRUE(result.joint);
  // One draw each; 4.5 standard deviations of a normal distribution are exceeded by 7 in a million.
  constexpr double kLimit = 4.5;
  for (std::size_t j = 0; j < 3; ++j) {
    const auto at = static_cast<Eigen::Index>(j);
    // The measurand is the line over all directions of gravity (docs/theory/effects.md).
    const double square = aut.sensitivity_matrix.row(at).squaredNorm();
    const double line = 1.0 + 0.6 * aut.k3(at) * square;
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_LT(std::abs(deviation((*result.sensitivity_matrix)[j][k],
                                   line * aut.sensitivity_matrix(at, static_cast<Eigen::Index>(k)))),
                kLimit);
    }
    EXPECT_LT(std::abs(deviation(result.offset[j], aut.offset(at) + aut.k2(at) * square / 3.0)), kLimit);
    EXPECT_LT(std::abs(deviation(result.intrinsic_sensitivity[j], line * std::sqrt(square))), kLimit);
    EXPECT_LT(std::abs(deviation(result.joint->k2[j], aut.k2(at))), kLimit);
    EXPECT_LT(std::abs(deviation(result.joint->k3[j], aut.k3(at))), kLimit);
    EXPECT_LT(std::abs(deviation(result.joint->drift[j], aut.drift(at))), kLimit);
    for (std::size_t n = 0; n < 72; ++n) {
      EXPECT_LT(std::abs(deviation(result.joint->step_error[j][n], acs.step_errors[j][n].deg())), kLimit);
    }
  }
  EXPECT_LT(std::abs(deviation(result.joint->alignment[0], acs.alignment.zx)), kLimit);
  EXPECT_LT(std::abs(deviation(result.joint->alignment[2], acs.alignment.xz)), kLimit);
  EXPECT_LT(std::abs(deviation(result.joint->initial_turn_error[0], acs.d2.deg())), kLimit);
  EXPECT_LT(std::abs(deviation(result.joint->mean_step_error[0], acs.mean_step_x.deg())), kLimit);
  EXPECT_TRUE(result.joint->nonlinearity_fitted);
  EXPECT_THAT(result.why, HasSubstr("non-linearity fitted"));
  EXPECT_EQ(result.diagnostics.degrees_of_freedom, 648 - 12);
  // A stage error of this size is worth 1e-4 to plain ABC; here it is gone.
  EXPECT_LT(result.intrinsic_sensitivity[0].standard_uncertainty, 1e-5);
}

TEST(JointFitTest, VarianceIsTheSumOfNoiseAndTolerances) {
  const CalibrationResult result = analyse_joint(noisy_record(some_accelerometer(), 7, 1e-5));
  ASSERT_TRUE(result.sensitivity_matrix);
  const auto& s = *result.sensitivity_matrix;
  for (const auto& row : s) {
    for (const Quantity& q : row) {
      EXPECT_NEAR(std::hypot(*q.type_a, *q.type_b), q.standard_uncertainty, 1e-12);
    }
  }
  // The orientation about X hangs on the tolerances alone, the intrinsic sensitivity on the noise.
  EXPECT_GT(*s[1][2].type_b, 5.0 * *s[1][2].type_a);
  EXPECT_GT(*result.intrinsic_sensitivity[0].type_a, *result.intrinsic_sensitivity[0].type_b);
  EXPECT_TRUE((*result.covariance - *result.covariance_type_a - *result.covariance_type_b).isZero(1e-20));
}

TEST(JointFitTest, ResultInCountsIsTheSameResult) {
  AccelerometerModel aut = some_accelerometer();
  aut.k2 = {1e-3, -5e-4, 8e-4};
  const RunRecord record = noisy_record(aut, 11, 1e-5);
  RunRecord counts = record;
  for (DwellRecord& dwell : counts.dwells) {
    dwell.mean *= 3000.0;
    *dwell.u_mean *= 3000.0;
  }
  const CalibrationResult a = analyse_joint(record);
  const CalibrationResult b = analyse_joint(counts);
  EXPECT_EQ(a.verdict, b.verdict);
  // Round-off, not physics, may differ: far below any uncertainty (1e-6).
  EXPECT_NEAR(*a.diagnostics.chi2, *b.diagnostics.chi2, 1e-6 * *a.diagnostics.chi2);
  for (std::size_t j = 0; j < 3; ++j) {
    const double u = a.intrinsic_sensitivity[j].standard_uncertainty;
    EXPECT_NEAR(a.intrinsic_sensitivity[j].value, b.intrinsic_sensitivity[j].value / 3000.0, 1e-4 * u);
    EXPECT_NEAR(u, b.intrinsic_sensitivity[j].standard_uncertainty / 3000.0, 1e-6 * u);
    EXPECT_NEAR(a.joint->k2[j].value, b.joint->k2[j].value * 3000.0,
                1e-4 * a.joint->k2[j].standard_uncertainty);
    EXPECT_NEAR(a.joint->k3[j].value, b.joint->k3[j].value * 9e6, 1e-4 * a.joint->k3[j].standard_uncertainty);
  }
}

TEST(JointFitTest, MissingAnglesUnequalNAndClosingAnglesAreFine) {
  AccelerometerModel aut = some_accelerometer();
  aut.drift = {2e-5, 2e-5, 2e-5};
  RunRecord record = noisy_record(aut, 13, 1e-5);
  std::vector<DwellRecord> kept;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.experiment == 2 && dwell.n % 3 != 0) continue;  // 24 of 72
    if (dwell.experiment == 3 && dwell.n > 40) continue;      // not a full circle
    kept.push_back(dwell);
    if (dwell.experiment == 1 && dwell.n == 72) {
      DwellRecord closing = record.dwells.front();
      closing.n = 73;
      closing.alpha = Angle::degrees(360.0);
      closing.closing = true;
      kept.push_back(closing);
    }
  }
  record.dwells = kept;
  const CalibrationResult result = analyse_joint(record);
  ASSERT_TRUE(result.sensitivity_matrix) << result.why;
  EXPECT_EQ(result.diagnostics.angles_used, 72 + 1 + 24 + 40);
  for (std::size_t j = 0; j < 3; ++j) {
    EXPECT_LT(std::abs(deviation(result.intrinsic_sensitivity[j],
                                 aut.sensitivity_matrix.row(static_cast<Eigen::Index>(j)).norm())),
              4.5);
  }
  // Errors of angles that were not measured have no number.
  EXPECT_TRUE(std::isnan(result.joint->step_error[1][0].value));
  EXPECT_FALSE(std::isnan(result.joint->step_error[1][2].value));
  EXPECT_EQ(result.joint->step_error[0].size(), 72U);
}

TEST(JointFitTest, OneMapPerAxisUsesTheStepErrorsOfBothExperiments) {
  const AccelerometerModel aut = some_accelerometer();
  std::mt19937_64 engine(17);
  AcsErrors acs = some_errors(engine);
  acs.step_errors[1] = acs.step_errors[0];
  RunRecord record = test::made_record(aut, acs);
  test::add_noise(record, 1e-5, engine);
  JointOptions options;
  options.one_map_per_axis = true;
  const CalibrationResult shared = analyse_joint(record, options);
  const CalibrationResult separate = analyse_joint(record);
  ASSERT_EQ(shared.verdict, Verdict::kUsable) << shared.why;
  EXPECT_EQ(shared.joint->step_error[0][10].value, shared.joint->step_error[1][10].value);
  // Two circles with one map determine the accelerometer better than two circles with two.
  EXPECT_LT(shared.intrinsic_angle[1].standard_uncertainty, separate.intrinsic_angle[1].standard_uncertainty);
  EXPECT_LT(std::abs(deviation(shared.joint->step_error[0][10], acs.step_errors[0][10].deg())), 4.5);
  // With maps that are not shared the option contradicts the readings, and chi2 says so.
  acs.step_errors[1].assign(72, Angle::degrees(0.0));
  record = test::made_record(aut, acs);
  test::add_noise(record, 1e-5, engine);
  EXPECT_EQ(analyse_joint(record, options).verdict, Verdict::kDoubtful);
}

TEST(JointFitTest, MeasuredAlignmentServesAsData) {
  const AccelerometerModel aut = some_accelerometer();
  std::mt19937_64 engine(19);
  const AcsErrors acs = some_errors(engine);
  RunRecord record = test::made_record(aut, acs);
  test::add_noise(record, 1e-5, engine);
  JointOptions options;
  options.measured_alignment.zy = MeasuredValue{acs.alignment.zy, 5e-6};
  const CalibrationResult with = analyse_joint(record, options);
  const CalibrationResult without = analyse_joint(record);
  // The run alone does not determine the orientation about X.
  EXPECT_GT((*without.sensitivity_matrix)[1][2].standard_uncertainty, 7e-5);
  EXPECT_LT((*with.sensitivity_matrix)[1][2].standard_uncertainty, 1e-5);
  EXPECT_LT(std::abs(deviation((*with.sensitivity_matrix)[1][2], aut.sensitivity_matrix(1, 2))), 4.5);
}

TEST(JointFitTest, ChiSquareRefusesAnAccelerometerThatTheModelDoesNotKnow) {
  RunRecord record = noisy_record(some_accelerometer(), 23, 1e-5);
  ASSERT_EQ(analyse_joint(record).verdict, Verdict::kUsable);
  for (DwellRecord& dwell : record.dwells) {
    const double l = dwell.mean(0) - 0.05;
    dwell.mean(0) += 3e-4 * l * l * l * l * l;  // a fifth-order term
  }
  JointOptions options;
  options.noise_process = false;
  CalibrationResult result = analyse_joint(record, options);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, HasSubstr("chi2"));
  EXPECT_LT(*result.diagnostics.chi2_probability, 1e-3);
  // With the noise process in the fit a term that is stated as zero reads as slow noise, of which chi2 says
  // nothing. The residuals still have the shape of the term.
  result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful) << result.why;
  EXPECT_THAT(result.why, HasSubstr("k5 of u is stated as zero, and is not (nonlinearity"));
}

// docs/theory/joint_estimator.md: "k2 = 1e-4 gives chi2/dof 3.3 and 7e-5 in s_uz, s_wx, O; k3 = 1e-4
// gives 2.2 and 8e-5 in the diagonal" when they are left out. Its figures are of one AUT and two digits: 10 %
// on chi2, 20 % on the errors.
TEST(JointFitTest, NonlinearityLeftOutIsSoakedUpElsewhereAndChiSquareSays) {
  const AccelerometerModel ideal;
  std::mt19937_64 engine(29);
  JointOptions options;
  options.nonlinearity = Nonlinearity::kLeftOut;
  options.noise_process = false;
  double chi2_k2 = 0.0;
  double chi2_k3 = 0.0;
  double offset = 0.0;
  double diagonal = 0.0;
  constexpr int kRuns = 20;
  for (int run = 0; run < kRuns; ++run) {
    AccelerometerModel aut = ideal;
    aut.k2.setConstant(1e-4);
    const AcsErrors acs = some_errors(engine);
    RunRecord record = test::made_record(aut, acs);
    test::add_noise(record, 1e-5, engine);
    CalibrationResult result = analyse_joint(record, options);
    EXPECT_EQ(result.verdict, Verdict::kDoubtful);
    chi2_k2 += *result.diagnostics.chi2 / result.diagnostics.degrees_of_freedom / kRuns;
    offset += result.offset[0].value / kRuns;
    aut.k2.setZero();
    aut.k3.setConstant(1e-4);
    record = test::made_record(aut, acs);
    test::add_noise(record, 1e-5, engine);
    result = analyse_joint(record, options);
    EXPECT_EQ(result.verdict, Verdict::kDoubtful);
    chi2_k3 += *result.diagnostics.chi2 / result.diagnostics.degrees_of_freedom / kRuns;
    diagonal += ((*result.sensitivity_matrix)[0][0].value - 1.0) / kRuns;
  }
  EXPECT_NEAR(chi2_k2, 2.9, 0.29);  // 3.3 with drift of the first order alone
  EXPECT_NEAR(chi2_k3, 2.2, 0.22);
  EXPECT_NEAR(offset, 7e-5, 1.4e-5);
  EXPECT_NEAR(diagonal, 8e-5, 1.6e-5);
}

// No test decides whether k2 and k3 are in the fit: a term that is not seen may still be present.
TEST(JointFitTest, NonlinearityIsAlwaysFitted) {
  for (unsigned seed = 100; seed < 105; ++seed) {
    const CalibrationResult result = analyse_joint(noisy_record(some_accelerometer(), seed, 1e-5));
    EXPECT_TRUE(result.joint->nonlinearity_fitted);
    EXPECT_FALSE(std::isnan(result.joint->k2[0].value));
    EXPECT_LT(std::abs(deviation(result.joint->k3[0], 0.0)), 4.5);
  }
}

TEST(JointFitTest, EstimatesTheNoiseWhereReadingsCarryNoUncertainty) {
  RunRecord record = noisy_record(some_accelerometer(), 31, 1e-5);
  const CalibrationResult with = analyse_joint(record);
  for (DwellRecord& dwell : record.dwells) dwell.u_mean.reset();
  const CalibrationResult without = analyse_joint(record);
  ASSERT_EQ(without.verdict, Verdict::kUsable) << without.why;
  EXPECT_THAT(without.why, HasSubstr("carry no uncertainty"));
  EXPECT_FALSE(without.diagnostics.chi2.has_value());
  // Some 140 degrees of freedom an accelerometer: its noise is known to 6 %; three of them.
  EXPECT_NEAR(without.intrinsic_sensitivity[0].standard_uncertainty /
                  with.intrinsic_sensitivity[0].standard_uncertainty,
              1.0, 0.18);
  // A fifth-order term cannot hide behind a larger noise: its residuals follow the angle.
  for (DwellRecord& dwell : record.dwells) dwell.mean(0) += 1e-3 * std::pow(dwell.mean(0) - 0.05, 5);
  const CalibrationResult bent = analyse_joint(record);
  EXPECT_EQ(bent.verdict, Verdict::kDoubtful);
  EXPECT_THAT(bent.why, HasSubstr("correlated"));
}

TEST(JointFitTest, NoiseFreeReadingsAreFitted) {
  const AccelerometerModel aut = some_accelerometer();
  std::mt19937_64 engine(37);
  const CalibrationResult result = analyse_joint(test::made_record(aut, some_errors(engine)));
  ASSERT_TRUE(result.sensitivity_matrix) << result.why;
  for (std::size_t j = 0; j < 3; ++j) {
    // The uncertainty is held at 1e-9 S_j a reading; nothing but second-order terms may remain.
    EXPECT_NEAR(result.intrinsic_sensitivity[j].value,
                aut.sensitivity_matrix.row(static_cast<Eigen::Index>(j)).norm(), 1e-8);
    EXPECT_NEAR(result.offset[j].value, aut.offset(static_cast<Eigen::Index>(j)), 1e-8);
  }
}

TEST(JointFitTest, ManyAnglesThatHadToBeRepeatedMakeTheResultDoubtful) {
  RunRecord record = noisy_record(some_accelerometer(), 8, 1e-5);
  EXPECT_EQ(analyse_joint(record).verdict, Verdict::kUsable);
  for (std::size_t k = 0; k < 55; ++k) record.dwells[3 * k].flags = kFlagRepeated;
  const CalibrationResult result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, HasSubstr("55 of 216 angles had to be measured again"));
}

TEST(JointFitTest, StageOutsideItsToleranceMakesTheResultDoubtful) {
  AcsErrors acs;
  acs.alignment.xz = 10.0 * std::sin(0.008 * kRadian);
  std::mt19937_64 engine(41);
  RunRecord record = test::made_record(some_accelerometer(), acs);
  test::add_noise(record, 1e-5, engine);
  const CalibrationResult result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, HasSubstr("Xz"));
}

TEST(JointFitTest, SizesThatAreNoSizesAreRefusedByName) {
  RunRecord record = noisy_record(some_accelerometer(), 43, 1e-5);
  const auto refused = [&](const std::string& key) {
    const CalibrationResult result = analyse_joint(record);
    EXPECT_EQ(result.verdict, Verdict::kNotUsable) << key;
    EXPECT_THAT(result.why, HasSubstr(key));
    EXPECT_FALSE(result.sensitivity_matrix);
    record.tolerances = without_further_effects({});
  };
  record.tolerances.step = Angle::degrees(-0.008);
  refused("step_deg is -0.008");
  record.tolerances.initial_turn = Angle::degrees(std::numeric_limits<double>::quiet_NaN());
  refused("initial_turn_deg is nan");
  record.tolerances.drift = -1e-4;
  refused("drift is -0.0001");
  record.tolerances.wobble_urad = std::numeric_limits<double>::infinity();
  refused("wobble_urad is inf");
  JointOptions options;
  options.measured_alignment.zx = MeasuredValue{0.0, 0.0};
  EXPECT_THAT(analyse_joint(record, options).why, HasSubstr("measured Zx = 0 with standard uncertainty 0"));
}

// A size stated as exactly zero is known exactly, as on a stage without that error.
TEST(JointFitTest, SizesOfZeroAreKnownExactly) {
  const AccelerometerModel aut = some_accelerometer();
  AcsErrors acs;
  acs.alignment = {1e-4, -5e-5, 8e-5};
  std::mt19937_64 engine(61);
  RunRecord perfect = test::made_record(aut, {});
  RunRecord tilted = test::made_record(aut, acs);
  test::add_noise(perfect, 1e-5, engine);
  test::add_noise(tilted, 1e-5, engine);
  for (RunRecord* record : {&perfect, &tilted}) {
    record->tolerances.step = record->tolerances.alignment = Angle::degrees(0.0);
    record->tolerances.zero = record->tolerances.initial_turn = Angle::degrees(0.0);
  }
  CalibrationResult result = analyse_joint(perfect);
  EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
  // Without F_X nothing hides the orientation about X: that of 144 readings with noise of 1e-5, and drifts.
  EXPECT_LT((*result.sensitivity_matrix)[1][2].standard_uncertainty, 1e-5);
  EXPECT_NEAR((*result.sensitivity_matrix)[1][2].value, aut.sensitivity_matrix(1, 2), 5e-6);
  EXPECT_TRUE(std::isnan(result.joint->alignment[0].value));
  // Alignment that is not zero contradicts the statement, and is named.
  result = analyse_joint(tilted);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, HasSubstr("Xz is stated as zero, and is not (alignment_deg"));
  // One that was measured otherwise is an unknown with that prior.
  JointOptions options;
  options.measured_alignment = {MeasuredValue{1e-4, 1e-6}, MeasuredValue{-5e-5, 1e-6},
                                MeasuredValue{8e-5, 1e-6}};
  result = analyse_joint(tilted, options);
  EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
  EXPECT_NEAR(result.joint->alignment[2].value, 8e-5, 5e-6);
}

TEST(JointFitTest, AnOutputThatTheAnglesDoNotDetermineIsToldWithWhatToAdd) {
  RunRecord record = noisy_record(some_accelerometer(), 67, 1e-5);
  std::erase_if(record.dwells, [](const DwellRecord& dwell) { return (dwell.n - 1) % 18 != 0; });  // 4 of 72
  const CalibrationResult result = analyse_joint(record);
  ASSERT_TRUE(result.sensitivity_matrix) << result.why;
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why,
              testing::AllOf(HasSubstr("s_ux, s_vy, s_wz are known to"), HasSubstr("do not determine k3"),
                             HasSubstr("Measure more angles on full circles"),
                             HasSubstr("state a smaller [item_uncertainty] k3")));
  record.tolerances.k3 = 1e-4;
  EXPECT_EQ(analyse_joint(record).verdict, Verdict::kUsable) << "what was asked for has been stated";
  // 72 angles determine everything.
  const CalibrationResult whole = analyse_joint(noisy_record(some_accelerometer(), 67, 1e-5));
  EXPECT_EQ(whole.verdict, Verdict::kUsable);
  EXPECT_THAT(whole.diagnostics.notes, testing::Not(testing::Contains(HasSubstr("determine"))));
}

// No angle distinguishes a turn of everything about X from the tilt of Z: both are known only as well as
// stated.
TEST(JointFitTest, AnOutputThatOnlyAStatementDeterminesIsToldAndDoubtfulBeyondTwoPercent) {
  RunRecord record = noisy_record(some_accelerometer(), 67, 1e-5);
  record.tolerances.zero = record.tolerances.alignment = record.tolerances.initial_turn = Angle::degrees(0.3);
  CalibrationResult result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
  EXPECT_THAT(result.diagnostics.notes,
              testing::Contains(testing::AllOf(HasSubstr("s_vz"), HasSubstr("no angle of a run tells"),
                                               HasSubstr("abcal level"), HasSubstr("_deg with its source"))));
  record.tolerances.zero = record.tolerances.alignment = record.tolerances.initial_turn = Angle::degrees(3.0);
  result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, testing::AllOf(HasSubstr("s_vz"), HasSubstr("no angle of a run tells")));
  // The published protocol, whose type B has it.
  record.tolerances.alignment = record.tolerances.initial_turn = Angle::degrees(0.008);
  result = analyse_abc(record);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, HasSubstr("no angle of a run tells F_X"));
  record.tolerances.zero = Angle::degrees(0.008);
  record.tolerances.initial_turn = Angle::degrees(3.0);
  result = analyse_abc(record);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, testing::AllOf(HasSubstr("this estimator takes d"), HasSubstr("initial_turn_deg")));
  EXPECT_EQ(analyse_joint(record).verdict, Verdict::kUsable) << "the readings show the turns";
}

TEST(JointFitTest, RunsThatDoNotDetermineTheMatrixGiveNoNumbers) {
  RunRecord record = noisy_record(some_accelerometer(), 47, 1e-5);
  record.dwells.resize(72);  // experiment 1 alone: gravity never leaves the y-z plane
  CalibrationResult result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kNotUsable);
  EXPECT_THAT(result.why, HasSubstr("do not determine"));
  EXPECT_FALSE(result.sensitivity_matrix.has_value());
  record.dwells.resize(3);
  result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kNotUsable);
  EXPECT_THAT(result.why, HasSubstr("3 usable angles"));
  record.dwells.clear();
  EXPECT_EQ(analyse_joint(record).verdict, Verdict::kNotUsable);
}

TEST(JointFitTest, OutputThatNeverChangesGivesNoNumbers) {
  RunRecord record = noisy_record(some_accelerometer(), 59, 1e-5);
  for (const double constant : {0.0, 0.3}) {
    for (DwellRecord& dwell : record.dwells) dwell.mean(2) = constant;
    const CalibrationResult result = analyse_joint(record);
    EXPECT_EQ(result.verdict, Verdict::kNotUsable);
    EXPECT_THAT(result.why, HasSubstr("accelerometer w does not respond"));
  }
  // The same holds if nothing responds and no uncertainty is stated.
  for (DwellRecord& dwell : record.dwells) {
    dwell.mean.setZero();
    dwell.u_mean.reset();
  }
  const CalibrationResult result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kNotUsable);
  EXPECT_THAT(result.why, HasSubstr("accelerometer u, v, w does not respond"));
}

TEST(JointFitTest, ReadingsThatAreNotFiniteAreRefusedUnlessFlagged) {
  RunRecord record = noisy_record(some_accelerometer(), 53, 1e-5);
  record.dwells[5].mean(1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(analyse_joint(record), UnusableData);
  record.dwells[5].flags = kFlagNotFinite;
  record.dwells[6].flags = kFlagClipped;
  const CalibrationResult result = analyse_joint(record);
  EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
  EXPECT_EQ(result.diagnostics.angles_used, 214);
  record.dwells[7].experiment = 4;
  EXPECT_THROW(analyse_joint(record), UnusableData);
}

}  // namespace
}  // namespace abcal
