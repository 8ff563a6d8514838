// Tables of other people, from the file to the end.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>
#include <string>
#include <tuple>
#include <vector>

#include "tests/app/program_fixtures.h"
#include "tests/support/test_data.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;
using Json = nlohmann::json;

class TableCommands : public ProgramTest {
 protected:
  Json json_of(std::vector<std::string> arguments) {
    arguments.emplace_back("--json");
    const ProgramResult result = abcal(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return Json::parse(result.out);
  }
  /// Poses of an item in g below `header`, without names of columns; the last one is off.
  void write_poses(const std::string& name, unsigned seed, const std::string& header = "") {
    std::mt19937_64 engine(seed);
    std::normal_distribution<double> normal(0.0, 1.0);
    std::ostringstream text;
    text.precision(9);
    text << header;
    for (int i = 0; i < 40; ++i) {
      const std::array<double, 3> a{normal(engine), normal(engine), normal(engine)};
      const double size = std::hypot(a[0], a[1], a[2]) / (i == 39 ? 1.2 : 1.0);
      text << 1.02 * a[0] / size + 0.01 + 1e-3 * normal(engine) << ","
           << 0.98 * a[1] / size - 0.02 + 1e-3 * normal(engine) << "," << a[2] / size + 1e-3 * normal(engine)
           << "\n";
    }
    test::write_file(folder / name, text.str());
  }
};

TEST_F(TableCommands, SixPositionsAreTheSameInEveryForm) {
  ABCAL_SHARED_DATA_OR_SKIP(tables, "tables");
  Json plain = json_of({"analyse", (tables / "six_plain.csv").string()});
  EXPECT_EQ(plain.at("estimator"), "norm");
  plain.erase("source");
  for (const char* name : {"six_bom.csv", "six_german.csv"}) {
    Json other = json_of({"analyse", (tables / name).string()});
    other.erase("source");
    EXPECT_EQ(other, plain) << name;
  }
}

TEST_F(TableCommands, ASeriesIsTheSameInSecondsAndMilliseconds) {
  ABCAL_SHARED_DATA_OR_SKIP(tables, "tables");
  const std::string in_s = (tables / "series_s.csv").string(), in_ms = (tables / "series_ms.csv").string();
  Json s = json_of({"analyse", in_s, "--unit", "m/s2"}), ms = json_of({"analyse", in_ms, "--unit", "m/s2"});
  s.erase("source");
  ms.erase("source");
  EXPECT_EQ(s, ms);
  EXPECT_EQ(s.at("poses"), 14);
  for (const Json& each : s.at("intrinsic_sensitivity")) {
    const double expanded =
        each.at("coverage_factor").get<double>() * each.at("standard_uncertainty").get<double>();
    EXPECT_NEAR(expanded, 0.009, 0.004);  // 78 poses of 14 gave 0.002.
  }
  const ProgramResult said = abcal({"analyse", in_ms});
  EXPECT_THAT(said.err, AllOf(HasSubstr("series_ms.csv: read as a time series"),
                              HasSubstr("time in ms (from the spacing of 20): 50 rows a second; 14 poses"),
                              HasSubstr("(--unit)")));
}

TEST_F(TableCommands, APoseThatIsOffIsNamedByItsLine) {
  write_poses("a.csv", 1);
  EXPECT_THAT(test::unwrapped(abcal({"analyse", "a.csv", "--full"}).out), HasSubstr("line 40 ("));
}

TEST_F(TableCommands, WhatTheFileDoesNotSayOptionsDo) {
  write_poses("a.csv", 1);
  EXPECT_EQ(json_of({"analyse", "a.csv", "--unit", "g"}).at("response_unit"), "g");
  // In another order the same sums round otherwise.
  EXPECT_NEAR(
      json_of({"analyse", "a.csv", "--columns", "w,v,u"}).at("offset").at(2).at("value").get<double>(),
      json_of({"analyse", "a.csv"}).at("offset").at(0).at("value").get<double>(), 1e-12);
  const ProgramResult refused = abcal({"analyse", "a.csv", "--columns", "t,x,y,z"});
  EXPECT_THAT(refused.err, HasSubstr("--columns: found 4 names"));
}

TEST_F(TableCommands, PrintedCommandsRepeatTheOptionsThatTheFileNeeds) {
  write_poses("a.csv", 1);
  const std::vector<std::string> options{"--columns=x,y,z", "--unit", "m/s2", "--time-unit", "ms"};
  std::vector<std::string> analyse{"analyse", "a.csv"};
  analyse.insert(analyse.end(), options.begin(), options.end());
  const std::string named = "a.csv --columns=x,y,z --unit=m/s2 --time-unit=ms";
  EXPECT_THAT(abcal(analyse).out,
              AllOf(HasSubstr("abcal analyse " + named + " --full\n"), HasSubstr("File: " + named + "\n")));
  // A line as it is printed is a command.
  std::vector<std::string> full{"analyse"};
  std::istringstream words(named + " --full");
  for (std::string word; words >> word;) full.push_back(word);
  const ProgramResult again = abcal(full);
  EXPECT_EQ(again.exit_code, 0) << again.err;
  EXPECT_THAT(again.err, HasSubstr("readings x, y, z in m/s2"));
}

TEST_F(TableCommands, AMappingIsKeptBesideTheTable) {
  write_poses("a.csv", 1);
  const ProgramResult kept =
      abcal({"analyse", "a.csv", "--unit", "m/s2", "--columns", "x,y,z", "--keep-mapping"});
  EXPECT_EQ(kept.exit_code, 0) << kept.err;
  EXPECT_THAT(kept.err, HasSubstr("kept in a.csv.mapping.toml"));
  EXPECT_THAT(kept.out, HasSubstr("abcal analyse a.csv --full\n"));
  EXPECT_EQ(test::read_file(folder / "a.csv.mapping.toml"),
            "schema = 'abcal.mapping/1'\ncolumns = 'x,y,z'\nunit = 'm/s2'\n");
  for (const char* command : {"analyse", "report", "uncertainty"})
    EXPECT_THAT(abcal({command, "a.csv"}).err,
                HasSubstr("readings x, y, z in m/s2; commas between the cells; columns, unit as "
                          "a.csv.mapping.toml states"))
        << command;
  EXPECT_EQ(json_of({"analyse", "a.csv"}).at("response_unit"), "m/s2");
  // The command line has precedence.
  EXPECT_EQ(json_of({"analyse", "a.csv", "--unit", "g"}).at("response_unit"), "g");
  write_poses("b.csv", 2);
  EXPECT_THAT(abcal({"analyse", "b.csv", "--keep-mapping"}).err, HasSubstr("nothing is stated of b.csv"));
  EXPECT_FALSE(std::filesystem::exists(folder / "b.csv.mapping.toml"));
}

TEST_F(TableCommands, AMappingHasTheShortNameOfAUnitOfTime) {
  write_poses("a.csv", 1);
  const ProgramResult kept = abcal({"analyse", "a.csv", "--time-unit", "Milliseconds", "--keep-mapping"});
  EXPECT_EQ(kept.exit_code, 0) << kept.err;
  EXPECT_THAT(test::read_file(folder / "a.csv.mapping.toml"), HasSubstr("time_unit = 'ms'\n"));
  const ProgramResult again = abcal({"analyse", "a.csv"});
  EXPECT_EQ(again.exit_code, 0) << again.err;
}

TEST_F(TableCommands, AMappingThatIsWrongIsRefusedWithEveryProblem) {
  write_poses("a.csv", 1);
  test::write_file(folder / "a.csv.mapping.toml",
                   "schema = \"abcal.mapping/1\"\nunits = \"g\"\ntime_unit = \"min\"\ncolumns = 3\n");
  const ProgramResult refused = abcal({"analyse", "a.csv"});
  EXPECT_NE(refused.exit_code, 0);
  EXPECT_THAT(refused.err,
              AllOf(HasSubstr("mapping a.csv.mapping.toml: 3 problems"), HasSubstr("line 2"),
                    HasSubstr("\"unit\""), HasSubstr("line 3, time_unit"), HasSubstr("line 4, columns")));
  // Columns that do not fit the table: the message names the mapping.
  test::write_file(folder / "a.csv.mapping.toml", "schema = \"abcal.mapping/1\"\ncolumns = \"t,x,y,z\"\n");
  EXPECT_THAT(abcal({"analyse", "a.csv"}).err, HasSubstr("a.csv.mapping.toml, columns: found 4 names"));
  test::write_file(folder / "a.csv.mapping.toml", "unit = \"g\"\n");
  EXPECT_THAT(abcal({"analyse", "a.csv"}).err, HasSubstr("abcal.mapping/1"));
}

TEST_F(TableCommands, AnEstimatorThatNeedsAnglesNamesTheOneThatDoesNot) {
  write_poses("a.csv", 1);
  write_poses("b.csv", 2);
  for (const char* command : {"analyse", "uncertainty", "compare"}) {
    std::vector<std::string> arguments{command, "a.csv", "--estimator", "joint"};
    if (arguments.front() == "compare") arguments.insert(arguments.begin() + 1, "b.csv");
    const ProgramResult result = abcal(arguments);
    EXPECT_EQ(result.exit_code, 2) << command;
    EXPECT_THAT(result.err, AllOf(HasSubstr("--estimator norm"), HasSubstr("alpha_deg"))) << command;
  }
}

TEST_F(TableCommands, IsReported) {
  write_poses("a.csv", 1);
  const ProgramResult text = abcal({"report", "a.csv", "--unit", "g"});
  EXPECT_EQ(text.exit_code, 0) << text.err;
  EXPECT_THAT(test::unwrapped(text.out),
              AllOf(HasSubstr("read as poses: 40 rows"), HasSubstr("whose angles are not known"),
                    HasSubstr("readings of the poses"), Not(HasSubstr("rotation experiments"))));
  const Json json = json_of({"report", "a.csv", "--unit", "g", "--html", "a.html", "--csv", "b.csv"});
  EXPECT_EQ(json.at("results").size(), 1U);
  EXPECT_THAT(test::read_file(folder / "a.html"), HasSubstr("whose angles are not known"));
  // The averages are read back to the same numbers.
  Json first = json_of({"analyse", "a.csv", "--unit", "g"}), again = json_of({"analyse", "b.csv"});
  for (const char* group : {"intrinsic_sensitivity", "intrinsic_angle", "offset"})
    EXPECT_EQ(first.at(group), again.at(group)) << group;
}

TEST_F(TableCommands, HasAnUncertainty) {
  write_poses("a.csv", 1);
  const Json study = json_of({"uncertainty", "a.csv", "--trials", "2000"});
  EXPECT_EQ(study.at("estimator"), "norm");
  EXPECT_EQ(study.at("trials"), 2000);
  EXPECT_TRUE(study.at("value").at("sensitivity_matrix").at(0).at(0).is_null());
  const double stated = study.at("posterior").at("expanded_uncertainty").at("offset").at(0);
  const Json& interval = study.at("interval").at("offset").at(0);
  EXPECT_NEAR((interval.at(1).get<double>() - interval.at(0).get<double>()) / (2.0 * stated), 1.0, 0.1);
  const ProgramResult text = abcal({"uncertainty", "a.csv", "--trials", "2000"});
  EXPECT_THAT(text.out, AllOf(StartsWith("Uncertainty of the norm result of a.csv"),
                              HasSubstr("Budget of O_"), Not(HasSubstr("s_ux")), Not(HasSubstr(" nan"))));
}

TEST_F(TableCommands, IsComparedAndExported) {
  write_poses("a.csv", 1);
  write_poses("b.csv", 2);
  // Noise alone may take one of nine properties beyond its limit.
  const ProgramResult compared = abcal({"compare", "a.csv", "b.csv", "--unit", "g", "--json"});
  ASSERT_LE(compared.exit_code, 1) << compared.err;
  const Json properties = Json::parse(compared.out).at("pairs").at(0).at("properties");
  EXPECT_EQ(properties.size(), 9U);
  for (const Json& property : properties) EXPECT_LT(std::abs(property.at("e_n").get<double>()), 3.0);
  const ProgramResult without = abcal({"export", "a.csv", "--as", "c", "--unit", "g"});
  EXPECT_EQ(without.exit_code, 2);
  EXPECT_THAT(without.err, HasSubstr("# g_loc.value_mps2"));
  write_poses("c.csv", 1, "# g_loc.value_mps2: 9.81\n# response_unit: g\n");
  for (const char* format : {"json", "csv", "c", "px4", "ardupilot", "ros", "imucal"}) {
    const ProgramResult result = abcal({"export", "c.csv", "--as", format});
    EXPECT_EQ(result.exit_code, 0) << format << result.err;
    EXPECT_FALSE(result.out.empty()) << format;
  }
  EXPECT_THAT(abcal({"export", "c.csv", "--as", "kalibr"}).err,
              HasSubstr("the noise of single readings is not known"));
}

TEST_F(TableCommands, StatedDirectionsGiveTheMatrix) {
  std::mt19937_64 engine(3);
  std::normal_distribution<double> normal(0.0, 1.0);
  std::ostringstream text;
  text.precision(12);
  text << "# pose_uncertainty_deg: 0.06\nup_x,up_y,up_z,ax,ay,az\n";
  for (int i = 0; i < 30; ++i) {
    std::array<double, 3> up{normal(engine), normal(engine), normal(engine)}, real{};
    const double size = std::hypot(up[0], up[1], up[2]);
    for (std::size_t k = 0; k < 3; ++k) real[k] = up[k] / size + 1e-3 * normal(engine);
    const double length = std::hypot(real[0], real[1], real[2]);
    text << up[0] << "," << up[1] << "," << up[2];
    // Turned by 90 degrees about z in its mount.
    text << "," << 1.02 * real[1] / length + 0.01 + 1e-4 * normal(engine) << ","
         << -0.98 * real[0] / length - 0.02 + 1e-4 * normal(engine) << ","
         << real[2] / length + 1e-4 * normal(engine) << "\n";
  }
  test::write_file(folder / "a.csv", text.str());
  const Json result = json_of({"analyse", "a.csv", "--unit", "g"});
  EXPECT_EQ(result.at("estimator"), "norm");
  const Json& matrix = result.at("sensitivity_matrix");
  EXPECT_NEAR(matrix.at(0).at(1).at("value").get<double>(), 1.02, 3e-3);
  EXPECT_NEAR(matrix.at(1).at(0).at("value").get<double>(), -0.98, 3e-3);
  EXPECT_NEAR(matrix.at(0).at(0).at("value").get<double>(), 0.0, 3e-3);
  EXPECT_THAT(abcal({"analyse", "a.csv", "--full"}).out,
              AllOf(HasSubstr("s_ux"), HasSubstr("of the directions:")));
  const ProgramResult reported = abcal({"report", "a.csv", "--unit", "g", "--csv", "b.csv"});
  EXPECT_EQ(reported.exit_code, 0) << reported.err;
  const Json again = json_of({"analyse", "b.csv"});
  for (const char* group : {"sensitivity_matrix", "offset"})
    EXPECT_EQ(result.at(group), again.at(group)) << group;
  EXPECT_THAT(test::unwrapped(abcal({"report", "a.csv", "--unit", "g"}).out),
              HasSubstr("whose directions are stated"));
  const Json study = json_of({"uncertainty", "a.csv", "--unit", "g", "--trials", "2000"});
  for (const auto& [group, i, k] : {std::tuple{"sensitivity_matrix", 0, 2}, {"sensitivity_matrix", 1, 0}}) {
    const Json& interval = study.at("interval").at(group).at(i).at(k);
    const double stated = study.at("posterior").at("expanded_uncertainty").at(group).at(i).at(k);
    EXPECT_NEAR((interval.at(1).get<double>() - interval.at(0).get<double>()) / (2.0 * stated), 1.0, 0.1);
  }
  test::write_file(folder / "c.csv", "# g_loc.value_mps2: 9.81\n" + text.str());
  EXPECT_EQ(abcal({"export", "c.csv", "--unit", "g", "--as", "json", "--frame", "platter"}).exit_code, 0);
}

TEST_F(TableCommands, GetsNoCertificate) {
  write_poses("a.csv", 1);
  const std::string laboratory = (test::source_folder() / "docs/examples/laboratory.toml").string();
  const ProgramResult draft =
      abcal({"report", "a.csv", "--dcc", "a.xml", "--laboratory", laboratory, "--draft"});
  EXPECT_NE(draft.exit_code, 0);
  EXPECT_THAT(draft.err, HasSubstr("no run that is traceable"));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.xml"));
}

TEST_F(TableCommands, OptionsOfTablesAreNotForRuns) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  const ProgramResult result = abcal({"analyse", "a.run", "--unit", "g"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, HasSubstr("a.run is a run file, which states all of it"));
}

}  // namespace
}  // namespace abcal
