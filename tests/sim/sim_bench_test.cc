#include "sim/sim_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "tests/support/test_data.h"

namespace abcal::sim {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using std::chrono::hours;
using std::chrono::milliseconds;
using std::chrono::seconds;

const double kQ = std::sin(0.008 * std::numbers::pi / 180.0);  // the tolerance of the paper's stage

/// The paper's Table 2.
Matrix3d table2_sensitivity() {
  Matrix3d s;
  s << 1.084557444843417, -0.047097516966133, 0.037216463393415,  //
      0.369246379560599, 0.920196068359764, 0.285771705579544,    //
      -0.117336380485872, 0.263805007662141, 0.819879210182046;
  return s;
}
const Vector3d kTable2Offset(0.053766713954610, 0.183388501459509, -0.225884686100365);

BenchTruth table2_truth() {
  BenchTruth truth;
  truth.sensitivity_matrix = table2_sensitivity();
  truth.offset = kTable2Offset;
  return truth;
}

/// Drives the stage as an experiment does and waits until it has arrived.
class Driver {
 public:
  explicit Driver(SimBench& bench) : bench_(bench), t_(bench.start()) {}
  Driver& turn(StageAxis axis, double degrees) {
    bench_.move(axis, Angle::degrees(degrees), t_);
    t_ = bench_.motion_end(axis, t_);
    return *this;
  }
  Clock::Instant now() const { return t_; }
  Clock::Instant wait(Clock::Duration duration) { return t_ += duration; }
  Vector3d reading() { return bench_.output(t_, 0).value; }

 private:
  SimBench& bench_;
  Clock::Instant t_;
};

/// The three experiments of the protocol: 72 readings each.
std::vector<Vector3d> drive_experiments(const BenchTruth& truth) {
  std::vector<Vector3d> readings;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    SimBench bench(truth);
    Driver stage(bench);
    if (experiment == 2) stage.turn(StageAxis::kZ, -90.0);
    if (experiment == 3) stage.turn(StageAxis::kX, -90.0);
    for (int n = 0; n < 72; ++n)
      readings.push_back(stage.turn(experiment == 3 ? StageAxis::kZ : StageAxis::kX, 5.0 * n).reading());
  }
  return readings;
}

/// RRF(v, e, a) of docs/theory/model.md, written out.
Vector3d rrf(const Vector3d& v, const Vector3d& e, double radians) {
  return v * std::cos(radians) + e.cross(v) * std::sin(radians) + e * e.dot(v) * (1.0 - std::cos(radians));
}

/// The forward model of docs/theory/model.md in its closed form; `f` is a step error in degrees at every
/// angle but 0 and 270.
std::vector<Vector3d> closed_form(const BenchTruth& truth, double f = 0.0) {
  const double zz = std::sqrt(1.0 - truth.zx * truth.zx - truth.zy * truth.zy);
  const Vector3d Z(truth.zx, truth.zy, zz);
  const Vector3d X(std::sqrt(1.0 - truth.xz * truth.xz), 0.0, truth.xz);
  const Vector3d up(0.0, 0.0, 1.0);
  const Vector3d cross = up.cross(Z);
  const double theta = std::atan2(cross.norm(), up.dot(Z));
  const double quarter = -std::numbers::pi / 2.0;
  std::vector<Vector3d> readings;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 0; n < 72; ++n) {
      const double error = n == 0 || n == 54 ? 0.0 : f;
      const double a = (5.0 * n + error) * std::numbers::pi / 180.0;
      Vector3d r;
      for (int j = 0; j < 3; ++j) {
        Vector3d s = truth.sensitivity_matrix.row(j);
        if (cross.norm() > 0.0) s = rrf(s, cross.normalized(), theta);
        if (experiment == 1) s = rrf(s, X, a);
        if (experiment == 2) s = rrf(rrf(s, Z, quarter), X, a);
        if (experiment == 3) s = rrf(rrf(s, X, quarter), rrf(Z, X, quarter), a);
        r[j] = s.dot(up) + truth.offset[j];
      }
      readings.push_back(r);
    }
  }
  return readings;
}

double largest_difference(const std::vector<Vector3d>& a, const std::vector<Vector3d>& b) {
  EXPECT_EQ(a.size(), b.size());
  double largest = 0.0;
  for (std::size_t n = 0; n < a.size(); ++n) largest = std::max(largest, (a[n] - b[n]).cwiseAbs().maxCoeff());
  return largest;
}

