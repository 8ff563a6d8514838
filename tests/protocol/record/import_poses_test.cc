#include "protocol/record/import_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <random>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/test_data.h"

namespace abcal {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

ImportedTable import_text(const std::string& text, const TableOptions& options = {}) {
  std::istringstream in(text);
  return import_table(in, "test.csv", options);
}

/// Everything that is wrong with a table; empty: it is read.
std::string refusal(const std::string& text, const TableOptions& options = {}) {
  try {
    import_text(text, options);
  } catch (const TableError& error) {
    EXPECT_THAT(error.what(), HasSubstr("test.csv: "));
    return error.what();
  }
  return {};
}

/// At rest 5 s, moved 1 s, at rest 5 s ...; `rate` readings a second.
TimeSeries placed_by_hand(int poses, double noise, unsigned seed, bool knock = false, int rate = 100) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, noise);
  TimeSeries series;
  Eigen::Vector3d from(0.0, 0.0, 1.0);
  double t = 0.0;
  for (int pose = 0; pose < poses; ++pose) {
    const Eigen::Vector3d to =
        Eigen::Vector3d(std::sin(1.7 * pose), std::cos(2.3 * pose), std::sin(0.9 * pose + 1.0)).normalized();
    for (int i = 0; i < 6 * rate; ++i) {
      Eigen::Vector3d r =
          i < 5 * rate ? from : Eigen::Vector3d(from + (to - from) * (i - 5 * rate + 1) / rate);
      if (knock && i >= 250 && i < 255) r.x() += 0.5;
      series.time_s.push_back(t);
      series.reading.push_back(r + Eigen::Vector3d(normal(engine), normal(engine), normal(engine)));
      t += 1.0 / rate;
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
  EXPECT_TRUE(static_stretches(series).empty());
  EXPECT_TRUE(static_stretches({}).empty());
  series.time_s[500] = series.time_s[499];
  EXPECT_THROW(static_stretches(series), std::invalid_argument);
  series.time_s[500] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(static_stretches(series), std::invalid_argument);
  EXPECT_THROW(static_stretches(placed_by_hand(3, 1e-3, 1), {.window_s = 0.0}), std::invalid_argument);
}

TEST(ImportPosesTest, ReadsPosesWithAndWithoutUncertainties) {
  const ImportedTable plain = import_text("# by hand\nr_u,r_v,r_w\n1,2,3\n4,5,6\n");
  EXPECT_EQ(plain.kind, TableKind::kPoses);
  ASSERT_EQ(plain.record.dwells.size(), 2U);
  EXPECT_EQ(plain.record.estimator, "norm");
  EXPECT_FALSE(has_angles(plain.record));
  EXPECT_EQ(plain.record.dwells[1].mean, Eigen::Vector3d(4.0, 5.0, 6.0));
  EXPECT_EQ(plain.record.dwells[1].first_line, 4U);
  EXPECT_FALSE(plain.record.dwells[0].u_mean.has_value());
  const ImportedTable with_u = import_text("r_u;r_v;r_w;u_u;u_v;u_w\r\n1;2;3;.1;.2;.3\r\n");
  EXPECT_EQ(*with_u.record.dwells[0].u_mean, Eigen::Vector3d(0.1, 0.2, 0.3));
  EXPECT_EQ(import_text("0.1\t-0.2\t1.02\n  3e-1\t+0.4\t0.5\n").record.dwells[1].mean,
            Eigen::Vector3d(0.3, 0.4, 0.5));
}

TEST(ImportPosesTest, AnItemIsTakenForLinearUnlessItsEffectsAreStated) {
  const RunRecord record = import_text("# item_uncertainty.k2: 0,002\n0,1 0,2 0,3\n").record;
  EXPECT_EQ(record.tolerances.k2, 0.002);
  EXPECT_EQ(record.tolerances.k3, 0.0);
  EXPECT_EQ(record.tolerances.drift, 0.0);
  EXPECT_FALSE(record.order_assumed);
  EXPECT_TRUE(import_text("# item_uncertainty.drift: 0.002\n0.1 0.2 0.3\n").record.order_assumed);
}

TEST(ImportPosesTest, KnowsTheNamesOfOthers) {
  const std::string row = "7,0.1,0.2,0.3,4,5,6\n";
  const std::vector<std::string> headers{
      "temp,ax,ay,az,gx,gy,gz\n",
      "index,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z\n",
      "n;Accel X (m/s^2);Accel Y (m/s^2);Accel Z (m/s^2);Gyro X (deg/s);Gyro Y (deg/s);Gyro Z (deg/s)\n",
      "seq,.linear_acceleration.x,.linear_acceleration.y,.linear_acceleration.z,.angular_velocity.x,"
      ".angular_velocity.y,.angular_velocity.z\n",
      "\"id\",\"x\",\"y\",\"z\",\"wx\",\"wy\",\"wz\"\n",
      "# id, x, y, z, mx, my, mz\n"};
  for (const std::string& header : headers) {
    std::string cells = row;
    if (header.find(';') != std::string::npos) std::ranges::replace(cells, ',', ';');
    const ImportedTable imported = import_text(header + cells);
    EXPECT_EQ(imported.kind, TableKind::kPoses) << header;
    ASSERT_EQ(imported.record.dwells.size(), 1U) << header;
    EXPECT_EQ(imported.record.dwells[0].mean, Eigen::Vector3d(0.1, 0.2, 0.3)) << header;
    EXPECT_EQ(imported.record.response_unit, header.starts_with("n;") ? "m/s2" : "R") << header;
  }
  EXPECT_THAT(import_text(headers[0] + row).record.read_as,
              ElementsAre("read as poses: 1 rows, readings ax, ay, az in a unit that is not stated (--unit); "
                          "commas between the cells",
                          "columns that are ignored: temp, gx, gy, gz"));
  EXPECT_EQ(import_text("# by my hand\n1 2 3\n").record.dwells.size(), 1U);
  EXPECT_THAT(refusal("ax,ay,az,x,y,z\n1,2,3,4,5,6\n"),
              AllOf(HasSubstr("several accelerations"), HasSubstr("--columns")));
  EXPECT_THAT(refusal("ax [g],ay [g],az [mg]\n1,2,3\n"), HasSubstr("the unit of the other readings, \"g\""));
}

TEST(ImportPosesTest, OptionsStateWhatTheFileDoesNot) {
  const ImportedTable imported =
      import_text("1,2,3,4,5,6,7\n8,9,10,11,12,13,14\n",
                  {.columns = "-,x,y,z", .unit = "g", .time_unit = "", .topic = ""});
  ASSERT_EQ(imported.record.dwells.size(), 2U);
  EXPECT_EQ(imported.record.dwells[1].mean, Eigen::Vector3d(9.0, 10.0, 11.0));
  EXPECT_EQ(imported.record.response_unit, "g");
  // In place of a header, which is passed over.
  const TableOptions columns{.columns = "z,y,x", .unit = "", .time_unit = "", .topic = ""};
  EXPECT_EQ(import_text("a,b,c\n1,2,3\n", columns).record.dwells[0].mean, Eigen::Vector3d(3.0, 2.0, 1.0));
  EXPECT_THAT(refusal("1,2\n", columns), HasSubstr("3 names; required: at most 2"));
}

TEST(ImportPosesTest, NeighbouringRowsOfOneDirectionAreOnePose) {
  std::mt19937_64 engine(7);
  std::normal_distribution<double> normal(0.0, 0.01);
  std::string text;
  for (const Eigen::Vector3d& pose :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0, 1, 0), Eigen::Vector3d(1, 0, 0)})
    for (int i = 0; i < 50; ++i)
      text += fmt::format("{},{},{}\n", pose.x() + normal(engine), pose.y() + normal(engine),
                          pose.z() + normal(engine));
  const RunRecord record = import_text(text).record;
  ASSERT_EQ(record.dwells.size(), 3U);
  EXPECT_EQ(record.dwells[1].count, 50);
  EXPECT_EQ(record.dwells[1].first_line, 51U);
  EXPECT_EQ(record.dwells[1].last_line, 100U);
  EXPECT_NEAR(record.dwells[1].mean.y(), 1.0, 0.01);  // Seven times 0.01 / sqrt(50).
  EXPECT_THAT(record.read_as.at(1),
              StartsWith("150 rows: neighbouring rows of one direction are one pose, 3 poses"));
  // A slow turn with one jump: the rows within it are poses of their own.
  text.clear();
  for (int i = 0; i < 60; ++i) {
    const double angle = 0.03 * i + (i < 30 ? 0.0 : 1.0);
    text += fmt::format("{},{},0\n", std::cos(angle), std::sin(angle));
  }
  EXPECT_EQ(import_text(text).record.dwells.size(), 60U);
}

