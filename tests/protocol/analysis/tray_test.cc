#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "protocol/analysis/analyse_tray.h"
#include "protocol/analysis/joint_work.h"
#include "protocol/analysis/line_response.h"
#include "protocol/analysis/tray_fit.h"
#include "tests/protocol/analysis/made_tray.h"

namespace abcal {
namespace {

using test::made_tray;
using test::MadeTray;
using test::TrayPlan;

Vector12 values_of(const CalibrationResult& result) {
  Vector12 out;
  const Eigen::Matrix3d s = result.sensitivity_values();
  for (int j = 0; j < 3; ++j) out.segment<3>(3 * j) = s.row(j).transpose();
  out.tail<3>() = result.offset_values();
  return out;
}

/// The work of the items' own fits, and which angle of the stage each reading belongs to: the n-th.
struct OwnFits {
  explicit OwnFits(const MadeTray& tray, const JointOptions& options = {}) {
    for (const RunRecord& record : tray.records) works.push_back(fit_jointly(record, options));
    for (JointWork& work : works) {
      std::vector<int> angle(work.readings.size());
      for (std::size_t n = 0; n < angle.size(); ++n) angle[n] = static_cast<int>(n);
      members.push_back({&*work.solution, angle});
    }
    for (const EffectReading& at : works.front().readings)
      angles.push_back({at.experiment, at.sin_alpha, at.cos_alpha});
  }
  std::vector<JointWork> works;
  std::vector<TrayMember> members;
  std::vector<TrayAngle> angles;
};

TEST(TrayTest, OneItemGivesTheJointResult) {
  const MadeTray tray = made_tray({.items = 1}, 1);
  const CalibrationResult alone = analyse_joint(tray.records.front());
  const TrayResult result = analyse_tray(tray.records);
  ASSERT_EQ(result.items.size(), 1U);
  EXPECT_TRUE(result.items.front().in_common_fit);
  EXPECT_EQ(result.verdict, alone.verdict);
  const CalibrationResult& of_tray = result.items.front().result;
  for (Eigen::Index i = 0; i < 12; ++i) {
    EXPECT_NEAR(values_of(of_tray)(i), values_of(alone)(i), 1e-12 * std::abs(values_of(alone)(i)));
    EXPECT_NEAR((*of_tray.covariance)(i, i), (*alone.covariance)(i, i), 1e-12 * (*alone.covariance)(i, i));
  }
}

// The machinery itself, with one member: step errors are unknowns here, and part of the noise there.
TEST(TrayTest, FitOfOneMemberIsItsOwnFit) {
  const MadeTray tray = made_tray({.items = 1}, 2);
  JointOptions options;
  options.noise_process = false;
  OwnFits own(tray, options);
  const EffectFit& alone = own.works.front().solution->fit;
  const TrayFit fit = fit_tray(own.members, own.angles);
  ASSERT_TRUE(fit.converged);
  EXPECT_NEAR(fit.chi2, alone.chi2, 1e-5 * alone.chi2);
  for (Eigen::Index i = 0; i < 12; ++i) {
    const double u = std::sqrt(alone.covariance_line(i, i));
    EXPECT_NEAR(fit.items[0].line(i), alone.line(i), 1e-4 * u) << i;
    EXPECT_NEAR(std::sqrt(fit.items[0].covariance_line(i, i)), u, 1e-5 * u) << i;
    EXPECT_NEAR(fit.items[0].covariance_line_type_b(i, i), alone.covariance_line_type_b(i, i), 1e-4 * u * u);
  }
  for (std::size_t n = 0; n < alone.step_error.size(); ++n) {
    EXPECT_NEAR(fit.items[0].step_error[n], alone.step_error[n], 1e-3 * alone.u_step_error[n]);
    EXPECT_NEAR(fit.items[0].u_step_error[n], alone.u_step_error[n], 1e-4 * alone.u_step_error[n]);
  }
}

/// The same problem by its definition: all readings of two items in one covariance matrix, with the step
/// errors that they share and the process of each.
struct DenseTray {
  explicit DenseTray(const OwnFits& own, const std::vector<AssumedNoise>& noises) {
    const EffectModel& first = *own.works[0].solution->model;
    const Eigen::Index a = first.layout().first_stage();
    const auto stage = static_cast<Eigen::Index>(first.layout().stage.size());
    const auto rows = static_cast<Eigen::Index>(3 * first.angles());
    Eigen::MatrixXd jacobian = Eigen::MatrixXd::Zero(2 * rows, 2 * a + stage);
    Eigen::MatrixXd steps(2 * rows, rows / 3);
    v = Eigen::MatrixXd::Zero(2 * rows, 2 * rows);
    Eigen::VectorXd prior(2 * a + stage);
    for (Eigen::Index k = 0; k < 2; ++k) {
      const EffectModel& model = *own.works[static_cast<std::size_t>(k)].solution->model;
      const AssumedNoise& noise = noises[static_cast<std::size_t>(k)];
      jacobian.block(k * rows, k * a, rows, a) = model.jacobian().leftCols(a);
      jacobian.block(k * rows, 2 * a, rows, stage) = model.jacobian().middleCols(a, stage);
      prior.segment(k * a, a) = model.prior_weight().head(a);
      prior.tail(stage) = model.prior_weight().segment(a, stage);
      const std::vector<NoiseAtAngle> angles = model.noise_at_angles(noise.white);
      const NoiseProcess process = model.process_of(noise.tau, noise.rho);
      Eigen::MatrixXd links = Eigen::MatrixXd::Zero(rows, rows / 3);
      double place = 0.0;
      std::vector<double> places;
      for (std::size_t n = 0; n < angles.size(); ++n) {
        if (n > 0) place += angles[n].distance;
        places.push_back(place);
        const auto at = 3 * static_cast<Eigen::Index>(n);
        links.block<3, 1>(at, static_cast<Eigen::Index>(n)) = angles[n].by_step;
        for (int j = 0; j < 3; ++j) v(k * rows + at + j, k * rows + at + j) += angles[n].white(j);
        for (std::size_t m = 0; m <= n; ++m) {
          for (int j = 0; j < 3; ++j) {
            const auto other = 3 * static_cast<Eigen::Index>(m) + j;
            const double shared =
                process.tau(j) * process.tau(j) * std::exp(-(place - places[m]) / process.rho);
            v(k * rows + at + j, k * rows + other) += shared;
            if (m < n) v(k * rows + other, k * rows + at + j) += shared;
          }
        }
      }
      steps.middleRows(k * rows, rows) = links;
    }
    v += first.step_sd() * first.step_sd() * steps * steps.transpose();
    Eigen::MatrixXd normal = jacobian.transpose() * v.llt().solve(jacobian);
    normal.diagonal() += prior;
    covariance = normal.llt().solve(Eigen::MatrixXd::Identity(normal.rows(), normal.rows()));
  }
  Eigen::MatrixXd v, covariance;
};

TEST(TrayTest, IsTheLeastSquaresSolutionByItsDefinition) {
  const MadeTray tray = made_tray({.items = 2, .steps = 12, .noise = 3e-5}, 3);
  OwnFits own(tray);
  std::vector<AssumedNoise> noises(2);
  noises[0].tau = 0.0;
  noises[1].tau = 1.7;
  noises[1].rho = 8.0;
  for (std::size_t k = 0; k < 2; ++k) {
    own.works[k].solution->noises = {noises[k]};
    own.works[k].solution->weights = {1.0};
    own.works[k].solution->log_likelihoods = {0.0};
  }
  const TrayFit fit = fit_tray(own.members, own.angles);
  ASSERT_TRUE(fit.converged);
  const DenseTray dense(own, noises);
  const Eigen::Index a = own.works[0].solution->model->layout().first_stage();
  const Eigen::Index stage = fit.stage.value.size();
  const Eigen::MatrixXd& of_first = fit.items[0].covariance;
  const Eigen::MatrixXd& of_second = fit.items[1].covariance;
  const auto expect_same = [](const Eigen::MatrixXd& found, const Eigen::MatrixXd& wanted) {
    ASSERT_EQ(found.rows(), wanted.rows());
    for (Eigen::Index i = 0; i < found.rows(); ++i) {
      for (Eigen::Index k = 0; k < found.cols(); ++k)
        EXPECT_NEAR(found(i, k), wanted(i, k), 1e-6 * std::sqrt(wanted(i, i) * wanted(k, k)))
            << i << ' ' << k;
    }
  };
  expect_same(of_first.topLeftCorner(a, a), dense.covariance.topLeftCorner(a, a));
  expect_same(of_second.topLeftCorner(a, a), dense.covariance.block(a, a, a, a));
  expect_same(fit.stage.covariance, dense.covariance.bottomRightCorner(stage, stage));
  // Between the items: s alone, as the mean of a process is no part of it.
  const Rows12 first = own.works[0].solution->model->line_rows().leftCols(a);
  const Rows12 second = own.works[1].solution->model->line_rows().leftCols(a);
  const Covariance12 between = units_of_line(own.works[0].solution->model->unit()).asDiagonal() *
                               (first * dense.covariance.block(0, a, a, a) * second.transpose()) *
                               units_of_line(own.works[1].solution->model->unit()).asDiagonal();
  for (Eigen::Index i = 0; i < 9; ++i) {
    for (Eigen::Index k = 0; k < 9; ++k) {
      const double scale = std::sqrt(fit.covariance(i, i) * fit.covariance(12 + k, 12 + k));
      EXPECT_NEAR(fit.covariance(i, 12 + k), between(i, k), 1e-6 * scale);
    }
  }
}

}  // namespace
}  // namespace abcal
