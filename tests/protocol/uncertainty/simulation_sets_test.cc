#include "protocol/uncertainty/simulation_sets.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "protocol/uncertainty/published_tables.h"

namespace abcal {
namespace {

// Half a unit of the last of four printed digits.
double half_of_the_last_digit(double printed) {
  return 0.5 * std::pow(10.0, std::floor(std::log10(std::abs(printed))) - 3.0);
}

// Compares every printed digit; printed numbers below 1e-14 are the paper's round-off and need only be below
// 1e-14 here.
void expect_as_printed(const StudyOutput& ours, const StudyOutput& printed) {
  const OutputVector a = to_vector(ours), b = to_vector(printed);
  for (int k = 0; k < kStudyOutputs; ++k) {
    if (std::abs(b(k)) < 1e-14) {
      EXPECT_LT(std::abs(a(k)), 1e-14) << output_symbol(k);
    } else {
      EXPECT_NEAR(a(k), b(k), half_of_the_last_digit(b(k)) * 1.000001) << output_symbol(k);
    }
  }
}

TEST(SimulationSetTest, Set1LeavesRoundOffOnly) {
  const StudyResult set = run_simulation_set("1", {});
  const OutputVector error = to_vector(*set.cases.at(0).error).cwiseAbs();
  EXPECT_LE(error.head<15>().maxCoeff(), 1e-15);
  EXPECT_LE(error.tail<3>().maxCoeff(), 1e-13);
  ASSERT_TRUE(set.cases[0].readings);
  EXPECT_EQ(set.cases[0].readings->readings[2].rows(), 72);
  EXPECT_LE(set.cases[0].readings->residuals[2].cwiseAbs().maxCoeff(), 2e-15);
}

TEST(SimulationSetTest, Set2LeavesRoundOffOnlyForThirtyAccelerometersAndFiveHarmonics) {
  const StudyResult set = run_simulation_set("2", {});
  ASSERT_EQ(set.cases.size(), 32U);  // Table 2, thirty, and their largest
  for (const StudyCase& one : set.cases) {
    const OutputVector error = to_vector(*one.error).cwiseAbs();
    EXPECT_LE(error.head<15>().maxCoeff(), 2e-15) << one.name;
    EXPECT_LE(error.tail<3>().maxCoeff(), 1e-13) << one.name;
    EXPECT_LE(*one.largest_higher_harmonic, 1e-15) << one.name;
  }
  // And the largest is not zero: something was measured.
  EXPECT_GT(to_vector(*set.cases.back().error).cwiseAbs().maxCoeff(), 0.0);
}

TEST(SimulationSetTest, Table2ToEveryPrintedDigit) {
  const StudyResult set = run_simulation_set("2", {});
  const OutputVector ours = to_vector(*set.cases.at(0).truth), printed = to_vector(published_table_2());
  for (int k = 0; k < kFirstIntrinsicAngle; ++k) EXPECT_NEAR(ours(k), printed(k), 1e-15) << output_symbol(k);
  // Printed with 15 decimals, of which a double near 100 holds 14.
  for (int k = kFirstIntrinsicAngle; k < kStudyOutputs; ++k)
    EXPECT_NEAR(ours(k), printed(k), 3e-14) << output_symbol(k);
}

TEST(SimulationSetTest, Tables5To7ToEveryPrintedDigit) {
  expect_as_printed(*run_simulation_set("3", {}).cases.at(0).error, published_table_5());
  expect_as_printed(*run_simulation_set("4", {}).cases.at(0).error, published_table_6());
  expect_as_printed(*run_simulation_set("5", {}).cases.at(0).error, published_table_7());
}

TEST(SimulationSetTest, Table8NeedsAnXzThatItsTextDoesNotName) {
  const StudyResult set = run_simulation_set("6", {});
  // Values by the paper's text: docs/theory/abc_protocol.md, row "T2, Zx = Zy = q, Xz = 0".
  const StudyOutput text =
      to_output((OutputVector() << -7.796e-06, -2.598e-06, +1.514e-04, -5.983e-05, -1.995e-05, +5.156e-05,
                 -1.717e-04, -5.724e-05, -1.638e-05, -1.732e-06, -1.330e-05, -3.816e-05, -2.492e-06,
                 -2.493e-05, -9.656e-06, +7.753e-04, +4.484e-03, +3.740e-03)
                    .finished());
  expect_as_printed(*set.cases.at(0).error, text);
  expect_as_printed(*set.cases.at(1).error, published_table_8());
  EXPECT_NE(set.cases[0].note.find("Slip"), std::string::npos);
  EXPECT_NE(set.cases[1].note.find("interchanged"), std::string::npos);
}

TEST(SimulationSetTest, ErrorsScaleWithTheMisalignment) {
  SimulationOptions options;
  options.scale = true;
  for (const char* name : {"3", "4", "5", "6"}) {
    const StudyResult set = run_simulation_set(name, options);
    ASSERT_EQ(set.cases.size() % 3, 0U);
    const OutputVector reference = to_vector(*set.cases[0].error);
    const double small = to_vector(*set.cases[1].error)(2) / reference(2);
    const double large = to_vector(*set.cases[2].error)(2) / reference(2);
    // The paper: within 1 part in 100 for the accelerometer of Table 2.
    EXPECT_NEAR(small, 0.1, 0.001) << name;
    EXPECT_NEAR(large, 10.0, 0.1) << name;
  }
  EXPECT_THROW(run_simulation_set("abc1", options), std::invalid_argument);
}

TEST(SimulationSetTest, ResolutionInsteadOfAccuracyIsAnEighth) {
  SimulationOptions options;
  options.resolution = true;
  const StudyResult fine = run_simulation_set("3", options);
  const StudyResult coarse = run_simulation_set("3", {});
  EXPECT_NEAR(fine.cases[0].error->sensitivity_matrix(0, 1) * 8.0,
              coarse.cases[0].error->sensitivity_matrix(0, 1), 1e-8);
  EXPECT_FALSE(fine.cases[0].published) << "the paper prints nothing for this";
}

// Issue: dominant entries of the variant with a random accelerometer every trial within 8 % of print at 20
// 000 trials.
TEST(SimulationSetTest, Abc1MeetsTheDominantEntriesOfTables3And4) {
  SimulationOptions options;
  options.trials = 20'000;
  const StudyResult set = run_simulation_set("abc1", options);
  ASSERT_EQ(set.cases.size(), 2U);
  const MonteCarloResult& random = *set.cases[1].monte_carlo;
  EXPECT_EQ(random.trials, 20'000U);
  const OutputVector printed = to_vector(published_table_3_and_4_standard_deviation());
  for (const int k : {1, 2, 3, 5, 6, 7, 9, 10, 11, 16, 17}) {
    EXPECT_NEAR(random.standard_deviation(k) / printed(k), 1.0, 0.08) << output_symbol(k);
  }
  // docs/reproduction.md, error 4: with Table 2's accelerometer these do not match the print.
  const MonteCarloResult& table_2 = *set.cases[0].monte_carlo;
  EXPECT_NEAR(table_2.standard_deviation(4), 3.3e-5, 0.1e-5);  // s_vy
  EXPECT_NEAR(table_2.standard_deviation(9), 4.8e-5, 0.1e-5);  // O
  EXPECT_NEAR(table_2.standard_deviation(10), 6.1e-5, 0.15e-5);
  EXPECT_NEAR(table_2.standard_deviation(11), 3.9e-5, 0.1e-5);
  EXPECT_NEAR(table_2.standard_deviation(16), 6.3e-3, 0.1e-3);  // phi_vw
  EXPECT_GT(std::abs(table_2.standard_deviation(4) / printed(4) - 1.0), 1.0);
  // The means are not zero by more than chance allows: 5 standard deviations of a mean.
  for (int k = 0; k < kStudyOutputs; ++k) {
    EXPECT_LT(std::abs(random.mean(k)), 5.0 * random.standard_deviation(k) / std::sqrt(2e4))
        << output_symbol(k);
  }
}

TEST(SimulationSetTest, Abc1HarmonicTestsItsMeansAgainstZero) {
  SimulationOptions options;
  options.seed = 3;
  const StudyResult set = run_simulation_set("abc1-harmonic", options);
  EXPECT_EQ(set.trials, 500U);
  for (const StudyCase& one : set.cases) {
    ASSERT_TRUE(one.means_not_zero);
    const std::array<bool, kStudyOutputs> differs = means_that_are_not_zero(*one.monte_carlo);
    for (int k = 0; k < kStudyOutputs; ++k) {
      // t of 499 degrees of freedom: 1.96473.
      const double limit = 1.96473 * one.monte_carlo->standard_deviation(k) / std::sqrt(500.0);
      EXPECT_EQ(differs[static_cast<std::size_t>(k)], std::abs(one.monte_carlo->mean(k)) > limit)
          << output_symbol(k);
    }
    // 36 harmonics of independent amplitude make steps 6 times as far off: the diagonals show it.
    EXPECT_GT(one.monte_carlo->standard_deviation(0), 4e-5);
  }
}

TEST(SimulationSetTest, Abc2IsAsThePaperSaysOnceItsSlipIsUndone) {
  const StudyResult set = run_simulation_set("abc2", {});
  ASSERT_EQ(set.cases.size(), 3U);
  const OutputVector deviations = to_vector(published_table_3_and_4_standard_deviation());
  const OutputVector first = to_vector(*set.cases[0].error).cwiseAbs();
  for (int k = 0; k < kStudyOutputs; ++k) EXPECT_LT(first(k), deviations(k)) << output_symbol(k);
  const StudyOutput& second = *set.cases[1].error;
  EXPECT_NEAR(std::abs(second.sensitivity_matrix(0, 2)), 2.1e-4, 0.05e-4);
  EXPECT_NEAR(std::abs(second.sensitivity_matrix(2, 0)), 2.1e-4, 0.05e-4);
  // "1.36 times as large as the largest off-diagonal standard-deviation uncertainty in Table 3"
  EXPECT_NEAR(std::abs(second.sensitivity_matrix(2, 0)) / 1.548e-4, 1.36, 0.01);
  // By the paper's text, 6 q: six times as much.
  EXPECT_NEAR(std::abs(set.cases[2].error->sensitivity_matrix(0, 2)), 1.26e-3, 0.005e-3);
}

TEST(SimulationSetTest, SeedsGiveOtherNumbersAndTheSameSeedTheSame) {
  SimulationOptions options;
  options.trials = 1000;
  const StudyResult a = run_simulation_set("abc1", options), b = run_simulation_set("abc1", options);
  options.seed = 2;
  const StudyResult c = run_simulation_set("abc1", options);
  EXPECT_EQ(a.cases[0].monte_carlo->covariance, b.cases[0].monte_carlo->covariance);
  EXPECT_NE(a.cases[0].monte_carlo->covariance, c.cases[0].monte_carlo->covariance);
}

TEST(SimulationSetTest, InterruptedItSaysSo) {
  std::stop_source stop;
  SimulationOptions options;
  options.trials = 500'000;
  options.stop = stop.get_token();
  options.progress = [&](std::uint64_t, std::uint64_t) { stop.request_stop(); };
  const StudyResult set = run_simulation_set("abc1", options);
  EXPECT_TRUE(set.interrupted);
  EXPECT_TRUE(set.cases.at(0).monte_carlo->interrupted);
  EXPECT_GE(set.cases[0].monte_carlo->trials, 1000U);
}

TEST(SimulationSetTest, RefusesBadOptions) {
  EXPECT_THROW(run_simulation_set("7", {}), std::invalid_argument);
  SimulationOptions options;
  options.trials = 0;
  EXPECT_THROW(run_simulation_set("abc1", options), std::invalid_argument);
  EXPECT_THROW(run_simulation_set("2", options), std::invalid_argument);
  options = {};
  options.alignment = Angle::degrees(std::numeric_limits<double>::quiet_NaN());
  EXPECT_THROW(run_simulation_set("3", options), std::invalid_argument);
  options.alignment = Angle::degrees(-0.1);
  EXPECT_THROW(run_simulation_set("abc1", options), std::invalid_argument);
}

TEST(PublishedBoundsTest, ScaleWithTheNormOfTheRow) {
  const StudyOutput bounds = published_bounds(2.0 * Eigen::Matrix3d::Identity());
  EXPECT_DOUBLE_EQ(bounds.sensitivity_matrix(0, 0), 4e-5);
  EXPECT_DOUBLE_EQ(bounds.sensitivity_matrix(0, 1), 4e-4);
  EXPECT_DOUBLE_EQ(bounds.intrinsic_sensitivity(1), 2e-5);
  EXPECT_DOUBLE_EQ(bounds.offset(2), 1e-4);
  EXPECT_DOUBLE_EQ(bounds.intrinsic_angle_deg(0), 5e-3);
}

}  // namespace
}  // namespace abcal
