// `abcal mountings` as a technician uses it.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/app/program_fixtures.h"
#include "tests/support/typed_program.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

class MountingsTest : public EmulatedBenchTest {
 protected:
  MountingsTest() {
    bench.stage_port = bench.accelerometer_port = "simulated";
    bench.protocol += "estimator = \"joint\"\n";
  }
  test::ProgramResult two(std::vector<std::string> more = {}) {
    std::vector<std::string> words{"mountings", "bench.toml", "--mountings", "2"};
    words.insert(words.end(), more.begin(), more.end());
    return abcal(words);
  }
};

TEST_F(MountingsTest, MeasuresEveryMountingAndEndsWithOneResult) {
  write_bench(bench);
  const test::ProgramResult result = two({"--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.err, AllOf(HasSubstr("Mounting 2 of 2: turned by 90 degrees about X"),
                                HasSubstr("y: -w"), HasSubstr("\"x z -y\", as required")));
  const Json both = Json::parse(result.out);
  ASSERT_EQ(both.at("series").size(), 2U);
  EXPECT_EQ(both.at("series").at(1).at("mounting"), "turned by 90 degrees about X");
  for (std::size_t j = 0; j < 3; ++j) {
    const Json& offset = both.at("offset").at(j);
    EXPECT_LT(std::abs(offset.at("value").get<double>() - 0.01 * static_cast<double>(j + 1)),
              4.0 * offset.at("standard_uncertainty").get<double>());
  }
  const Json one = Json::parse(abcal({"analyse", "bench-mounting-1.run", "--json"}).out);
  EXPECT_LT(both.at("offset").at(0).at("standard_uncertainty").get<double>(),
            0.7 * one.at("offset").at(0).at("standard_uncertainty").get<double>());
  // All there: only the result.
  const test::ProgramResult again = two();
  EXPECT_EQ(again.exit_code, 0) << again.err;
  EXPECT_THAT(again.err, Not(HasSubstr("gravity shows")));
  EXPECT_THAT(again.out, HasSubstr("File: bench-mounting.measurement"));
}

TEST_F(MountingsTest, TheSameCommandGoesOnAfterAnyInterruption) {
  // A run takes some 10 s of simulated time, and each session begins again at 0 s.
  test::write_file(folder / "bench.toml", bench.text() + "[[fault]]\nkind = \"no-output\"\nat_s = 9.0\n");
  const test::ProgramResult first = two();
  EXPECT_EQ(first.exit_code, 3) << first.err;
  EXPECT_THAT(first.err, HasSubstr("abcal mountings bench.toml --mountings 2 -o bench-mounting"));
  int more = 0;
  while (two().exit_code == 3 && ++more < 20) {
  }
  EXPECT_THAT(more, testing::AllOf(testing::Gt(0), testing::Lt(20)));
  EXPECT_EQ(two().exit_code, 0);
  const test::ProgramResult again =
      abcal({"analyse", "bench-mounting-1.run", "bench-mounting-2.run", "--full"});
  EXPECT_THAT(test::unwrapped(again.out), HasSubstr("one fit of 2 runs in 2 mountings"));
}

TEST_F(MountingsTest, RunsOfAnotherSeriesAreRefused) {
  write_bench(bench);
  ASSERT_EQ(two().exit_code, 0);
  const test::ProgramResult three = abcal({"mountings", "bench.toml", "--mountings", "3"});
  EXPECT_EQ(three.exit_code, 2);
  EXPECT_THAT(three.err, AllOf(HasSubstr("bench-mounting-2.run"), HasSubstr("another mounting")));
  EXPECT_EQ(abcal({"mountings", "bench.toml", "--mountings", "3", "--show"}).exit_code, 0);
  EXPECT_EQ(abcal({"mountings", "bench.toml", "--mountings", "4"}).exit_code, 2);
}

TEST_F(MountingsTest, AskAPersonAndLookByGravityWhetherItWasDone) {
  bench.stage_port = "links/stage";
  bench.accelerometer_port = "links/accelerometer";
  start_emulator();
  const test::Typed typed =
      test::type_at_terminal({"mountings", "bench.toml", "--mountings", "2"}, folder.path(),
                             test::answers_to("the same command goes on): ", {"", "", "\x03"}));
  EXPECT_NE(typed.exit_code, 0);
  EXPECT_THAT(typed.shown, AllOf(HasSubstr("\"x y z\", as required"),
                                 HasSubstr("Mounting 2 of 2: turned by 90 degrees about X"),
                                 // The emulated item stands as before.
                                 HasSubstr("it is still to be turned by 90 degrees about X"),
                                 HasSubstr("The same command goes on")));
  EXPECT_TRUE(std::filesystem::exists(folder / "bench-mounting-1.run"));
  EXPECT_FALSE(std::filesystem::exists(folder / "bench-mounting-2.run"));
  const test::ProgramResult nobody = two();
  EXPECT_EQ(nobody.exit_code, 2);
  EXPECT_THAT(nobody.err, HasSubstr("not a terminal"));
}

}  // namespace
}  // namespace abcal
