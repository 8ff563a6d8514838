#include "protocol/estimators/shared/known_acs_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "tests/protocol/estimators/made_record.h"
#include "tests/reference/paper_tables.h"

namespace abcal {
namespace {

AccelerometerModel table2() {
  AccelerometerModel a;
  a.sensitivity_matrix = reference::table2_sensitivity();
  a.offset = reference::table2_offset();
  return a;
}

AcsErrors some_errors() {
  AcsErrors errors;
  errors.alignment = {1e-3, -2e-3, 5e-4};
  errors.d2 = Angle::degrees(0.1);
  errors.d3 = Angle::degrees(-0.2);
  errors.mean_step_x = Angle::degrees(0.05);
  errors.mean_step_z = Angle::degrees(-0.03);
  std::mt19937_64 engine(9);
  std::normal_distribution<double> normal;
  for (auto& list : errors.step_errors) {
    for (int n = 0; n < 72; ++n) list.push_back(Angle::degrees(0.1 * normal(engine)));
  }
  return errors;
}

TEST(KnownAcsFitTest, KnownErrorsAreTakenOutWhole) {
  const KnownAcsFit fit = linear_fit_given_acs(test::made_record(table2(), some_errors()), some_errors());
  // Normal equations lose the square of the condition, which is about 2 here: a few ulp.
  EXPECT_LT((fit.sensitivity_matrix - reference::table2_sensitivity()).cwiseAbs().maxCoeff(), 4e-15);
  EXPECT_LT((fit.offset - reference::table2_offset()).cwiseAbs().maxCoeff(), 4e-15);
  // And it is these errors that matter: with a perfect stage assumed the result is off by about their size.
  const KnownAcsFit wrong = linear_fit_given_acs(test::made_record(table2(), some_errors()), AcsErrors());
  EXPECT_GT((wrong.sensitivity_matrix - reference::table2_sensitivity()).cwiseAbs().maxCoeff(), 1e-4);
}

TEST(KnownAcsFitTest, CofactorIsTheCovarianceForWeightsOfOneOverVariance) {
  RunRecord record = test::made_record(table2(), {});
  for (DwellRecord& dwell : record.dwells) dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
  const KnownAcsFit fit = linear_fit_given_acs(record, {});
  // Perfect stage, full circles: the mean square of g_x is (0 + 1/2 + 1/2)/3 = 1/3, no correlations.
  EXPECT_NEAR(std::sqrt(fit.cofactor(0, 0)), 1e-5 / std::sqrt(72.0), 1e-14);
  EXPECT_NEAR(std::sqrt(fit.cofactor(3, 3)), 1e-5 / std::sqrt(216.0), 1e-14);
  EXPECT_LT(std::abs(fit.cofactor(0, 3)), 1e-24);
}

TEST(KnownAcsFitTest, ClosingAnglesStayOut) {
  RunRecord record = test::made_record(table2(), {});
  DwellRecord closing = record.dwells.front();
  closing.closing = true;
  closing.mean.setConstant(100.0);
  record.dwells.push_back(closing);
  EXPECT_LT((linear_fit_given_acs(record, {}).offset - reference::table2_offset()).norm(), 4e-15);
}

TEST(KnownAcsFitTest, RefusesWhatDoesNotDetermineTheFit) {
  RunRecord one_plane = test::made_record(table2(), {});
  one_plane.dwells.resize(72);
  EXPECT_THROW(linear_fit_given_acs(one_plane, {}), std::runtime_error);
  EXPECT_THROW(linear_fit_given_acs(RunRecord(), {}), std::runtime_error);
  const std::vector<Eigen::Vector3d> g{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {-1, 0, 0}};
  const std::vector<double> three_weights{1, 1, 1};
  const std::vector<double> bad_weights{1, 1, -1, 1};
  EXPECT_THROW(linear_fit_given_acs(g, g, three_weights), std::invalid_argument);
  EXPECT_THROW(linear_fit_given_acs(g, g, bad_weights), std::invalid_argument);
  std::vector<Eigen::Vector3d> with_nan = g;
  with_nan[1].y() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(linear_fit_given_acs(g, with_nan), std::invalid_argument);
  EXPECT_LT((linear_fit_given_acs(g, g).sensitivity_matrix - Eigen::Matrix3d::Identity()).norm(), 1e-15);
}

}  // namespace
}  // namespace abcal
