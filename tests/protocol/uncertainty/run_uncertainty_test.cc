#include "protocol/uncertainty/run_uncertainty.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/model/effects.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/type_b.h"

namespace abcal {
namespace {

// A record of simulated readings, with white noise and its standard uncertainty.
RunRecord simulated_record(const AccelerometerUnderTest& accelerometer, const AcsErrors& errors, double noise,
                           int steps = 72) {
  RunRecord record;
  record.source = "simulated";
  record.steps = steps;
  record.step = Angle::degrees(360.0 / steps);
  const auto readings = simulated_readings(AbcDesign::uniform(steps, record.step), accelerometer, errors);
  RandomStream stream(1, StreamPurpose::kTest, 77);
  for (int i = 0; i < 3; ++i) {
    for (int n = 0; n < steps; ++n) {
      DwellRecord dwell;
      dwell.experiment = i + 1;
      dwell.n = n + 1;
      dwell.alpha = record.step * n;
      dwell.mean = readings[static_cast<std::size_t>(i)].row(n).transpose();
      for (double& reading : dwell.mean) reading += noise * stream.normal();
      if (noise > 0.0) dwell.u_mean = Eigen::Vector3d::Constant(noise);
      record.dwells.push_back(dwell);
    }
  }
  return record;
}

UncertaintyOptions quick() {
  UncertaintyOptions options;
  options.trials = 2000;
  return options;
}

TEST(RunUncertaintyTest, TypeBIsThatOfTheSameAccelerometerAndTolerances) {
  const RunRecord record = simulated_record(table_2_accelerometer(), {}, 0.0);
  const RunUncertainty study = run_uncertainty(record, quick());
  TypeBStudy type_b;
  type_b.accelerometer = table_2_accelerometer();
  MonteCarloOptions options;
  options.trials = 2000;
  const MonteCarloResult direct = run_type_b(type_b, options);
  for (int k = 0; k < kStudyOutputs; ++k) {
    EXPECT_NEAR(study.type_b.standard_deviation(k) / direct.standard_deviation(k), 1.0, 1e-9)
        << output_symbol(k);
  }
}

TEST(RunUncertaintyTest, TheBudgetAgreesWithMonteCarloAndItsSharesAddUp) {
  const RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-4);
  UncertaintyOptions options;
  options.trials =
      100000;  // The ends of the intervals are then known to 0.3 %, half of what their second digit asks.
  const RunUncertainty study = run_uncertainty(record, options);
  for (int k = 0; k < kStudyOutputs; ++k) {
    double shares = 0.0;
    for (const BudgetLine& line : study.budget.lines) shares += study.budget.share(line, k);
    EXPECT_NEAR(shares, 1.0, 1e-12) << output_symbol(k);
    // First order against Monte Carlo: 5 standard deviations of a standard deviation of 5000 trials.
    EXPECT_NEAR(study.budget.combined(k) / study.combined.standard_deviation(k), 1.0, 0.05)
        << output_symbol(k);
    EXPECT_NEAR(study.budget.combined(k), std::sqrt(study.budget.covariance(k, k)),
                1e-9 * study.budget.combined(k))
        << output_symbol(k);
    EXPECT_TRUE(study.validation.at(static_cast<std::size_t>(k)).validated) << output_symbol(k);
  }
  bool nutation = false;
  for (const Message& item : study.budget.not_covered)
    nutation = nutation || item.english().starts_with("nutation");
  EXPECT_TRUE(nutation);
}

// Everything of the budget is drawn with its correlations, also where ABC's correction for k2 and k3 makes
// the drawn errors smaller (incomplete circles).
TEST(RunUncertaintyTest, MonteCarloDrawsTheCovarianceOfTheResult) {
  RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-4);
  std::erase_if(record.dwells,
                [](const DwellRecord& dwell) { return dwell.n > 60 && dwell.experiment != 2; });
  UncertaintyOptions options;
  options.trials = 50000;
  const RunUncertainty study = run_uncertainty(record, options);
  const Covariance12& stated = *study.result.covariance;
  for (Eigen::Index a = 0; a < 12; ++a) {
    for (Eigen::Index b = 0; b <= a; ++b) {
      const double scale = std::sqrt(stated(a, a) * stated(b, b));
      // Five standard deviations of a covariance of 50000 trials; second order in angles of 1e-4 is less.
      EXPECT_NEAR(study.combined.covariance(a, b) / scale, stated(a, b) / scale,
                  5.0 * std::sqrt(2.0 / 50000.0))
          << a << " " << b;
    }
  }
}