/// The series as text, with `in_a_second` units of time in a second.
std::string text_of(const TimeSeries& series, const std::string& header, double in_a_second,
                    const std::string& before = "") {
  std::string text = header;
  for (std::size_t i = 0; i < series.time_s.size(); ++i)
    text += fmt::format("{}{:.10g},{:.6f},{:.6f},{:.6f}\n", before, series.time_s[i] * in_a_second,
                        series.reading[i].x(), series.reading[i].y(), series.reading[i].z());
  return text;
}

TEST(ImportSeriesTest, TheUnitOfTimeIsFoundFromTheSpacing) {
  const TimeSeries series = placed_by_hand(3, 1e-3, 5);
  const ImportedTable in_s = import_text(text_of(series, "t,x,y,z\n", 1.0));
  EXPECT_EQ(in_s.kind, TableKind::kTimeSeries);
  EXPECT_EQ(in_s.rows, 1800U);
  ASSERT_EQ(in_s.record.dwells.size(), 3U);
  EXPECT_GT(in_s.record.dwells[0].count, 100);
  for (const auto& [unit, in_a_second] : {std::pair{"ms", 1e3}, {"us", 1e6}, {"ns", 1e9}}) {
    const ImportedTable other = import_text(text_of(series, "", in_a_second));
    ASSERT_EQ(other.record.dwells.size(), 3U) << unit;
    for (std::size_t i = 0; i < 3; ++i)
      EXPECT_EQ(other.record.dwells[i].mean, in_s.record.dwells[i].mean) << unit;
    EXPECT_THAT(other.record.read_as.at(1),
                StartsWith(fmt::format("time in {} (from the spacing of ", unit)));
    EXPECT_THAT(other.record.read_as.at(1), HasSubstr(": 100 rows a second; 3 poses at rest"));
  }
  // A header, a comment or an option states it; a rate of 1000 a second could be 1 a second.
  const TimeSeries fast = placed_by_hand(2, 1e-3, 5, false, 1000);
  EXPECT_THAT(refusal(text_of(fast, "", 1e3)),
              AllOf(HasSubstr("times that are 1 apart"), HasSubstr("--time-unit")));
  for (const std::string& read :
       {import_text(text_of(fast, "time_ms,x,y,z\n", 1e3)).record.read_as.at(1),
        import_text(text_of(fast, "Time [ms],x,y,z\n", 1e3)).record.read_as.at(1),
        import_text(text_of(fast, "# time_unit: ms\n", 1e3)).record.read_as.at(1),
        import_text(text_of(fast, "", 1e3), {.columns = "", .unit = "", .time_unit = "ms", .topic = ""})
            .record.read_as.at(1)})
    EXPECT_THAT(read, AllOf(StartsWith("time in ms ("), HasSubstr("1000 rows a second")));
}

