// Several runs as one measurement: every command that takes a run takes it, or says why not.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <regex>

#include "protocol/record/sha256.h"
#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

/// Two mountings of one item, measured once for all tests, which work on copies.
constexpr const char* kOperator = "[operator]\nname = \"Operator N. N.\"\n";

class MeasurementTest : public ProgramTest {
 protected:
  static void SetUpTestSuite() {
    made_ = new test::TemporaryFolder;
    BenchText bench;
    bench.protocol += "estimator = \"joint\"\n";
    test::write_file(*made_ / "bench.toml", std::string(kOperator) + bench.text());
    const auto done =
        test::run_program({"mountings", "bench.toml", "--mountings", "2", "-o", "m"}, made_->path());
    ASSERT_EQ(done.exit_code, 0) << done.err;
    EXPECT_THAT(done.err, HasSubstr("measurement written: m.measurement (2 runs)"));
  }
  static void TearDownTestSuite() {
    delete made_;
    made_ = nullptr;
  }
  void SetUp() override { std::filesystem::copy(made_->path(), folder.path()); }

  Json json_of(const std::vector<std::string>& words) {
    const test::ProgramResult result = abcal(words);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return Json::parse(result.out);
  }
  /// The words of a refusal on standard error.
  std::string refusal(const std::vector<std::string>& words) {
    const test::ProgramResult result = abcal(words);
    EXPECT_NE(result.exit_code, 0) << result.out;
    return result.err;
  }
  std::string run_of_other_bench(const std::string& from, const std::string& to) {
    BenchText bench;
    std::string text = bench.text();
    text.replace(text.find(from), from.size(), to);
    test::write_file(folder / "other.toml", text);
    const test::ProgramResult done = abcal({"run", "other.toml", "-o", "other.run"});
    EXPECT_EQ(done.exit_code, 0) << done.err;
    return "other.run";
  }

  /// Measures rate-N.run at 60 and 20 degrees/s.
  void run_at_rate(int number, const std::string& matrix, const std::string& more) {
    constexpr const char* kText = R"([bench]
g_loc_mps2 = 9.81
[item]
serial_number = "A1"
[stage]
driver = "simulated"
[accelerometer]
driver = "simulated"
rate_hz = 100.0
[protocol]
estimator = "joint"
motion = "constant_rate"
rate_deg_per_s = [60, 20]
acceleration_deg_per_s2 = 200.0
steps = 36
step_deg = 10.0
check_poses = false
settle_s = "auto"
dwell_readings = 100
[simulation]
seed = 11
run = {0}
sensitivity_matrix = {1}
offset = [0.01, -0.02, 0.005]
noise = 1e-4
low_pass_hz = 5.0
group_delay_s = 0.02
{2}[simulation.x]
speed_deg_per_s = 60.0
acceleration_deg_per_s2 = 200.0
step_error_deg = 0.003
[simulation.z]
speed_deg_per_s = 60.0
acceleration_deg_per_s2 = 200.0
step_error_deg = 0.003
)";
    test::write_file(folder / "rate.toml",
                     kOperator + fmt::format(fmt::runtime(kText), number, matrix, more));
    const test::ProgramResult done = abcal({"run", "rate.toml", "-o", fmt::format("rate-{}.run", number)});
    EXPECT_EQ(done.exit_code, 0) << done.err;
  }
  /// Measures tray-N.run of two items, which change their places from run to run.
  void run_tray(int number) {
    std::string text = "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n" +
                       quick_calibration(fmt::format("seed = 11\nrun = {}\n", number));
    for (const int k : {1 + (number + 1) % 2, 1 + number % 2})
      text += fmt::format(
          "[[item]]\nmaker = \"MicroStrain\"\nmodel = \"3DM-GV7-AR\"\nserial_number = \"SN-{0}\"\n"
          "[item.accelerometer]\ndriver = \"microstrain_mip\"\nport = \"simulated\"\nrate_hz = 200.0\n"
          "serial_number = \"SN-{0}\"\n",
          k);
    test::write_file(folder / "tray.toml", kOperator + text);
    const test::ProgramResult done = abcal({"run", "tray.toml", "-o", fmt::format("tray-{}.run", number)});
    ASSERT_EQ(done.exit_code, 0) << done.err;
  }

 private:
  static inline test::TemporaryFolder* made_ = nullptr;
};

