#include "protocol/record/import_table.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace abcal {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Field;
using ::testing::HasSubstr;

constexpr const char* kHeader = "experiment,n,alpha_deg,r_u,r_v,r_w\n";

// Four angles in each experiment, 90 degrees apart; replaced lines by number of the data row (0 is the
// first).
std::string good_rows() {
  std::string text;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 1; n <= 4; ++n)
      text += fmt::format("{},{},{},0.5,-0.25,{}\n", experiment, n, 90 * (n - 1), n);
  }
  return text;
}

RunRecord imported(const std::string& text) {
  std::istringstream input(text);
  return import_table(input, "test.csv").record;
}

std::vector<Problem> problems_of(const std::string& text) {
  try {
    imported(text);
  } catch (const TableError& error) {
    return error.problems();
  }
  return {};
}

auto problem(const std::string& where, const std::string& found, const std::string& required) {
  return AllOf(Field("where", &Problem::where, HasSubstr(where)),
               Field("found", &Problem::found, HasSubstr(found)),
               Field("required", &Problem::required, HasSubstr(required)));
}

TEST(ImportCsvTest, ReadsThePlainTable) {
  const RunRecord record = imported(kHeader + good_rows());
  ASSERT_EQ(record.dwells.size(), 12U);
  EXPECT_EQ(record.steps, 4);
  EXPECT_EQ(record.step.deg(), 90.0);
  EXPECT_EQ(record.response_unit, "R");
  EXPECT_FALSE(record.g_loc_known);
  const DwellRecord& dwell = record.dwells[6];
  EXPECT_EQ(dwell.experiment, 2);
  EXPECT_EQ(dwell.n, 3);
  EXPECT_EQ(dwell.alpha.deg(), 180.0);
  EXPECT_EQ(dwell.mean, Eigen::Vector3d(0.5, -0.25, 3.0));
  EXPECT_FALSE(dwell.u_mean.has_value());
  EXPECT_FALSE(dwell.time_s.has_value());
  EXPECT_EQ(dwell.commanded_z.deg(), -90.0);
  EXPECT_EQ(record.tolerances.step.deg(), 0.008);
}