struct NamedTruth {
  std::string name;
  BenchTruth truth;
};

/// The cases of docs/theory/abc_protocol.md.
std::vector<NamedTruth> paper_cases() {
  std::vector<NamedTruth> cases;
  cases.push_back({"table2_ideal_acs", table2_truth()});
  BenchTruth table5;
  table5.xz = kQ;
  cases.push_back({"table5", table5});
  BenchTruth table6 = table2_truth();
  table6.xz = kQ;
  cases.push_back({"table6", table6});
  BenchTruth table7;
  table7.zx = table7.zy = kQ;
  cases.push_back({"table7", table7});
  BenchTruth table8 = table2_truth();
  table8.zx = table8.zy = kQ;
  // The shared readings were made with 0.9144 (a fit to them gives 0.91440000); docs/theory/abc_protocol.md
  // says 0.91434, which the digits of Table 8 cannot tell from it.
  table8.xz = 0.9144 * kQ;
  cases.push_back({"table8_as_printed", table8});
  return cases;
}

TEST(SimBenchTest, TheDrivenStageGivesTheClosedFormsOfThePaper) {
  for (const NamedTruth& each : paper_cases())
    // 4e-15: round-off of two ways of turning vectors of norm 1.2 (18 ulp of 1).
    EXPECT_LE(largest_difference(drive_experiments(each.truth), closed_form(each.truth)), 4e-15) << each.name;
}

TEST(SimBenchTest, AStepErrorMovesTheReadingsAsTheClosedFormSays) {
  BenchTruth truth = table2_truth();
  truth.zx = 3 * kQ;
  truth.xz = -2 * kQ;
  truth.x.mean_step_error = truth.z.mean_step_error = Angle::degrees(0.005);
  EXPECT_LE(largest_difference(drive_experiments(truth), closed_form(truth, 0.005)), 4e-15);
  // And the check can fail: 0.005 degrees are 8.7e-5 rad.
  EXPECT_GT(largest_difference(drive_experiments(truth), closed_form(truth, 0.0)), 8e-5);
}

TEST(SimBenchTest, TheDrivenStageGivesTheReadingsOfTheSharedData) {
  for (const NamedTruth& each : paper_cases()) {
    ABCAL_SHARED_DATA_OR_SKIP(path, "abc/" + each.name + ".csv");
    std::ifstream file(path);
    std::string line;
    std::getline(file, line);
    ASSERT_EQ(line, "experiment,n,alpha_deg,r_u,r_v,r_w");
    std::vector<Vector3d> expected;
    while (std::getline(file, line)) {
      std::istringstream row(line);
      std::vector<double> values;
      for (std::string cell; std::getline(row, cell, ',');) values.push_back(std::stod(cell));
      ASSERT_EQ(values.size(), 6U);
      expected.emplace_back(values[3], values[4], values[5]);
    }
    ASSERT_EQ(expected.size(), 216U);
    // A few ulp of the largest reading (1.3).
    EXPECT_LE(largest_difference(drive_experiments(each.truth), expected), 1.5e-15) << each.name;
  }
}

TEST(SimBenchTest, AtRestTheAccelerometerReadsTheReactionUpwards) {
  const SimBench bench{BenchTruth{}};
  EXPECT_EQ(bench.specific_force(bench.start()), Vector3d(0.0, 0.0, 1.0));
}

TEST(SimBenchTest, TheSpecificForceHasTheMagnitudeOfGravityInEveryPose) {
  BenchTruth truth;
  truth.zx = 0.1;
  truth.zy = -0.2;
  truth.xz = 0.05;
  SimBench bench(truth);
  Driver stage(bench);
  for (int n = 0; n < 50; ++n) {
    stage.turn(StageAxis::kX, 37.0 * n - 360.0).turn(StageAxis::kZ, 360.0 - 53.0 * n);
    EXPECT_NEAR(bench.specific_force(stage.now()).norm(), 1.0, 1e-15);
  }
}

