// The joint fit prepares the readings of a sweep and models them: ripple, filter, delay, places of the
// elements.
#include "protocol/estimators/joint/swept_readings.h"

#include <gtest/gtest.h>

#include <Eigen/QR>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/joint/effect_model.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr double kHalfTurn = std::numbers::pi;
constexpr double kFilterS = 1.0 / (2.0 * kHalfTurn * 5.0);
constexpr double kDelayS = 0.02;
constexpr int kBins = 36;

/// An axis that turns with a ripple of its rate: order 2 and order 6.
struct RippledTurn {
  double rate_radps = 0.0;

  static constexpr double kOrder2 = 4e-4, kOrder6 = 1e-4;
  double angle(double t) const {
    const double even = rate_radps * t;
    return even + kOrder2 * std::sin(2.0 * even) + kOrder6 * std::cos(6.0 * even);
  }
  double rate(double t) const {
    const double even = rate_radps * t;
    return rate_radps * (1.0 + 2.0 * kOrder2 * std::cos(2.0 * even) - 6.0 * kOrder6 * std::sin(6.0 * even));
  }
  double acceleration(double t) const {
    const double even = rate_radps * t;
    return rate_radps * rate_radps *
           (-4.0 * kOrder2 * std::sin(2.0 * even) - 36.0 * kOrder6 * std::cos(6.0 * even));
  }
  double time_at(double angle_rad) const {
    double t = angle_rad / rate_radps;
    for (int step = 0; step < 5; ++step) t += (angle_rad - angle(t)) / rate(t);
    return t;
  }
  /// The cosine of the angle behind a delay and a low-pass of first order: Simpson's rule over its memory.
  double filtered(double t) const {
    constexpr int kSteps = 4000;
    constexpr double kMemory = 40.0;
    double sum = 0.0;
    for (int k = 0; k <= kSteps; ++k) {
      const double s = kMemory * k / kSteps;
      const double weight = k == 0 || k == kSteps ? 1.0 : k % 2 == 1 ? 4.0 : 2.0;
      sum += weight * std::exp(-s) * std::cos(angle(t - kDelayS - kFilterS * s));
    }
    return sum * kMemory / kSteps / 3.0;
  }
};

/// Two sweeps of circle 1, up at 180 degrees/s and down at 60.
std::vector<RippledTurn> turns() {
  return {{kHalfTurn}, {-kHalfTurn / 3.0}};
}

RunRecord swept_record() {
  RunRecord record;
  record.source = "two sweeps";
  const std::vector<RippledTurn> all = turns();
  for (std::size_t k = 0; k < all.size(); ++k) {
    for (int i = 0; i < kBins; ++i) {
      const int n = all[k].rate_radps > 0.0 ? i : kBins - 1 - i;
      DwellRecord dwell;
      dwell.experiment = 1;
      dwell.n = n + 1;
      dwell.alpha = dwell.commanded_x = Angle::degrees(10.0 * n);
      const double t = all[k].time_at(dwell.alpha.rad());
      dwell.time_s = t + 10.0 * static_cast<double>(k);
      const double value = all[k].filtered(t);
      dwell.mean = Eigen::Vector3d(0.0, value, 2.0 * value);
      dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
      dwell.motion = DwellMotion{.sweep = static_cast<int>(k) + 1,
                                 .rate_deg_per_s = Angle::radians(all[k].rate(t)).deg(),
                                 .acceleration_deg_per_s2 = Angle::radians(all[k].acceleration(t)).deg(),
                                 .u_angle_deg = 1e-4};
      record.dwells.push_back(dwell);
    }
  }
  return record;
}

TEST(SweptReadingsTest, TakeAngleRateAndAccelerationThatTheItemSaw) {
  const RunRecord record = swept_record();
  const CollectedReadings data = collect_readings(record, false);
  ASSERT_EQ(data.readings.size(), 2U * kBins);
  EXPECT_NEAR(data.delay_s[0], kDelayS + kFilterS, 2e-4);
  for (std::size_t n = 0; n < data.readings.size(); ++n) {
    const EffectReading& reading = data.readings[n];
    const std::size_t k = n / kBins;
    const RippledTurn turn = turns()[k];
    const double then = *record.dwells[n].time_s - 10.0 * static_cast<double>(k) - data.delay_s[0];
    EXPECT_NEAR(reading.cos_alpha, std::cos(turn.angle(then)), 1e-7) << n;
    EXPECT_NEAR(reading.sin_alpha, std::sin(turn.angle(then)), 1e-7) << n;
    EXPECT_NEAR(reading.rate_radps, turn.rate(then), 1e-6 * std::abs(turn.rate_radps)) << n;
    EXPECT_NEAR(reading.acceleration_radps2, turn.acceleration(then), 1e-5 * std::pow(turn.rate_radps, 2))
        << n;
  }
}