TEST(ImportCsvTest, ReadsOptionalColumnsInAnyOrder) {
  std::string text =
      "time_s,count,r_w,r_v,r_u,alpha_deg,n,experiment,u_u,u_v,u_w,temperature_degc,operator\n";
  for (int e = 1; e <= 3; ++e) {
    for (int n = 1; n <= 3; ++n) {
      text += fmt::format("{},100,3,2,1,{},{},{},1e-5,2e-5,3e-5,23.5,\"Doe, J. \"\"jd\"\"\"\n", 10 * n,
                          120 * n - 120, n, e);
    }
  }
  const RunRecord record = imported(text);
  ASSERT_EQ(record.dwells.size(), 9U);
  EXPECT_EQ(record.dwells[1].mean, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(*record.dwells[1].u_mean, Eigen::Vector3d(1e-5, 2e-5, 3e-5));
  EXPECT_EQ(record.dwells[1].time_s, 20.0);
  EXPECT_EQ(record.dwells[1].count, 100);
  EXPECT_EQ(record.dwells[1].temperature_degc, 23.5);
}

TEST(ImportCsvTest, ToleratesWhatSpreadsheetsWrite) {
  const RunRecord plain = imported(kHeader + good_rows());
  std::string crlf;
  for (const char c : kHeader + good_rows()) crlf += c == '\n' ? std::string("\r\n") : std::string(1, c);
  std::string semicolons;
  for (const char c : "experiment,n,alpha_deg,r_u,r_v,r_w\n" + good_rows()) {
    semicolons += c == ',' ? ';' : c == '.' ? ',' : c;
  }
  std::string all_quoted = "\"experiment\",\"n\",\"alpha_deg\",\"r_u\",\"r_v\",\"r_w\"\n" + good_rows();
  for (const std::string& text :
       {"\xEF\xBB\xBF" + (kHeader + good_rows()), crlf, semicolons, all_quoted,
        "# made by hand\n\n# response_unit: V\n" + (kHeader + good_rows()) + "# the end\n\n",
        "Experiment, N, Alpha_deg, r_u, r_v, r_w\n" + good_rows()}) {
    const RunRecord record = imported(text);
    ASSERT_EQ(record.dwells.size(), plain.dwells.size()) << text;
    for (std::size_t i = 0; i < plain.dwells.size(); ++i) {
      EXPECT_EQ(record.dwells[i].mean, plain.dwells[i].mean) << text;
      EXPECT_EQ(record.dwells[i].alpha.deg(), plain.dwells[i].alpha.deg());
    }
  }
  EXPECT_EQ(imported("# response_unit: V\n" + (kHeader + good_rows())).response_unit, "V");
  EXPECT_EQ(imported(kHeader + good_rows().substr(0, good_rows().size() - 1)).dwells.size(),
            12U);  // no last newline
}

TEST(ImportCsvTest, TheClosingAngleIsTold) {
  std::string text = kHeader + good_rows() + "1,5,360,0.5,-0.25,1\n2,1,360,0.5,-0.25,1\n";
  const RunRecord record = imported(text);
  ASSERT_EQ(record.dwells.size(), 14U);
  EXPECT_FALSE(record.dwells[0].closing);
  EXPECT_TRUE(record.dwells[12].closing);
  EXPECT_TRUE(record.dwells[13].closing);
  EXPECT_EQ(record.dwells[12].commanded_x.deg(), 0.0);
  EXPECT_EQ(record.steps, 4);
}

TEST(ImportCsvTest, AColumnMayTellTheClosingAngleAndFlags) {
  std::string text = "experiment,n,alpha_deg,r_u,r_v,r_w,closing,flags\n";
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 3; n <= 6; ++n)  // begins at 180 degrees; closes at 540
      text += fmt::format("{},{},{},0.5,0.25,0.125,0,{}\n", experiment, n, 90 * (n - 1), n == 4 ? 5 : 0);
  }
  const RunRecord record = imported(text + "1,3,540,0.5,0.25,0.125,1,\n");
  ASSERT_EQ(record.dwells.size(), 13U);
  EXPECT_FALSE(record.dwells[0].closing);
  EXPECT_TRUE(record.dwells[12].closing);
  EXPECT_EQ(record.dwells[1].flags, kFlagNotQuiet | kFlagClipped);
  EXPECT_EQ(record.dwells[12].flags, kFlagNone);
  EXPECT_THAT(
      problems_of(text + fmt::format("1,3,540,0.5,0.25,0.125,2,{}\n", kAllFlags + 1U)),
      testing::ElementsAre(problem("flags", "1024", "known flags"), problem("closing", "2", "0 or 1")));
}

TEST(ImportCsvTest, AColumnTellsTheFace) {
  const std::string header = "experiment,n,alpha_deg,r_u,r_v,r_w,face\n";
  std::string text = header;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (const int n : {1, 3, 5, 7, 2, 4, 6, 8})
      text += fmt::format("{},{},{},0.5,0.25,0.125,{}\n", experiment, n, 45 * (n - 1), n % 2 == 1 ? 1 : 2);
    text += fmt::format("{},2,405,0.5,0.25,0.125,2\n", experiment);
  }
  const RunRecord record = imported(text);
  ASSERT_EQ(record.dwells.size(), 27U);
  EXPECT_TRUE(has_two_faces(record));
  EXPECT_EQ(record.steps, 8);
  EXPECT_EQ(record.step.deg(), 45.0);
  for (std::size_t k = 0; k < record.dwells.size(); ++k) {
    const DwellRecord& dwell = record.dwells[k];
    EXPECT_EQ(dwell.face, dwell.n % 2 == 1 ? 1 : 2);
    EXPECT_EQ(dwell.closing, k % 9 == 8) << k;  // One turn after the first angle of its own circle.
    const double held = dwell.experiment == 3 ? dwell.commanded_x.deg() : dwell.commanded_z.deg();
    const double of_face_1 = dwell.experiment == 1 ? 0.0 : -90.0;
    EXPECT_EQ(held, dwell.face == 2 ? of_face_1 + 180.0 : of_face_1);
  }
  EXPECT_THAT(
      problems_of(header + "1,1,0,0.5,0.25,0.125,3\n"),
      Contains(AllOf(Field(&Problem::where, HasSubstr("face")), Field(&Problem::found, HasSubstr("3")))));
}