TEST_F(MeasurementTest, EveryRoadGivesTheSameResult) {
  const Json result = json_of({"analyse", "m.measurement", "--json"});
  EXPECT_EQ(result.at("verdict"), "usable") << result.at("why");
  EXPECT_TRUE(result == json_of({"analyse", "m-2.run", "m-1.run", "--json"}));
  ASSERT_EQ(result.at("series").size(), 2U);
  EXPECT_THAT(result.at("diagnostics").at("notes").dump(), HasSubstr("taken to be the same in all runs"));
  for (const Json& run : result.at("series"))
    for (const char* estimator : {"joint", "abc", "norm"})
      EXPECT_LT(run.at("alone").at(estimator).at("largest_difference_in_u").get<double>(), 4.0);
  const Json offset = result.at("offset").at(1);
  const double value = offset.at("value").get<double>(), u = offset.at("standard_uncertainty").get<double>();
  EXPECT_LT(std::abs(value - 0.02), 4.0 * u);
  const Json alone = json_of({"analyse", "m-1.run", "--json"});
  EXPECT_LT(u, 0.7 * alone.at("offset").at(1).at("standard_uncertainty").get<double>());

  const Json report = json_of({"report", "m.measurement", "--json"});
  EXPECT_EQ(report.at("results").at(0).at("offset"), result.at("offset"));
  EXPECT_EQ(report.at("runs").at(1).at("sha256"), sha256_of_file(folder / "m-2.run"));
  EXPECT_TRUE(report.at("run").is_null());
  EXPECT_TRUE(report.at("budget").is_object());
  const Json exported = json_of({"export", "m.measurement", "--as", "json"});
  EXPECT_THAT(exported.dump(), HasSubstr(offset.at("value").dump()));
  const Json study = json_of({"uncertainty", "m.measurement", "--trials", "8", "--json"});
  EXPECT_EQ(study.at("posterior").at("standard_uncertainty").at("offset").at(1),
            offset.at("standard_uncertainty"));
  EXPECT_EQ(study.at("cases").at(0).at("trials"), 8);
  EXPECT_EQ(json_of({"verify", "m.measurement", "--json"}).at("good"), true);
  EXPECT_THAT(abcal({"analyse", "m.measurement", "--full"}).out,
              AllOf(HasSubstr("m-2.run: turned by 90 degrees about X; usable"), HasSubstr("abc    alone")));
}

TEST_F(MeasurementTest, TheReadingsAreWrittenRunByRun) {
  const test::ProgramResult done = abcal({"report", "m.measurement", "--csv", "data.csv"});
  ASSERT_EQ(done.exit_code, 0) << done.err;
  for (const char* run : {"1", "2"}) {
    const Json of_file =
        json_of({"analyse", fmt::format("data-{}.csv", run), "--estimator", "abc", "--json"});
    const Json of_run = json_of({"analyse", fmt::format("m-{}.run", run), "--estimator", "abc", "--json"});
    EXPECT_EQ(of_file.at("offset"), of_run.at("offset")) << run;
  }
  EXPECT_THAT(refusal({"report", "m.measurement", "--csv", "data.csv"}), HasSubstr("data-1.csv"));
}

TEST_F(MeasurementTest, TheReportNamesEachRunAndItsFile) {
  ASSERT_EQ(abcal({"report", "m.measurement", "--html", "m.html"}).exit_code, 0);
  std::ifstream file(folder / "m.html");
  const std::string page{std::istreambuf_iterator<char>(file), {}};
  EXPECT_THAT(page, AllOf(HasSubstr(sha256_of_file(folder / "m-1.run")),
                          HasSubstr(sha256_of_file(folder / "m-2.run")),
                          HasSubstr(sha256_of_file(folder / "m.measurement")),
                          HasSubstr("turned by 90 degrees about X"), HasSubstr("Simulated")));
}

