// Backlash that no approach from below removes: plan, result and report of the program say so.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

class BacklashNoteTest : public ProgramTest {
 protected:
  void write_bench_with(const std::string& protocol) {
    BenchText bench;
    bench.protocol += protocol;
    test::write_file(folder / "bench.toml", bench.text() + "[stage_uncertainty]\nzero_deg = 0.02\n");
  }
  std::vector<std::string> notes_of_plan() {
    const ProgramResult plan = abcal({"plan", "bench.toml", "--json"});
    EXPECT_EQ(plan.exit_code, 0) << plan.err;
    return nlohmann::json::parse(plan.out).at("notes");
  }
  void run_and_report() {
    const ProgramResult made = abcal({"run", "bench.toml", "-o", "a.run", "--full"});
    ASSERT_EQ(made.exit_code, 0) << made.err;
    told_by_run = made.out;
    const ProgramResult report = abcal({"report", "a.run", "--html", "a.html", "--csv", "a.csv"});
    ASSERT_EQ(report.exit_code, 0) << report.err;
    page = test::read_file(folder / "a.html");
  }

  const std::string words = "required: backlash within zero_deg (0.02 degree)";
  const std::string not_covered = "backlash of the axes beyond zero_deg (approach_deg = 0)";
  std::string told_by_run, page;
};

TEST_F(BacklashNoteTest, EveryPlaceSaysThatBacklashIsNotTakenOut) {
  write_bench_with("approach_deg = 0.0\n");
  EXPECT_THAT(test::unwrapped(abcal({"plan", "bench.toml"}).out), HasSubstr(words));
  EXPECT_THAT(notes_of_plan(), Contains(HasSubstr(words)));
  ASSERT_NO_FATAL_FAILURE(run_and_report());
  EXPECT_THAT(test::unwrapped(told_by_run), HasSubstr(words));
  EXPECT_THAT(test::unwrapped(abcal({"analyse", "a.run", "--full"}).out), HasSubstr(words));
  EXPECT_THAT(page, AllOf(HasSubstr(words), HasSubstr(not_covered)));
  EXPECT_THAT(abcal({"uncertainty", "a.run", "--trials", "1000"}).out, HasSubstr(not_covered));
  EXPECT_THAT(test::unwrapped(abcal({"analyse", "a.run", "--estimator", "norm", "--full"}).out),
              Not(HasSubstr(words)))
      << "uses no angles";
  EXPECT_THAT(test::unwrapped(abcal({"analyse", "a.csv", "--full"}).out), HasSubstr(words))
      << "its CSV states it";
}

TEST_F(BacklashNoteTest, ARunThatApproachesFromBelowSaysNothing) {
  write_bench_with("");
  EXPECT_THAT(test::unwrapped(abcal({"plan", "bench.toml"}).out), Not(HasSubstr(words)));
  EXPECT_THAT(notes_of_plan(), Not(Contains(HasSubstr(words))));
  ASSERT_NO_FATAL_FAILURE(run_and_report());
  EXPECT_THAT(test::unwrapped(told_by_run), Not(HasSubstr(words)));
  EXPECT_THAT(page, AllOf(Not(HasSubstr(words)), Not(HasSubstr(not_covered))));
}

TEST_F(BacklashNoteTest, ThePlanAsJsonHasTheNotesOfItsText) {
  const std::string bench = BenchText{}.text();
  test::write_file(folder / "bench.toml", bench);
  const std::string text = abcal({"plan", "bench.toml", "--full"}).out;
  const std::vector<std::string> notes = notes_of_plan();
  EXPECT_THAT(notes, Contains(HasSubstr("not covered: an offset that comes and goes")));
  for (const std::string& note : notes) EXPECT_THAT(text, HasSubstr("Note: " + note + ".\n"));
  test::write_file(folder / "bench.toml", bench + "[item_uncertainty]\ncyclic_drift = 0.0\n");
  EXPECT_THAT(notes_of_plan(), Not(Contains(HasSubstr("comes and goes"))));
}

}  // namespace
}  // namespace abcal
