#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/joint/analyse_tray.h"
#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/measurement/stage_learning.h"
#include "tests/protocol/estimators/made_tray.h"

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

/// The items of one run with their own fits.
struct OwnFits {
  explicit OwnFits(const MadeTray& tray, const JointOptions& options = {}) {
    for (const RunRecord& record : tray.records) works.push_back(fit_item(record, options));
  }
  MeasurementFit common() {
    informations.clear();
    measured.clear();
    for (const ItemFit& work : works) informations.push_back(run_information(work.data, *work.solution));
    for (std::size_t k = 0; k < works.size(); ++k)
      measured.push_back({.information = &informations[k],
                          .item = static_cast<int>(k),
                          .pose = {},
                          .own = &*works[k].solution});
    MeasurementOptions of_one_run;
    of_one_run.separates_what_repeats = false;
    return fit_measurement(measured, of_one_run);
  }
  std::vector<ItemFit> works;
  std::vector<RunInformation> informations;
  std::vector<MeasuredItem> measured;
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
  const MeasurementFit fit = own.common();
  ASSERT_TRUE(fit.converged);
  EXPECT_NEAR(fit.chi2, alone.chi2, 1e-5 * alone.chi2);
  const FittedItem& item = fit.items.front();
  const EffectFit common = common_fit(alone, own.measured.front(), fit);
  for (Eigen::Index i = 0; i < 12; ++i) {
    const double u = std::sqrt(alone.covariance_line(i, i));
    EXPECT_NEAR(item.line(i), alone.line(i), 1e-4 * u) << i;
    EXPECT_NEAR(std::sqrt(item.covariance_line(i, i)), u, 1e-5 * u) << i;
    EXPECT_NEAR(common.covariance_line_type_b(i, i), alone.covariance_line_type_b(i, i), 1e-4 * u * u);
  }
  ASSERT_EQ(item.shares.size(), alone.shares.size());
  for (const EffectShare& share : item.shares) {
    const auto same = std::ranges::find(alone.shares, share.effect, &EffectShare::effect);
    ASSERT_NE(same, alone.shares.end()) << share.effect;
    EXPECT_EQ(share.key, same->key);
    EXPECT_EQ(share.unknowns, same->unknowns) << share.effect;
    EXPECT_DOUBLE_EQ(share.prior_sd, same->prior_sd) << share.effect;
    for (Eigen::Index i = 0; i < 12; ++i)
      EXPECT_NEAR(share.covariance(i, i), same->covariance(i, i), 1e-4 * alone.covariance_line(i, i));
  }
  ASSERT_EQ(item.gain.rows(), alone.gain.rows());
  EXPECT_LT((item.gain - alone.gain).norm(), 1e-4 * alone.gain.norm());
  for (std::size_t n = 0; n < alone.step_error.size(); ++n) {
    EXPECT_NEAR(common.step_error[n], alone.step_error[n], 1e-3 * alone.u_step_error[n]);
    EXPECT_NEAR(common.u_step_error[n], alone.u_step_error[n], 1e-4 * alone.u_step_error[n]);
  }
}

/// The problem by its definition: all readings of two items in one covariance matrix, with the step
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
  const MeasurementFit fit = own.common();
  ASSERT_TRUE(fit.converged);
  const DenseTray dense(own, noises);
  const Eigen::Index a = own.works[0].solution->model->layout().first_stage();
  const auto stage = static_cast<Eigen::Index>(fit.stage.names.size());
  const Eigen::MatrixXd& of_first = fit.in_runs[0].covariance;
  const Eigen::MatrixXd& of_second = fit.in_runs[1].covariance;
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
  // Between the items only s is compared: unlike the offset, it does not contain the mean of a process.
  const auto rows_of = [&](std::size_t k) -> Rows12 {
    return line_rows(own.informations[k].layout, fit.in_runs[k].value).leftCols(a);
  };
  const Rows12 first = rows_of(0), second = rows_of(1);
  const Covariance12 between = units_of_line(own.works[0].solution->model->unit()).asDiagonal() *
                               (first * dense.covariance.block(0, a, a, a) * second.transpose()) *
                               units_of_line(own.works[1].solution->model->unit()).asDiagonal();
  for (Eigen::Index i = 0; i < 9; ++i) {
    for (Eigen::Index k = 0; k < 9; ++k) {
      const double scale = std::sqrt(fit.covariance_lines(i, i) * fit.covariance_lines(12 + k, 12 + k));
      EXPECT_NEAR(fit.covariance_lines(i, 12 + k), between(i, k), 1e-6 * scale);
    }
  }
}

