#include "protocol/estimators/norm/pose_import.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <sstream>
#include <stdexcept>

namespace abcal {
namespace {

using ::testing::HasSubstr;

ImportedPoses import_text(const std::string& text) {
  std::istringstream in(text);
  return import_poses(in, "test.csv");
}

/// At rest 5 s, moved 1 s, at rest 5 s ...; 100 readings a second.
TimeSeries placed_by_hand(int poses, double noise, unsigned seed, bool knock = false) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, noise);
  TimeSeries series;
  Eigen::Vector3d from(0.0, 0.0, 1.0);
  double t = 0.0;
  for (int pose = 0; pose < poses; ++pose) {
    const Eigen::Vector3d to =
        Eigen::Vector3d(std::sin(1.7 * pose), std::cos(2.3 * pose), std::sin(0.9 * pose + 1.0)).normalized();
    for (int i = 0; i < 600; ++i) {
      Eigen::Vector3d r = i < 500 ? from : Eigen::Vector3d(from + (to - from) * (i - 499) / 100.0);
      if (knock && i >= 250 && i < 255) r.x() += 0.5;
      series.time_s.push_back(t);
      series.reading.push_back(r + Eigen::Vector3d(normal(engine), normal(engine), normal(engine)));
      t += 0.01;
    }
    from = to;
  }
  return series;
}

TEST(StaticStretchTest, FindsEveryPoseAndItsMean) {
  const TimeSeries series = placed_by_hand(12, 1e-3, 1);
  const std::vector<StaticStretch> found = static_stretches(series);
  ASSERT_EQ(found.size(), 12U);
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_GE(found[i].start_s, 6.0 * static_cast<double>(i));
    EXPECT_LE(found[i].end_s, 6.0 * static_cast<double>(i) + 5.0);  // the motion is not in it
    EXPECT_GT(found[i].end_s - found[i].start_s, 2.0);
    EXPECT_NEAR(found[i].mean.norm(), 1.0,
                4e-4);  // 1e-3 / sqrt(300 readings), five of them and the curvature
    EXPECT_NEAR(found[i].spread.x(), 1e-3, 2e-4);
  }
}

TEST(StaticStretchTest, KnockInAPoseDoesNotMakeTwoOfIt) {
  // Both parts of most poses are shorter than the shortest pose.
  const std::vector<StaticStretch> found =
      static_stretches(placed_by_hand(12, 1e-3, 2, true), {.min_length_s = 1.5});
  EXPECT_EQ(found.size(), 12U);
  for (const StaticStretch& stretch : found) EXPECT_LT(stretch.count, stretch.last - stretch.first);
}

TEST(StaticStretchTest, UncertaintyOfTheMeanSeesCorrelatedNoise) {
  std::mt19937_64 engine(3);
  std::normal_distribution<double> normal(0.0, 1e-3);
  TimeSeries white;
  TimeSeries filtered;
  Eigen::Vector3d state = Eigen::Vector3d::Zero();
  for (int i = 0; i < 4000; ++i) {
    const Eigen::Vector3d noise(normal(engine), normal(engine), normal(engine));
    state = 0.9 * state + std::sqrt(1.0 - 0.81) * noise;  // same spread, correlated over ten readings
    white.time_s.push_back(0.01 * i);
    white.reading.push_back(noise);
    filtered.time_s.push_back(0.01 * i);
    filtered.reading.push_back(state);
  }
  const double u_white = static_stretches(white).front().u_mean.norm();
  const double u_filtered = static_stretches(filtered).front().u_mean.norm();
  // Exact ratio sqrt(1.9 / 0.1) = 4.4; eight batches in three outputs know each to 15 %.
  EXPECT_GT(u_filtered / u_white, 2.2);
}

TEST(StaticStretchTest, SaysWhenNothingStandsStill) {
  TimeSeries series;
  for (int i = 0; i < 1000; ++i) {
    series.time_s.push_back(0.01 * i);
    series.reading.emplace_back(std::sin(0.02 * i * i), std::cos(0.03 * i), 0.1 * i);
  }
  EXPECT_THROW(static_stretches(series), std::runtime_error);
  EXPECT_THROW(static_stretches({}), std::runtime_error);
  series.time_s[500] = series.time_s[499];
  EXPECT_THROW(static_stretches(series), std::invalid_argument);
  series.time_s[500] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(static_stretches(series), std::invalid_argument);
  EXPECT_THROW(static_stretches(placed_by_hand(3, 1e-3, 1), {.window_s = 0.0}), std::invalid_argument);
}

TEST(PoseImportTest, ReadsPosesWithAndWithoutUncertainties) {
  const ImportedPoses plain = import_text("# by hand\nr_u,r_v,r_w\n1,2,3\n4,5,6\n");
  ASSERT_EQ(plain.record.dwells.size(), 2U);
  EXPECT_EQ(plain.record.dwells[1].mean, Eigen::Vector3d(4.0, 5.0, 6.0));
  EXPECT_FALSE(plain.record.dwells[0].u_mean.has_value());
  const ImportedPoses with_u = import_text("experiment;r_u;r_v;r_w;u_u;u_v;u_w\r\n1;1;2;3;.1;.2;.3\r\n");
  EXPECT_EQ(*with_u.record.dwells[0].u_mean, Eigen::Vector3d(0.1, 0.2, 0.3));
  EXPECT_EQ(import_text("0.1\t-0.2\t1.02\n  3e-1 +0.4  0.5\n").record.dwells[1].mean,
            Eigen::Vector3d(0.3, 0.4, 0.5));
}

TEST(PoseImportTest, ReadsTimeSeries) {
  const TimeSeries series = placed_by_hand(3, 1e-3, 5);
  std::ostringstream text;
  text << "t,x,y,z\n";
  for (std::size_t i = 0; i < series.time_s.size(); ++i) {
    text << series.time_s[i] << "," << series.reading[i].x() << "," << series.reading[i].y() << ","
         << series.reading[i].z() << "\n";
  }
  const ImportedPoses imported = import_text(text.str());
  EXPECT_TRUE(imported.from_time_series);
  EXPECT_EQ(imported.samples, 1800U);
  EXPECT_EQ(imported.record.dwells.size(), 3U);
  EXPECT_GT(imported.record.dwells[0].count, 100);
}

TEST(PoseImportTest, SaysFileAndLineOfWhatIsWrong) {
  const auto refused = [](const std::string& text, const std::string& words) {
    try {
      import_text(text);
      ADD_FAILURE() << "accepted: " << text;
    } catch (const std::exception& error) {
      EXPECT_THAT(error.what(), HasSubstr("test.csv"));
      EXPECT_THAT(error.what(), HasSubstr(words));
    }
  };
  refused("r_u,r_v,r_w\n1,2,3\n1,2\n", "line 3");
  refused("r_u,r_v,r_w\n1,2,three\n", "\"three\"");
  refused("r_u,r_v,r_w\n1,2,\n", "line 2");
  refused("r_u,r_v,r_w\n1,2,nan\n", "line 2");
  refused("a,b,c\n1,2,3\n", "r_u, r_v, r_w");
  refused("1 2\n3 4\n", "2 columns");
  refused("r_u,r_v,r_w,u_u,u_v,u_w\n1,2,3,-1,1,1\n", "negative");
  refused("", "no numbers");
  EXPECT_THROW(import_poses(std::filesystem::path("no/such/file.csv")), std::runtime_error);
}

}  // namespace
}  // namespace abcal
