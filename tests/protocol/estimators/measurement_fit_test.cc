// The fit of several runs of several items: against the least squares of its definition, and its symmetries.

#include "protocol/estimators/measurement/measurement_fit.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/measurement/stage_learning.h"
#include "tests/protocol/estimators/made_tray.h"

namespace abcal {
namespace {

/// Two runs of two items. The second run has the readings of the first, with other noise.
class TwoRunsOfTwoItems {
 public:
  explicit TwoRunsOfTwoItems(double noise, const EffectSizes& sizes = {}) {
    trays_.resize(
        2, test::made_tray({.items = 2, .steps = 12, .noise = noise, .mixed_mounting = false, .sizes = sizes},
                           3));
    int number = 0;
    for (RunRecord& record : trays_.back().records)
      for (DwellRecord& dwell : record.dwells)
        for (Eigen::Index j = 0; j < 3; ++j) dwell.mean(j) += (*dwell.u_mean)(j)*std::sin(17.0 * ++number);
    std::vector<Eigen::Vector3d> units;
    for (const test::MadeTray& tray : trays_)
      for (std::size_t k = 0; k < 2; ++k) {
        JointOptions options;
        options.noise_process = false;
        if (units.size() == 2) options.unit = units[k];
        own.push_back(std::make_unique<ItemFit>(fit_item(tray.records[k], options)));
        if (units.size() < 2) units.push_back(own.back()->solution->fit.unit);
        informations.push_back(run_information(own.back()->data, *own.back()->solution));
      }
  }
  /// @param order  of the four: item 1 and 2 in run 1, then in run 2
  MeasurementFit fit(const std::vector<std::size_t>& order = {0, 1, 2, 3}) const {
    std::vector<MeasuredItem> measured;
    std::map<std::size_t, int> items;
    for (const std::size_t m : order) {
      const int next = static_cast<int>(items.size());
      measured.push_back({.information = &informations[m],
                          .item = items.try_emplace(m % 2, next).first->second,
                          .run = static_cast<int>(m / 2),
                          .pose = {}});
    }
    MeasurementOptions options;
    options.estimate_repeatabilities = false;
    return fit_measurement(measured, options);
  }
  std::vector<std::unique_ptr<ItemFit>> own;
  std::vector<RunInformation> informations;

 private:
  std::vector<test::MadeTray> trays_;
};

Eigen::Matrix3d rotated(const Eigen::Vector3d& turn) {
  return Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
}

/// All readings of four members with one covariance matrix, in which every unknown with a prior is a part of
/// the noise. What is left to estimate: s and O of both items.
struct Dense {
  static constexpr Eigen::Index kItem = 12;
  Eigen::MatrixXd covariance;  ///< s_u, O_u, s_v, O_v, s_w, O_w of item 1, then of item 2; relative.
  Eigen::VectorXd change;      ///< From the values of the fit.