TEST(ImportCsvTest, CommentsCarryWhatTheAnalysisNeedsBesideTheNumbers) {
  const RunRecord record = imported(
      "# g_loc.value_mps2: 9.80101\n# g_loc.expanded_uncertainty_mps2: 3e-05\n"
      "# g_loc.coverage_factor: 2\n# g_loc.source: survey: 2021\n# tolerances.alignment_deg: 0.001\n"
      "# tolerances.step_deg: 0.002\n# tolerances.initial_turn_deg: 0.003\n"
      "# tolerances.zero_deg: 0.004\n# tolerances.drift: 5e-6\n# alignment.zx: -0.0001\n"
      "# alignment.u_zx: 2e-6\n# alignment.zy: 1\n# protocol.step_deg: 90\n# protocol.steps: 8\n"
      "# limits.slip_deg: 0.02\n# limits.drift: 0.001\n# limits.temperature_min_degc: -5\n"
      "# limits.temperature_change_degc: 1.5\n# expected.mounting: -y x z\n"
      "# expected.nominal_sensitivity: 0.66\n# continuations: 2\n# item.model: 1,2; # \"3\"\n" +
      (kHeader + good_rows()));
  EXPECT_TRUE(record.g_loc_known);
  EXPECT_EQ(record.g_loc.value_mps2, 9.80101);
  EXPECT_EQ(record.g_loc.expanded_uncertainty_mps2, 3e-5);
  EXPECT_EQ(record.g_loc.source, "survey: 2021");
  EXPECT_EQ(record.tolerances.alignment.deg(), 0.001);
  EXPECT_EQ(record.tolerances.step.deg(), 0.002);
  EXPECT_EQ(record.tolerances.initial_turn.deg(), 0.003);
  EXPECT_EQ(record.tolerances.zero.deg(), 0.004);
  EXPECT_EQ(record.tolerances.drift, 5e-6);
  ASSERT_TRUE(record.measured_alignment.zx);
  EXPECT_EQ(record.measured_alignment.zx->value, -0.0001);
  EXPECT_EQ(record.measured_alignment.zx->standard_uncertainty, 2e-6);
  EXPECT_FALSE(record.measured_alignment.zy);  // its uncertainty is not there
  EXPECT_EQ(record.steps, 8);
  EXPECT_EQ(record.continuations, 2);
  EXPECT_EQ(record.limits.slip->deg(), 0.02);
  EXPECT_EQ(record.limits.drift, 0.001);
  EXPECT_EQ(record.limits.temperature_min_degc, -5.0);
  EXPECT_EQ(record.limits.temperature_change_degc, 1.5);
  EXPECT_FALSE(record.limits.angle);
  EXPECT_EQ(record.expected.mounting, "-y x z");
  EXPECT_EQ(record.expected.nominal_sensitivity, 0.66);
  EXPECT_THAT(
      problems_of("# tolerances.step_deg: small\n# g_loc.value_mps2: 98.1\n" + (kHeader + good_rows())),
      testing::UnorderedElementsAre(problem("tolerances.step_deg", "small", "a number"),
                                    problem("g_loc.value_mps2", "98.1", "9 to 10.5")));
}