TEST(RunUncertaintyTest, NoiseEntersAsTheFitPassesItOn) {
  const RunRecord record = simulated_record({}, {}, 1e-3);
  const Budget budget = make_budget(record, analyse_abc(record));
  for (const BudgetLine& line : budget.lines) {
    if (!line.type_a) continue;
    // docs/theory/uncertainty.md: u(s) = sigma/sqrt(N), u(O) = sigma/sqrt(3 N), u(phi) = sqrt(2)
    // sigma/sqrt(N) rad. The correction for k3 (0.75 - 0.6 times it in the diagonal) adds the uncertainty of
    // k3: a third harmonic of 1/4 on two circles.
    EXPECT_NEAR(line.contribution(0), 1e-3 * std::sqrt(1.0 / 72.0 + 0.15 * 0.15 * 32.0 / 144.0), 1e-9);
    EXPECT_NEAR(line.contribution(9), 1e-3 / std::sqrt(216.0), 1e-9);
    EXPECT_NEAR(line.contribution(15), std::sqrt(2.0) * 1e-3 / std::sqrt(72.0) * 57.29578, 5e-5);
    return;
  }
  FAIL() << "no type A line";
}

TEST(RunUncertaintyTest, ResolutionIsALineOnlyWhereItIsKnown) {
  const RunRecord record = simulated_record({}, {}, 1e-5);
  const CalibrationResult result = analyse_abc(record);
  const Budget without = make_budget(record, result);
  const Budget with = make_budget(record, result, 1e-3);
  EXPECT_EQ(with.lines.size(), without.lines.size() + 1);
  for (const BudgetLine& line : with.lines) {
    if (line.input.english().starts_with("resolution")) {
      EXPECT_NEAR(line.contribution(0), 1e-3 / std::sqrt(12.0) / std::sqrt(72.0), 1e-12);
      EXPECT_EQ(line.distribution, "rectangular");
    }
  }
  EXPECT_THROW(make_budget(record, result, 0.0), std::invalid_argument);
}

// One result, one uncertainty: the budget combines to what the result states, for every output.
TEST(RunUncertaintyTest, TheBudgetCombinesToTheStatedUncertainty) {
  for (std::uint64_t run = 0; run < 100; ++run) {
    RandomStream stream(99, StreamPurpose::kTest, run);
    AccelerometerUnderTest aut = table_2_accelerometer();
    for (double& element : aut.sensitivity_matrix.reshaped()) element += 0.1 * stream.normal();
    RunRecord record = simulated_record(aut, {}, 1e-5);
    record.tolerances.wobble_urad = 30.0 * std::abs(stream.normal());
    record.tolerances.nonlinearity = 1e-4 * std::abs(stream.normal());
    record.tolerances.step_smooth = Angle::degrees(0.004 * std::abs(stream.normal()));
    const CalibrationResult result = analyse_abc(record);
    const Budget budget = make_budget(record, result);
    const auto same = [&](const Quantity& stated, int output) {
      EXPECT_NEAR(budget.combined(output) / stated.standard_uncertainty, 1.0, 1e-9) << output_symbol(output);
    };
    for (std::size_t j = 0; j < 3; ++j) {
      const int row = static_cast<int>(j);
      for (std::size_t k = 0; k < 3; ++k)
        same((*result.sensitivity_matrix)[j][k], 3 * row + static_cast<int>(k));
      same(result.offset[j], 9 + row);
      same(result.intrinsic_sensitivity[j], kFirstIntrinsicSensitivity + row);
      same(result.intrinsic_angle[j], kFirstIntrinsicAngle + row);
    }
  }
}

