// Series of runs and stage records: the figures of the design with their coverage, and the commands as a
// technician uses them.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/bench_file/stage_record_file.h"
#include "app/studies/stage_records/stage_record_study.h"
#include "app/studies/stage_records/stage_record_text.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::Each;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using Json = nlohmann::json;

// Twelve stages: the uncertainties hardly differ from stage to stage, so that the figures hold for few. A
// mean square of z over 12 stages with three correlated outputs is known to sqrt(2/12), its root to 20 %.
TEST(StageRecordStudyTest, ReachesTheFiguresAndItsErrorsAgreeWithThem) {
  StageRecordOptions options;
  options.stages = 12;
  options.stages_at_rate = 2;
  options.threads = 2;
  const StageRecordStudy study = run_stage_record_study(options);
  // Runs of 90 s have not reached their figures: noise and the step errors of each sweep limit them.
  EXPECT_THAT(study.missed(), Each(HasSubstr("60 and 20 degrees/s"))) << stage_record_text(study);
  ASSERT_EQ(study.outcomes.size(), kStageExperiments);
  for (const StageExperimentOutcome& outcome : study.outcomes) {
    EXPECT_EQ(outcome.failed, 0) << outcome.words;
    for (const ErrorGroup& group : outcome.groups) EXPECT_LT(group.rms_z, 1.6) << outcome.words;
  }
  EXPECT_EQ(study.alarms.sound, 26);
  EXPECT_LE(study.alarms.sound_contradicted, 2);
  EXPECT_EQ(study.alarms.knocked_contradicted, 12);
  EXPECT_EQ(study.alarms.other_contradicted, 12);
}

TEST(StageRecordStudyTest, IsTheSameForAnyNumberOfThreads) {
  StageRecordOptions one;
  one.stages = 3;
  one.stages_at_rate = 1;
  StageRecordOptions three = one;
  three.threads = 3;
  EXPECT_EQ(stage_record_json(run_stage_record_study(one)), stage_record_json(run_stage_record_study(three)));
}

struct Mounting {
  const char* words;                       ///< [item] mounting
  std::array<std::array<int, 3>, 3> turn;  ///< Directions of u, v, w.
};
constexpr Mounting kAsIs{"x y z", {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}};
constexpr Mounting kAboutX{"x -z y", {{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}}}};
constexpr Mounting kAboutZ{"-y x z", {{{0, -1, 0}, {1, 0, 0}, {0, 0, 1}}}};

class StageCommands : public testing::Test {
 protected:
  ProgramResult abcal(const std::vector<std::string>& arguments) {
    return test::run_program(arguments, folder.path());
  }
  Json json_of(std::vector<std::string> arguments) {
    arguments.emplace_back("--json");
    const ProgramResult result = abcal(arguments);
    EXPECT_LE(result.exit_code, 1) << result.err;
    return Json::parse(result.out);
  }