TEST_F(MeasurementTest, TeachesTheStageAndIsComparedWithAnotherRun) {
  const test::ProgramResult learned = abcal({"stage", "learn", "m.measurement", "-o", "bench.stage"});
  EXPECT_EQ(learned.exit_code, 0) << learned.err;
  EXPECT_THAT(
      refusal({"combine", "m-1.run", "m-2.run", "--stage-record", "bench.stage", "-o", "x.measurement"}),
      HasSubstr("taught the record of the stage"));
  EXPECT_FALSE(std::filesystem::exists(folder / "x.measurement"));
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "third.run"}).exit_code, 0);
  const Json comparison = json_of({"compare", "m.measurement", "third.run", "--json"});
  EXPECT_THAT(comparison.dump(), HasSubstr("m.measurement"));
  // A run of the measurement agrees with it by its own readings.
  EXPECT_THAT(refusal({"compare", "m.measurement", "m-2.run"}), HasSubstr("required: each measurement once"));
}

TEST_F(MeasurementTest, FilesAreFoundByTheirHashAndWhatIsMissingIsNamed) {
  std::filesystem::create_directory(folder / "moved");
  for (const char* name : {"m.measurement", "m-1.run"})
    std::filesystem::rename(folder / name, folder / "moved" / name);
  EXPECT_THAT(refusal({"analyse", "moved/m.measurement"}),
              AllOf(HasSubstr("m-2.run is not there, nor is another file with its SHA-256"),
                    Not(HasSubstr("m-1.run is"))));
  std::filesystem::rename(folder / "m-2.run", folder / "moved/renamed.run");
  EXPECT_EQ(abcal({"analyse", "moved/m.measurement"}).exit_code, 0);
  std::filesystem::permissions(folder / "moved/m-1.run", std::filesystem::perms::owner_write,
                               std::filesystem::perm_options::add);
  std::ofstream(folder / "moved/m-1.run", std::ios::app) << "x";
  EXPECT_THAT(refusal({"verify", "moved/m.measurement"}),
              HasSubstr("m-1.run was changed after the measurement"));
}

TEST_F(MeasurementTest, ChangedAnalysesAreFound) {
  ASSERT_TRUE(std::filesystem::exists(folder / "m.measurement.results"));
  std::filesystem::remove(folder / "m.measurement.results");
  EXPECT_EQ(abcal({"verify", "m.measurement"}).exit_code, 0);
  test::write_file(folder / "m.measurement", test::read_file(folder / "m.measurement") + "\n");
  EXPECT_EQ(abcal({"analyse", "m.measurement"}).exit_code, 0);
  test::write_file(folder / "m.measurement", test::read_file(folder / "m.measurement") + "\n");
  // Its results belong to the file as it was.
  EXPECT_THAT(abcal({"analyse", "m.measurement"}).err, HasSubstr("one of the two was changed"));
}

// A run of 90 s in two mountings, the second one turned by 90 degrees about X.
TEST_F(MeasurementTest, RunsAtConstantRateAreAMeasurementToo) {
  run_at_rate(1, "[[1.0, 0.004, -0.003], [0.006, 1.0, 0.008], [-0.011, 0.006, 1.0]]",
              "position_u_mm = [10, 5, 20]\n");
  run_at_rate(2, "[[1.0, -0.003, -0.004], [0.006, 0.008, -1.0], [-0.011, 1.0, -0.006]]",
              "position_u_mm = [20, -15, 4]\n");
  const Json both = json_of({"combine", "rate-1.run", "rate-2.run", "-o", "rate.measurement", "--json"});
  EXPECT_EQ(both.at("verdict"), "usable") << both.at("why");
  EXPECT_EQ(both.at("series").at(1).at("mounting"), "turned by 90 degrees about -X");
  const Json& alone = both.at("series").at(1).at("alone");
  ASSERT_TRUE(alone.contains("abc")) << alone.dump();
  EXPECT_LT(alone.at("abc").at("largest_difference_in_u").get<double>(), 3.0);
  const Json one = json_of({"analyse", "rate-1.run", "--json"});
  for (std::size_t j = 0; j < 3; ++j) {
    const Json &offset = both.at("offset").at(j), &s = both.at("intrinsic_sensitivity").at(j);
    const double u = offset.at("standard_uncertainty").get<double>();
    EXPECT_LT(u, 0.7 * one.at("offset").at(j).at("standard_uncertainty").get<double>());
    EXPECT_LT(std::abs(offset.at("value").get<double>() - std::array{0.01, -0.02, 0.005}[j]), 4.0 * u);
    EXPECT_LT(s.at("standard_uncertainty").get<double>(),
              0.8 * one.at("intrinsic_sensitivity").at(j).at("standard_uncertainty").get<double>());
  }
  EXPECT_EQ(abcal({"report", "rate.measurement", "--html", "rate.html"}).exit_code, 0);
  EXPECT_EQ(abcal({"verify", "rate.measurement"}).exit_code, 0);
}