// The budget states the results of the check poses, which add nothing to the lines of the drifts.
TEST(RunUncertaintyTest, TheBudgetSaysWhatTheCheckPosesShow) {
  RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-5);
  const auto note_of = [](const Budget& budget) {
    for (const std::string& note : budget.notes)
      if (note.starts_with("Check poses")) return note;
    return std::string();
  };
  EXPECT_EQ(note_of(make_budget(record, analyse_abc(record))), "");
  const AccelerometerUnderTest aut = table_2_accelerometer();
  const std::array<CheckPose, kCheckPoses> poses = check_poses();
  for (const std::size_t after : {0U, 72U, 144U, 216U}) {
    for (int n = 1; n <= kCheckPoses; ++n) {
      DwellRecord dwell;
      dwell.n = n;
      dwell.role = DwellRole::kCheck;
      const CheckPose& pose = poses[static_cast<std::size_t>(n - 1)];
      dwell.commanded_x = pose.x;
      dwell.commanded_z = pose.z;
      const SinCos x = sincos(pose.x), z = sincos(pose.z);
      dwell.mean = aut.sensitivity_matrix * Eigen::Vector3d(x.sin * z.sin, x.sin * z.cos, x.cos) + aut.offset;
      if (after == 216) dwell.mean(2) += 4e-5;  // The offset drifted within its statement.
      dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
      record.check_poses.push_back({dwell, after});
    }
  }
  const CalibrationResult result = analyse_abc(record);
  const Budget budget = make_budget(record, result);
  const std::string note = note_of(budget), of_offset = "of an offset ";
  ASSERT_NE(note.find(of_offset), std::string::npos) << note;
  EXPECT_THAT(note, testing::HasSubstr("change of a gain "));
  const double s_w = aut.sensitivity_matrix.row(2).norm();
  EXPECT_NEAR(std::stod(note.substr(note.find(of_offset) + of_offset.size())), 4e-5 / s_w, 1e-6);
  for (const BudgetLine& line : budget.lines)
    EXPECT_FALSE(line.contribution.isZero(0.0)) << line.input << " does not apply";
  EXPECT_NEAR(budget.combined(9) / result.offset[0].standard_uncertainty, 1.0, 1e-9);
}

TEST(RunUncertaintyTest, TypeAWithMeasuredErrorsFindsTheTruthThatPlainAbcMisses) {
  AcsErrors errors;
  errors.alignment = {2e-4, -1e-4, 3e-4};
  errors.d2 = Angle::degrees(0.01);
  errors.mean_step_x = Angle::degrees(-0.02);
  const RunRecord record = simulated_record(table_2_accelerometer(), errors, 0.0);
  const OutputVector truth = to_vector(true_outputs(table_2_accelerometer(), errors.alignment));
  MeasuredAcs measured;
  measured.state.names = {"Zx", "Zy", "Xz", "d2", "F_X"};
  measured.state.mean.resize(5);
  measured.state.mean << 2e-4, -1e-4, 3e-4, errors.d2.rad(), errors.mean_step_x.rad();
  measured.state.covariance = Eigen::MatrixXd::Zero(5, 5);
  MonteCarloOptions options;
  options.trials = 200;
  const MonteCarloResult exact = run_type_a(record, measured, 1, options);
  for (int k = 0; k < kStudyOutputs; ++k) {
    EXPECT_NEAR(exact.mean(k), truth(k), k < kFirstIntrinsicAngle ? 1e-14 : 1e-12) << output_symbol(k);
    EXPECT_LT(exact.standard_deviation(k), 1e-12) << output_symbol(k);  // nothing was drawn
  }
  const MonteCarloResult blind = run_type_a(record, {}, 1, options);
  EXPECT_GT((blind.mean - truth).cwiseAbs().maxCoeff(), 1e-4);
  // Uncertainties of the means spread the result in proportion.
  measured.state.covariance.topLeftCorner<3, 3>() = 1e-10 * Eigen::Matrix3d::Identity();
  const MonteCarloResult spread = run_type_a(record, measured, 1, options);
  EXPECT_GT(spread.standard_deviation(2), 1e-6);
  EXPECT_LT(spread.standard_deviation(2), 1e-4);
  measured.state.covariance(0, 0) = -1e-10;
  EXPECT_THROW(run_type_a(record, measured, 1, options), std::invalid_argument);
}