TEST(ImportCsvTest, ExperimentZeroIsACheckPoseInItsPlace) {
  const std::string header = "experiment,n,alpha_deg,r_u,r_v,r_w\n";
  std::string rows = "0,1,0,0.5,0.5,0.5\n0,2,0,-0.5,-0.5,-0.5\n";
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 1; n <= 4; ++n)
      rows += std::to_string(experiment) + "," + std::to_string(n) + "," + std::to_string(90 * (n - 1)) +
              ",1,2,3\n";
    rows += "0,1,0,0.5,0.5,0.5\n0,2,0,-0.5,-0.5,-0.5\n";
  }
  std::istringstream in(header + rows);
  const RunRecord record = import_table(in, "made").record;
  EXPECT_EQ(record.dwells.size(), 12U);
  ASSERT_EQ(record.check_poses.size(), 8U);
  EXPECT_EQ(record.check_poses[0].after, 0U);
  EXPECT_EQ(record.check_poses[5].after, 8U);
  EXPECT_NEAR(record.check_poses[5].dwell.commanded_x.deg(), 234.7356, 1e-4);  // The digits written.
  std::istringstream wrong(header + rows + "0,3,0,1,2,3\n");
  try {
    import_table(wrong, "made");
    FAIL();
  } catch (const TableError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("required: check pose 1 or 2"));
  }
}

TEST(ImportCsvTest, MissingAnglesAreNoProblem) {
  std::string text = kHeader + good_rows();
  text.erase(text.find("2,3,180"), text.find("2,4,270") - text.find("2,3,180"));
  const RunRecord record = imported(text);
  EXPECT_EQ(record.dwells.size(), 11U);
  EXPECT_EQ(record.steps, 4);
}

TEST(ImportCsvTest, EveryProblemIsReportedAtOnceWithItsLine) {
  const std::string text = kHeader + good_rows() +  // lines 2..13
                           "1,2,90,0.5,0.5,0.5\n"   // 14: again
                           "4,1,0,1,1,1\n"          // 15: no such experiment
                           "1,9,45,abc,1,nan\n"     // 16
                           "1,10,50,1,1\n"          // 17: a field missing
                           "1,0,60,1,,1\n"          // 18
                           "1,1.5,60,1,1e999,1\n";  // 19
  const std::vector<Problem> problems = problems_of(text);
  EXPECT_THAT(problems, Contains(problem("line 14", "experiment 1, n = 2 again (first on line 3)", "once")));
  EXPECT_THAT(problems, Contains(problem("line 15, experiment", "\"4\"", "experiment 1, 2 or 3")));
  EXPECT_THAT(problems, Contains(problem("line 16, r_u", "\"abc\"", "a number")));
  EXPECT_THAT(problems, Contains(problem("line 16, r_w", "\"nan\"", "finite")));
  EXPECT_THAT(problems, Contains(problem("line 17", "5 fields", "6")));
  EXPECT_THAT(problems, Contains(problem("line 18, n", "\"0\"", "whole number")));
  EXPECT_THAT(problems, Contains(problem("line 18, r_v", "nothing", "a number")));
  EXPECT_THAT(problems, Contains(problem("line 19, n", "\"1.5\"", "whole number")));
  EXPECT_THAT(problems, Contains(problem("line 19, r_v", "\"1e999\"", "a number")));
  EXPECT_EQ(problems.size(), 9U);
  try {
    imported(text);
    FAIL();
  } catch (const TableError& error) {
    EXPECT_THAT(error.what(), HasSubstr("test.csv: line 15, experiment"));
  }
}

TEST(ImportCsvTest, EveryMistakeInAnEffectIsReportedAtOnceWithLineRangeAndUnit) {
  const auto problems = problems_of(
      "# stage_uncertainty.wobble_urad: 1e6\n"
      "# stage_uncertainty.step_deg: -0.1\n"
      "# stage_uncertainty.zero_deg: nan\n"
      "# stage_uncertainty.step_smoth_deg: 0.004\n"
      "# stage_uncertainty.alignment_deg.source: a certificate\n"
      "# item_uncertainty.hysteresis: small\n"
      "# protocol.estimator: best\n" +
      (kHeader + good_rows()));
  EXPECT_THAT(
      problems,
      testing::UnorderedElementsAre(
          problem("line 1, comment \"stage_uncertainty.wobble_urad\"", "\"1e6\"",
                  "a number from 0 to 10000 urad"),
          problem("line 2, comment \"stage_uncertainty.step_deg\"", "\"-0.1\"",
                  "a number from 0 to 10 degree"),
          problem("line 3, comment \"stage_uncertainty.zero_deg\"", "\"nan\"",
                  "a number from 0 to 10 degree"),
          problem("line 4, comment \"stage_uncertainty.step_smoth_deg\"", "an effect of this name",
                  "step_smooth_deg"),
          problem("line 5, comment \"stage_uncertainty.alignment_deg.source\"", "a source without a value",
                  "a number from 0 to 10 degree"),
          problem("line 6, comment \"item_uncertainty.hysteresis\"", "\"small\"", "a number from 0 to 0.1"),
          problem("line 7, comment \"protocol.estimator\"", "\"best\"", "one of abc, joint, norm")));
}