TEST(SimBenchTest, TheTrueMatrixIsTiltedWithTheZAxis) {
  BenchTruth truth = table2_truth();
  truth.zx = 3e-3;
  truth.zy = -4e-3;
  const SimBench bench(truth);
  const Vector3d Z(truth.zx, truth.zy, std::sqrt(1.0 - 25e-6));
  // The row along the platter's z shows along Z.
  EXPECT_LE((bench.true_sensitivity_matrix().transpose() -
             [&] {
               Matrix3d columns;
               const Vector3d E = Vector3d::UnitZ().cross(Z).normalized();
               const double theta = std::asin(5e-3);
               for (int j = 0; j < 3; ++j) columns.col(j) = rrf(truth.sensitivity_matrix.row(j), E, theta);
               return columns;
             }())
                .cwiseAbs()
                .maxCoeff(),
            2e-15);
  // At rest the tilted matrix's z column plus the offset is the reading.
  EXPECT_LE((bench.output(bench.start(), 0).value - bench.true_sensitivity_matrix().col(2) - truth.offset)
                .cwiseAbs()
                .maxCoeff(),
            1e-15);
}

TEST(SimBenchTest, TheIntrinsicPropertiesAreThoseOfTable2AndIndependentOfTheTilt) {
  for (const double tilt : {0.0, 0.01}) {
    BenchTruth truth = table2_truth();
    truth.zx = tilt;
    const TrueIntrinsicProperties intrinsic = SimBench(truth).true_intrinsic_properties();
    // Printed to 15 decimals: half a digit of the sensitivity, and what 5e-16 in an element does to an angle.
    EXPECT_NEAR(intrinsic.sensitivity[0], 1.086217332036812, 2e-15);
    EXPECT_NEAR(intrinsic.sensitivity[1], 1.031876523985898, 2e-15);
    EXPECT_NEAR(intrinsic.sensitivity[2], 0.869231170369473, 2e-15);
    EXPECT_NEAR(intrinsic.angle[0].deg(), 70.845583191199623, 1e-13);
    EXPECT_NEAR(intrinsic.angle[1].deg(), 61.081782813884068, 1e-13);
    EXPECT_NEAR(intrinsic.angle[2].deg(), 96.639644038935558, 1e-13);
    EXPECT_EQ(intrinsic.offset, kTable2Offset);
  }
}

BenchTruth rough_stage() {
  BenchTruth truth;
  truth.seed = 42;
  for (AxisTruth* axis : {&truth.x, &truth.z}) {
    axis->mean_step_error = Angle::degrees(0.003);
    axis->initial_turn_error = Angle::degrees(-0.011);
    axis->step_error_sd = Angle::degrees(0.008);
    axis->harmonics = {
        {.order = 2, .sin_coefficient = Angle::degrees(0.02), .cos_coefficient = Angle::degrees(0.01)}};
  }
  return truth;
}

TEST(SimBenchTest, TheStageErrorIsZeroAtZeroAndTheInitialTurnAtMinus90) {
  const SimBench bench(rough_stage());
  for (const StageAxis axis : kStageAxes) {
    for (const double turn : {-360.0, 0.0, 360.0}) {
      EXPECT_EQ(bench.stage_error(axis, Angle::degrees(turn), Angle::degrees(30)).deg(), 0.0);
      EXPECT_EQ(bench.stage_error(axis, Angle::degrees(turn - 90.0), Angle::degrees(30)).deg(), -0.011);
    }
  }
}

TEST(SimBenchTest, TheStageErrorIsAMapOfThePoseOfBothAxes) {
  const SimBench bench(rough_stage());
  const auto error = [&](StageAxis axis, double angle, double other) {
    return bench.stage_error(axis, Angle::degrees(angle), Angle::degrees(other)).deg();
  };
  EXPECT_NEAR(error(StageAxis::kX, 35.0, -90.0), error(StageAxis::kX, 35.0 - 360.0, 270.0), 1e-17);
  // The same pose to a millionth of a degree gives the same draw (another one would differ by some 0.008),
  // and the harmonics move by 0.04 x 1e-8 degrees per radian.
  EXPECT_NEAR(error(StageAxis::kX, 35.0, -90.0), error(StageAxis::kX, 35.0 + 1e-8, -90.0 - 1e-8), 1e-11);
  EXPECT_NE(error(StageAxis::kX, 35.0, -90.0), error(StageAxis::kX, 35.0, 0.0));
  EXPECT_NE(error(StageAxis::kX, 35.0, 35.0), error(StageAxis::kZ, 35.0, 35.0));
  BenchTruth other_seed = rough_stage();
  other_seed.seed = 43;
  EXPECT_NE(error(StageAxis::kX, 35.0, 0.0),
            SimBench(other_seed).stage_error(StageAxis::kX, Angle::degrees(35), Angle{}).deg());
}