TEST_F(MeasurementTest, EachItemOfRunsWithSeveralHasItsResult) {
  for (const int number : {1, 2}) run_tray(number);
  const Json tray = json_of({"combine", "tray-1.run", "tray-2.run", "-o", "tray.measurement", "--json"});
  ASSERT_EQ(tray.at("items").size(), 2U);
  for (std::size_t k = 0; k < 2; ++k) {
    const Json& item = tray.at("items").at(k);
    EXPECT_EQ(item.at("result").at("series").size(), 2U);
    EXPECT_EQ(item.at("serial_number"), fmt::format("SN-{}", k + 1));
    EXPECT_EQ(item.at("in_common_fit"), true) << item.at("why_not_in_common_fit");
    EXPECT_TRUE(item.at("result") ==
                json_of({"analyse", "tray.measurement", "--item", fmt::format("{}", k + 1), "--json"}));
  }
  const Json report = json_of({"report", "tray.measurement", "--item", "2", "--json"});
  EXPECT_EQ(report.at("item").at("serial_number"), "SN-2");
  EXPECT_EQ(report.at("results").at(0).at("offset"), tray.at("items").at(1).at("result").at("offset"));
  EXPECT_THAT(refusal({"report", "tray.measurement", "--json"}), HasSubstr("--item 1 to 2"));
  // Each item has its own page, the same as if it were asked for alone.
  ASSERT_EQ(abcal({"report", "tray.measurement", "--html", "x.html"}).exit_code, 0);
  EXPECT_FALSE(std::filesystem::exists(folder / "x.html"));
  for (const std::string k : {"1", "2"}) {
    ASSERT_EQ(abcal({"report", "tray.measurement", "--item", k, "--html", "alone.html", "--force"}).exit_code,
              0);
    const auto but_for_when = [](const std::string& page) {
      constexpr const char* kWhen =
          R"(@bottom-left \{[^}]*\}|\d{4}-\d\d-\d\d \d\d:\d\d(:\d\d)?)";  // In the margin it is escaped.
      return std::regex_replace(page, std::regex(kWhen), "");
    };
    EXPECT_EQ(but_for_when(test::read_file(folder / ("x-item-" + k + ".html"))),
              but_for_when(test::read_file(folder / "alone.html")));
  }
  EXPECT_EQ(abcal({"verify", "tray.measurement"}).exit_code, 0);
  EXPECT_THAT(refusal({"combine", "tray-1.run", "m-1.run", "-o", "x.measurement"}),
              HasSubstr("required: runs of one item, or of the same several"));
}

/// Standard uncertainty of an element of the sensitivity matrix.
double u_of(const Json& result, std::size_t row, std::size_t column) {
  return result.at("sensitivity_matrix").at(row).at(column).at("standard_uncertainty").get<double>();
}

