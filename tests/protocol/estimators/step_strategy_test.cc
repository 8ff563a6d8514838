#include "protocol/estimators/joint/step_strategy.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <functional>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/white_noise_fit.h"
#include "tests/protocol/estimators/made_record.h"

namespace abcal {
namespace {

/// Residuals and their derivatives, as functions of the unknowns.
class Residuals : public SumOfSquares {
 public:
  using Values = std::function<Eigen::VectorXd(const Eigen::VectorXd&)>;
  using Jacobian = std::function<Eigen::MatrixXd(const Eigen::VectorXd&)>;
  Residuals(Values values, Jacobian jacobian, Eigen::VectorXd start)
      : values_(std::move(values)), jacobian_(std::move(jacobian)), x_(std::move(start)) {}

  double cost() override { return values_(x_).squaredNorm(); }
  std::optional<double> solve_step(double damping, bool /*anew*/) override {
    largest_damping_ = std::max(largest_damping_, damping);
    last_damping_ = damping;
    const Eigen::MatrixXd jacobian = jacobian_(x_);
    Eigen::MatrixXd normal = jacobian.transpose() * jacobian;
    const Eigen::VectorXd diagonal = normal.diagonal();
    normal.diagonal() *= 1.0 + damping;
    const Eigen::VectorXd right = -jacobian.transpose() * values_(x_);
    step_ = normal.llt().solve(right);
    return right.dot(step_) + damping * diagonal.dot(step_.cwiseAbs2());
  }
  void move() override {
    before_ = x_;
    x_ += step_;
  }
  void move_back() override { x_ = before_; }

  const Eigen::VectorXd& x() const { return x_; }
  double largest_damping() const { return largest_damping_; }
  double last_damping() const { return last_damping_; }

