// abcal simulate and abcal uncertainty as their users call them: options, files written, several processes.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;
using Json = nlohmann::json;

// Averaged readings of an accelerometer (s row by row over 1 g_loc, O) on a perfect stage, 12 angles of 30
// degrees: docs/theory/model.md, written down once more.
std::string perfect_run(const std::array<double, 9>& s, const std::array<double, 3>& offset) {
  std::string csv = "# protocol.estimator: abc\nexperiment,n,alpha_deg,r_u,r_v,r_w\n";
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 0; n < 12; ++n) {
      const double alpha = 30.0 * n * std::acos(-1.0) / 180.0;
      const double sine = std::sin(alpha), cosine = std::cos(alpha);
      // The reaction to gravity in the platter's frame: about X, about -Y, about Z.
      const std::array<double, 3> a = experiment == 1   ? std::array{0.0, sine, cosine}
                                      : experiment == 2 ? std::array{-sine, 0.0, cosine}
                                                        : std::array{-sine, -cosine, 0.0};
      std::ostringstream row;
      row.precision(17);
      row << experiment << ',' << n + 1 << ',' << 30 * n;
      for (std::size_t j = 0; j < 3; ++j)
        row << ',' << s[3 * j] * a[0] + s[3 * j + 1] * a[1] + s[3 * j + 2] * a[2] + offset[j];
      csv += row.str() + "\n";
    }
  }
  return csv;
}