  /// Measures an item on a stage that repeats; the file is NAME.run.
  void measure(const std::string& name, int number, const Mounting& mounting, const std::string& stage = "",
               int seed = 7, const std::string& zero = "0") {
    std::string rows;
    for (const auto& row : mounting.turn)
      rows += fmt::format("[{}, {}, {}],", row[0] + 0.0, row[1] + 0.0, row[2] + 0.0);
    std::string axes;
    for (const char* axis : {"x", "z"})
      axes += fmt::format(
          "[simulation.{}]\nmean_step_error_deg = 0.006\ninitial_turn_error_deg = -0.005\nfine_map_deg = "
          "0.008\n"
          "step_repeatability_deg = 0.0005\nhoming_repeatability_deg = 0.001\nsmooth_error_deg = 0.004\n"
          "wobble_urad = 40.0\n",
          axis);
    test::write_file(
        folder / (name + ".toml"),
        fmt::format(
            "schema = \"abcal.bench/2\"\n[bench]\nname = \"b\"\nlatitude_deg = 47.0\nheight_m = 400.0\n"
            "[stage]\ndriver = \"simulated\"\n{}[stage.x]\nzero_deg = {}\n[accelerometer]\ndriver = "
            "\"simulated\"\n[item]\nmaker = \"Acme\"\nmodel = \"T1\"\nserial_number = \"C100\"\nmounting = "
            "\"{}\"\n[protocol]\nsteps = 24\nstep_deg = 15.0\nestimator = \"joint\"\nsettle_s = 0.5\n"
            "dwell_readings = 100\n[simulation]\nseed = {}\nrun = {}\nsensitivity_matrix = [{}]\n"
            "offset = [0.01, -0.02, 0.03]\nnoise = 1e-4\nfloor_repeatability_urad = 5.0\n{}",
            stage, zero, mounting.words, seed, number, rows, axes));
    const ProgramResult run = abcal({"run", name + ".toml", "-o", name + ".run"});
    ASSERT_EQ(run.exit_code, 0) << run.err;
    ASSERT_THAT(run.out, HasSubstr("Result: usable")) << run.out;
  }
  void teach() {
    measure("m1", 1, kAsIs);
    measure("m2", 2, kAboutX);
    measure("m3", 3, kAboutZ);
    const ProgramResult learned = abcal({"stage", "learn", "m1.run", "m2.run", "m3.run", "-o", "b.stage"});
    ASSERT_EQ(learned.exit_code, 0) << learned.err;
    ASSERT_THAT(learned.out, AllOf(HasSubstr("3 runs in 1 learning"), HasSubstr("Good for: 6.5 months")));
  }

  test::TemporaryFolder folder;
};

double u_of_offset(const Json& result) {
  return result.at("offset").at(0).at("standard_uncertainty").get<double>();
}

TEST_F(StageCommands, ARecordIsLearnedUsedAndTested) {
  teach();
  measure("new", 11, kAsIs);
  measure("kept", 12, kAsIs, "record = \"b.stage\"\n");
  const Json alone = json_of({"analyse", "new.run"});
  const Json with = json_of({"analyse", "new.run", "--stage-record", "b.stage"});
  EXPECT_LT(u_of_offset(with), 0.5 * u_of_offset(alone));
  EXPECT_TRUE(with.at("stage_record").at("agrees"));
  EXPECT_LT(std::abs(with.at("offset").at(0).at("value").get<double>() - 0.01), 4.0 * u_of_offset(with));
  // The run that kept the record uses it, with the file gone.
  std::filesystem::remove(folder / "b.stage");
  const Json kept = json_of({"analyse", "kept.run"});
  EXPECT_EQ(kept.at("stage_record").at("sha256"), with.at("stage_record").at("sha256"));
  EXPECT_NEAR(u_of_offset(kept), u_of_offset(with), 0.1 * u_of_offset(with));
  EXPECT_FALSE(alone.contains("stage_record"));
  const Json of_trials = json_of({"uncertainty", "kept.run", "--trials", "10"});
  EXPECT_EQ(of_trials.at("cases").at(0).at("trials"), 10);
  EXPECT_EQ(of_trials.at("posterior").at("standard_uncertainty").at("offset").at(0).get<double>(),
            u_of_offset(kept));
  // The type A evaluation of the published protocol takes the stage from the record.
  const auto type_a = [&](std::vector<std::string> run) {
    run.insert(run.begin(), "uncertainty");
    for (const char* word : {"--estimator", "abc", "--trials", "2000"}) run.emplace_back(word);
    return json_of(run).at("cases").at(1);
  };
  const Json alone_a = type_a({"new.run"}), kept_a = type_a({"kept.run"});
  const auto u_of_phi = [](const Json& study) {
    return study.at("standard_deviation").at("intrinsic_angle").at(0).get<double>();
  };
  EXPECT_THAT(kept_a.at("note").get<std::string>(),
              HasSubstr(with.at("stage_record").at("sha256").get<std::string>()));
  EXPECT_THAT(alone_a.at("note").get<std::string>(), HasSubstr("Nothing measured"));
  EXPECT_LT(u_of_phi(kept_a), 0.6 * u_of_phi(alone_a));
}