TEST(SimBenchTest, TheStageErrorHasItsMeanHarmonicsAndStandardDeviation) {
  const BenchTruth truth = rough_stage();
  const SimBench bench(truth);
  double sum = 0.0;
  double sum_of_squares = 0.0;
  int count = 0;
  for (int n = 1; n < 10000; ++n) {
    const double degrees = 0.036 * n;
    if (n == 7500) continue;  // 270 degrees: the initial turn
    const double twice = 2.0 * degrees * std::numbers::pi / 180.0;
    const double systematic = 0.003 + 0.02 * std::sin(twice) + 0.01 * (std::cos(twice) - 1.0);
    const double random =
        bench.stage_error(StageAxis::kZ, Angle::degrees(degrees), Angle{}).deg() - systematic;
    sum += random;
    sum_of_squares += random * random;
    ++count;
  }
  // Four standard errors of 9998 draws: sd / sqrt(n), sd / sqrt(2 n).
  EXPECT_NEAR(sum / count, 0.0, 4.0 * 0.008 / 100.0);
  EXPECT_NEAR(std::sqrt(sum_of_squares / count), 0.008, 4.0 * 0.008 / 141.0);
}

TEST(SimBenchTest, ThePoseReachedDoesNotDependOnTheWay) {
  SimBench direct(rough_stage());
  SimBench roundabout(rough_stage());
  Driver a(direct);
  Driver b(roundabout);
  a.turn(StageAxis::kX, 35.0).turn(StageAxis::kZ, 70.0);
  b.turn(StageAxis::kZ, 12.0).turn(StageAxis::kX, -200.0).turn(StageAxis::kZ, 70.0).turn(StageAxis::kX, 35.0);
  for (const StageAxis axis : kStageAxes)
    EXPECT_EQ(direct.actual_angle(axis, a.now()).deg(), roundabout.actual_angle(axis, b.now()).deg());
  EXPECT_EQ(direct.specific_force(a.now()), roundabout.specific_force(b.now()));
}

TEST(SimBenchTest, BacklashLagsBehindAMoveThatEndsInTheNegativeDirection) {
  BenchTruth truth;
  truth.x.backlash = Angle::degrees(0.02);
  SimBench bench(truth);
  Driver stage(bench);
  stage.turn(StageAxis::kX, 30.0);
  EXPECT_EQ(bench.actual_angle(StageAxis::kX, stage.now()).deg(), 30.0);
  stage.turn(StageAxis::kX, 10.0);
  EXPECT_EQ(bench.actual_angle(StageAxis::kX, stage.now()).deg(), 10.02);
  EXPECT_EQ(bench.encoder_angle(StageAxis::kX, stage.now()).deg(), 10.0);
  stage.turn(StageAxis::kX, 5.0).turn(StageAxis::kX, 10.0);  // one-sided approach
  EXPECT_EQ(bench.actual_angle(StageAxis::kX, stage.now()).deg(), 10.0);
}

TEST(SimBenchTest, TheEncoderReadsTheCommandedCoordinateToItsResolution) {
  BenchTruth truth = rough_stage();
  truth.x.encoder_resolution = Angle::degrees(0.01);
  SimBench bench(truth);
  Driver stage(bench);
  stage.turn(StageAxis::kX, 12.3456);
  EXPECT_DOUBLE_EQ(bench.encoder_angle(StageAxis::kX, stage.now()).deg(), 12.35);
  EXPECT_EQ(bench.commanded_angle(StageAxis::kX, stage.now()).deg(), 12.3456);
  EXPECT_NE(bench.actual_angle(StageAxis::kX, stage.now()).deg(), 12.3456);
}