class StudyCommands : public testing::Test {
 protected:
  ProgramResult abcal(const std::vector<std::string>& arguments) {
    return test::run_program(arguments, folder.path());
  }
  Json json_of(std::vector<std::string> arguments) {
    arguments.emplace_back("--json");
    const ProgramResult result = abcal(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return Json::parse(result.out);
  }
  void write_run() {
    test::write_file(folder / "run.csv",
                     perfect_run({1.1, 0.02, -0.03, 0.01, 0.9, 0.04, -0.02, 0.03, 1.0}, {0.1, -0.2, 0.3}));
  }

  test::TemporaryFolder folder;
};

TEST_F(StudyCommands, OptionsThatAStudyDoesNotReadAreRefusedAtOnce) {
  const ProgramResult robustness =
      abcal({"simulate", "robustness", "--trials", "10", "--step", "0.01", "--csv", "a.csv"});
  EXPECT_EQ(robustness.exit_code, 2);
  EXPECT_THAT(robustness.err, AllOf(HasSubstr("found --trials, --step, --csv"), HasSubstr("--benches")));
  const ProgramResult joint = abcal({"simulate", "joint", "--trials", "2", "--scale"});
  EXPECT_EQ(joint.exit_code, 2);
  EXPECT_THAT(joint.err, HasSubstr("found --scale;"));
}

TEST_F(StudyCommands, AnAccelerometerFromAFileIsTheOneThatIsSimulated) {
  test::write_file(folder / "aut.json",
                   R"({"sensitivity_matrix": [[2, 0, 0], [0, 3, 0], [0, 0, 4]], "offset": [0, 0, 0]})");
  test::write_file(folder / "aut.txt", "# s row by row, then O\n2 0 0\n0 3 0\n0 0 4\n0 0 0\n");
  const Json json = json_of({"simulate", "3", "--aut", "aut.json"});
  const Json text = json_of({"simulate", "3", "--aut", "aut.txt"});
  EXPECT_EQ(json.at("cases"), text.at("cases"));
  // Xz alone turns the readings of experiment 3's row: the errors scale with the row of s.
  const Json unit = json_of({"simulate", "3"});
  const auto error = [](const Json& study, std::size_t row, std::size_t column) {
    return study.at("cases").at(0).at("error").at("sensitivity_matrix").at(row).at(column).get<double>();
  };
  EXPECT_NEAR(error(json, 0, 1), 2.0 * error(unit, 0, 1), 1e-8);
  EXPECT_NEAR(error(json, 1, 0), 3.0 * error(unit, 1, 0), 1e-8);
}

TEST_F(StudyCommands, AnAccelerometerFileThatCannotBeUsedIsRefused) {
  const auto refusal = [&](const std::string& name, const std::string& text) {
    test::write_file(folder / name, text);
    const ProgramResult result = abcal({"simulate", "3", "--aut", name});
    EXPECT_EQ(result.exit_code, 2);
    EXPECT_EQ(result.out, "");
    return result.err;
  };
  EXPECT_THAT(refusal("eleven.txt", "1 0 0 0 1 0 0 0 1 0 0"), HasSubstr("11 numbers, 12 are needed"));
  EXPECT_THAT(refusal("word.txt", "1 0 0 0 one 0 0 0 1 0 0 0"), HasSubstr("\"one\" is not a number"));
  EXPECT_THAT(refusal("nan.txt", "1 0 0 0 nan 0 0 0 1 0 0 0"), HasSubstr("not finite"));
  EXPECT_THAT(refusal("rows.json", R"({"sensitivity_matrix": [[1, 0]], "offset": [0, 0, 0]})"),
              HasSubstr("rows.json"));
  EXPECT_THAT(abcal({"simulate", "3", "--aut", "none.txt"}).err, HasSubstr("none.txt"));
}

TEST_F(StudyCommands, TheTableOfAStudyIsWrittenAsCsv) {
  const Json study = json_of({"simulate", "6", "--csv", "out.csv"});
  std::istringstream csv(test::read_file(folder / "out.csv"));
  std::string line;
  std::getline(csv, line);
  EXPECT_THAT(line, StartsWith("case,output,unit,error"));
  std::size_t rows = 0;
  while (std::getline(csv, line)) ++rows;
  EXPECT_EQ(rows, 18 * study.at("cases").size());
  const ProgramResult result = abcal({"simulate", "6", "--csv", "no/such/folder.csv"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("no/such/folder.csv"));
}

TEST_F(StudyCommands, FiguresAreWrittenOrTheMissingPlotterIsNamed) {
  const ProgramResult drawn = abcal({"simulate", "2", "--figures", "figures"});
  ASSERT_EQ(drawn.exit_code, 0) << drawn.err;
  for (const char* name : {"figure3.svg", "figure4.svg"})
    EXPECT_THAT(test::read_file(folder / "figures" / name), HasSubstr("<svg"));
  for (const char* name : {"figure3.png", "figure4.png"})
    EXPECT_THAT(test::read_file(folder / "figures" / name), StartsWith("\x89PNG"));

  EXPECT_THAT(abcal({"simulate", "3", "--figures", "figures"}).err,
              HasSubstr("figures 1 and 2 belong to set 1"));

  const std::string path = std::getenv("PATH");
  ::setenv("PATH", folder.path().c_str(), 1);
  const ProgramResult missing = abcal({"simulate", "2", "--figures", "figures"});
  ::setenv("PATH", path.c_str(), 1);
  EXPECT_EQ(missing.exit_code, 1);
  EXPECT_THAT(missing.err, AllOf(HasSubstr("gnuplot"), HasSubstr("not installed")));
}

TEST_F(StudyCommands, TolerancesOnTheCommandLineReplaceTheRunsOwn) {
  write_run();
  const std::vector<std::string> exact{"uncertainty",    "run.csv", "--trials", "2000",  "--alignment", "0",
                                       "--initial-turn", "0",       "--step",   "0.002", "--zero",      "0"};
  const auto u = [](const Json& study) {  // type B of s_uy
    return study.at("cases")
        .at(0)
        .at("standard_deviation")
        .at("sensitivity_matrix")
        .at(0)
        .at(1)
        .get<double>();
  };
  const Json small = json_of(exact);
  std::vector<std::string> arguments = exact;
  arguments[9] = "0.004";
  const Json twice = json_of(arguments);
  // s_uy: to first order proportional; the second-order part is 0.004 degrees = 7e-5 relative.
  EXPECT_NEAR(u(twice) / u(small), 2.0, 2e-3);
  arguments[9] = "-0.004";
  const ProgramResult negative = abcal(arguments);
  EXPECT_EQ(negative.exit_code, 2);
  EXPECT_THAT(negative.err, HasSubstr("step"));
  EXPECT_EQ(abcal({"uncertainty", "run.csv", "--alignment", "nan"}).exit_code, 2);
  EXPECT_EQ(abcal({"uncertainty", "run.csv", "--trials", "0"}).exit_code, 2);
}

TEST_F(StudyCommands, StepErrorsOfOneRunAreNoRecordOfAStage) {
  write_run();
  test::write_file(folder / "acs.json", abcal({"analyse", "run.csv", "--estimator", "joint", "--json"}).out);
  for (const char* option : {"--measured-acs", "--stage-record"}) {
    const ProgramResult old =
        abcal({"uncertainty", "run.csv", "--estimator", "abc", "--trials", "2000", option, "acs.json"});
    EXPECT_EQ(old.exit_code, 2);
    EXPECT_THAT(old.err, AllOf(HasSubstr("acs.json"), HasSubstr("without their covariances"),
                               HasSubstr("abcal stage learn")));
  }
}

// A run answers for the estimator that it declared: the number that a user reads after `analyse` is the one
// that `uncertainty` is about.
TEST_F(StudyCommands, TheUncertaintyIsThatOfTheDeclaredEstimator) {
  test::write_file(folder / "bench.toml",
                   "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"simulated\"\nport = \"simulated\"\n"
                   "[accelerometer]\ndriver = \"simulated\"\nport = \"simulated\"\nrate_hz = 200.0\n"
                   "[protocol]\nestimator = \"joint\"\ncheck_poses = false\nsteps = 12\nstep_deg = 30.0\n"
                   "settle_s = 0.05\ndwell_readings = 20\n[simulation]\nnoise = 1e-5\n");
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  const Json analysed = json_of({"analyse", "a.run"});
  ASSERT_EQ(analysed.at("estimator"), "joint");
  const Json study = json_of({"uncertainty", "a.run", "--trials", "2000"});
  EXPECT_EQ(study.at("schema"), "abcal.study/1");
  EXPECT_EQ(study.at("estimator"), "joint");
  EXPECT_EQ(study.at("cases").size(), 1U);
  EXPECT_THAT(study.at("cases").at(0).at("name").get<std::string>(), StartsWith("joint: "));
  EXPECT_THAT(study.at("cases").at(0).at("note").get<std::string>(), HasSubstr("does not check the model"));
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      const Json& stated = analysed.at("sensitivity_matrix").at(j).at(k);
      EXPECT_EQ(study.at("value").at("sensitivity_matrix").at(j).at(k), stated.at("value"));
      EXPECT_EQ(study.at("posterior").at("standard_uncertainty").at("sensitivity_matrix").at(j).at(k),
                stated.at("standard_uncertainty"));
      const Json& interval = study.at("interval").at("sensitivity_matrix").at(j).at(k);
      EXPECT_LT(interval.at(0).get<double>(), stated.at("value").get<double>());
      EXPECT_GT(interval.at(1).get<double>(), stated.at("value").get<double>());
    }
  }
  const ProgramResult text = abcal({"uncertainty", "a.run", "--trials", "2000"});
  EXPECT_THAT(text.out, HasSubstr("Uncertainty of the joint result of a.run"));
  EXPECT_EQ(abcal({"uncertainty", "a.run", "--trials", "2000", "--threads", "3"}).out, text.out);