const Quantity& output_of(const CalibrationResult& result, std::size_t i) {
  return i < 9 ? (*result.sensitivity_matrix)[i / 3][i % 3] : result.offset[i - 9];
}

/// How often the 95 % intervals of items hold the truth, and the mean square of error over uncertainty: of s
/// (without the elements that a turn of the stage moves, which all items of a bench share), of O.
struct Coverage {
  int s_inside = 0, s_count = 0, o_inside = 0, o_count = 0, doubtful = 0;
  double s_square = 0.0, o_square = 0.0;

  void add(const TrayResult& result, const MadeTray& tray) {
    if (result.verdict != Verdict::kUsable) ++doubtful;
    for (std::size_t k = 0; k < tray.records.size(); ++k) {
      for (std::size_t i = 0; i < 12; ++i) {
        const Quantity& q = output_of(result.items[k].result, i);
        const double off = q.value - tray.line[k](static_cast<Eigen::Index>(i));
        const bool inside = std::abs(off) <= coverage_factor(q, 0.95) * q.standard_uncertainty;
        const double square = std::pow(off / q.standard_uncertainty, 2);
        (i < 9 ? s_inside : o_inside) += inside ? 1 : 0;
        (i < 9 ? s_square : o_square) += square;
        ++(i < 9 ? s_count : o_count);
      }
    }
  }
};

Coverage coverage_of(int benches, const TrayPlan& plan, std::uint64_t first_seed) {
  Coverage out;
  for (int b = 0; b < benches; ++b) {
    const MadeTray tray = made_tray(plan, first_seed + static_cast<std::uint64_t>(b));
    out.add(analyse_tray(tray.records), tray);
  }
  return out;
}

// Shared errors make the four items of a bench err together: benches count, not items.
void expect_covered(const Coverage& found, int benches) {
  const double scatter = 3.0 * std::sqrt(0.05 * 0.95 / benches);
  EXPECT_GT(static_cast<double>(found.s_inside) / found.s_count, 0.95 - scatter);
  EXPECT_GT(static_cast<double>(found.o_inside) / found.o_count, 0.95 - scatter);
  // Not by claiming too much.
  EXPECT_GT(found.s_square / found.s_count, 0.6);
  EXPECT_GT(found.o_square / found.o_count, 0.6);
  EXPECT_EQ(found.doubtful, 0);
}

TEST(TrayTest, IntervalsHoldTheTruth) {
  for (const bool mixed : {false, true}) {
    const Coverage found = coverage_of(10, {.items = 4, .steps = 12, .mixed_mounting = mixed}, 100);
    expect_covered(found, 10);
  }
}

TEST(LongTrayTest, IntervalsHoldTheTruth) {
  for (const double process : {0.0, 2.0}) {
    for (const bool mixed : {false, true}) {
      const Coverage found =
          coverage_of(100, {.items = 4, .steps = 24, .process = process, .mixed_mounting = mixed}, 1000);
      expect_covered(found, 100);
    }
  }
}