TEST(ImportCsvTest, AnEffectWithoutAValueOrStatedTwiceIsAMistake) {
  EXPECT_THAT(
      problems_of("# stage_uncertainty.wobble_urad:\n"
                  "# item_uncertainty.drift: 1e-5\n"
                  "# item_uncertainty.drift.source:\n"
                  "# tolerances.step_deg:  \n"
                  "# stage_uncertainty.zero_deg: 0.01\n"
                  "# stage_uncertainty.zero_deg: 0.02\n"
                  "# item_uncertainty.wobble_urad:\n"
                  "# operator.name:\n" +
                  (kHeader + good_rows())),
      testing::UnorderedElementsAre(
          problem("line 1, comment \"stage_uncertainty.wobble_urad\"", "nothing",
                  "a number from 0 to 10000 urad"),
          problem("line 3, comment \"item_uncertainty.drift.source\"", "nothing", "the source"),
          problem("line 4, comment \"tolerances.step_deg\"", "nothing", "a number from 0 to 10 degree"),
          problem("line 6, comment \"stage_uncertainty.zero_deg\"", "the key again (first on line 5)",
                  "each key once"),
          problem("line 7, comment \"item_uncertainty.wobble_urad\"", "an effect of this name", "drift")));
}

TEST(ImportCsvTest, TheEstimatorThatWasChosenBeforeTheRunIsKept) {
  EXPECT_EQ(imported(kHeader + good_rows()).estimator, "joint");
  EXPECT_EQ(imported("# protocol.estimator: abc\n" + (kHeader + good_rows())).estimator, "abc");
}

TEST(ImportCsvTest, HeaderProblemsNameTheColumn) {
  EXPECT_THAT(problems_of("experiment,n,alpha_deg,r_u,r_w\n1,1,0,1,1\n"),
              Contains(problem("header", "", "column r_v")));
  EXPECT_THAT(problems_of("experiment,n,alpha_deg,r_u,r_v,r_w,r_w\n"),
              Contains(problem("r_w", "twice", "once")));
  EXPECT_THAT(problems_of("experiment,n,alpha_deg,r_u,r_v,r_w,u_u\n"),
              Contains(problem("header", "", "column u_v")));
  EXPECT_THAT(problems_of(""), Contains(problem("the file", "nothing", "header")));
  EXPECT_THAT(problems_of("# only a comment\n"),
              Contains(problem("the file", "no header", "experiment,n,alpha_deg")));
  EXPECT_THAT(problems_of("1,1,0,1,1,1\n"),
              Contains(problem("header", "6 columns without a header", "--columns")));
}

TEST(ImportCsvTest, AnglesInRadiansAreRefusedAndDegreesNeverTakenForThem) {
  const auto circles = [](int steps, double step, int decimals, int last) {
    std::string text = kHeader;
    for (int experiment = 1; experiment <= 3; ++experiment)
      for (int n = 1; n <= last; ++n)
        text +=
            fmt::format("{},{},{:.{}f},0.5,-0.25,{}\n", experiment, n, step * (n - 1), decimals, n % steps);
    return text;
  };
  constexpr double kTurn = 6.283185307179586;
  for (const int steps : {4, 5, 12, 24, 72, 100})
    for (const int last : {steps, steps + 1})
      EXPECT_THAT(problems_of(circles(steps, kTurn / steps, 4, last)),
                  Contains(problem("alpha_deg", "so they are radians", "multiply every angle by 180/pi")))
          << steps;
  EXPECT_THAT(problems_of(circles(12, kTurn / 12, 2, 12)),
              Contains(problem("alpha_deg", "5.76 is 330 degrees", "")));
  EXPECT_THAT(problems_of(circles(12, -kTurn / 12, 4, 12)), Contains(problem("alpha_deg", "radians", "")));
  for (const double step : {0.5, 1.0, 5.0, 30.0, 90.0})
    EXPECT_TRUE(problems_of(circles(7, step, 4, 7)).empty()) << step;
}