TEST(SimBenchTest, TheActualAngleNeverJumps) {
  BenchTruth truth = rough_stage();
  truth.x.backlash = Angle::degrees(0.02);
  SimBench bench(truth);
  const Clock::Instant t0 = bench.start();
  bench.move(StageAxis::kX, Angle::degrees(40), t0);
  bench.move(StageAxis::kZ, Angle::degrees(-20), t0 + milliseconds(700));
  bench.halt(StageAxis::kX, t0 + milliseconds(900));
  bench.move(StageAxis::kX, Angle::degrees(-5), t0 + milliseconds(1300));
  for (const StageAxis axis : kStageAxes) {
    double before = bench.actual_angle(axis, t0).deg();
    for (Clock::Instant t = t0; t < t0 + seconds(6); t += milliseconds(1)) {
      const double now = bench.actual_angle(axis, t).deg();
      // 20 degrees/s, and the errors (0.1 degree at most) change over at least a quarter of a second.
      ASSERT_LE(std::abs(now - before), 0.020 + 0.1 / 250.0 + 1e-9);
      before = now;
    }
  }
}

TEST(SimBenchTest, ThePastMayBeAskedAbout) {
  SimBench bench(rough_stage());
  const Clock::Instant t0 = bench.start();
  bench.move(StageAxis::kX, Angle::degrees(40), t0 + seconds(1));
  std::vector<Vector3d> live;
  for (int n = 0; n < 500; ++n) live.push_back(bench.specific_force(t0 + milliseconds(10 * n)));
  bench.move(StageAxis::kX, Angle::degrees(-40), t0 + seconds(5));
  bench.move(StageAxis::kZ, Angle::degrees(15), t0 + seconds(20));
  for (std::size_t n = 0; n < live.size(); ++n)
    ASSERT_EQ(bench.specific_force(t0 + milliseconds(10) * static_cast<int>(n)), live[n]);
  EXPECT_THROW(bench.move(StageAxis::kX, Angle{}, t0 + seconds(10)), std::invalid_argument);
}

TEST(SimBenchTest, NoiseIsAFunctionOfSeedAndSampleIndexOnly) {
  BenchTruth truth;
  truth.noise = 1e-3;
  truth.seed = 7;
  const SimBench bench(truth);
  const SimBench again(truth);
  const Clock::Instant t = bench.start();
  const Vector3d at5 = bench.output(t, 5).value;
  EXPECT_NE(at5, bench.output(t, 6).value);
  EXPECT_EQ(at5, bench.output(t, 5).value);
  EXPECT_EQ(at5, again.output(t + hours(1), 5).value);
  truth.seed = 8;
  EXPECT_NE(at5, SimBench(truth).output(t, 5).value);
}

TEST(SimBenchTest, NoiseHasItsStandardDeviationOnEveryAxisAndNoCorrelation) {
  BenchTruth truth;
  truth.noise = 2.0;
  const SimBench bench(truth);
  const int count = 40000;
  Vector3d sum = Vector3d::Zero();
  Matrix3d products = Matrix3d::Zero();
  for (int n = 0; n < count; ++n) {
    const Vector3d noise =
        bench.output(bench.start(), static_cast<std::uint64_t>(n)).value - Vector3d::UnitZ();
    sum += noise;
    products += noise * noise.transpose();
  }
  // Four standard errors: 1/sqrt(n) of a mean and of a correlation, sqrt(2/n) of a variance.
  EXPECT_LE((sum / count).cwiseAbs().maxCoeff(), 4.0 * 2.0 / 200.0);
  const Matrix3d covariance = products / count;
  EXPECT_LE((covariance - 4.0 * Matrix3d::Identity()).cwiseAbs().maxCoeff(),
            4.0 * 4.0 * std::sqrt(2.0) / 200.0);
}

TEST(SimBenchTest, NoiseSeededByAngleRepeatsWhenThePoseDoes) {
  BenchTruth truth;
  truth.noise = 1e-3;
  truth.noise_seeded_by_angle = true;
  const Clock::Duration period = milliseconds(10);
  SimBench bench(truth);
  Driver stage(bench);
  const auto dwell = [&](std::uint64_t first_index) {
    std::vector<Vector3d> readings;
    for (int n = 0; n < 10; ++n)
      readings.push_back(
          bench.output(stage.now() + n * period, first_index + static_cast<unsigned>(n), period).value);
    return readings;
  };
  stage.turn(StageAxis::kX, 35.0);
  const auto first = dwell(100);
  stage.wait(seconds(10));
  const auto elsewhere = (stage.turn(StageAxis::kX, 40.0), dwell(5000));
  stage.wait(seconds(10));
  stage.turn(StageAxis::kX, 35.0);
  EXPECT_EQ(dwell(9000), first);
  EXPECT_NE(first[0], first[1]);
  const double noise_there = elsewhere[0][0];  // u does not see a turn about X
  EXPECT_NE(noise_there, first[0][0]);
  EXPECT_THROW(bench.output(stage.now(), 1), std::invalid_argument);
}