 private:
  Values values_;
  Jacobian jacobian_;
  Eigen::VectorXd x_, step_, before_;
  double largest_damping_ = 0.0, last_damping_ = -1.0;
};

void expect_no_rise(const Minimum& minimum) {
  for (std::size_t i = 1; i < minimum.costs.size(); ++i)
    EXPECT_LT(minimum.costs[i], minimum.costs[i - 1]) << "step " << i;
}

// Newton's step for atan(x) = 0 overshoots more and more from |x| > 1.39.
TEST(StepStrategyTest, DampsWhereTheUndampedStepRaisesTheCost) {
  Residuals problem(
      [](const Eigen::VectorXd& x) { return Eigen::VectorXd::Constant(1, std::atan(x(0))); },
      [](const Eigen::VectorXd& x) { return Eigen::MatrixXd::Constant(1, 1, 1.0 / (1.0 + x(0) * x(0))); },
      Eigen::VectorXd::Constant(1, 3.0));
  const double start = problem.cost();
  problem.solve_step(0.0, true);
  problem.move();
  ASSERT_GT(problem.cost(), start) << "the case that this test is about did not arise";
  problem.move_back();
  const Minimum minimum = minimise(problem);
  EXPECT_TRUE(minimum.found);
  EXPECT_NEAR(problem.x()(0), 0.0, 1e-4);
  EXPECT_GT(problem.largest_damping(), 0.0);
  EXPECT_EQ(problem.last_damping(), 0.0) << "the covariance would be that of the damped matrix";
  expect_no_rise(minimum);
}

// Rosenbrock's valley from his own start (Moré, Garbow and Hillstrom 1981, problem 1).
TEST(StepStrategyTest, FollowsACurvedValley) {
  Residuals problem(
      [](const Eigen::VectorXd& x) {
        return Eigen::VectorXd(Eigen::Vector2d(10.0 * (x(1) - x(0) * x(0)), 1.0 - x(0)));
      },
      [](const Eigen::VectorXd& x) {
        Eigen::MatrixXd jacobian(2, 2);
        jacobian << -20.0 * x(0), 10.0, -1.0, 0.0;
        return jacobian;
      },
      Eigen::VectorXd(Eigen::Vector2d(-1.2, 1.0)));
  const Minimum minimum = minimise(problem);
  EXPECT_TRUE(minimum.found);
  EXPECT_LT((problem.x() - Eigen::VectorXd::Ones(2)).cwiseAbs().maxCoeff(), 1e-3);
  expect_no_rise(minimum);
}

// The curvature of x^2 + (1 + 0.98 x^2 / 2)^2 is 1.98 times that which the derivatives tell: each step ends
// at -0.98 x.
TEST(StepStrategyTest, StepsThatGoToAndFroEndAtTheMinimum) {
  Residuals problem(
      [](const Eigen::VectorXd& x) {
        return Eigen::VectorXd(Eigen::Vector2d(x(0), 1.0 + 0.49 * x(0) * x(0)));
      },
      [](const Eigen::VectorXd& x) {
        Eigen::MatrixXd jacobian(2, 1);
        jacobian << 1.0, 0.98 * x(0);
        return jacobian;
      },
      Eigen::VectorXd::Constant(1, 0.3));
  const Minimum minimum = minimise(problem);
  EXPECT_TRUE(minimum.found);
  EXPECT_GT(minimum.iterations, 100);
  EXPECT_NEAR(problem.x()(0), 0.0, 1e-3);
  expect_no_rise(minimum);
}

// log(x) has no value beyond 0, where the undamped step from 5 goes.
TEST(StepStrategyTest, AStepOutOfTheModelIsRefused) {
  Residuals problem([](const Eigen::VectorXd& x) { return Eigen::VectorXd::Constant(1, std::log(x(0))); },
                    [](const Eigen::VectorXd& x) { return Eigen::MatrixXd::Constant(1, 1, 1.0 / x(0)); },
                    Eigen::VectorXd::Constant(1, 5.0));
  const Minimum minimum = minimise(problem);
  EXPECT_TRUE(minimum.found);
  EXPECT_NEAR(problem.x()(0), 1.0, 1e-4);
  expect_no_rise(minimum);
}

// 1000 + |x|: a kink, at which no derivative says that it is the minimum.
TEST(StepStrategyTest, AKinkIsAMinimum) {
  Residuals problem(
      [](const Eigen::VectorXd& x) { return Eigen::VectorXd::Constant(1, 1e3 + std::abs(x(0))); },
      [](const Eigen::VectorXd& x) { return Eigen::MatrixXd::Constant(1, 1, x(0) > 0.0 ? 1.0 : -1.0); },
      Eigen::VectorXd::Constant(1, 0.3));
  const Minimum minimum = minimise(problem);
  EXPECT_TRUE(minimum.found);
  EXPECT_NEAR(problem.x()(0), 0.0, 1e-6);
  expect_no_rise(minimum);
}

TEST(StepStrategyTest, AProblemThatCannotBeSolvedIsNotCalledSolved) {
  class Unsolvable : public SumOfSquares {
   public:
    double cost() override { return 1.0; }
    std::optional<double> solve_step(double /*damping*/, bool /*anew*/) override { return std::nullopt; }
    void move() override { ADD_FAILURE(); }
    void move_back() override { ADD_FAILURE(); }
  } problem;
  const Minimum minimum = minimise(problem);
  EXPECT_FALSE(minimum.found);
  EXPECT_EQ(minimum.iterations, 1);
}

// Axes 23 degrees askew and turns 60 degrees off, all of it stated: the fit starts on a perfect stage.
TEST(StepStrategyTest, StageFarFromPerfectIsFittedByDampedStepsThatNeverRaiseTheCost) {
  AcsErrors acs;
  acs.alignment = {0.4, -0.4, 0.4};
  acs.d2 = Angle::degrees(60.0);
  acs.d3 = Angle::degrees(-60.0);
  AccelerometerModel aut;
  aut.sensitivity_matrix << 1.05, -0.08, 0.03, 0.11, 0.93, -0.05, -0.02, 0.07, 1.01;
  std::mt19937_64 engine(1);
  RunRecord record = test::made_record(aut, acs, 24, Angle::degrees(15.0));
  test::add_noise(record, 1e-5, engine);
  record.tolerances.alignment = Angle::degrees(20.0);
  record.tolerances.initial_turn = Angle::degrees(60.0);
  const std::vector<EffectReading> readings = collect_readings(record).readings;
  EffectModel model(readings, {.sizes = record.tolerances, .measured_alignment = {}});
  const Minimum minimum = fit_with_white_noise(model).minimum;
  ASSERT_TRUE(minimum.found);
  EXPECT_GT(minimum.damped, 0) << "no undamped step raised the cost: the case of this test did not arise";
  expect_no_rise(minimum);
  // 72 angles of three readings less 12 outputs, at 4.5 standard deviations; a stage without step errors is
  // explained better still.
  constexpr double kDegrees = 3.0 * 72.0 - 12.0;
  EXPECT_LT(minimum.costs.back(), kDegrees + 4.5 * std::sqrt(2.0 * kDegrees));
}

}  // namespace
}  // namespace abcal
