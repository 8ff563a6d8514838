// The times of a run's angles: --truth averages over them, and a CSV without them says what it assumes.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::HasSubstr;
using testing::Not;

class TimeOfAnglesTest : public ProgramTest {
 protected:
  void measure(const std::string& simulation) {
    BenchText bench;
    bench.simulation = simulation;
    test::write_file(folder / "bench.toml", bench.text());
    const ProgramResult made = abcal({"run", "bench.toml", "-o", "a.run"});
    ASSERT_EQ(made.exit_code, 0) << made.err;
  }
};

// The run takes a minute of the hour over which the offsets drift: they are 2.5e-4 from their mean.
TEST_F(TimeOfAnglesTest, TheTruthIsAveragedOverTheRunAndNotOverTheSpan) {
  measure("drift_1 = [5e-4, -5e-4, 5e-4]\nspan_s = 3600\n");
  const ProgramResult result = abcal({"analyse", "a.run", "--truth", "bench.toml"});
  EXPECT_EQ(result.exit_code, 0) << result.out;
  EXPECT_THAT(result.out, HasSubstr("agrees"));
}

TEST_F(TimeOfAnglesTest, ACsvWithoutTimesSaysThatItsRowsAreTakenInTheOrderOfTime) {
  measure("");
  const std::string words = "the order of its rows is taken as the order of time";
  ASSERT_EQ(abcal({"report", "a.run", "--csv", "timed.csv"}).exit_code, 0);
  std::string csv = test::read_file(folder / "timed.csv");
  csv.replace(csv.find(",time_s,"), 8, ",not_it,");
  test::write_file(folder / "untimed.csv", csv);
  test::write_file(folder / "stated.csv", "# row_order: time\n" + csv);
  for (const char* estimator : {"abc", "joint", "norm"}) {
    const auto analysed = [&](const char* file) {
      return test::unwrapped(abcal({"analyse", file, "--estimator", estimator}).out);
    };
    EXPECT_THAT(analysed("timed.csv"), Not(HasSubstr(words))) << estimator;
    EXPECT_THAT(analysed("untimed.csv"), HasSubstr(words)) << estimator;
    EXPECT_THAT(analysed("stated.csv"), Not(HasSubstr(words))) << estimator;
  }
}

}  // namespace
}  // namespace abcal