  Dense(const TwoRunsOfTwoItems& data, const MeasurementFit& fit) {
    const EffectSizes& sizes = data.informations.front().sizes;
    const Repeatabilities repeats = stated_repeatabilities(sizes);
    const double step = step_prior(sizes), visit = repeats[0].rms;
    // The map has the part of a step error that visits leave, and a twentieth of it at least.
    const double map = std::max(step * step - visit * visit, std::pow(0.05 * step, 2));
    Eigen::Index readings = 0;
    for (const RunInformation& run : data.informations) readings += run.readings;
    Eigen::MatrixXd design = Eigen::MatrixXd::Zero(readings, 2 * kItem);
    Eigen::VectorXd left(readings);
    Eigen::MatrixXd v = Eigen::MatrixXd::Zero(readings, readings);
    std::map<std::string, std::pair<Eigen::VectorXd, double>> shared;  // Derivatives and prior variance.
    const auto share = [&](const std::string& name, double variance) -> Eigen::VectorXd& {
      auto& [by, prior] = shared.try_emplace(name, Eigen::VectorXd::Zero(readings), variance).first->second;
      EXPECT_DOUBLE_EQ(prior, variance) << name;
      return by;
    };
    Eigen::Index row = 0;
    for (std::size_t m = 0; m < 4; ++m) {
      const RunInformation& run = data.informations[m];
      const EffectModel& model = *data.own[m]->solution->model;
      const Eigen::Index count = run.readings, unknowns = run.layout.count();
      Eigen::MatrixXd by_q = Eigen::MatrixXd::Zero(count, run.at.size());
      by_q.leftCols(unknowns) = model.jacobian();
      const AssumedNoise& noise = data.own[m]->solution->noises[best_noise(*data.own[m]->solution)];
      const std::vector<NoiseAtAngle> angles = model.noise_at_angles(noise.white);
      for (std::size_t n = 0; n < run.visits.size(); ++n) {
        const auto at = static_cast<Eigen::Index>(n);
        by_q.block<3, 1>(3 * at, unknowns + at) = model.by_step(n);
        v.diagonal().segment<3>(row + 3 * at) += angles[n].white;
      }
      const std::size_t item = m % 2;
      const Eigen::VectorXd& of_item = fit.in_runs[item].value;  // As it is mounted in its first run.
      const Eigen::Vector3d small = -fit.in_runs[m].small_turn;
      const Eigen::Matrix3d turn = m < 2 ? Eigen::Matrix3d::Identity() : rotated(small);
      Eigen::VectorXd q = Eigen::VectorXd::Zero(run.at.size());
      const std::string items = "item " + std::to_string(item), here = "member " + std::to_string(m);
      for (int j = 0; j < 3; ++j) {
        const Eigen::Index first = run.layout.own_count() * j,
                           x = kItem * static_cast<Eigen::Index>(item) + 4 * j;
        const Eigen::Vector3d s = of_item.segment<3>(first);
        q.segment<3>(first) = turn.transpose() * s;
        q(first + 3) = of_item(first + 3);
        const Eigen::MatrixXd by_s = by_q.middleCols<3>(first);
        design.block(row, x, count, 3) = by_s * turn.transpose();
        design.block(row, x + 3, count, 1) = by_q.col(first + 3);
        if (m >= 2)
          for (int k = 0; k < 3; ++k)
            share(here + " turn " + std::to_string(k), std::pow(0.5 * std::numbers::pi / 180.0, 2))
                .segment(row, count) += by_s * turn.transpose() * s.cross(Eigen::Vector3d::Unit(k));
        for (std::size_t i = 0; i < run.layout.own.size(); ++i) {
          const Eigen::Index at = first + EffectLayout::kOwnFixed + static_cast<Eigen::Index>(i);
          const EffectUnknown& unknown = run.unknowns[static_cast<std::size_t>(at)];
          const bool drifts = run.layout.own[i].effect->kind == ItemEffectKind::kDrift;
          share((drifts ? here : items) + " " + std::to_string(at), std::pow(unknown.prior_sd, 2))
              .segment(row, count) += by_q.col(at);
        }
      }
      const std::string of_run = "run " + std::to_string(m / 2);
      for (Eigen::Index at = run.layout.first_stage(); at < unknowns; ++at) {
        const EffectUnknown& unknown = run.unknowns[static_cast<std::size_t>(at)];
        share(unknown.name, std::pow(unknown.prior_sd, 2)).segment(row, count) += by_q.col(at);
        if (const int part = repeat_part_of(unknown.name); part >= 0)
          share(of_run + " " + unknown.name, std::pow(repeats[static_cast<std::size_t>(part)].rms, 2))
              .segment(row, count) += by_q.col(at);
      }
      for (std::size_t n = 0; n < run.visits.size(); ++n) {
        const Eigen::Index at = unknowns + static_cast<Eigen::Index>(n);
        const bool free = run.visits[n].microdegrees == 0;
        share(name_of_map(run.visits[n]), free ? std::pow(100.0 * step, 2) : map).segment(row, count) +=
            by_q.col(at);
        share(of_run + " pose " + std::to_string(n), visit * visit).segment(row, count) += by_q.col(at);
      }
      left.segment(row, count) = model.misfit() - by_q * (q - run.at);
      // The prior of the small turn is about zero, and the model is linear at the turn of the fit.
      for (int k = 0; k < 3 && m >= 2; ++k)
        left.segment(row, count) +=
            small(k) * share(here + " turn " + std::to_string(k), std::pow(0.5 * std::numbers::pi / 180.0, 2))
                           .segment(row, count);
      row += count;
    }
    for (const auto& [name, one] : shared) v += one.second * one.first * one.first.transpose();
    const Eigen::LLT<Eigen::MatrixXd> llt(v);
    covariance = (design.transpose() * llt.solve(design)).llt().solve(Eigen::MatrixXd::Identity(24, 24));
    change = covariance * design.transpose() * llt.solve(left);
  }
};

/// Places of s and O among the unknowns of an item, as Dense lists them.
std::vector<Eigen::Index> places_of(const RunInformation& run) {
  std::vector<Eigen::Index> out;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 4; ++i) out.push_back(run.layout.own_count() * j + i);
  return out;
}

TEST(MeasurementFitTest, IsTheLeastSquaresSolutionByItsDefinition) {
  const TwoRunsOfTwoItems data(3e-5);
  const MeasurementFit fit = data.fit();
  ASSERT_TRUE(fit.converged);
  const Dense dense(data, fit);
  for (std::size_t item = 0; item < 2; ++item) {
    const std::vector<Eigen::Index> places = places_of(data.informations[item]);
    for (Eigen::Index i = 0; i < 12; ++i) {
      const Eigen::Index at = Dense::kItem * static_cast<Eigen::Index>(item) + i;
      const double u = std::sqrt(dense.covariance(at, at));
      EXPECT_LT(std::abs(dense.change(at)), 1e-4 * u) << item << ", " << i;
      for (Eigen::Index k = 0; k < 12; ++k) {
        const Eigen::Index other = Dense::kItem * static_cast<Eigen::Index>(item) + k;
        EXPECT_NEAR(fit.in_runs[item].covariance(places[static_cast<std::size_t>(i)],
                                                 places[static_cast<std::size_t>(k)]),
                    dense.covariance(at, other), 1e-5 * u * std::sqrt(dense.covariance(other, other)))
            << item << ", " << i << ", " << k;
      }
    }
  }
}

TEST(MeasurementFitTest, TheOrderInWhichRunsAndItemsAreGivenDoesNotMatter) {
  const TwoRunsOfTwoItems data(3e-5);
  const MeasurementFit one = data.fit(), other = data.fit({1, 0, 3, 2});
  ASSERT_TRUE(one.converged && other.converged);
  EXPECT_NEAR(one.chi2, other.chi2, 1e-6 * one.chi2);
  for (std::size_t k = 0; k < 2; ++k)
    for (Eigen::Index i = 0; i < 12; ++i) {
      const FittedItem &a = one.items[k], &b = other.items[1 - k];
      const double u = std::sqrt(a.covariance_line(i, i));
      EXPECT_NEAR(a.line(i), b.line(i), 1e-6 * u);
      EXPECT_NEAR(std::sqrt(b.covariance_line(i, i)), u, 1e-6 * u);
    }
}

// A second item says something of the stage that a run of the first one alone leaves open.
TEST(MeasurementFitTest, AnItemThatIsBesideAnotherIsKnownBetter) {
  const TwoRunsOfTwoItems data(1e-6);
  const MeasurementFit both = data.fit(), alone = data.fit({0, 2});
  ASSERT_TRUE(both.converged && alone.converged);
  double least = 1.0;
  for (Eigen::Index i = 0; i < 12; ++i) {
    const double ratio =
        std::sqrt(both.items[0].covariance_line(i, i) / alone.items[0].covariance_line(i, i));
    EXPECT_LE(ratio, 1.0 + 1e-9) << i;
    least = std::min(least, ratio);
  }
  EXPECT_LT(least, 0.9);
}

TEST(MeasurementFitTest, TheBudgetHasALineForEachOwner) {
  const TwoRunsOfTwoItems data(3e-5);
  const MeasurementFit fit = data.fit();
  ASSERT_TRUE(fit.converged);
  for (const FittedItem& item : fit.items) {
    std::map<std::string, int> unknowns;
    Covariance12 sum = Covariance12::Zero();
    for (const EffectShare& share : item.shares) {
      unknowns[share.effect] = share.unknowns;
      sum += share.covariance;
      EXPECT_GT(share.prior_sd, 0.0) << share.effect;
    }
    EXPECT_EQ(unknowns.at("mounting"), 3);
    EXPECT_EQ(unknowns.at("fine map"), 24) << "12 angles of each axis";
    EXPECT_EQ(unknowns.at("step errors, from visit to visit"), 72) << "36 poses in each run, for both items";
    EXPECT_EQ(unknowns.at("alignment, from run to run"), 6);
    EXPECT_TRUE(unknowns.contains("effects of the other items"));
    EXPECT_FALSE(unknowns.contains("f_1"));
    // The rest is noise.
    for (Eigen::Index i = 0; i < 12; ++i) EXPECT_LT(sum(i, i), item.covariance_line(i, i)) << i;
  }
}

// Runs have no unknowns of their own then.
TEST(MeasurementFitTest, NoEffectNeedsToBeStated) {
  EffectSizes none;
  for (const EffectSizeKey& key : effect_size_keys()) key.set(none, 0.0);
  const TwoRunsOfTwoItems data(3e-5, none);
  const MeasurementFit fit = data.fit();
  ASSERT_TRUE(fit.converged);
  for (std::size_t k = 0; k < 2; ++k)
    for (Eigen::Index j = 0; j < 3; ++j) {
      // The mean of 72 readings, all of which tell the offset.
      const double unit = data.informations[k].unit(j);
      EXPECT_NEAR(std::sqrt(fit.items[k].covariance_line(9 + j, 9 + j)), unit * 3e-5 / std::sqrt(72.0),
                  0.4 * unit * 3e-5 / std::sqrt(72.0));
    }
}

TEST(MeasurementFitTest, OneRunHasAllOfItsStepErrorsAtEachPose) {
  const TwoRunsOfTwoItems data(3e-5);
  std::vector<MeasuredItem> measured{{.information = &data.informations[0], .item = 0, .run = 0, .pose = {}},
                                     {.information = &data.informations[2], .item = 0, .run = 1, .pose = {}}};
  MeasurementOptions of_one_run;
  of_one_run.separates_what_repeats = false;
  EXPECT_THROW(fit_measurement(measured, of_one_run), std::invalid_argument);
  EXPECT_THROW(fit_measurement({}, of_one_run), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