TEST_F(MeasurementTest, RunsWithSeveralItemsTeachARecordAndUseOne) {
  for (const int number : {1, 2, 3}) run_tray(number);
  ASSERT_EQ(abcal({"stage", "learn", "tray-1.run", "tray-2.run", "-o", "tray.stage"}).exit_code, 0);
  const Json record = json_of({"stage", "show", "tray.stage", "--json"});
  EXPECT_EQ(record.at("learnings").at(0).at("runs").size(), 4U) << "two items in two runs";
  EXPECT_THAT(abcal({"stage", "show", "tray.stage"}).out, HasSubstr("Learned: 2 runs in 1 learning"));
  EXPECT_EQ(abcal({"stage", "check", "tray.stage", "tray-3.run"}).exit_code, 0);
  const Json without = json_of({"analyse", "tray-3.run", "--json"});
  const Json with = json_of({"analyse", "tray-3.run", "--stage-record", "tray.stage", "--json"});
  for (std::size_t k = 0; k < 2; ++k) {
    const Json& item = with.at("items").at(k);
    EXPECT_EQ(item.at("in_common_fit"), true) << item.at("why_not_in_common_fit");
    EXPECT_TRUE(item.at("result").contains("stage_record"));
    // Runs in one mounting teach angles, not tilts.
    double least = 1.0;
    for (std::size_t row = 0; row < 3; ++row)
      for (std::size_t column = 0; column < 3; ++column)
        least = std::min(least, u_of(item.at("result"), row, column) /
                                    u_of(without.at("items").at(k).at("result"), row, column));
    EXPECT_LT(least, 0.9);
  }
  EXPECT_THAT(refusal({"analyse", "tray-1.run", "--stage-record", "tray.stage"}), HasSubstr("taught"));
}

/// One way of measuring: its file, a second one measured in the same way, and the item that is asked for.
struct Way {
  std::string name, file, other;
  std::vector<std::string> item = {};
};
/// One use of a file. A use that a way refuses says why.
struct Use {
  std::string name;
  std::function<std::vector<std::string>(const Way&)> words;
  std::map<std::string, std::string> refused = {};
};

// The table of docs/measurements.md: each way of measuring, and each use of it.
TEST_F(MeasurementTest, EveryWayHasEveryRoadOrSaysWhyNot) {
  constexpr const char* kAsItIs = "[[1.0, 0.004, -0.003], [0.006, 1.0, 0.008], [-0.011, 0.006, 1.0]]";
  for (const int number : {1, 2}) {
    BenchText faces;
    faces.protocol += "estimator = \"joint\"\nfaces = 2\n";
    faces.simulation += fmt::format("run = {}\n", number);
    test::write_file(folder / "faces.toml", kOperator + faces.text());
    ASSERT_EQ(abcal({"run", "faces.toml", "-o", fmt::format("faces-{}.run", number)}).exit_code, 0);
    run_at_rate(number, kAsItIs, "");
    run_tray(number);
  }
  for (const char* name : {"rate", "tray"})
    ASSERT_EQ(abcal({"combine", fmt::format("{}-1.run", name), fmt::format("{}-2.run", name), "-o",
                     fmt::format("{}.measurement", name)})
                  .exit_code,
              0);
  ASSERT_EQ(abcal({"stage", "learn", "m.measurement", "-o", "m.stage"}).exit_code, 0);
  for (const int number : {3, 4}) {
    BenchText with_record;
    with_record.protocol += "estimator = \"joint\"\n";
    with_record.simulation += fmt::format("run = {}\n", number);
    std::string text = with_record.text();
    text.insert(text.find("[stage]\n") + 8, "record = \"m.stage\"\n");
    test::write_file(folder / "record.toml", kOperator + text);
    const test::ProgramResult done =
        abcal({"run", "record.toml", "-o", fmt::format("record-{}.run", number)});
    ASSERT_EQ(done.exit_code, 0) << done.err;
  }
  std::filesystem::copy_file(test::source_folder() / "docs/examples/laboratory.toml", folder / "lab.toml");

  const std::vector<Way> ways{{"steps", "m-1.run", "m-2.run"},
                              {"two faces", "faces-1.run", "faces-2.run"},
                              {"constant rate", "rate-1.run", "rate-2.run"},
                              {"several items", "tray-1.run", "tray-2.run#2", {"--item", "1"}},
                              {"several runs", "m.measurement", "record-3.run"},
                              {"several runs at constant rate", "rate.measurement", ""},
                              {"several runs of several items", "tray.measurement", "", {"--item", "2"}},
                              {"with a record", "record-3.run", "record-4.run"}};
  const auto on = [](std::vector<std::string> words, const Way& way, std::vector<std::string> more = {}) {
    words.push_back(way.file);
    words.insert(words.end(), way.item.begin(), way.item.end());
    words.insert(words.end(), more.begin(), more.end());
    return words;
  };
  const std::string several = "has the joint result alone";
  const std::vector<Use> uses{
      {"analyse", [&](const Way& way) { return on({"analyse"}, way, {"--json"}); }},
      {"published protocol",
       [&](const Way& way) {
         return on({"analyse"}, way, {"--estimator", "abc"});
       },
       {{"several runs", several},
        {"several runs at constant rate", several},
        {"several runs of several items", several}}},
      {"uncertainty",
       [&](const Way& way) {
         return on({"uncertainty"}, way, {"--trials", "6", "--json"});
       }},
      {"readings",
       [&](const Way& way) {
         return on({"report"}, way, {"--csv-raw", "x.csv", "--hdf5", "x.h5", "--force"});
       }},
      {"report",
       [&](const Way& way) {
         return on({"report"}, way, {"--html", "x.html", "--force"});
       }},
      {"draft of a certificate",
       [&](const Way& way) {
         return on({"report"}, way, {"--dcc", "x.xml", "--laboratory", "lab.toml", "--draft", "--force"});
       }},
      {"export",
       [&](const Way& way) {
         return on({"export"}, way, {"--as", "json"});
       }},
      {"verify",
       [&](const Way& way) {
         return std::vector<std::string>{"verify", way.file};
       }},
      {"compare",
       [&](const Way& way) {
         return way.other.empty()
                    ? std::vector<std::string>{"analyse", way.file}
                    : std::vector<std::string>{"compare", way.file + (way.item.empty() ? "" : "#1"),
                                               way.other, "--json"};
       }},
      {"teach a record",
       [&](const Way& way) {
         std::filesystem::remove(folder / "x.stage");
         return std::vector<std::string>{"stage", "learn", way.file, "-o", "x.stage"};
       },
       {{"constant rate", "constant rates"}, {"several runs at constant rate", "constant rates"}}},
  };
  for (const Way& way : ways)
    for (const Use& use : uses) {
      SCOPED_TRACE(way.name + ": " + use.name);
      const test::ProgramResult done = abcal(use.words(way));
      const auto refused = use.refused.find(way.name);
      if (refused == use.refused.end()) {
        EXPECT_EQ(done.exit_code, 0) << done.err << done.out.substr(0, 400);
        continue;
      }
      EXPECT_NE(done.exit_code, 0) << done.out.substr(0, 400);
      EXPECT_THAT(done.err + done.out, HasSubstr(refused->second));
    }
}