// A rippled cosine behind a filter is left as a cosine of the angle that the item saw, with the loss
// at the rate of the turn. With the harmonics of the angle in place of those of the time 1e-5 would remain.
TEST(SweptReadingsTest, LeaveAnEvenSineOfARippledTurnBehindAFilter) {
  const CollectedReadings data = collect_readings(swept_record(), false);
  for (std::size_t k = 0; k < 2; ++k) {
    Eigen::MatrixXd design(kBins, 3);
    Eigen::VectorXd values(kBins);
    for (int i = 0; i < kBins; ++i) {
      const EffectReading& reading = data.readings[k * kBins + static_cast<std::size_t>(i)];
      design.row(i) << reading.cos_alpha, reading.sin_alpha, 1.0;
      values(i) = reading.value(1);
    }
    const Eigen::VectorXd found = design.colPivHouseholderQr().solve(values);
    EXPECT_NEAR(found(0), 1.0 / std::hypot(1.0, turns()[k].rate_radps * kFilterS), 2e-6);
    EXPECT_LT((values - design * found).cwiseAbs().maxCoeff(), 2e-6) << "sweep " << k + 1;
  }
}

/// Even turns about both axes at 180 degrees/s, an item with cross terms, and elements away from the axes.
class SweptModelTest : public testing::Test {
 protected:
  void SetUp() override {
    for (int experiment = 1; experiment <= 3; ++experiment) {
      for (int i = 0; i < kBins; ++i) {
        EffectReading& reading = readings_.emplace_back();
        reading.experiment = experiment;
        const double alpha = 2.0 * kHalfTurn * i / kBins;
        reading.sin_alpha = std::sin(alpha);
        reading.cos_alpha = std::cos(alpha);
        reading.turned_rad = alpha - kHalfTurn;
        reading.value = gravity_alone(StagePose::of(experiment, 1, reading.sin_alpha, reading.cos_alpha),
                                      StageInputs::Zero());
        reading.u.setConstant(1e-5);
        reading.rate_radps = reading.mean_rate_radps = kHalfTurn;
        reading.sweep = experiment - 1;
      }
    }
    EffectFitOptions options;
    options.sizes = with_effects_of_motion({});
    options.sizes.nonlinearity = 1e-4;
    options.sweeps.assign(3, SweepSize{1e-5, 1e-5});
    model_.emplace(readings_, options);
    steps_.assign(readings_.size(), 0.0);
    value_ = model_->value();
  }
  /// @param number  of the unknown among those of the effect and the output; -1: of the stage
  Eigen::Index unknown(const std::string& effect, int output, int number) const {
    for (std::size_t i = 0; i < model_->unknowns().size(); ++i)
      if (model_->unknowns()[i].effect == effect && model_->unknowns()[i].output == output && number-- == 0)
        return static_cast<Eigen::Index>(i);
    ADD_FAILURE() << effect;
    return 0;
  }
  Eigen::VectorXd readings_at(const Eigen::VectorXd& value) const {
    return model_->readings_at(value, steps_,
                               std::vector<Eigen::Vector3d>(steps_.size(), Eigen::Vector3d::Zero()));
  }

  static constexpr int kV = 1, kW = 2;
  std::vector<EffectReading> readings_;
  std::optional<EffectModel> model_;
  std::vector<double> steps_;
  Eigen::VectorXd value_;
};

// An output that bends with its neighbour sees the acceleration of the neighbour's place.
TEST_F(SweptModelTest, CrossTermsSeeThePlacesOfTheNeighbours) {
  constexpr double kCross = 1e-3, kPlaceM = 0.05;
  const Eigen::VectorXd plain = readings_at(value_);
  value_(unknown("apparent position", kV, 1)) = kPlaceM;  // v along y
  const Eigen::VectorXd placed = readings_at(value_);
  value_(unknown("cross terms", kW, 1)) = kCross;  // w times v, the last one
  const Eigen::VectorXd crossed = readings_at(value_);
  const double force = -kHalfTurn * kHalfTurn * kPlaceM / kStandardGravity;
  for (int i = 0; i < kBins; ++i) {  // About X: v and w turn.
    const double v = plain(3 * i + kV), w = plain(3 * i + kW);
    EXPECT_NEAR(placed(3 * i + kV), v + force, 1e-9);
    EXPECT_NEAR(crossed(3 * i + kW) - w, kCross * w * (v + force), 1e-9) << i;
  }
}