TEST(SimBenchTest, OffsetDriftTemperatureAndNonLinearityAreWhatTheTruthSays) {
  BenchTruth truth;
  truth.offset = Vector3d(0.1, 0.2, 0.3);
  truth.k2 = Vector3d(0.0, 0.0, 1e-3);
  truth.k3 = Vector3d(0.0, 0.0, 2e-3);
  truth.drift_per_hour = Vector3d(1e-4, 0.0, 0.0);
  truth.offset_per_degc = Vector3d(0.0, 5e-4, 0.0);
  truth.temperature_per_hour = 2.0;
  const SimBench bench(truth);
  const SimOutput output = bench.output(bench.start() + hours(3), 0);
  EXPECT_DOUBLE_EQ(output.temperature_degc, 29.0);
  EXPECT_NEAR(output.value[0], 0.1 + 3e-4, 1e-16);
  EXPECT_NEAR(output.value[1], 0.2 + 6.0 * 5e-4, 1e-16);
  EXPECT_NEAR(output.value[2], 1.3 + 3e-3, 3e-16);  // l - O is 1
}

TEST(SimBenchTest, TheOutputIsQuantisedAndClipped) {
  BenchTruth truth = table2_truth();
  truth.quantisation = 0.01;
  truth.full_scale = 0.5;
  const SimBench bench(truth);
  const SimOutput output = bench.output(bench.start(), 0);
  // Unquantised: 0.090983, 0.469160, 0.593995.
  EXPECT_DOUBLE_EQ(output.value[0], 0.09);
  EXPECT_DOUBLE_EQ(output.value[1], 0.47);
  EXPECT_EQ(output.value[2], 0.5);
  EXPECT_THAT(output.clipped, testing::ElementsAre(false, false, true));
}

TEST(SimBenchTest, TheOutputRingsAfterAMoveAndDiesDown) {
  BenchTruth truth;
  truth.ring_down_amplitude = 1e-4;
  truth.ring_down_frequency_hz = 25.0;
  truth.ring_down_decay_s = 0.05;
  SimBench bench(truth);
  Driver stage(bench);
  EXPECT_EQ(bench.output(stage.now(), 0).value, Vector3d::UnitZ());  // nothing has moved
  stage.turn(StageAxis::kZ, 90.0);                                   // cruises at 20 degrees/s
  const Clock::Instant arrival = stage.now();
  // A quarter of a period after the arrival: sin = 1.
  EXPECT_NEAR(bench.output(arrival + milliseconds(10), 0).value[0], 1e-4 * 20.0 * std::exp(-0.2), 1e-15);
  EXPECT_EQ(bench.output(arrival + seconds(3), 0).value[0], 0.0);
}

TEST(SimBenchTest, AHaltedAxisDeceleratesAndStays) {
  SimBench bench{BenchTruth{}};
  const Clock::Instant t = bench.start();
  bench.move(StageAxis::kX, Angle::degrees(90), t);
  bench.halt(StageAxis::kX, t + seconds(1));
  EXPECT_TRUE(bench.moving(StageAxis::kX, t + seconds(1)));
  const Clock::Instant end = bench.motion_end(StageAxis::kX, t + seconds(1));
  EXPECT_EQ(end - t, milliseconds(1250));  // 20 degrees/s at 80 degrees/s2
  EXPECT_FALSE(bench.moving(StageAxis::kX, end));
  // 2.5 degrees to speed up, 15 at speed, 2.5 to stop.
  EXPECT_NEAR(bench.commanded_angle(StageAxis::kX, end + hours(1)).deg(), 20.0, 1e-12);
  bench.halt(StageAxis::kX, end + seconds(1));  // nothing to halt
  EXPECT_EQ(bench.motion_end(StageAxis::kX, end + seconds(1)), end);
}