TEST_F(MeasurementTest, BadInputIsRefusedAndNothingIsWrittenOver) {
  EXPECT_EQ(abcal({"combine", "m-1.run", "m-2.run", "-o", "m.measurement"}).exit_code, 0);  // The same again.
  EXPECT_THAT(refusal({"combine", "m-1.run", "m-1.run", "-o", "x.measurement"}), HasSubstr("is given twice"));
  EXPECT_THAT(refusal({"combine", "m-1.run", "-o", "x.measurement"}), HasSubstr("required: two or more"));
  EXPECT_THAT(refusal({"combine", "m-1.run", "m-2.run", "-o", "bench.toml"}),
              HasSubstr("nothing is written over"));
  const std::string other = run_of_other_bench("g_loc_mps2 = 9.81", "g_loc_mps2 = 9.80");
  EXPECT_THAT(refusal({"combine", "m-1.run", "m-2.run", other, "-o", "x.measurement"}),
              AllOf(HasSubstr("m-1.run: local gravity is 9.81 m/s2; in other.run it is 9.8 m/s2"),
                    HasSubstr("m-2.run: local gravity")));
  EXPECT_THAT(refusal({"analyse", "m.measurement", "--estimator", "abc"}), HasSubstr("m-2.run"));
  for (const char* schema :
       {"{\"schema\": \"abcal.measurement/1\"}", "{\"schema\": \"abcal.measurement/2\"}"}) {
    test::write_file(folder / "x.measurement", schema);
    EXPECT_THAT(refusal({"analyse", "x.measurement"}), HasSubstr("required"));
  }
  EXPECT_THAT(refusal({"level", "bench.toml", "--sensitivity", "m.measurement"}),
              HasSubstr("is a measurement of several runs"));
}

}  // namespace
}  // namespace abcal