// The noise of the items limits the knowledge of the angles of the stage, of its turn errors and of the
// higher wobble; where a prior limits it (a turn of the whole stage), more items do not help.
TEST(TrayTest, EightItemsKnowTheStageBetter) {
  const TrayPlan plan{.items = 8, .steps = 16, .noise = 1e-4};
  const MadeTray tray = made_tray(plan, 7);
  const TrayResult of_all = analyse_tray(tray.records);
  const TrayResult of_one =
      analyse_tray(std::span(tray.records).first(1), {.stage_of_one = true, .measured_alignment = {}});
  ASSERT_TRUE(of_all.stage && of_one.stage);
  EXPECT_EQ(of_all.stage->items, 8);
  for (std::size_t a = 0; a < of_all.stage->steps.size(); ++a)
    EXPECT_GT(of_one.stage->steps[a].angle_error.standard_uncertainty,
              2.0 * of_all.stage->steps[a].angle_error.standard_uncertainty)
        << a;
  for (std::size_t i = 0; i < of_all.stage->unknowns.size(); ++i) {
    const StageQuantity& all = of_all.stage->unknowns[i];
    EXPECT_LE(all.value.standard_uncertainty,
              of_one.stage->unknowns[i].value.standard_uncertainty * (1.0 + 1e-9))
        << all.name;
    if (all.name == "d2") {
      EXPECT_LT(2.0 * all.value.standard_uncertainty, of_one.stage->unknowns[i].value.standard_uncertainty);
    }
  }
}

/// Mean square of the errors of a stage's angles over their uncertainties. The truth: smooth and other step
/// errors, less their mean over the experiment.
double square_of_angle_errors(const TrayStage& stage, const MadeTray& tray) {
  std::array<double, 4> mean{};
  const double each = 3.0 / static_cast<double>(stage.steps.size());
  for (std::size_t a = 0; a < stage.steps.size(); ++a)
    mean[static_cast<std::size_t>(stage.steps[a].experiment)] += each * tray.angle_error(a);
  double square = 0.0;
  for (std::size_t a = 0; a < stage.steps.size(); ++a) {
    const Quantity& found = stage.steps[a].angle_error;
    const double truth = tray.angle_error(a) - mean[static_cast<std::size_t>(stage.steps[a].experiment)];
    square += std::pow((found.value - truth * 180.0 / std::numbers::pi) / found.standard_uncertainty, 2);
  }
  return square / static_cast<double>(stage.steps.size());
}

// One bench scatters by 0.3, as the angles of a bench err together.
TEST(TrayTest, StageIsKnownAsWellAsClaimed) {
  double of_angles = 0.0;
  double of_unknowns = 0.0;
  constexpr int kBenches = 6;
  for (std::uint64_t seed = 0; seed < kBenches; ++seed) {
    const MadeTray tray = made_tray({.items = 4, .steps = 12, .noise = 1e-4}, 500 + seed);
    const TrayResult result = analyse_tray(tray.records);
    ASSERT_TRUE(result.stage) << result.why;
    of_angles += square_of_angle_errors(*result.stage, tray) / kBenches;
    const std::vector<StageQuantity>& unknowns = result.stage->unknowns;
    for (std::size_t i = 0; i < unknowns.size(); ++i) {
      const Quantity& found = unknowns[i].value;
      const double unit = found.unit == "degree" ? 180.0 / std::numbers::pi
                          : found.unit == "urad" ? 1e6
                                                 : 1.0;
      const double off = found.value - unit * tray.stage(static_cast<Eigen::Index>(i));
      of_unknowns +=
          std::pow(off / found.standard_uncertainty, 2) / static_cast<double>(unknowns.size()) / kBenches;
    }
  }
  EXPECT_NEAR(of_angles, 1.0, 0.5);
  EXPECT_NEAR(of_unknowns, 1.0, 0.3);
}

