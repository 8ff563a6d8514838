#include "protocol/model/effects.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <set>
#include <string>

#include "protocol/model/forward_model.h"

namespace abcal {
namespace {

constexpr double kRadian = std::numbers::pi / 180.0;

StagePose pose_at(int experiment, double degrees, int face = 1) {
  return StagePose::of(experiment, face, std::sin(degrees * kRadian), std::cos(degrees * kRadian));
}

TEST(EffectsTest, EverySizeBelongsToAKeyAndEveryUnknownHasAName) {
  std::set<std::string> keys;
  for (const EffectSizeKey& key : effect_size_keys()) keys.insert(std::string(key.key));
  EffectSizes stated;
  for (const EffectSizeKey& key : effect_size_keys()) key.set(stated, 1e-5);  // Some defaults are zero.
  for (const StageEffect& effect : stage_effects()) {
    EXPECT_TRUE(keys.contains(std::string(effect.key))) << effect.name.english();
    EXPECT_GT(effect.prior(stated), 0.0) << effect.name.english();
    std::set<std::string> names;
    for (int i = 0; i < effect.count; ++i) names.insert(effect.unknown_name(i));
    EXPECT_EQ(static_cast<int>(names.size()), effect.count) << effect.name.english();
  }
  for (const ItemEffect& effect : item_effects()) {
    EXPECT_TRUE(keys.contains(std::string(effect.key))) << effect.name.english();
    EXPECT_GT(effect.prior(stated), 0.0) << effect.name.english();
    std::set<std::string> names;
    for (int i = 0; i < effect.count; ++i) names.insert(effect.unknown_name(i));
    EXPECT_EQ(static_cast<int>(names.size()), effect.count) << effect.name.english();
  }
}

// Half the Legendre polynomials of orders 1 to 3 have the slopes 1, 3 and 6 at the ends of the run; a
// cyclic drift of 2 to 6 cycles that of 2 pi times the root of 4 + 9 + 16 + 25 + 36; all are independent.
TEST(EffectsTest, TheLargestDriftRateIsThatOfTheStatedEffects) {
  EffectSizes sizes = without_further_effects({});
  sizes.sensitivity_drift = 0.0;
  sizes.drift = 1e-4;
  EXPECT_NEAR(largest_drift_rate(sizes), 1e-4 * std::sqrt(1.0 + 9.0 + 36.0), 4e-5);
  sizes.drift = 0.0;
  EXPECT_EQ(largest_drift_rate(sizes), 0.0);
  sizes.sensitivity_drift = 1e-4;
  EXPECT_NEAR(largest_drift_rate(sizes), 1e-4, 1e-9);
  sizes.cyclic_drift = 1e-4;
  EXPECT_NEAR(largest_drift_rate(sizes), 2e-4 * std::numbers::pi * std::sqrt(90.0), 6e-5);
}

TEST(StageModelTest, IsTheForwardModelWithoutTilts) {
  AcsErrors acs;
  acs.alignment = {0.01, -0.007, 0.004};
  acs.d2 = Angle::degrees(0.3);
  acs.d3 = Angle::degrees(-0.2);
  StageInputs inputs = StageInputs::Zero();
  inputs(kInputZx) = 0.01;
  inputs(kInputZy) = -0.007;
  inputs(kInputXz) = 0.004;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    inputs(kInputAngleZ) = experiment == 2 ? 0.3 * kRadian : 0.0;
    inputs(kInputAngleX) = experiment == 3 ? -0.2 * kRadian : 0.0;
    const GravityCircle circle = gravity_circle(experiment, acs);
    for (double alpha = 0.0; alpha < 360.0; alpha += 35.0) {
      EXPECT_TRUE(
          gravity_at(pose_at(experiment, alpha), inputs).g.isApprox(circle.at(Angle::degrees(alpha)), 1e-13))
          << experiment << " " << alpha;
    }
  }
}

// Pose (x, z) and pose (-x, z + 180 degrees) see the same gravity with opposite errors of the stage.
TEST(StageModelTest, TheSecondFaceSeesTheGravityOfTheFirstAndOppositeErrors) {
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (double alpha = 0.0; alpha < 360.0; alpha += 35.0) {
      const double same = experiment == 3 ? alpha + 180.0 : -alpha;
      const GravityAt first = gravity_at(pose_at(experiment, same), StageInputs::Zero());
      const GravityAt second = gravity_at(pose_at(experiment, alpha, 2), StageInputs::Zero());
      EXPECT_TRUE(second.g.isApprox(first.g, 1e-13)) << experiment << " " << alpha;
      if (experiment == 3) continue;
      // An error of the angle of X turns the item in the opposite sense.
      EXPECT_TRUE(second.by_input.col(kInputAngleX).isApprox(-first.by_input.col(kInputAngleX), 1e-13));
    }
  }
}