// The outputs at the errors' means, by which the moments of a trial are computed without drawing.
OutputVector fitted(const RunRecord& record, MeasuredAcs known) {
  known.state.covariance.setZero();
  known.step = known.repeatability = Angle();
  MonteCarloOptions options;
  options.trials = 2;
  return run_type_a(record, known, 1, options, TypeADraw::kEachError).mean;
}

TEST(RunUncertaintyTest, TheSumsOfTypeAHaveTheMomentsOfItsErrors) {
  AcsErrors errors;
  errors.alignment = {2e-4, -1e-4, 3e-4};
  errors.mean_step_x = Angle::degrees(-0.02);
  const RunRecord record = simulated_record(table_2_accelerometer(), errors, 1e-5, 12);
  const MeasuredAcs measured = MeasuredAcs::not_measured(record);
  // To first order, along each independent error.
  const OutputVector centre = fitted(record, measured);
  OutputCovariance expected = OutputCovariance::Zero();
  OutputVector mean = centre;
  const auto add = [&](const OutputVector& below, const OutputVector& above) {
    expected += 0.25 * (above - below) * (above - below).transpose();
    mean += 0.5 * (above + below) - centre;
  };
  for (Eigen::Index k = 0; k < measured.state.mean.size(); ++k) {
    MeasuredAcs above = measured, below = measured;
    above.state.mean(k) += std::sqrt(measured.state.covariance(k, k));
    below.state.mean(k) -= std::sqrt(measured.state.covariance(k, k));
    add(fitted(record, below), fitted(record, above));
  }
  for (std::size_t i = 0; i < record.dwells.size(); ++i) {
    if (record.dwells[i].closing) continue;
    RunRecord above = record, below = record;
    above.dwells[i].alpha += measured.step;
    below.dwells[i].alpha += -measured.step;
    add(fitted(below, measured), fitted(above, measured));
  }
  MonteCarloOptions options;
  options.trials = 100'000;
  const auto n = static_cast<double>(*options.trials);
  const auto expect_moments = [&](const MonteCarloResult& found, double trials) {
    for (int i = 0; i < kStudyOutputs; ++i) {
      const double u = std::sqrt(expected(i, i));
      // Five standard deviations of the mean and of a covariance of so many normal numbers; what is left of
      // higher order is of the size of an error in radian, 1.4e-4.
      EXPECT_NEAR(found.mean(i), mean(i), 5.0 * u / std::sqrt(trials)) << output_symbol(i);
      for (int k = 0; k <= i; ++k) {
        const double product = expected(i, i) * expected(k, k);
        const double sd = std::sqrt((product + expected(i, k) * expected(i, k)) / trials);
        EXPECT_NEAR(found.covariance(i, k), expected(i, k), 5.0 * sd + 1e-3 * std::sqrt(product))
            << output_symbol(i) << ", " << output_symbol(k);
      }
    }
  };
  expect_moments(run_type_a(record, measured, 1, options), n);
  options.trials = 10'000;
  expect_moments(run_type_a(record, measured, 1, options, TypeADraw::kEachError), 1e4);
}