// An angle that is wrong around the circle has a wrong rate and acceleration, which elements away from the
// axes feel: with order 6 more than the angle itself.
TEST_F(SweptModelTest, ErrorsOfTheAnglesOfASweepActOnPlacesToo) {
  for (int j = 0; j < 3; ++j)
    for (int k = 0; k < 3; ++k) value_(unknown("apparent position", j, k)) = 0.03 * (1.0 + j - 0.7 * k);
  for (std::size_t i = 0; i < model_->unknowns().size(); ++i)
    if (model_->unknowns()[i].key == "axes_distance_mm") value_(static_cast<Eigen::Index>(i)) = 0.01;
  model_->move_to(value_, steps_);
  constexpr double kStep = 1e-6;
  for (int sweep = 0; sweep < 3; ++sweep) {
    for (int part = 0; part < kSweepUnknowns; ++part) {
      const Eigen::Index at = model_->layout().first_sweep() + kSweepUnknowns * sweep + part;
      Eigen::VectorXd more = value_, less = value_;
      more(at) += kStep;
      less(at) -= kStep;
      const Eigen::VectorXd slope = (readings_at(more) - readings_at(less)) / (2.0 * kStep);
      EXPECT_LT((slope - model_->jacobian().col(at)).cwiseAbs().maxCoeff(), 1e-5) << sweep << " " << part;
    }
  }
  const Eigen::Index sine_6 = model_->layout().first_sweep() + 2 * 6 - 1;
  const double angle_alone = std::numbers::sqrt2;
  EXPECT_GT(model_->jacobian().col(sine_6).cwiseAbs().maxCoeff(), 3.0 * angle_alone);
}

/// Sweeps of three circles whose angles lie about the turning points of the responses, not on them: there a
/// slope is as large as its change within a step. Only the sizes that a test states have a part in the signs.
class SweptSignsTest : public testing::Test {
 protected:
  static constexpr double kFirst = 3.0 / 180.0 * kHalfTurn, kStepRad = 2.0 * kHalfTurn / kBins;
  static constexpr double kHysteresis = 1e-5;

  void make(double step_rad) {
    step_rad_ = step_rad;
    for (int experiment = 1; experiment <= 3; ++experiment) {
      for (int i = 0; i < kBins; ++i) {
        EffectReading& reading = readings_.emplace_back();
        reading.experiment = experiment;
        reading.sin_alpha = std::sin(angle(i));
        reading.cos_alpha = std::cos(angle(i));
        reading.turned_rad = angle(i) - kHalfTurn;
        for (int j = 0; j < 3; ++j) reading.value(j) = response(experiment, j, angle(i));
        reading.u.setConstant(1e-5);
        reading.rate_radps = reading.mean_rate_radps = kHalfTurn;
        reading.sweep = experiment - 1;
      }
    }
    EffectFitOptions options;
    options.sizes = with_effects_of_motion(without_further_effects({}));
    options.sizes.hysteresis = kHysteresis;
    options.sizes.step = Angle::radians(step_rad);
    options.sweeps.assign(3, SweepSize{1e-5, 1e-5});
    model_.emplace(readings_, options);
    root_ = Eigen::MatrixXd::Zero(model_->layout().count(), model_->layout().count());
  }

