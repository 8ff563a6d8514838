#include "protocol/run/settling.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "protocol/run/item_channels.h"
#include "tests/protocol/run/run_parts_fixture.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class SettlingTest : public test::RunPartsTest {
 protected:
  SettlingTest() {
    settings.protocol.settle_s = 0.5;
    settings.protocol.quiet_timeout_s = 2.0;
    settings.protocol.dwell_readings = 100;
    accelerometer.output = noisy;
  }
  ReadingSource& readings() {
    if (!readings_) readings_.emplace(context(), accelerometer);
    return *readings_;
  }
  Settling settling() { return Settling(context(), readings()); }
  ItemChannels items() { return {context(), instruments(), {}}; }

 private:
  std::optional<ReadingSource> readings_;
};

TEST_F(SettlingTest, WaitsTheSettleTimeWhereAllIsQuiet) {
  const Clock::Instant stopped = clock.now();
  EXPECT_TRUE(settling().settle(stopped));
  EXPECT_NEAR(to_seconds(clock.now() - stopped), 0.5, 0.02);
}

TEST_F(SettlingTest, SaysWhatIsNotQuietAtTheLongestWait) {
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + 1e-3 * static_cast<double>(k) * Eigen::Vector3d::UnitX();  // It creeps.
  };
  const Clock::Instant stopped = clock.now();
  EXPECT_FALSE(settling().settle(stopped));
  EXPECT_NEAR(to_seconds(clock.now() - stopped), 2.5, 0.3);
}

TEST_F(SettlingTest, ByTheOutputsItWaitsTwiceTheTimeUntilNothingIsSeen) {
  settings.protocol.settle_auto = true;
  const Clock::Instant stopped = clock.now();
  Settling part = settling();
  EXPECT_TRUE(part.settle(stopped));
  EXPECT_NEAR(to_seconds(clock.now() - stopped), 0.25, 0.02) << "one window of 25 readings";

  accelerometer.output = [begin = accelerometer.count](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + std::exp(-0.1 * static_cast<double>(k - begin)) * Eigen::Vector3d::UnitX();
  };
  const Clock::Instant stopped_again = clock.now();
  EXPECT_TRUE(part.settle(stopped_again));
  // exp(-10 t) falls to the noise (0.6e-4) after 0.97 s; a window shows three times that, after 0.87 s.
  EXPECT_GT(to_seconds(clock.now() - stopped_again), 1.5);
  EXPECT_LT(to_seconds(clock.now() - stopped_again), 2.1);
}

TEST_F(SettlingTest, ByTheOutputsItSaysWhatIsNotQuietAtTheLongestWait) {
  settings.protocol.settle_auto = true;
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + 1e-3 * static_cast<double>(k) * Eigen::Vector3d::UnitX();
  };
  const Clock::Instant stopped = clock.now();
  EXPECT_FALSE(settling().settle(stopped));
  EXPECT_NEAR(to_seconds(clock.now() - stopped), 2.0, 0.3);
}

TEST_F(SettlingTest, ADwellThatStillCreepsBeginsLater) {
  settings.protocol.settle_auto = true;
  // 2e-4 that vanishes with 0.3 s: too little for a window to show, and 0.6e-4 in the mean of 1 s.
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + 2e-4 * std::exp(-static_cast<double>(k) / 30.0) * Eigen::Vector3d::UnitY();
  };
  std::vector<Reading> dwell = readings().read(100);
  EXPECT_TRUE(settling().read_until_at_rest(dwell));
  EXPECT_EQ(dwell.size(), 100U);
  EXPECT_GE(dwell.front().sequence, 25U);
  for (std::size_t k = 1; k < dwell.size(); ++k) EXPECT_EQ(dwell[k].sequence, dwell[k - 1].sequence + 1);

  accelerometer.output = noisy;
  std::vector<Reading> quiet = readings().read(100);
  const std::uint64_t first = quiet.front().sequence;
  EXPECT_TRUE(settling().read_until_at_rest(quiet));
  EXPECT_EQ(quiet.front().sequence, first);
}

TEST_F(SettlingTest, ADwellThatCreepsWithoutEndIsTold) {
  settings.protocol.settle_auto = true;
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + 1e-5 * static_cast<double>(k) * Eigen::Vector3d::UnitX();
  };
  std::vector<Reading> dwell = readings().read(100);
  EXPECT_FALSE(settling().read_until_at_rest(dwell));
}

TEST_F(SettlingTest, AfterAFixedTimeADwellThatCreepsIsToldAndReadAsItIs) {
  // Swings that are slower than the window before the dwell: at a turning point it shows no slope.
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + 2e-4 * std::cos(0.03 * static_cast<double>(k)) * Eigen::Vector3d::UnitY();
  };
  std::vector<Reading> dwell = readings().read(100);
  EXPECT_FALSE(settling().read_until_at_rest(dwell));
  EXPECT_EQ(dwell.front().sequence, 0U);
  EXPECT_EQ(dwell.size(), 100U);

  accelerometer.output = noisy;
  for (int k = 0; k < 1000; ++k) {
    std::vector<Reading> quiet = readings().read(100);
    ASSERT_TRUE(settling().read_until_at_rest(quiet)) << k;
  }
}

