// Files as other programs and instruments write them: each gives the poses of the plain table with the same
// readings, or is refused. Forms after public descriptions; all numbers are made here.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "protocol/record/import_table.h"
#include "protocol/record/labelled_line.h"

namespace abcal {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Pair;

struct FormRow {
  double t, x, y, z;
};

/// Twelve poses of 5 s at 50 Hz, in m/s2, turned by hand between them.
const std::vector<FormRow>& form_rows() {
  static const std::vector<FormRow> made = [] {
    std::mt19937_64 random(20261130);
    std::normal_distribution<double> noise(0.0, 0.01), hand(0.0, 4.0);
    std::vector<FormRow> list;
    for (int pose = 0; pose < 12; ++pose) {
      const double a = 0.5 * pose, b = 0.9 * pose;
      for (int i = 0; i < 290; ++i) {
        const double moved = i < 250 ? 0.0 : 1.0;
        list.push_back({0.02 * static_cast<double>(list.size()),
                        9.81 * std::cos(a) * std::cos(b) + noise(random) + moved * hand(random),
                        9.81 * std::sin(a) * std::cos(b) + noise(random) + moved * hand(random),
                        9.81 * std::sin(b) + noise(random) + moved * hand(random)});
      }
    }
    return list;
  }();
  return made;
}

ImportedTable read_form(const std::string& text, const TableOptions& options = {}) {
  std::istringstream in(text);
  return import_table(in, "test", options);
}

std::string written_form(const std::string& head, const std::function<std::string(const FormRow&)>& line) {
  std::string text = head;
  for (const FormRow& row : form_rows()) text += line(row) + "\n";
  return text;
}

struct Form {
  std::string name, head;
  std::function<std::string(const FormRow&)> line;
  std::string unit;         ///< As the file states it; "R": it does not.
  double scale = 1.0;       ///< Readings in m/s2 for one of the file.
  bool has_time = true;     ///< Else the rows are in their order.
  double resolution = 0.0;  ///< Steps of the readings of the file, in m/s2.
};
std::ostream& operator<<(std::ostream& out, const Form& form) {
  return out << form.name;
}

/// A time of day, or with a date before it.
std::string clock_of(double t, const std::string& before = "") {
  const int ms = static_cast<int>(std::lround(t * 1000.0));
  return fmt::format("{}10:{:02d}:{:02d}.{:03d}", before, ms / 60'000, ms / 1000 % 60, ms % 1000);
}

const std::vector<Form>& forms() {
  constexpr double kG = 9.80665;
  static const std::vector<Form> all{
      {"Phone",
       "\"Time (s)\",\"Acceleration x (m/s^2)\",\"Acceleration y (m/s^2)\",\"Acceleration z (m/s^2)\"\n",
       [](const FormRow& r) { return fmt::format("{:.6E},{:.8E},{:.8E},{:.8E}", r.t, r.x, r.y, r.z); },
       "m/s2"},
      {"PhoneWithAxesInReverse", "time,seconds_elapsed,z,y,x\n",
       [](const FormRow& r) {
         return fmt::format("{},{:.3f},{},{},{}", 1'700'000'000'000'000'000 + std::llround(r.t * 1e9), r.t,
                            r.z, r.y, r.x);
       },
       "R"},
      {"WearableWithThreeTimes", "epoc (ms),timestamp (-0500),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n",
       [](const FormRow& r) {
         return fmt::format("{},{},{:.3f},{},{},{}", 1'700'000'000'000 + std::llround(r.t * 1e3),
                            clock_of(r.t, "2026-03-01T"), r.t, r.x / kG, r.y / kG, r.z / kG);
       },
       "g", kG},
      {"LoggerWithDatesAndNoHeader", "",
       [](const FormRow& r) {
         return fmt::format("{},{},{},{}", clock_of(r.t, "2026-03-01 "), r.x, r.y, r.z);
       },
       "R"},
      {"LoggerWithRemarksBefore",
       ";Title, a logger\n;Start_time, 2026-03-01, 10:00:00.000\n; SampleRate, 50,Hz\n; Headers, "
       "time,Ax,Ay,Az\n",
       [](const FormRow& r) {
         return fmt::format("{:.3f},{},{},{}", r.t, std::lround(r.x * 1000), std::lround(r.y * 1000),
                            std::lround(r.z * 1000));
       },
       "R", 1e-3, true, 1e-3},
      {"DatasetOfADrone",
       "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m "
       "s^-2],a_RS_S_y [m "
       "s^-2],a_RS_S_z [m s^-2]\n",
       [](const FormRow& r) {
         return fmt::format("{},0.1,0.2,0.3,{},{},{}", 1'700'000'000'000'000'000 + std::llround(r.t * 1e9),
                            r.x, r.y, r.z);
       },
       "m/s2"},
      {"TopicAsText",
       "%time,field.header.seq,field.header.stamp,field.angular_velocity.x,field.angular_velocity.y,"
       "field.angular_velocity.z,field.linear_acceleration.x,field.linear_acceleration.y,field.linear_"
       "acceleration.z\n",
       [](const FormRow& r) {
         const auto ns = 1'700'000'000'000'000'000 + std::llround(r.t * 1e9);
         return fmt::format("{},7,{},0.1,0.2,0.3,{},{},{}", ns, ns, r.x, r.y, r.z);
       },
       "R"},
      {"UnitsInALineOfTheirOwn",
       "\"sep=\t\"\nShimmer_5E2F_Timestamp_Unix_CAL\tShimmer_5E2F_Accel_LN_X_CAL\tShimmer_5E2F_Accel_LN_Y_"
       "CAL\t"
       "Shimmer_5E2F_Accel_LN_Z_CAL\t\nms\tm/(s^2)\tm/(s^2)\tm/(s^2)\t\n",
       [](const FormRow& r) {
         return fmt::format("{:.3f}\t{}\t{}\t{}\t", 1.7e12 + r.t * 1e3, r.x, r.y, r.z);
       },
       "m/s2"},
      {"TenLinesBefore",
       "------------ Data File Created By A Logger v6.13 date format M/d/yyyy at 50 Hz -----------\nSerial "
       "Number: "
       "N1\nStart Time 12:00:00\nStart Date 6/27/2026\nEpoch Period (hh:mm:ss) 00:00:00\nCurrent Memory "
       "Address: "
       "0\n--------------------------------------------------\nAccelerometer X,Accelerometer Y,Accelerometer "
       "Z\n",
       [](const FormRow& r) { return fmt::format("{},{},{}", r.x, r.y, r.z); }, "R", 1.0, false},
      {"SeparatorStated",
       "sep=,\nDeviceTag:,D1\nOutputRate:,50Hz\n\nPacketCounter,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n",
       [](const FormRow& r) {
         return fmt::format("{},{},{},{},0,0,0", std::lround(r.t * 50), r.x, r.y, r.z);
       },
       "R", 1.0, false},
      {"RemarksWithSlashes",
       "// Start Time: Unknown\n// Update Rate: "
       "50.0Hz\nPacketCounter\tYear\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\n",
       [](const FormRow& r) {
         return fmt::format("{:05d}\t\t{}\t{}\t{}\t0\t0\t0", std::lround(r.t * 50), r.x, r.y, r.z);
       },
       "R", 1.0, false},
      {"TimeOfDay",
       "StartTime: 2026-03-01\naddress\tTime(s)\tax(g)\tay(g)\taz(g)\twx(deg/s)\twy(deg/s)\twz(deg/s)\n",
       [](const FormRow& r) {
         return fmt::format("0x50\t{}\t{}\t{}\t{}\t1\t2\t3", clock_of(r.t), r.x / kG, r.y / kG, r.z / kG);
       },
       "g", kG},
      {"Microcontroller", "MPU6050 ready\n",
       [](const FormRow& r) { return fmt::format("AcX = {} | AcY = {} | AcZ = {}", r.x, r.y, r.z); }, "R",
       1.0, false},
      {"SerialMonitor", "",
       [](const FormRow& r) {
         return fmt::format("{} -> X: {}\tY: {}\tZ: {}\tm/s^2", clock_of(r.t), r.x, r.y, r.z);
       },
       "R"},
      {"LinesOfJson", "",
       [](const FormRow& r) {
         return fmt::format(R"({{"millis":{},"ax":{},"ay":{},"az":{}}})", std::lround(r.t * 1e3), r.x, r.y,
                            r.z);
       },
       "R"},
      {"Epoch", "Epoch,Accel_x,Accel_y,Accel_z\n",
       [](const FormRow& r) { return fmt::format("{:.3f},{},{},{}", 1.7e9 + r.t, r.x, r.y, r.z); }, "R"},
      {"German",
       "Zeit [s];Beschleunigung X [m/s\u00b2];Beschleunigung Y [m/s\u00b2];Beschleunigung Z [m/s\u00b2]\n",
       [](const FormRow& r) {
         std::string line = fmt::format("{:.3f};{};{};{}", r.t, r.x, r.y, r.z);
         std::ranges::replace(line, '.', ',');
         return line;
       },
       "m/s2"},
      {"ArrayInNames", "timestamp_us,accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2]\n",
       [](const FormRow& r) { return fmt::format("{},{},{},{}", std::lround(r.t * 1e6), r.x, r.y, r.z); },
       "R"},
  };
  return all;
}

class TablesOfOthersTest : public testing::TestWithParam<Form> {};

TEST_P(TablesOfOthersTest, GiveThePosesOfThePlainTable) {
  const Form& form = GetParam();
  const ImportedTable plain = read_form(written_form("t,r_u,r_v,r_w\n", [](const FormRow& r) {
    return fmt::format("{:.3f},{},{},{}", r.t, r.x, r.y, r.z);
  }));
  ASSERT_EQ(plain.record.dwells.size(), 12U);
  const ImportedTable other = read_form(written_form(form.head, form.line));
  EXPECT_EQ(other.record.response_unit, form.unit) << other.record.read_as.front();
  EXPECT_EQ(other.kind, form.has_time ? TableKind::kTimeSeries : TableKind::kPoses);
  ASSERT_EQ(other.record.dwells.size(), 12U);
  for (std::size_t i = 0; i < 12; ++i) {
    const Eigen::Vector3d found = form.scale * other.record.dwells[i].mean;
    // A mean of some 200 readings with noise of 0.01; rounding of the times may move its ends by a reading,
    // and without a time they are cut off otherwise.
    const double tolerance = form.resolution + (form.has_time ? 5e-4 : 5e-3);
    EXPECT_LT((found - plain.record.dwells[i].mean).norm(), tolerance) << i;
  }
}
INSTANTIATE_TEST_SUITE_P(All, TablesOfOthersTest, testing::ValuesIn(forms()),
                         [](const auto& tested) { return tested.param.name; });

// Seen: readings of a series without a time were a pose each, and U was eighteen times too small.
TEST(TablesOfOthersTest, PosesThatFollowOneAnotherSlowlyStayPoses) {
  std::string text;
  for (int i = 0; i < 400; ++i)
    text +=
        fmt::format("{},{},{}\n", 9.81 * std::cos(0.03 * i), 9.81 * std::sin(0.03 * i) * std::cos(0.011 * i),
                    9.81 * std::sin(0.03 * i) * std::sin(0.011 * i));
  EXPECT_EQ(read_form(text).record.dwells.size(), 400U);
}

TEST(TablesOfOthersTest, TheBeginningIsNamedByItsLine) {
  const ImportedTable imported = read_form("made by hand\non a day\n\nax,ay,az\n1,2,3\n4,5,6\n");
  EXPECT_EQ(imported.record.dwells.size(), 2U);
  EXPECT_THAT(imported.record.read_as.front(), HasSubstr("the table begins on line 4"));
  EXPECT_EQ(imported.record.dwells.front().first_line, 5U);
}

TEST(LabelledLineTest, TakesTheLastWordBeforeEachNumber) {
  EXPECT_THAT(*labelled_numbers("AcX = -4995 | AcY = +161 | AcZ = 1.5e3"),
              ElementsAre(Pair("AcX", "-4995"), Pair("AcY", "+161"), Pair("AcZ", "1.5e3")));
  EXPECT_THAT(*labelled_numbers("10:00:00.5 -> Accel X: 1 m/s^2 Y: 2 Z: 3 m/s^2"),
              ElementsAre(Pair("time", "10:00:00.5"), Pair("X", "1"), Pair("Y", "2"), Pair("Z", "3")));
  EXPECT_THAT(*labelled_numbers(R"({"a_x":0.1, "a_y":-2, "a_z":3})"),
              ElementsAre(Pair("a_x", "0.1"), Pair("a_y", "-2"), Pair("a_z", "3")));
  for (const char* line : {"", "1,2,3", "x: 1 y: 2", "12:30:45", "a: b c: d e: f", "=1=2=3"})
    EXPECT_FALSE(labelled_numbers(line)) << line;
}

}  // namespace
}  // namespace abcal