TEST(TrayTest, ItemsShareWhatTheStageDoes) {
  const MadeTray tray = made_tray({.items = 3, .steps = 16}, 5);
  const TrayResult result = analyse_tray(tray.records);
  ASSERT_EQ(result.verdict, Verdict::kUsable) << result.why;
  const Covariance18 between = result.covariance_of_all_outputs(0, 2);
  EXPECT_TRUE(between.isApprox(result.covariance_of_all_outputs(2, 0).transpose(), 1e-12));
  const Covariance18 first = result.covariance_of_all_outputs(0, 0);
  const Covariance18 last = result.covariance_of_all_outputs(2, 2);
  double largest = 0.0;
  for (Eigen::Index i = 0; i < 9; ++i) {
    for (Eigen::Index k = 0; k < 9; ++k)
      largest = std::max(largest, std::abs(between(i, k)) / std::sqrt(first(i, i) * last(k, k)));
  }
  EXPECT_GT(largest, 0.9) << "a turn of the whole stage moves all items alike";
  // All outputs together have a covariance: no difference has a variance below zero.
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(result.common_covariance);
  EXPECT_GT(eigen.eigenvalues()(0), -1e-12 * eigen.eigenvalues().tail(1)(0));
  const IntrinsicComparison comparison = compare_items(result, 0, 2);
  EXPECT_EQ(comparison.degrees_of_freedom, 9);
  for (const PropertyDifference& property : comparison.properties)
    EXPECT_GT(property.standard_uncertainty, 0.0);
}

TEST(TrayTest, GainOfOneVoltmeterIsCommonToItsItems) {
  constexpr double kGain = 1e-3;
  const std::string one = "calibration EX-V-1 of DMM-1 by EX, performed 2026-01-01, due 2027-01-01";
  MadeTray tray = made_tray({.items = 3, .steps = 16}, 5);
  const auto with_sources = [&](const std::string& first, const std::string& second) {
    for (RunRecord& record : tray.records) record.tolerances.voltmeter_gain = kGain;
    tray.records[0].tolerances.sources["voltmeter_gain"] = first;
    tray.records[1].tolerances.sources["voltmeter_gain"] = second;
    tray.records[2].tolerances.sources["voltmeter_gain"] = "data sheet";
    return analyse_tray(tray.records);
  };
  const TrayResult shared = with_sources(one, one);
  const TrayResult apart = with_sources(one, "calibration EX-V-2 of DMM-2 by EX");
  ASSERT_EQ(shared.verdict, Verdict::kUsable) << shared.why;
  const Vector12 first = values_of(shared.items[0].result), second = values_of(shared.items[1].result);
  const Covariance12 gain = kGain * kGain * first * second.transpose();
  EXPECT_TRUE((shared.covariance(0, 1) - apart.covariance(0, 1)).isApprox(gain, 1e-9));
  EXPECT_EQ(shared.covariance(0, 2), apart.covariance(0, 2));
  // Equal free-text sources do not name one instrument.
  EXPECT_EQ(with_sources("data sheet", "data sheet").covariance(0, 1), apart.covariance(0, 1));
  // The items' own uncertainties have the gain either way; the common part cancels in the difference.
  EXPECT_EQ(shared.items[0].result.covariance, apart.items[0].result.covariance);
  const double s1 = shared.items[0].result.intrinsic_sensitivity[0].value;
  const double s2 = shared.items[1].result.intrinsic_sensitivity[0].value;
  const double u = compare_items(shared, 0, 1).properties[0].standard_uncertainty;
  const double u_apart = compare_items(apart, 0, 1).properties[0].standard_uncertainty;
  EXPECT_NEAR(u_apart * u_apart - u * u, 2.0 * kGain * kGain * s1 * s2, 1e-9 * u_apart * u_apart);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(shared.common_covariance);
  EXPECT_GT(eigen.eigenvalues()(0), -1e-12 * eigen.eigenvalues().tail(1)(0));
}

// One item that came loose: it is doubtful on its own, and the others are as without it.
TEST(TrayTest, LooseItemDoesNotSpoilTheOthers) {
  MadeTray tray = made_tray({.items = 4, .steps = 16}, 11);
  const TrayResult without = analyse_tray(std::span(tray.records).first(3));
  RunRecord& loose = tray.records[3];
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.01, Eigen::Vector3d(1, 2, 3).normalized()).matrix();
  for (std::size_t n = 30; n < loose.dwells.size(); ++n) loose.dwells[n].mean = turn * loose.dwells[n].mean;
  const TrayResult result = analyse_tray(tray.records);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_NE(result.why.english().find("3 of 4 items usable"), std::string::npos) << result.why;
  EXPECT_NE(result.why.english().find("item 4"), std::string::npos) << result.why;
  EXPECT_EQ(result.items[3].result.verdict, Verdict::kDoubtful);
  EXPECT_FALSE(result.items[3].in_common_fit);
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_EQ(result.items[k].result.verdict, Verdict::kUsable) << result.items[k].result.why;
    EXPECT_EQ(values_of(result.items[k].result), values_of(without.items[k].result));
  }
  EXPECT_THROW(compare_items(result, 0, 3), std::invalid_argument);
}