TEST(ImportSeriesTest, TimesMayBeDates) {
  const TimeSeries series = placed_by_hand(3, 1e-3, 5);
  std::string text = "timestamp,ax,ay,az\n";
  for (std::size_t i = 0; i < series.time_s.size(); ++i)
    text += fmt::format("2026-01-31T23:59:{:05.2f}+01:00,{},{},{}\n", 40.0 + series.time_s[i],
                        series.reading[i].x(), series.reading[i].y(), series.reading[i].z());
  const ImportedTable imported = import_text(text);
  EXPECT_EQ(imported.record.dwells.size(), 3U);
  EXPECT_THAT(imported.record.read_as.at(1), StartsWith("time in s (dates): 100 rows a second"));
}

TEST(ImportSeriesTest, RowsWhoseTimeDoesNotAscendAreLeftOutAndCounted) {
  const TimeSeries series = placed_by_hand(3, 1e-3, 5);
  std::string text = text_of(series, "", 1.0);
  const std::size_t end = text.find("\n1,") + 1;  // Line 101 has the time 1 s.
  text.insert(end, "0.99,5,5,5\n0.5,7,7,7\n");
  const ImportedTable imported = import_text(text);
  EXPECT_EQ(imported.rows, 1800U);
  ASSERT_EQ(imported.record.dwells.size(), 3U);
  EXPECT_LT(imported.record.dwells[0].spread.norm(), 3e-3);
  EXPECT_THAT(imported.record.read_as.at(1),
              HasSubstr("2 rows left out whose time repeats or goes back, the first on line 101"));
  std::string back;
  for (int i = 0; i < 50; ++i) back += fmt::format("{},0,0,1\n", 50 - i);
  EXPECT_THAT(refusal(back),
              AllOf(HasSubstr("49 of 50 rows do not come after the row before, the first on line 2"),
                    HasSubstr("--columns")));
}