TEST_F(SettlingTest, AFixedTimeThatIsTooShortIsToldOnce) {
  Settling part = settling();
  std::mt19937_64 engine(3);
  std::normal_distribution<double> normal(0.0, 1e-4);
  for (int angle = 1; angle <= 200; ++angle) {
    // The direction of gravity changes with the angle, and each output creeps after its change: too little
    // for one dwell.
    const double alpha = 0.3 * angle;
    const Eigen::Vector3d mean(std::sin(alpha), std::cos(alpha), 0.0);
    const Eigen::Vector3d change(std::cos(alpha), -std::sin(alpha), 0.0);
    std::vector<Reading> dwell(100);
    for (std::size_t k = 0; k < dwell.size(); ++k)
      dwell[k].output = mean - (k < 25 ? 3e-5 : 0.0) * change.cwiseSign() +
                        Eigen::Vector3d(normal(engine), normal(engine), normal(engine));
    ASSERT_TRUE(part.read_until_at_rest(dwell)) << angle;
    part.learn(dwell_statistics(dwell, {}));
  }
  ASSERT_EQ(observer.notices.size(), 1U);
  EXPECT_EQ(observer.notices[0].first, "settling");
  EXPECT_THAT(observer.notices[0].second, HasSubstr("settle_s = 0.5 is too short"));
}

// A quiet item drifts by much more than its noise while it dwells: by what is stated, that is no way to rest.
TEST_F(SettlingTest, TheStatedDriftIsNoMotion) {
  settings.protocol.settle_auto = true;
  constexpr double kDriftPerS = 2e-6;
  const auto quiet = [this](double drift_per_s) {
    accelerometer.output = [drift_per_s](std::uint64_t k) -> Eigen::Vector3d {
      const Eigen::Vector3d mean(0.1, 0.2, 1.0);
      return mean + 1e-3 * (noisy(k) - mean) +
             0.01 * drift_per_s * static_cast<double>(k) * Eigen::Vector3d::UnitX();
    };
    std::vector<Reading> dwell;
    for (int k = 0; k < 200; ++k) dwell.push_back(*accelerometer.next(clock.now() + from_seconds(1.0)));
    Settling part = settling();
    return part.find_rest(clock.now()).quiet && part.read_until_at_rest(dwell);
  };
  EXPECT_FALSE(quiet(2.0 * kDriftPerS)) << "nothing is known of a drift";
  context().drift_per_s = kDriftPerS;
  EXPECT_TRUE(quiet(2.0 * kDriftPerS));
  EXPECT_FALSE(quiet(20.0 * kDriftPerS)) << "it is not as stated";
}

TEST(CreepTest, ChangesOfNoAccountAreNoneThoughTheOutputHasNoNoise) {
  std::vector<Reading> readings(100);
  for (std::size_t k = 0; k < readings.size(); ++k)
    readings[k].output = {0.0, 1.0 + (k < 25 ? 1e-9 : 0.0), 1e-6 * (k < 25)};
  const Eigen::Vector3d creep = creep_of(readings, {});
  EXPECT_EQ(creep[1], 0.0);
  EXPECT_GT(creep[2], 100.0);
}

TEST(CreepTest, OfNoiseIsAStandardNormalOfItsSize) {
  constexpr int kDwells = 2000;
  double squares = 0.0;
  std::mt19937_64 engine(7);
  std::normal_distribution<double> normal;
  for (int d = 0; d < kDwells; ++d) {
    std::vector<Reading> readings(200);
    for (Reading& reading : readings) reading.output = {normal(engine), normal(engine), 0.0};
    const Eigen::Vector3d creep = creep_of(readings, {});
    squares += (creep[0] * creep[0] + creep[1] * creep[1]) / (2.0 * kDwells);
    EXPECT_EQ(creep[2], 0.0);
  }
  EXPECT_NEAR(std::sqrt(squares), 1.0, 0.1);
}

TEST(SettlingLessonTest, FindsACreepThatNoSingleDwellShows) {
  std::mt19937_64 engine(11);
  std::normal_distribution<double> normal;
  const auto angles_until_learnt = [&](double creep_each) {
    SettlingLesson lesson;
    for (int angle = 1; angle <= 400; ++angle) {
      const double alpha = 0.3 * angle;
      const Eigen::Vector3d mean(std::sin(alpha), std::cos(alpha), 0.0);
      const Eigen::Vector3d direction(std::cos(alpha), -std::sin(alpha), 0.0);
      const Eigen::Vector3d creep = -creep_each * direction.cwiseSign() +
                                    Eigen::Vector3d(normal(engine), normal(engine), normal(engine));
      if (lesson.add(creep, mean, Eigen::Vector3d::Constant(1e-4))) {
        EXPECT_EQ(lesson.patience(), 2.0 * kSettlingPatience);
        return angle;
      }
    }
    return 0;
  };
  EXPECT_EQ(angles_until_learnt(0.0), 0);
  const int learnt = angles_until_learnt(0.7);
  EXPECT_GT(learnt, 6);
  EXPECT_LT(learnt, 60);
}