TEST(StageEffectsTest, OnlyTheSecondFaceHasTurnsOfItsOwn) {
  for (const StageEffect& effect : stage_effects()) {
    if (effect.in_motion) continue;
    bool in_first = false, in_second = false;
    for (int experiment = 1; experiment <= 3; ++experiment) {
      for (int i = 0; i < effect.count; ++i) {
        in_first = in_first || effect.share(pose_at(experiment, 20.0), i).value != 0.0;
        in_second = in_second || effect.share(pose_at(experiment, 20.0, 2), i).value != 0.0;
      }
    }
    EXPECT_EQ(in_first, effect.face == 1) << effect.name.english();
    EXPECT_EQ(in_second, effect.name != "d2" && effect.name != "d3") << effect.name.english();
  }
}

TEST(StageModelTest, DerivativesAreThoseOfDifferences) {
  std::mt19937_64 engine(3);
  std::normal_distribution<double> normal(0.0, 1e-2);
  for (int experiment = 1; experiment <= 3; ++experiment) {
    StageInputs at;
    for (int i = 0; i < kStageInputs; ++i) at(i) = normal(engine);
    const StagePose pose = pose_at(experiment, 77.0);
    const GravityAt found = gravity_at(pose, at);
    for (int i = 0; i < kStageInputs; ++i) {
      constexpr double kStep = 1e-5;
      StageInputs above = at;
      StageInputs below = at;
      above(i) += kStep;
      below(i) -= kStep;
      const Eigen::Vector3d slope = (gravity_at(pose, above).g - gravity_at(pose, below).g) / (2.0 * kStep);
      // Truncation h^2/6 times a third derivative of about 1; round-off 1e-16/h.
      EXPECT_LT((found.by_input.col(i) - slope).cwiseAbs().maxCoeff(), 1e-10) << experiment << " input " << i;
    }
  }
}

TEST(StageModelTest, AWobbleThatStandsAtThePoseZeroIsNoEffect) {
  for (const StageEffect& effect : stage_effects()) {
    if (effect.key != "wobble_urad") continue;
    for (int i = 0; i < effect.count; ++i) {
      const StagePose zero = pose_at(1, 0.0);
      const StageShare share = effect.share(zero, i);
      StageInputs inputs = StageInputs::Zero();
      inputs(share.input) += 1e-4 * share.value;
      inputs(share.second_input) += 1e-4 * share.second_value;
      EXPECT_TRUE(gravity_at(zero, inputs).g.isApprox(Eigen::Vector3d::UnitZ(), 1e-7))
          << effect.name.english() << i;
    }
  }
}

TEST(ItemEffectsTest, SlopesAreThoseOfDifferences) {
  const ItemPoint at{0.2, {0.6, -0.5, 0.3}, {1.0, -1.0, 1.0}};
  for (const ItemEffect& effect : item_effects()) {
    for (int j = 0; j < 3; ++j) {
      for (int i = 0; i < effect.count; ++i) {
        const ItemShare share = effect.share(at, j, i);
        const std::array slopes{share.by_y, share.by_next, share.by_last};
        for (int k = 0; k < 3; ++k) {
          ItemPoint above = at;
          ItemPoint below = at;
          above.y((j + k) % 3) += 1e-6;
          below.y((j + k) % 3) -= 1e-6;
          EXPECT_NEAR(slopes[static_cast<std::size_t>(k)],
                      (effect.share(above, j, i).value - effect.share(below, j, i).value) / 2e-6, 1e-8)
              << effect.name.english();
        }
      }
    }
  }
}

// The least-squares line over all directions of gravity, by a sum over a Fibonacci sphere.
TEST(ItemEffectsTest, LineResponseIsTheLeastSquaresLineOverTheSphere) {
  Eigen::Matrix3d rows;
  rows << 0.99, 0.1, 0.05, -0.08, 0.98, 0.12, 0.03, -0.2, 0.97;
  rows.rowwise().normalize();
  constexpr int kPoints = 200'000;
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  for (const ItemEffect& effect : item_effects()) {
    if (effect.key != "k2" && effect.key != "k3" && effect.key != "nonlinearity") continue;
    for (int i = 0; i < effect.count; ++i) {
      const int j = 1;
      double mean = 0.0;
      Eigen::Vector3d slope = Eigen::Vector3d::Zero();
      for (int p = 0; p < kPoints; ++p) {
        const double z = 1.0 - (2.0 * p + 1.0) / kPoints;
        const double r = std::sqrt(1.0 - z * z);
        const Eigen::Vector3d g(r * std::cos(golden * p), r * std::sin(golden * p), z);
        const double value = effect.share({0.0, rows * g, Eigen::Vector3d::Zero()}, j, i).value;
        mean += value / kPoints;
        slope += 3.0 * value * g / kPoints;
      }
      const LineShare line = effect.line(rows, j, i);
      EXPECT_NEAR(mean, line.offset, 1e-5) << effect.name.english() << " " << i;
      EXPECT_TRUE((slope - line.scale * rows.row(j).transpose()).isZero(1e-4))
          << effect.name.english() << " " << i;
    }
  }
}

}  // namespace
}  // namespace abcal
