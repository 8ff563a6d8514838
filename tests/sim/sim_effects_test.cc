// The effects of docs/effects.md in the simulated world, each against a formula of its own.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <functional>
#include <initializer_list>
#include <limits>
#include <memory>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "sim/sim_bench.h"

namespace abcal::sim {
namespace {

using Eigen::AngleAxisd;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using std::chrono::seconds;

constexpr double kDeg = std::numbers::pi / 180.0;

BenchTruth plain_truth() {
  BenchTruth truth;
  truth.sensitivity_matrix << 1.02, -0.05, 0.04, 0.07, 0.98, 0.08, -0.10, 0.06, 1.01;
  truth.offset = {0.005, -0.018, 0.022};
  return truth;
}

/// Reading at the pose, `at_s` after the start, in a world that has been nowhere else.
Vector3d reading(const BenchTruth& truth, double x_deg, double z_deg, double at_s = 0.0) {
  SimBench bench(truth);
  bench.place(StageAxis::kX, Angle::degrees(x_deg), bench.start());
  bench.place(StageAxis::kZ, Angle::degrees(z_deg), bench.start());
  return bench.output(bench.start() + from_seconds(at_s), 0).value;
}

/// The least-squares linear function over the sphere, from readings alone: poses (X, Z) at equal steps of
/// cos X and of Z.
std::pair<Matrix3d, Vector3d> fitted_line(const BenchTruth& truth) {
  constexpr int kRings = 400;
  constexpr int kEach = 96;
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Matrix<double, 4, 3> right = Eigen::Matrix<double, 4, 3>::Zero();
  SimBench bench(truth);
  for (int i = 0; i < kRings; ++i) {
    const double x = std::acos(1.0 - 2.0 * (i + 0.5) / kRings);
    bench.place(StageAxis::kX, Angle::radians(x), bench.start());
    for (int k = 0; k < kEach; ++k) {
      const double z = 2.0 * std::numbers::pi * (k + 0.5) / kEach;
      bench.place(StageAxis::kZ, Angle::radians(z), bench.start());
      const Vector3d g = (AngleAxisd(x, Vector3d::UnitX()) * AngleAxisd(z, Vector3d::UnitZ()))
                             .toRotationMatrix()
                             .transpose() *
                         Vector3d::UnitZ();
      const Eigen::Vector4d row(g.x(), g.y(), g.z(), 1.0);
      normal += row * row.transpose();
      right += row * bench.output(bench.start(), 0).value.transpose();
    }
  }
  const Eigen::Matrix<double, 4, 3> c = normal.ldlt().solve(right);
  return {c.topRows<3>().transpose(), c.row(3).transpose()};
}

TEST(SimEffectsTest, TheLineResponseIsTheLeastSquaresLineOverTheSphere) {
  BenchTruth truth = plain_truth();
  truth.k2 = {1e-3, -2e-3, 3e-3};
  truth.k3 = {-2e-3, 1e-3, 2e-3};
  truth.k4 = {1e-3, 2e-3, -1e-3};
  truth.k5 = {2e-3, -1e-3, 1e-3};
  truth.asymmetry = {1e-3, -2e-3, 3e-3};
  truth.cross_ab = {1e-3, 2e-3, -3e-3};
  truth.cross_ac = {-1e-3, 1e-3, 2e-3};
  truth.cross_bc = {2e-3, -1e-3, 1e-3};
  truth.cross_bb = {3e-3, 1e-3, -2e-3};
  truth.cross_cc = {-1e-3, 2e-3, 1e-3};
  const auto [s, offset] = fitted_line(truth);
  const SimBench bench(truth);
  const TrueLineResponse line = bench.true_line_response(bench.start());
  // 400 rings of equal area: an error of 1/400^2 of what bends (1e-2); the kink of |y| the same.
  EXPECT_LT((line.sensitivity_matrix - s).cwiseAbs().maxCoeff(), 2e-7) << s;
  EXPECT_LT((line.offset - offset).cwiseAbs().maxCoeff(), 2e-7) << offset.transpose();
  // Without the bending it is another line: the test can fail.
  EXPECT_GT((bench.true_sensitivity_matrix() - s).cwiseAbs().maxCoeff(), 1e-4);
}

TEST(SimEffectsTest, ALinearStageAndAccelerometerHaveTheirMatrixAsLineResponse) {
  BenchTruth truth = plain_truth();
  truth.zx = 1e-4;
  truth.zy = -2e-4;
  truth.xz = 1e-4;
  const SimBench bench(truth);
  const TrueLineResponse line = bench.true_line_response(bench.start());
  EXPECT_LT((line.sensitivity_matrix - bench.true_sensitivity_matrix()).cwiseAbs().maxCoeff(), 1e-15);
  EXPECT_EQ(line.offset, truth.offset);
}

TEST(SimEffectsTest, WobbleTurnsThePlatformAboutTwoDirectionsAcrossItsAxis) {
  BenchTruth truth = plain_truth();
  truth.x.wobble.push_back({1, 30.0, -20.0, 10.0, 40.0});
  truth.x.wobble.push_back({2, 5.0, 0.0, 0.0, -7.0});
  truth.z.wobble.push_back({3, 0.0, 15.0, -25.0, 0.0});
  const auto turned = [](const Vector3d& v) {
    return AngleAxisd(v.norm(), v.normalized()).toRotationMatrix();
  };
  const auto platform = [&](double x_deg, double z_deg) {
    const double x = x_deg * kDeg;
    const double z = z_deg * kDeg;
    // X lies along x: across it first y, then z. Z lies along z: first x, then y.
    const Vector3d wx(0.0, 30e-6 * std::cos(x) - 20e-6 * std::sin(x) + 5e-6 * std::cos(2 * x),
                      10e-6 * std::cos(x) + 40e-6 * std::sin(x) - 7e-6 * std::sin(2 * x));
    const Vector3d wz(15e-6 * std::sin(3 * z), -25e-6 * std::cos(3 * z), 0.0);
    const Matrix3d rx = AngleAxisd(x, Vector3d::UnitX()).toRotationMatrix();
    const Matrix3d rz = AngleAxisd(z, Vector3d::UnitZ()).toRotationMatrix();
    return Matrix3d(turned(wx) * rx * turned(wz) * rz);
  };
  for (const auto& [x, z] : std::vector<std::pair<double, double>>{{0, 0}, {35, 0}, {190, -90}, {-90, 77}}) {
    const Vector3d g = platform(x, z).transpose() * Vector3d::UnitZ();
    const Vector3d expected = truth.sensitivity_matrix * g + truth.offset;
    EXPECT_LT((reading(truth, x, z) - expected).norm(), 1e-15) << x << ", " << z;  // round-off
  }
  const SimBench bench(truth);
  const Matrix3d s = truth.sensitivity_matrix * platform(0, 0).transpose();
  EXPECT_LT((bench.true_line_response(bench.start()).sensitivity_matrix - s).cwiseAbs().maxCoeff(), 1e-15);
}

TEST(SimEffectsTest, DrawnWobbleAndSmoothErrorsHaveTheirSizeAndRepeatBySeed) {
  BenchTruth truth;
  truth.x.wobble_sd_urad = 50.0;
  truth.x.smooth_error_sd = Angle::degrees(0.004);
  double tilt2 = 0.0;
  double error2 = 0.0;
  constexpr int kWorlds = 2000;
  for (int seed = 1; seed <= kWorlds; ++seed) {
    truth.seed = static_cast<std::uint64_t>(seed);
    SimBench bench(truth);
    bench.place(StageAxis::kX, Angle::degrees(180.0), bench.start());
    // Turned over, a tilt about y shows along x; of X turned by the error of its angle nothing does.
    const double tilt = bench.specific_force(bench.start()).x();
    tilt2 += tilt * tilt;
    const double error = bench.stage_error(StageAxis::kX, Angle::degrees(180.0), Angle{}).deg();
    error2 += error * error;
    if (seed == 5) {
      SimBench again(truth);
      again.place(StageAxis::kX, Angle::degrees(180.0), again.start());
      EXPECT_EQ(again.specific_force(again.start()), bench.specific_force(bench.start()));
    }
  }
  // At 180 degrees three cosines of one direction: sqrt(3) 50 urad. Six cosine terms (cos(180 m) - 1): -2 for
  // the three odd orders, 0 for the even ones. Standard deviation of either ratio: 0.016.
  EXPECT_NEAR(std::sqrt(tilt2 / kWorlds), std::sqrt(3.0) * 50e-6, 0.08 * std::sqrt(3.0) * 50e-6);
  EXPECT_NEAR(std::sqrt(error2 / kWorlds), std::sqrt(12.0) * 0.004, 0.08 * std::sqrt(12.0) * 0.004);
}

TEST(SimEffectsTest, AllItemsStandOnOneStage) {
  BenchTruth truth;
  truth.noise = 1e-4;
  truth.zx_per_degc = 1e-4;
  for (AxisTruth* axis : {&truth.x, &truth.z}) {
    axis->wobble_sd_urad = 50.0;
    axis->smooth_error_sd = Angle::degrees(0.004);
    axis->step_error_sd = Angle::degrees(0.005);
  }
  SimBench first(truth);
  ItemTruth other{truth, item_seed(truth.seed, 2)};
  other.temperature_per_hour = 10.0;  // The stage has the temperature of the first item.
  const std::shared_ptr<SimBench> second = first.add_item(other);
  Clock::Instant now = first.start();
  for (const double x : {30.0, 75.0, 210.0}) {
    now += std::chrono::minutes(10);
    first.place(StageAxis::kX, Angle::degrees(x), now);
    first.place(StageAxis::kZ, Angle::degrees(2.0 * x), now);
    for (const StageAxis axis : kStageAxes)
      EXPECT_EQ(first.actual_angle(axis, now), second->actual_angle(axis, now));
    EXPECT_EQ(first.specific_force(now), second->specific_force(now));
    EXPECT_NE(first.output(now, 0).value, second->output(now, 0).value) << "each has noise of its own";
  }
}

TEST(SimEffectsTest, DriftsAreFunctionsOfTheSpan) {
  BenchTruth truth;
  truth.span_s = 1000.0;
  truth.drift_1 = {1e-3, 0, 0};
  truth.drift_2 = {0, 1e-3, 0};
  truth.drift_3 = {0, 0, 1e-3};
  const auto drift = [&](double at_s) { return Vector3d(reading(truth, 0, 0, at_s) - Vector3d::UnitZ()); };
  EXPECT_LT((drift(0.0) - Vector3d(-0.5e-3, 0.5e-3, -0.5e-3)).norm(), 1e-15);
  EXPECT_LT((drift(500.0) - Vector3d(0.0, -0.25e-3, 0.0)).norm(), 1e-15);
  EXPECT_LT((drift(1000.0) - Vector3d(0.5e-3, 0.5e-3, 0.5e-3)).norm(), 1e-15);
  truth = BenchTruth{};
  truth.span_s = 1000.0;
  truth.exponential_drift = {1e-3, 0, 0};
  truth.exponential_drift_s = 100.0;
  truth.sinusoidal_drift = {0, 1e-3, 0};
  truth.sinusoidal_drift_period_s = 400.0;
  truth.sensitivity_drift = {0, 0, 1e-3};
  EXPECT_LT((drift(100.0) - Vector3d(1e-3 * std::exp(-1.0), 1e-3, -0.4e-3)).norm(), 1e-15);
  truth.gain_step = {0, 0, 2e-3};
  truth.gain_step_at_s = 700.0;
  EXPECT_NEAR(drift(699.9).z(), 0.1999e-3, 1e-15);
  EXPECT_NEAR(drift(700.0).z(), 2.2e-3, 1e-15);
}

TEST(SimEffectsTest, TheLineResponseFollowsTime) {
  BenchTruth truth = plain_truth();
  truth.span_s = 1000.0;
  truth.drift_1 = {1e-3, 2e-3, 3e-3};
  truth.sensitivity_drift = {1e-3, 0, 0};
  truth.random_walk = 1e-3;
  truth.mount_creep_urad = {30.0, -20.0, 10.0};
  truth.mount_creep_s = 300.0;
  const SimBench bench(truth);
  for (const double at_s : {0.0, 250.0, 900.0}) {
    const Clock::Instant t = bench.start() + from_seconds(at_s);
    const TrueLineResponse line = bench.true_line_response(t);
    const Vector3d up = line.sensitivity_matrix * Vector3d::UnitZ() + line.offset;
    EXPECT_LT((bench.output(t, 0).value - up).norm(), 1e-15) << at_s;
  }
}

TEST(SimEffectsTest, TheMountCreepsTheFloorTiltsThePlatformSags) {
  BenchTruth creep;
  creep.mount_creep_urad = {100.0, 0.0, 0.0};
  creep.mount_creep_s = 300.0;
  // Turned about x by +d, the accelerometer's y axis points up by d.
  EXPECT_NEAR(reading(creep, 0, 0, 300.0).y(), 100e-6 * (1.0 - std::exp(-1.0)), 1e-13);
  EXPECT_EQ(reading(creep, 0, 0, 0.0).y(), 0.0);

  BenchTruth floor;
  floor.span_s = 1000.0;
  floor.floor_tilt_y_urad = 100.0;
  // About y by +d the x axis points down by d.
  EXPECT_NEAR(reading(floor, 0, 0, 1000.0).x(), -50e-6, 1e-13);
  EXPECT_NEAR(reading(floor, 0, 0, 500.0).x(), 0.0, 1e-15);
  // Whatever the pose, the same tilt of the base: with X turned over the platter's x still points along x.
  EXPECT_NEAR(reading(floor, 180, 0, 1000.0).x(), -50e-6, 1e-13);

  BenchTruth sag;
  sag.sag_urad = {0.0, 0.0, 100.0};
  EXPECT_LT((reading(sag, 0, 0) - Vector3d::UnitZ()).norm(), 1e-15);
  // X at 30 degrees: up is at (0, sin 30, cos 30) in the platter; the load above it falls farther, by 100
  // sin 30.
  const double more = 30.0 * kDeg + 100e-6 * std::sin(30.0 * kDeg);
  EXPECT_LT((reading(sag, 30, 0) - Vector3d(0.0, std::sin(more), std::cos(more))).norm(), 1e-13);
}

/// Reading at X by way of the angles in turn.
Eigen::Vector3d reading_by_way_of(const BenchTruth& truth, std::initializer_list<double> x_deg) {
  SimBench bench(truth);
  Clock::Instant t = bench.start();
  for (const double deg : x_deg) {
    bench.move(StageAxis::kX, Angle::degrees(deg), t);
    t = bench.motion_end(StageAxis::kX, t) + std::chrono::seconds(1);
  }
  return bench.output(t, 0).value;
}

// Whatever the motions were: v = sin x falls by 0.003 behind its way up, in one motion or in two.
TEST(SimEffectsTest, HysteresisWithAWidthTurnsRoundGradually) {
  BenchTruth truth;
  truth.hysteresis = {0.0, 1e-4, 1e-4};
  truth.hysteresis_width = 0.01;
  BenchTruth without = truth;
  without.hysteresis.setZero();
  const auto turned = [&](std::initializer_list<double> way) {
    return ((reading_by_way_of(truth, way) - reading_by_way_of(without, way)) / 1e-4).eval();
  };
  EXPECT_NEAR(turned({30.0})(1), 1.0, 1e-9);
  EXPECT_NEAR(turned({30.0})(2), -1.0, 1e-9);
  const double fall = std::sin(30.0 * std::numbers::pi / 180.0) - std::sin(29.8 * std::numbers::pi / 180.0);
  double expected = 0.0;
  for (const double gap : {0.001, 0.002, 0.0035, 0.005}) expected += 0.25 * std::max(-1.0, 1.0 - fall / gap);
  EXPECT_NEAR(turned({30.0, 29.8})(1), expected, 1e-9);
  EXPECT_NEAR(turned({30.0, 29.9, 29.8})(1), expected, 1e-9);
  EXPECT_NEAR(turned({30.0, 20.0})(1), -1.0, 1e-9);
  // On the way from 60 to 120 degrees v has its extremum, and falls again.
  EXPECT_NEAR(turned({60.0, 120.0})(1), -1.0, 1e-9);
}

TEST(SimEffectsTest, HysteresisTakesTheSignOfTheLastChange) {
  BenchTruth truth;
  truth.hysteresis = {0.0, 1e-4, 1e-4};
  SimBench bench(truth);
  Clock::Instant t = bench.start();
  const auto at = [&](double x_deg) {
    t += seconds(1);
    bench.place(StageAxis::kX, Angle::degrees(x_deg), t);
    return Vector3d(bench.output(t, 0).value - Vector3d(0.0, std::sin(x_deg * kDeg), std::cos(x_deg * kDeg)));
  };
  EXPECT_LT((bench.output(t, 0).value - Vector3d::UnitZ()).norm(), 1e-15) << "nothing has moved yet";
  EXPECT_LT((at(10.0) - Vector3d(0.0, 1e-4, -1e-4)).norm(), 1e-14);
  EXPECT_LT((at(20.0) - Vector3d(0.0, 1e-4, -1e-4)).norm(), 1e-14);
  EXPECT_LT((at(20.0) - Vector3d(0.0, 1e-4, -1e-4)).norm(), 1e-14) << "a move to where it is changes nothing";
  EXPECT_LT((at(5.0) - Vector3d(0.0, -1e-4, 1e-4)).norm(), 1e-14);
}

TEST(SimEffectsTest, RefusesWhatCannotBe) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<std::pair<std::string, std::function<void(BenchTruth&)>>> cases{
      {"span_s", [&](BenchTruth& t) { t.span_s = 0.0; }},
      {"k4", [&](BenchTruth& t) { t.k4[1] = nan; }},
      {"cross terms", [&](BenchTruth& t) { t.cross_bb[2] = nan; }},
      {"random_walk", [&](BenchTruth& t) { t.random_walk = -1.0; }},
      {"flicker_noise", [&](BenchTruth& t) { t.flicker_noise = nan; }},
      {"correlated_noise_s", [&](BenchTruth& t) { t.correlated_noise_s = 0.0; }},
      {"mount_creep_s", [&](BenchTruth& t) { t.mount_creep_s = nan; }},
      {"x.wobble_sd_urad", [&](BenchTruth& t) { t.x.wobble_sd_urad = -1.0; }},
      {"z.wobble is nan",
       [&](BenchTruth& t) {
         t.z.wobble.push_back({1, nan, 0, 0, 0});
       }},
      {"z.smooth_error_sd", [&](BenchTruth& t) { t.z.smooth_error_sd = Angle::degrees(nan); }},
      {"sag_urad", [&](BenchTruth& t) { t.sag_urad[0] = nan; }},
      {"floor_tilt_x_urad", [&](BenchTruth& t) { t.floor_tilt_x_urad = nan; }},
  };
  for (const auto& [what, make] : cases) {
    BenchTruth truth;
    make(truth);
    try {
      const SimBench bench(truth);
      ADD_FAILURE() << "accepted: " << what;
    } catch (const std::invalid_argument& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr(what));
    }
  }
}

}  // namespace
}  // namespace abcal::sim