TEST_F(SettlingTest, LearnsTheNoiseAfterTheRingDown) {
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    const double t = 0.01 * static_cast<double>(k);
    return noisy(k) + 0.1 * std::exp(-3.0 * t) * std::sin(40.0 * t) * Eigen::Vector3d::UnitZ();
  };
  settings.protocol.quiet_timeout_s = 30.0;
  Settling part = settling();
  EXPECT_FALSE(part.spreads().median());
  readings().discard_pending();
  part.learn_noise();
  ASSERT_TRUE(part.spreads().median());
  // A uniform distribution of +-1e-4 has a standard deviation of 0.58e-4.
  for (int j = 0; j < 3; ++j) EXPECT_NEAR((*part.spreads().median())[j], 0.58e-4, 0.4e-4) << j;
}

TEST_F(SettlingTest, UnstableTemperatureEndsTheWaitWithWhatIsRequired) {
  settings.protocol.stability_s = 1.0;
  settings.protocol.stability_timeout_s = 2.0;
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + 1e-3 * static_cast<double>(k) * Eigen::Vector3d::UnitX();
  };
  const auto [fault, words] = failure_of([&] { items().wait_until_stable(); });
  EXPECT_EQ(fault, Fault::kImplausible);
  EXPECT_THAT(words, HasSubstr("not stable for 1 s within 2 s"));
}

TEST_F(SettlingTest, StableOutputsBeginTheRunWithANotice) {
  settings.protocol.stability_s = 1.0;
  items().wait_until_stable();
  ASSERT_EQ(observer.notices.size(), 1U);
  EXPECT_EQ(observer.notices[0].first, "stable");
}

TEST(SpreadHistoryTest, TheMedianForgetsOldDwellsAndIgnoresOneThatWasShaken) {
  SpreadHistory history;
  for (int k = 0; k < 15; ++k) history.add(Eigen::Vector3d::Constant(1.0), 0.0);
  history.add(Eigen::Vector3d::Constant(100.0), 0.0);
  EXPECT_EQ(*history.median(), Eigen::Vector3d::Constant(1.0));
  for (int k = 0; k < 15; ++k) history.add(Eigen::Vector3d::Constant(2.0), 0.0);
  EXPECT_EQ(*history.median(), Eigen::Vector3d::Constant(2.0));
}

TEST(SpreadHistoryTest, AFrozenOutputSaysNothingOfItsNoise) {
  SpreadHistory history;
  history.add({0.0, 1e-4, 1e-4}, 1e-6);
  EXPECT_TRUE(std::isnan((*history.median())[0]));
  EXPECT_EQ((*history.median())[1], 1e-4);
  history.add({2e-4, 1e-4, 1e-4}, 1e-6);
  EXPECT_EQ((*history.median())[0], 2e-4);
  // Noise of less than a step: an output that stands still is usual.
  SpreadHistory coarse;
  coarse.add({0.0, 5e-4, 0.0}, 1e-3);
  EXPECT_EQ(*coarse.median(), Eigen::Vector3d(0.0, 5e-4, 0.0));
}

TEST(QuietWindowTest, IsAQuarterOfADwellWithinBounds) {
  ProtocolConfig protocol;
  protocol.dwell_readings = 100;
  EXPECT_EQ(quiet_window_size(protocol, 100.0), 25U);
  protocol.dwell_readings = 10;
  EXPECT_EQ(quiet_window_size(protocol, 100.0), 10U);
  protocol.dwell_readings = 100000;
  EXPECT_EQ(quiet_window_size(protocol, 100.0), 50U);
}

class ReadingSourceTest : public SettlingTest {};

TEST_F(ReadingSourceTest, ASilentAccelerometerIsAnErrorAfterItsTime) {
  accelerometer.output = nullptr;
  const Clock::Instant begin = clock.now();
  const auto [fault, words] = failure_of([&] { readings().read(1); });
  EXPECT_EQ(fault, Fault::kNoReply);
  EXPECT_THAT(words, HasSubstr("no reading for 2 s"));
  EXPECT_NEAR(to_seconds(clock.now() - begin), 2.0, 0.03);
}

TEST_F(ReadingSourceTest, AStopEndsTheWaitForReadings) {
  accelerometer.output = [this](std::uint64_t k) {
    if (k == 20) stop.request_stop();
    return noisy(k);
  };
  EXPECT_THROW(readings().read(1000), RunInterrupted);
  EXPECT_LT(accelerometer.count, 25U);
}

}  // namespace
}  // namespace abcal