  const Json abc = json_of({"uncertainty", "a.run", "--trials", "2000", "--estimator", "abc"});
  EXPECT_EQ(abc.at("estimator"), "abc");
  ASSERT_EQ(abc.at("cases").size(), 3U);
  for (const Json& one : abc.at("cases")) EXPECT_THAT(one.at("name").get<std::string>(), StartsWith("abc: "));

  const ProgramResult wrong = abcal({"uncertainty", "a.run", "--preset", "paper"});
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_THAT(wrong.err, AllOf(HasSubstr("--preset"), HasSubstr("--estimator abc")));
  const ProgramResult norm = abcal({"uncertainty", "a.run", "--estimator", "norm", "--step", "0.01"});
  EXPECT_EQ(norm.exit_code, 2);
  EXPECT_THAT(norm.err, AllOf(HasSubstr("--step"), HasSubstr("--estimator joint")));
  EXPECT_EQ(json_of({"uncertainty", "a.run", "--estimator", "norm", "--trials", "200"}).at("estimator"),
            "norm");
}

TEST_F(StudyCommands, SeveralProcessesGiveTheSameBitsAsOne) {
#ifndef ABCAL_MPIRUN
  GTEST_SKIP() << "built without MPI";
#else
  write_run();
  ::setenv("OMPI_ALLOW_RUN_AS_ROOT", "1", 1);
  ::setenv("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1", 1);
  for (const std::vector<std::string>& number :
       {std::vector<std::string>{"--trials", "30500"}, {"--digits", "1"}}) {
    std::vector<std::string> arguments{"uncertainty", "run.csv", "--json", "--threads", "2"};
    arguments.insert(arguments.end(), number.begin(), number.end());
    const ProgramResult alone = abcal(arguments);
    ASSERT_EQ(alone.exit_code, 0) << alone.err;
    std::vector<std::string> words{"--oversubscribe", "-n", "3", test::abcal_program() + "-mpi"};
    words.insert(words.end(), arguments.begin(), arguments.end());
    test::Program team(ABCAL_MPIRUN, words, folder.path());
    EXPECT_EQ(team.wait(), 0) << team.err();
    EXPECT_EQ(team.out(), alone.out);
  }
  test::Program wrong(ABCAL_MPIRUN, {"-n", "1", test::abcal_program(), "uncertainty", "run.csv"},
                      folder.path());
  EXPECT_NE(wrong.wait(), 0);
  EXPECT_THAT(wrong.err(), HasSubstr("required: mpirun abcal-mpi uncertainty"));
#endif
}

}  // namespace
}  // namespace abcal
