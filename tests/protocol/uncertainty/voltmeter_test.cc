#include "protocol/estimators/shared/voltmeter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/norm/norm_fit.h"
#include "protocol/uncertainty/budget.h"
#include "tests/protocol/estimators/made_record.h"

namespace abcal {
namespace {

constexpr double kGain = 3e-4;
constexpr double kOffset = 2e-4;
constexpr double kNoise = 1e-5;

AccelerometerModel analog_item() {
  AccelerometerModel item;
  item.sensitivity_matrix << 0.98, 0.01, -0.02, 0.015, 1.03, 0.004, -0.01, 0.02, 1.01;
  item.offset << 2.5, 2.4, 2.6;  // V: half the supply, so that the gain matters for O.
  return item;
}

EffectSizes voltmeter_sizes() {
  EffectSizes sizes = without_further_effects({});
  sizes.voltmeter_gain = kGain;
  sizes.voltmeter_offset = kOffset;
  sizes.drift = 0.0;
  sizes.k2 = sizes.k3 = 0.0;
  sizes.alignment = sizes.step = sizes.initial_turn = sizes.zero = Angle::degrees(1e-4);
  return sizes;
}

/// A record read by a voltmeter with a gain and offsets of its own.
RunRecord read_by_voltmeter(std::mt19937_64& engine) {
  RunRecord record = test::made_record(analog_item(), {}, 12, Angle::degrees(30.0));
  record.tolerances = voltmeter_sizes();
  test::add_noise(record, kNoise, engine);
  std::normal_distribution<double> normal;
  const double gain = 1.0 + kGain * normal(engine);
  const Eigen::Vector3d offset =
      kOffset * Eigen::Vector3d(normal(engine), normal(engine), normal(engine))
                    .cwiseProduct(analog_item().sensitivity_matrix.rowwise().norm());
  for (DwellRecord& dwell : record.dwells) dwell.mean = gain * dwell.mean + offset;
  return record;
}

CalibrationResult without_voltmeter(RunRecord record, CalibrationResult (*analyse)(const RunRecord&)) {
  record.tolerances.voltmeter_gain = record.tolerances.voltmeter_offset = 0.0;
  return analyse(record);
}

CalibrationResult by_abc(const RunRecord& record) {
  return analyse_abc(record);
}
CalibrationResult by_joint(const RunRecord& record) {
  return analyse_joint(record);
}
CalibrationResult by_norm(const RunRecord& record) {
  return analyse_norm(record);
}

TEST(VoltmeterTest, TheStatedUncertaintyCoversVoltmetersOfThatSize) {
  std::mt19937_64 engine(5);
  constexpr int kVoltmeters = 200;
  for (const auto analyse : {by_abc, by_joint, by_norm}) {
    Eigen::Array<double, 6, 1> squares = Eigen::Array<double, 6, 1>::Zero();
    for (int i = 0; i < kVoltmeters; ++i) {
      const CalibrationResult result = analyse(read_by_voltmeter(engine));
      const Eigen::Vector3d s = analog_item().sensitivity_matrix.rowwise().norm();
      for (Eigen::Index j = 0; j < 3; ++j) {
        const auto at = static_cast<std::size_t>(j);
        const Quantity& norm = result.intrinsic_sensitivity[at];
        const Quantity& offset = result.offset[at];
        squares(j) += std::pow((norm.value - s(j)) / norm.standard_uncertainty, 2);
        squares(3 + j) += std::pow((offset.value - analog_item().offset(j)) / offset.standard_uncertainty, 2);
      }
    }
    // Mean squares of 200 normal errors in standard uncertainties: 1 with a standard deviation of 0.1.
    for (const double sum : squares) EXPECT_NEAR(sum / kVoltmeters, 1.0, 0.4);
  }
}

TEST(VoltmeterTest, ScalesSensitivityAndOffsetTogetherAndLeavesTheAngles) {
  std::mt19937_64 engine(6);
  const RunRecord record = read_by_voltmeter(engine);
  for (const auto analyse : {by_abc, by_joint}) {
    const CalibrationResult with = analyse(record);
    const CalibrationResult without = without_voltmeter(record, analyse);
    ASSERT_TRUE(with.covariance && without.covariance);
    EXPECT_EQ(with.verdict, without.verdict) << with.why;
    const Covariance12 added = *with.covariance - *without.covariance;
    const Eigen::Matrix3d s = with.sensitivity_values();
    EXPECT_NEAR(added(4, 4), std::pow(kGain * s(1, 1), 2), 1e-15);
    EXPECT_NEAR(added(4, 10), kGain * kGain * s(1, 1) * with.offset[1].value, 1e-15);
    EXPECT_NEAR(added(9, 9),
                std::pow(kGain * with.offset[0].value, 2) + std::pow(kOffset * s.row(0).norm(), 2), 1e-15);
    EXPECT_EQ(with.intrinsic_angle[0].standard_uncertainty, without.intrinsic_angle[0].standard_uncertainty);
    EXPECT_EQ(s, without.sensitivity_values());
    const Quantity& element = (*with.sensitivity_matrix)[2][2];
    EXPECT_NEAR(std::pow(element.standard_uncertainty, 2), (*with.covariance)(8, 8), 1e-16);
    EXPECT_NEAR(std::pow(with.intrinsic_sensitivity[2].standard_uncertainty, 2),
                (*with.covariance_intrinsic)(2, 2), 1e-16);
  }
}

TEST(VoltmeterTest, HasItsLinesInTheBudget) {
  std::mt19937_64 engine(7);
  const RunRecord record = read_by_voltmeter(engine);
  for (const auto analyse : {by_abc, by_joint}) {
    const CalibrationResult result = analyse(record);
    const Budget budget = make_budget(record, result);
    double gain = 0.0, offset = 0.0;
    for (const BudgetLine& line : budget.lines) {
      if (line.input == "gain of the voltmeter") gain = line.contribution(0);
      if (line.input == "offset of the voltmeter") offset = line.contribution(kFirstOffset);
    }
    EXPECT_NEAR(gain, kGain * result.sensitivity_values()(0, 0), 1e-9);
    EXPECT_NEAR(offset, kOffset * result.intrinsic_sensitivity[0].value, 1e-9);
    EXPECT_NEAR(budget.combined(kFirstOffset) / result.offset[0].standard_uncertainty, 1.0, 1e-6);
  }
}

}  // namespace
}  // namespace abcal