  static double angle(int i) { return kFirst + kStepRad * i; }
  /// The gravity of the three circles, as an item that stands straight sees it.
  static double response(int experiment, int output, double alpha) {
    constexpr std::array<std::array<double, 3>, 3> kOfSine{{{0, 1, 0}, {-1, 0, 0}, {-1, 0, 0}}};
    constexpr std::array<std::array<double, 3>, 3> kOfCosine{{{0, 0, 1}, {0, 0, 1}, {0, -1, 0}}};
    const auto row = static_cast<std::size_t>(experiment - 1), column = static_cast<std::size_t>(output);
    return kOfSine[row][column] * std::sin(alpha) + kOfCosine[row][column] * std::cos(alpha);
  }
  static bool responds(int experiment, int output) { return response(experiment, output, 0.7) != 0.0; }
  /// The mean sign of a change that is normally distributed, and within a step evenly.
  /// @param sd_s_vy  standard deviation of the sensitivity of v along y
  double expected_sign(int experiment, int output, int i, double sd_s_vy) const {
    const auto y = [&](int at) { return response(experiment, output, angle(at)); };
    const auto slope = [&](int at) { return response(experiment, output, angle(at) + 0.5 * kHalfTurn); };
    const int from = std::max(0, i - 1), to = std::min(kBins - 1, i + 1);
    const double change = y(to) - y(from);
    const double bend = to == from + 2 ? y(i + 1) - 2.0 * y(i) + y(i - 1) : 0.0;
    const double by_s =
        output == kV ? response(experiment, kV, angle(to)) - response(experiment, kV, angle(from)) : 0.0;
    const double variance = std::pow(step_rad_, 2) * (std::pow(slope(from), 2) + std::pow(slope(to), 2)) +
                            bend * bend / 3.0 + std::pow(sd_s_vy * by_s, 2);
    return std::erf(change / std::sqrt(2.0 * variance));
  }
  double expected_sign(std::size_t n, int output, double sd_s_vy) const {
    return expected_sign(readings_[n].experiment, output, static_cast<int>(n) % kBins, sd_s_vy);
  }
  Eigen::Index s_vy() const { return model_->layout().own_count() + 1; }
  void expect_signs(double sd_s_vy) const {
    for (std::size_t n = 0; n < readings_.size(); ++n)
      for (int j = 0; j < 3; ++j)
        if (responds(readings_[n].experiment, j)) {
          EXPECT_NEAR(model_->signs().mean[n](j), expected_sign(n, j, sd_s_vy), 1e-8) << n << " " << j;
        }
  }

  static constexpr int kV = 1;
  std::vector<EffectReading> readings_;
  std::optional<EffectModel> model_;
  Eigen::MatrixXd root_;
  double step_rad_ = 0.0;
};

TEST_F(SweptSignsTest, AMeanSignIsThatOfTheSlopeWithinItsStep) {
  make(0.0);
  ASSERT_TRUE(model_->take_signs(root_));
  EXPECT_LT(std::abs(expected_sign(1, kV, 9, 0.0)), 0.8) << "near the turning point";
  expect_signs(0.0);
}

TEST_F(SweptSignsTest, StepErrorsOfBothNeighboursAreInTheUncertaintyOfTheSlope) {
  make(0.02);
  ASSERT_TRUE(model_->take_signs(root_));
  expect_signs(0.0);
}

TEST_F(SweptSignsTest, TheUncertaintyOfTheUnknownsIsToo) {
  make(0.0);
  root_(s_vy(), s_vy()) = 0.8;
  for (const Eigen::Index at : model_->hysteresis_unknowns()) root_(at, at) = 3.0 * kHysteresis;
  ASSERT_TRUE(model_->take_signs(root_));
  expect_signs(0.8);
  // Where the hysteresis is less well known than it is stated, its own uncertainty counts.
  const double of_9 = 1.0 - std::pow(expected_sign(1, kV, 9, 0.8), 2);
  EXPECT_NEAR(model_->signs().variance[9](kV) / std::pow(3.0 * kHysteresis, 2), of_9, 1e-8);
  root_.setZero();
  ASSERT_TRUE(model_->take_signs(root_));
  const double as_stated = 1.0 - std::pow(expected_sign(1, kV, 9, 0.0), 2);
  EXPECT_NEAR(model_->signs().variance[9](kV) / std::pow(kHysteresis, 2), as_stated, 1e-8);
}

TEST_F(SweptSignsTest, SignsThatChangeByLessThanAThousandthAreTheSame) {
  make(0.0);
  ASSERT_TRUE(model_->take_signs(root_));
  const auto largest_change = [&](double sd) {
    double largest = 0.0;
    for (std::size_t n = 0; n < readings_.size(); ++n)
      largest = std::max(largest, std::abs(expected_sign(n, kV, sd) - expected_sign(n, kV, 0.0)));
    return largest;
  };
  const auto sd_of_change = [&](double change) {
    double less = 0.0, more = 1.0;
    for (int k = 0; k < 60; ++k)
      (largest_change(0.5 * (less + more)) < change ? less : more) = 0.5 * (less + more);
    return less;
  };
  root_(s_vy(), s_vy()) = sd_of_change(0.995e-3);
  EXPECT_FALSE(model_->take_signs(root_));
  expect_signs(0.0);
  const double sd = sd_of_change(1.005e-3);
  root_(s_vy(), s_vy()) = sd;
  EXPECT_TRUE(model_->take_signs(root_));
  expect_signs(sd);
}

}  // namespace
}  // namespace abcal