TEST(ImportCsvTest, TheOrderOfRowsIsThatOfTimeOnlyWhereItIsStated) {
  EXPECT_TRUE(imported(kHeader + good_rows()).order_assumed);
  EXPECT_FALSE(imported("# row_order: time\n" + (kHeader + good_rows())).order_assumed);
  EXPECT_THAT(problems_of("# row_order: angle\n" + (kHeader + good_rows())),
              Contains(problem("row_order", "angle", "time: the rows are in the order of measurement")));
  std::string timed = "experiment,n,alpha_deg,r_u,r_v,r_w,time_s\n", one_missing = timed;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 1; n <= 4; ++n) {
      const std::string row = fmt::format("{},{},{},0.5,-0.25,{},", experiment, n, 90 * (n - 1), n);
      timed += fmt::format("{}{}\n", row, 10 * experiment + n);
      one_missing += experiment == 2 && n == 2 ? row + "\n" : fmt::format("{}{}\n", row, 10 * experiment + n);
    }
  }
  EXPECT_FALSE(imported(timed).order_assumed);
  EXPECT_TRUE(imported(one_missing).order_assumed);
}

TEST(ImportCsvTest, TooFewAnglesAreRefused) {
  const std::string text = std::string(kHeader) + "1,1,0,1,1,1\n1,2,90,1,1,1\n1,3,360,1,1,1\n2,1,0,1,1,1\n";
  const std::vector<Problem> problems = problems_of(text);
  EXPECT_THAT(problems, Contains(problem("experiment 1", "2 different angles", "at least 3")));
  EXPECT_THAT(problems, Contains(problem("experiment 2", "1 different angle", "at least 3")));
  EXPECT_THAT(problems, Contains(problem("experiment 3", "0 different angles", "at least 3")));
}

TEST(ImportCsvTest, UncertaintiesAreAllOrNoneAndNotNegative) {
  std::string text = "experiment,n,alpha_deg,r_u,r_v,r_w,u_u,u_v,u_w\n";
  for (int e = 1; e <= 3; ++e) {
    for (int n = 1; n <= 3; ++n) text += fmt::format("{},{},{},1,1,1,,,\n", e, n, 120 * n);
  }
  EXPECT_FALSE(imported(text).dwells[0].u_mean.has_value());
  EXPECT_THAT(problems_of(text + "1,4,10,1,1,1,1e-5,,1e-5\n"),
              Contains(problem("line 11", "2 of", "all three")));
  EXPECT_THAT(problems_of(text + "1,4,10,1,1,1,1e-5,-1e-5,1e-5\n"),
              Contains(problem("line 11, u_v", "-1e-5", ">= 0")));
}

TEST(ImportCsvTest, GarbageIsRefusedAndQuotedShort) {
  std::string garbage;
  for (int i = 0; i < 5000; ++i) garbage += static_cast<char>((i * 7919) % 251);
  const std::vector<Problem> problems = problems_of(garbage);
  ASSERT_FALSE(problems.empty());
  for (const Problem& p : problems) EXPECT_LT(p.found.size(), 60U);
  EXPECT_THAT(problems_of(kHeader + good_rows() + "1,9,\"45,1,1,1\n"),
              Contains(problem("line 14", "quoted", "quote")));
}

TEST(ImportCsvTest, AFileThatIsNotThereIsSaidSo) {
  try {
    import_table(std::filesystem::path("no/such/file.csv"));
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("no/such/file.csv"), HasSubstr("No such file")));
  }
  EXPECT_THROW(import_table(std::filesystem::temp_directory_path()), std::runtime_error);
}

}  // namespace
}  // namespace abcal