TEST(RunUncertaintyTest, LargeErrorsOfTypeAAreDrawnOneByOne) {
  const RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-5, 12);
  MeasuredAcs measured = MeasuredAcs::not_measured(record);
  MonteCarloOptions options;
  options.trials = 200;
  const auto are_equal = [&] {
    return run_type_a(record, measured, 1, options).covariance ==
           run_type_a(record, measured, 1, options, TypeADraw::kEachError).covariance;
  };
  EXPECT_FALSE(are_equal()) << "the sums are drawn";
  const double most = Angle::degrees(kMostSummedTypeADegrees).rad();
  measured.state.covariance(0, 0) = 1.01 * most * most;
  EXPECT_TRUE(are_equal());
  measured = MeasuredAcs::not_measured(record);
  measured.step = Angle::degrees(1.01 * kMostSummedTypeADegrees);
  EXPECT_TRUE(are_equal());
}

// Stages drawn from the covariance that the evaluation is told, all effects of the stage among them.
TEST(RunUncertaintyTest, TypeACoversStagesThatItsCovarianceDescribes) {
  RunRecord record = simulated_record(table_2_accelerometer(), {}, 0.0, 24);
  MeasuredAcs measured = MeasuredAcs::not_measured(record);
  measured.state.angles = {{'X', 90'000'000}};
  const auto size = static_cast<Eigen::Index>(measured.state.names.size());
  measured.state.mean = Eigen::VectorXd::Zero(size + 1);
  measured.state.covariance.conservativeResizeLike(Eigen::MatrixXd::Zero(size + 1, size + 1));
  measured.state.covariance(size, size) = 1e-8;
  // Two wobbles that are known together only: their sum is zero.
  const Eigen::Index one = measured.state.place_of("wobble of X, sin 1/rev, direction 1");
  const Eigen::Index other = measured.state.place_of("wobble of X, sin 1/rev, direction 2");
  ASSERT_GE(one, 0);
  ASSERT_GE(other, 0);
  measured.state.covariance(one, other) = measured.state.covariance(other, one) =
      -measured.state.covariance(one, one);
  RandomStream draw(5, StreamPurpose::kTest, 3);
  MonteCarloOptions options;
  options.trials = 300;
  const AccelerometerUnderTest truth = table_2_accelerometer();
  const OutputVector true_values = to_vector(outputs_of(truth.sensitivity_matrix, truth.offset));
  OutputVector z2 = OutputVector::Zero();
  constexpr int kStages = 40;
  const auto measure = [&](const Eigen::VectorXd& q, double step_sd) {
    for (DwellRecord& dwell : record.dwells) {
      const SinCos alpha = sincos(dwell.alpha);
      const StagePose pose = StagePose::of(dwell.experiment, 1, alpha.sin, alpha.cos);
      StageInputs inputs = StageInputs::Zero();
      Eigen::Index at = 0;
      for (const StageEffect& effect : stage_effects()) {
        if (effect.face != 1) continue;
        for (int i = 0; i < effect.count; ++i, ++at) {
          const StageShare share = effect.share(pose, i);
          inputs(share.input) += share.value * q(at);
          inputs(share.second_input) += share.second_value * q(at);
        }
      }
      const int moving = moving_angle_input(dwell.experiment);
      if (dwell.experiment != 3 && std::abs(dwell.alpha.deg() - 90.0) < 1e-6) inputs(moving) += q(size);
      inputs(moving) += step_sd * draw.normal();
      dwell.mean = truth.sensitivity_matrix * gravity_alone(pose, inputs) + truth.offset;
    }
  };
  const auto drawn = [&] {
    Eigen::VectorXd q(size + 1);
    for (Eigen::Index i = 0; i <= size; ++i)
      q(i) = std::sqrt(measured.state.covariance(i, i)) * draw.normal();
    q(other) = -q(one);
    return q;
  };
  // A stage that is known exactly: the truth.
  MeasuredAcs known = measured;
  known.state.mean = drawn();
  known.state.covariance.setZero();
  known.step = known.repeatability = Angle();
  measure(known.state.mean, 0.0);
  const MonteCarloResult exact = run_type_a(record, known, 1, options);
  for (int k = 0; k < kStudyOutputs; ++k)
    EXPECT_NEAR(exact.mean(k), true_values(k), 1e-11) << output_symbol(k);

  for (int stage = 0; stage < kStages; ++stage) {
    measure(drawn(), record.tolerances.step.rad());
    const MonteCarloResult result = run_type_a(record, measured, 1, options);
    z2 += ((result.mean - true_values).array() / result.standard_deviation.array()).square().matrix();
  }
  // A mean of 40 squares of normal numbers is 1 within 0.22 (standard deviation).
  for (int k = 0; k < kStudyOutputs; ++k) {
    EXPECT_GT(z2(k) / kStages, 0.35) << output_symbol(k);
    EXPECT_LT(z2(k) / kStages, 1.9) << output_symbol(k);
  }
}