TEST(ImportSeriesTest, ARowEachFewSecondsIsRefused) {
  std::string text = "t,x,y,z\n";
  for (int i = 0; i < 40; ++i) text += fmt::format("{},{},0,1\n", 4 * i, i);
  EXPECT_THAT(refusal(text, {.columns = "", .unit = "", .time_unit = "s", .topic = ""}),
              AllOf(HasSubstr("a row each 4 s"), HasSubstr("at least one each 1 s"), HasSubstr("-,x,y,z")));
}

TEST(ImportTableTest, SaysEverythingThatIsWrongAtOnce) {
  EXPECT_THAT(
      refusal("r_u,r_v,r_w\n1,2,3\n1,2\n1,2,three\n1,2,\n1,2,nan\n"),
      AllOf(HasSubstr("line 3: found 2 fields; required: 3"), HasSubstr("line 4, r_w: found \"three\""),
            HasSubstr("line 5, r_w: found nothing"), HasSubstr("line 6, r_w: found \"nan\"")));
  EXPECT_THAT(refusal("a,b,c\n1,2,3\n"), HasSubstr("r_u,r_v,r_w"));
  EXPECT_THAT(refusal("1 2\n3 4\n"), HasSubstr("2 columns without a header"));
  EXPECT_THAT(refusal("r_u,r_v,r_w,u_u,u_v,u_w\n1,2,3,-1,1,1\n"), HasSubstr("a standard uncertainty >= 0"));
  EXPECT_THAT(refusal(""), HasSubstr("found nothing"));
  EXPECT_THAT(refusal("x,y,z\n"), HasSubstr("no rows of numbers"));
  EXPECT_THAT(refusal("0.1,x,2,3\n"), HasSubstr("header"));
  EXPECT_THAT(refusal("# item_uncertainty.k9: 1\n1 2 3\n"), HasSubstr("an effect of this name"));
  std::string bad = "x,y,z\n";
  for (int i = 0; i < 500; ++i) bad += "1,2,a\n";
  EXPECT_THAT(refusal(bad), HasSubstr("and 450 problems more"));
}

// The memory that a file may take is bounded: its rows, the bytes of one of them, its problems.
TEST(ImportTableTest, FilesWithoutAnEndAreRefused) {
  EXPECT_THAT(refusal("x,y,z\n" + std::string(3 * TableReader::kLongestRow, '1')),
              HasSubstr("line 2: found more than 1048576 bytes"));
  EXPECT_THAT(refusal(std::string("\x89PNG\r\n\x1a\n\0\0\0\rIHDR", 16)),
              HasSubstr("line 3: found a byte of zero: no text"));
  EXPECT_THAT(refusal(std::string("\xff\xfe"
                                  "t\0,\0",
                                  6)),
              HasSubstr("UTF-16"));
  EXPECT_THAT(refusal("x,y,z\n1,2,\"3\n" + std::string(100'000, '\n')),
              HasSubstr("line 2: found a quoted field"));
  std::string rows;
  for (int i = 0; i < 4'000'001; ++i) rows += "1 2 3\n";
  EXPECT_THAT(refusal(rows), AllOf(HasSubstr("line 4000001"), HasSubstr("at most 4000000 rows")));
}

TEST(ImportTableTest, TablesOfOthersGiveTheSame) {
  ABCAL_SHARED_DATA_OR_SKIP(folder, "tables");
  const RunRecord plain = import_table(folder / "six_plain.csv").record;
  ASSERT_EQ(plain.dwells.size(), 6U);
  EXPECT_EQ(plain.response_unit, "g");
  EXPECT_EQ(plain.tolerances.orthogonality.deg(), 0.5);
  for (const char* name : {"six_bom.csv", "six_german.csv"}) {
    const RunRecord other = import_table(folder / name).record;
    ASSERT_EQ(other.dwells.size(), 6U) << name;
    EXPECT_EQ(other.response_unit, "g");
    EXPECT_EQ(other.tolerances, plain.tolerances);
    for (std::size_t i = 0; i < 6; ++i) {
      EXPECT_EQ(other.dwells[i].mean, plain.dwells[i].mean);
      EXPECT_EQ(other.dwells[i].u_mean, plain.dwells[i].u_mean);
    }
  }
  const RunRecord in_s = import_table(folder / "series_s.csv").record;
  const RunRecord in_ms = import_table(folder / "series_ms.csv").record;
  ASSERT_EQ(in_s.dwells.size(), 14U);
  ASSERT_EQ(in_ms.dwells.size(), 14U);
  for (std::size_t i = 0; i < 14; ++i) EXPECT_EQ(in_ms.dwells[i].mean, in_s.dwells[i].mean);
}

}  // namespace
}  // namespace abcal