TEST_F(StageCommands, MountingsAreFoundFromTheRunsAndGiveTheItem) {
  measure("m1", 1, kAsIs);
  measure("m2", 2, kAboutX);
  const Json one = json_of({"analyse", "m1.run"});
  const Json both = json_of({"analyse", "m2.run", "m1.run"});
  EXPECT_LT(u_of_offset(both), 0.6 * u_of_offset(one));
  EXPECT_EQ(both.at("series").at(0).at("mounting"), "as in the first run");
  // The order in which they are given does not matter: m1 is the first.
  EXPECT_EQ(both.at("series").at(1).at("mounting"), "turned by 90 degrees about -X");
  EXPECT_EQ(both, json_of({"analyse", "m1.run", "m2.run"}));
  const ProgramResult twice = abcal({"analyse", "m1.run", "m1.run"});
  EXPECT_EQ(twice.exit_code, 2);
  EXPECT_THAT(twice.err, HasSubstr("is given twice"));
}

TEST_F(StageCommands, WhatMakesARecordWrongIsRefusedOrNamed) {
  teach();
  const ProgramResult taught = abcal({"analyse", "m1.run", "--stage-record", "b.stage"});
  EXPECT_EQ(taught.exit_code, 2);
  EXPECT_THAT(taught.err, HasSubstr("taught the record"));
  const ProgramResult again = abcal({"stage", "learn", "m1.run", "--record", "b.stage", "-o", "c.stage"});
  EXPECT_EQ(again.exit_code, 2);
  EXPECT_THAT(again.err, HasSubstr("taught b.stage already"));
  const ProgramResult exists = abcal({"stage", "learn", "m1.run", "-o", "b.stage"});
  EXPECT_EQ(exists.exit_code, 2);
  // Another stage of the same name: only its errors show it.
  measure("other", 1, kAsIs, "", 8);
  const ProgramResult other = abcal({"stage", "check", "b.stage", "other.run"});
  EXPECT_EQ(other.exit_code, 1);
  EXPECT_THAT(other.out, AllOf(HasSubstr("contradicts the record"), HasSubstr("fine map of X")));
  const ProgramResult analysed = abcal({"analyse", "other.run", "--stage-record", "b.stage"});
  EXPECT_THAT(analysed.out, HasSubstr("Result: doubtful"));
  // Another zero: refused, by the analysis and before a run.
  measure("turned", 4, kAsIs, "", 7, "1");
  const ProgramResult turned = abcal({"analyse", "turned.run", "--stage-record", "b.stage"});
  EXPECT_EQ(turned.exit_code, 2);
  EXPECT_THAT(turned.err, AllOf(HasSubstr("another stage"), HasSubstr("zero 1 degrees")));
  test::write_file(folder / "no.stage", "{}");
  EXPECT_THAT(abcal({"stage", "show", "no.stage"}).err, HasSubstr("not a stage record"));
  test::write_file(folder / "text.stage", "stage");
  EXPECT_THAT(abcal({"stage", "show", "text.stage"}).err,
              AllOf(HasSubstr("not JSON"), Not(HasSubstr("json."))));
}

TEST_F(StageCommands, ALaterLearningContinuesARecordAndAgreesWithIt) {
  teach();
  measure("m4", 4, kAboutX);
  measure("m5", 5, kAsIs);
  const ProgramResult later =
      abcal({"stage", "learn", "m4.run", "m5.run", "--record", "b.stage", "-o", "c.stage"});
  ASSERT_EQ(later.exit_code, 0) << later.err;
  EXPECT_THAT(later.out, HasSubstr("5 runs in 2 learnings"));
  const ProgramResult compared = abcal({"stage", "compare", "b.stage", "c.stage"});
  EXPECT_EQ(compared.exit_code, 0) << compared.out;
  EXPECT_THAT(compared.out, HasSubstr("the later one continues the earlier one"));
  const StageRecord before = read_stage_record(folder / "b.stage"),
                    after = read_stage_record(folder / "c.stage");
  EXPECT_LT(after.state.covariance.trace(), before.state.covariance.trace());
  // Written and read again it is the same, to the bit.
  EXPECT_EQ(stage_record_json(parse_stage_record(stage_record_json(after).dump(), "again")),
            stage_record_json(after));
}

}  // namespace
}  // namespace abcal