TEST(SimBenchTest, AStalledAxisNeverArrivesUntilItIsHalted) {
  SimBench bench{BenchTruth{}};
  const Clock::Instant t = bench.start();
  bench.inject({.kind = FaultKind::kStalledAxis, .at = t + seconds(2), .axis = StageAxis::kX});
  bench.move(StageAxis::kX, Angle::degrees(90), t);
  bench.move(StageAxis::kZ, Angle::degrees(90), t);
  EXPECT_TRUE(bench.moving(StageAxis::kX, t + hours(1)));
  EXPECT_FALSE(bench.moving(StageAxis::kZ, t + hours(1)));
  EXPECT_NEAR(bench.commanded_angle(StageAxis::kX, t + hours(1)).deg(), 37.5, 1e-12);
  bench.halt(StageAxis::kX, t + hours(1));
  EXPECT_FALSE(bench.moving(StageAxis::kX, t + hours(1)));
  EXPECT_NEAR(bench.commanded_angle(StageAxis::kX, t + hours(2)).deg(), 37.5, 1e-12);
}

TEST(SimBenchTest, AFaultyAxisStopsShortOfItsTarget) {
  SimBench bench{BenchTruth{}};
  bench.inject({.kind = FaultKind::kStopsShort, .axis = StageAxis::kZ, .value = 0.5});
  Driver stage(bench);
  stage.turn(StageAxis::kZ, 20.0);
  EXPECT_EQ(bench.encoder_angle(StageAxis::kZ, stage.now()).deg(), 19.5);
  stage.turn(StageAxis::kZ, -20.0).turn(StageAxis::kX, 20.0);
  EXPECT_EQ(bench.encoder_angle(StageAxis::kZ, stage.now()).deg(), -19.5);
  EXPECT_EQ(bench.encoder_angle(StageAxis::kX, stage.now()).deg(), 20.0);
}

TEST(SimBenchTest, OutputFaultsBeginAndEndWhenTheyAreScripted) {
  BenchTruth truth;
  truth.noise = 1e-3;
  SimBench bench(truth);
  const Clock::Instant t = bench.start();
  bench.inject({.kind = FaultKind::kStuckOutput, .at = t + seconds(10), .until = t + seconds(20)});
  bench.inject({.kind = FaultKind::kNotFinite, .at = t + seconds(30), .until = t + seconds(40)});
  bench.inject(
      {.kind = FaultKind::kClippedOutput, .at = t + seconds(50), .until = t + seconds(60), .value = 0.25});
  EXPECT_NE(bench.output(t + seconds(9), 1).value, bench.output(t + seconds(9), 2).value);
  EXPECT_EQ(bench.output(t + seconds(11), 1).value, bench.output(t + seconds(19), 2).value);
  EXPECT_NE(bench.output(t + seconds(21), 1).value, bench.output(t + seconds(21), 2).value);
  EXPECT_TRUE(bench.output(t + seconds(35), 1).value.array().isNaN().all());
  EXPECT_TRUE(bench.output(t + seconds(40), 1).value.allFinite());
  EXPECT_EQ(bench.output(t + seconds(55), 1).value[2], 0.25);
  EXPECT_TRUE(bench.output(t + seconds(55), 1).clipped[2]);
  EXPECT_FALSE(bench.output(t + seconds(60), 1).clipped[2]);
  EXPECT_THROW(bench.inject({.kind = FaultKind::kGarbage}), std::invalid_argument);
}

TEST(SimBenchTest, RefusesATruthThatCannotBeAndSaysWhich) {
  const auto message = [](auto spoil) -> std::string {
    BenchTruth truth;
    spoil(truth);
    try {
      const SimBench bench(truth);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "accepted";
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  using testing::HasSubstr;
  EXPECT_THAT(message([&](BenchTruth& t) { t.noise = -1.0; }), HasSubstr("noise is -1, required: >= 0"));
  EXPECT_THAT(message([&](BenchTruth& t) { t.offset[1] = nan; }), HasSubstr("offset"));
  EXPECT_THAT(message([&](BenchTruth& t) { t.zx = 1.5; }), HasSubstr("zx"));
  EXPECT_THAT(message([&](BenchTruth& t) { t.x.speed_deg_per_s = 0.0; }), HasSubstr("x.speed_deg_per_s"));
  EXPECT_THAT(message([&](BenchTruth& t) { t.z.mean_step_error = Angle::degrees(nan); }),
              HasSubstr("z.mean_step_error"));
  EXPECT_THAT(message([&](BenchTruth& t) { t.x.travel_min = Angle::degrees(400); }),
              HasSubstr("x.travel_min"));
}

}  // namespace
}  // namespace abcal::sim