TEST(RunUncertaintyTest, ThePaperPresetWarnsWhereTheBenchExceedsIt) {
  const RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-5);
  UncertaintyOptions options = quick();
  options.paper_preset = true;
  const RunUncertainty study = run_uncertainty(record, options);
  // docs/theory/abc_protocol.md: Table 2's accelerometer gives more than the bounds for s_vy, s_v and O_v.
  std::string all;
  for (const std::string& warning : study.warnings) all += warning + "\n";
  for (const char* symbol : {"s_vy:", "s_v:", "O_v:"}) EXPECT_NE(all.find(symbol), std::string::npos) << all;
  EXPECT_GE(study.standard_uncertainty(1), 2e-4 * study.value.intrinsic_sensitivity(0));
  RunRecord fine = record;
  fine.tolerances.alignment = fine.tolerances.step = fine.tolerances.initial_turn = fine.tolerances.zero =
      Angle::degrees(0.0008);
  EXPECT_TRUE(run_uncertainty(fine, options).warnings.empty());
}

// Per m/s2 a sensitivity is s / g_loc: its relative variance is the sum of both.
TEST(RunUncertaintyTest, TheUncertaintyOfGravityIsARowOfSensitivitiesInSiUnits) {
  RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-5);
  const BudgetLine* none = nullptr;
  const auto gravity_of = [&](const Budget& budget) {
    const BudgetLine* found = none;
    for (const BudgetLine& line : budget.lines)
      if (line.input == "g_loc") found = &line;
    return found;
  };
  const CalibrationResult without = analyse_abc(record);
  EXPECT_EQ(gravity_of(make_budget(record, without)), none) << "not known, so not a row";
  record.g_loc = {9.81, 0.0, 2.0, "formula"};
  record.g_loc_known = true;
  const Budget unstated = make_budget(record, without);
  EXPECT_EQ(gravity_of(unstated), none);
  EXPECT_THAT(unstated.not_covered, testing::Contains(testing::HasSubstr("local gravity")));
  record.g_loc = {9.81, 4e-4, 2.0, "gravimeter"};
  const CalibrationResult result = analyse_abc(record);
  const Budget budget = make_budget(record, result);
  const BudgetLine* line = gravity_of(budget);
  ASSERT_NE(line, none);
  EXPECT_EQ(line->source, "gravimeter");
  const std::vector<Quantity> quantities = quantities_of_outputs(result);
  for (int k = 0; k < kStudyOutputs; ++k) {
    const Quantity& q = quantities[static_cast<std::size_t>(k)];
    EXPECT_EQ(line->contribution(k), 0.0) << output_symbol(k);
    const double expected = is_sensitivity(k)
                                ? std::hypot(q.standard_uncertainty, q.value * 2e-4 / 9.81) / 9.81
                                : budget.combined(k);
    EXPECT_NEAR(budget.combined_per_mps2(k), expected, 1e-9 * expected) << output_symbol(k);
    double shares = 0.0;
    for (const BudgetLine& each : budget.lines) shares += budget.share_per_mps2(each, k);
    EXPECT_NEAR(shares, 1.0, 1e-9) << output_symbol(k);
  }
  EXPECT_GT(budget.share_per_mps2(*line, kFirstIntrinsicSensitivity), 0.1);
}