// Readings that are sound in themselves, but of another stage: an item of another run among these.
TEST(TrayTest, ItemOfAnotherRunContradictsTheOthers) {
  MadeTray tray = made_tray({.items = 4, .steps = 16}, 12);
  const MadeTray other = made_tray({.items = 1, .steps = 16}, 13);
  tray.records[1] = other.records.front();
  const TrayResult result = analyse_tray(tray.records);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_FALSE(result.items[1].in_common_fit);
  EXPECT_NE(result.items[1].result.why.english().find("contradicts the other items about the stage"),
            std::string::npos)
      << result.items[1].result.why;
  for (const std::size_t k : {0U, 2U, 3U}) {
    EXPECT_TRUE(result.items[k].in_common_fit);
    EXPECT_EQ(result.items[k].result.verdict, Verdict::kUsable) << result.items[k].result.why;
  }
  // Two cannot tell which is wrong.
  const TrayResult of_two = analyse_tray(std::span(tray.records).first(2));
  for (const TrayItemResult& item : of_two.items) {
    EXPECT_EQ(item.result.verdict, Verdict::kDoubtful);
    EXPECT_FALSE(item.in_common_fit);
  }
}

TEST(TrayTest, ItemReadTwiceIsFound) {
  MadeTray tray = made_tray({.items = 3, .steps = 16}, 14);
  tray.records[2] = tray.records[0];
  const TrayResult result = analyse_tray(tray.records);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  for (const std::size_t k : {0U, 2U}) {
    EXPECT_EQ(result.items[k].result.verdict, Verdict::kDoubtful);
    EXPECT_NE(
        result.items[k].result.why.english().find("items 1 and 3 have the same readings at 48 of 48 angles"),
        std::string::npos);
  }
  EXPECT_EQ(result.items[1].result.verdict, Verdict::kUsable) << result.items[1].result.why;
}

// An item that fell silent has fewer angles; those that it has are the stage's own.
TEST(TrayTest, ItemsMayMissAngles) {
  MadeTray tray = made_tray({.items = 3, .steps = 16}, 15);
  std::vector<DwellRecord>& dwells = tray.records[0].dwells;
  dwells.erase(dwells.begin() + 20);
  tray.records[1].dwells[7].flags = kFlagClipped;
  tray.records[2].dwells.resize(12);
  const TrayResult result = analyse_tray(tray.records);
  ASSERT_TRUE(result.stage);
  EXPECT_EQ(result.stage->steps.size(), 48U);
  for (std::size_t k = 0; k < 2; ++k) {
    EXPECT_TRUE(result.items[k].in_common_fit) << result.items[k].why_not;
    for (std::size_t i = 0; i < 12; ++i) {
      const Quantity& q = output_of(result.items[k].result, i);
      EXPECT_NEAR(q.value, tray.line[k](static_cast<Eigen::Index>(i)), 4.0 * q.standard_uncertainty);
    }
  }
  EXPECT_FALSE(result.items[2].in_common_fit);
  EXPECT_FALSE(result.items[2].why_not.empty());
}

TEST(TrayTest, RefusesTwoStages) {
  MadeTray tray = made_tray({.items = 2, .steps = 12}, 16);
  tray.records[1].tolerances.wobble_urad = 12.0;
  EXPECT_THROW(analyse_tray(tray.records), std::invalid_argument);
  EXPECT_THROW(analyse_tray({}), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