// Welch and Satterthwaite's formula over the rows gives the degrees of freedom of the result.
TEST(RunUncertaintyTest, EveryRowHasItsDegreesOfFreedomAndItsSource) {
  RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-4, 12);
  for (DwellRecord& dwell : record.dwells) dwell.u_mean.reset();
  record.tolerances.sources = {{"alignment_deg", "certificate 12"}};
  record.tolerances.shapes = {{"zero_deg", Shape::kRectangular}};
  for (const CalibrationResult& result : {analyse_abc(record), analyse_joint(record)}) {
    const Budget budget = make_budget(record, result);
    const std::vector<Quantity> quantities = quantities_of_outputs(result);
    for (int k = 0; k < kStudyOutputs; ++k) {
      double sum = 0.0;
      for (const BudgetLine& line : budget.lines)
        sum += std::pow(line.contribution(k), 4) / line.degrees_of_freedom(k);
      const double nu = std::pow(budget.combined(k), 4) / sum;
      const double stated = quantities[static_cast<std::size_t>(k)].degrees_of_freedom;
      EXPECT_TRUE(std::isfinite(stated)) << result.estimator << " " << output_symbol(k);
      EXPECT_NEAR(nu / stated, 1.0, 1e-6) << result.estimator << " " << output_symbol(k);
    }
    for (const BudgetLine& line : budget.lines) {
      EXPECT_FALSE(line.source.empty()) << line.input;
      if (line.key == "alignment_deg") {
        EXPECT_EQ(line.source, "certificate 12");
      }
      if (line.key == "step_deg") {
        EXPECT_EQ(line.source, "default");
      }
      EXPECT_EQ(line.distribution, line.key == "zero_deg" ? "rectangular" : "normal") << line.input;
    }
  }
}

TEST(RunUncertaintyTest, WhatAnAssessorAsksForIsNamedAsNotCovered) {
  RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-5, 12);
  record.g_loc_known = true;
  const Budget budget = make_budget(record, analyse_abc(record));
  for (const char* word : {"torque", "cable", "self-heating", "magnetic", "vibration", "height", "tide"}) {
    bool named = false;
    for (const Message& source : budget.not_covered)
      named = named || source.english().find(word) != std::string::npos;
    EXPECT_TRUE(named) << word;
  }
}

TEST(RunUncertaintyTest, TheNumberOfThreadsChangesNoBit) {
  const RunRecord record = simulated_record(table_2_accelerometer(), {}, 1e-5, 24);
  UncertaintyOptions options;
  options.trials = 3000;
  options.threads = 1;
  const RunUncertainty one = run_uncertainty(record, options);
  options.threads = 3;
  const RunUncertainty three = run_uncertainty(record, options);
  EXPECT_EQ(one.type_a.covariance, three.type_a.covariance);
  EXPECT_EQ(one.combined.covariance, three.combined.covariance);
}

TEST(RunUncertaintyTest, RefusesWhatCannotBeAnswered) {
  RunRecord record = simulated_record({}, {}, 1e-5);
  UncertaintyOptions options = quick();
  options.trials = 0;
  EXPECT_THROW(run_uncertainty(record, options), std::invalid_argument);
  RunRecord negative = record;
  negative.tolerances.step = Angle::degrees(-1.0);
  EXPECT_THROW(run_uncertainty(negative, quick()), std::invalid_argument);
  RunRecord in_faces = record;
  for (DwellRecord& dwell : in_faces.dwells) dwell.face = dwell.n % 2 == 0 ? 2 : 1;
  try {
    run_uncertainty(in_faces, quick());
    ADD_FAILURE() << "accepted";
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), testing::AllOf(testing::HasSubstr("simulated: has two faces"),
                                             testing::HasSubstr("--estimator joint")));
  }
  record.dwells.resize(74);  // two angles of experiment 2, none of 3
  EXPECT_THROW(run_uncertainty(record, quick()), std::exception);
}

}  // namespace
}  // namespace abcal
