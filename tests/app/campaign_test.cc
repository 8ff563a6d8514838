#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/app/program_fixtures.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class CampaignCommandTest : public ProgramTest {
 protected:
  std::vector<std::string> campaign(std::vector<std::string> more = {}) {
    std::vector<std::string> words{"run", "bench.toml", "--repeat", "3", "-o", "c"};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  }
};

TEST_F(CampaignCommandTest, MeasuresEveryRunAndGivesTheirMean) {
  write_bench({});
  const test::ProgramResult result = abcal(campaign({"--json"}));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const nlohmann::json json = nlohmann::json::parse(result.out);
  EXPECT_EQ(json["schema"], "abcal.campaign/1");
  ASSERT_EQ(json["runs"].size(), 3U);
  ASSERT_EQ(json["estimators"].size(), 3U);
  const nlohmann::json& s_u = json["estimators"][0]["properties"]["s_u"];
  double sum = 0.0;
  for (int k = 1; k <= 3; ++k) {
    const std::string file = "c-" + std::to_string(k) + ".run";
    EXPECT_EQ(json["runs"][static_cast<std::size_t>(k - 1)]["file"], file);
    EXPECT_EQ(RunFile::load(folder / file).state, RunState::kComplete);
    const nlohmann::json run = nlohmann::json::parse(abcal({"analyse", file, "--json"}).out);
    sum += run["intrinsic_sensitivity"][0]["value"].get<double>();
  }
  EXPECT_NEAR(s_u["mean"].get<double>(), sum / 3.0, 1e-12);
  EXPECT_GT(s_u["standard_deviation"].get<double>(), 0.0) << "the runs must not repeat one another's noise";
  EXPECT_GE(s_u["standard_uncertainty"].get<double>(), s_u["type_b"].get<double>());
}

TEST_F(CampaignCommandTest, ShowsASummaryToPeople) {
  write_bench({});
  const test::ProgramResult result = abcal(campaign());
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, AllOf(HasSubstr("Campaign of 3 runs"), HasSubstr("c-3.run: usable"),
                                HasSubstr("Mean of the runs, estimator abc"), HasSubstr("phi_vw")));
}

TEST_F(CampaignCommandTest, EveryItemHasItsMeanAndSpread) {
  std::string text = BenchText().text();
  const std::string accelerometer =
      "[accelerometer]\ndriver = \"microstrain_mip\"\nport = \"simulated\"\nrate_hz = 200.0\n";
  ASSERT_NE(text.find(accelerometer), std::string::npos);
  text.erase(text.find(accelerometer), accelerometer.size());
  for (int k = 1; k <= 2; ++k) text += "[[item]]\n[item." + accelerometer.substr(1);
  test::write_file(folder / "bench.toml", text);
  const test::ProgramResult result = abcal(campaign({"--json"}));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const nlohmann::json json = nlohmann::json::parse(result.out);
  ASSERT_EQ(json["items"].size(), 2U);
  for (std::size_t k = 0; k < 2; ++k) {
    const nlohmann::json& item = json["items"][k];
    ASSERT_EQ(item["runs"].size(), 3U);
    double sum = 0.0;
    for (const nlohmann::json& run : item["runs"]) {
      const nlohmann::json analysed = nlohmann::json::parse(
          abcal({"analyse", run["file"].get<std::string>(), "--item", std::to_string(k + 1), "--json"}).out);
      sum += analysed["intrinsic_sensitivity"][0]["value"].get<double>();
    }
    EXPECT_NEAR(item["estimators"][0]["properties"]["s_u"]["mean"].get<double>(), sum / 3.0, 1e-12);
  }
  EXPECT_THAT(abcal(campaign({"--go-on"})).out, HasSubstr("item 2: Campaign of 3 runs"));
}

TEST_F(CampaignCommandTest, ARemountNeedsATerminal) {
  write_bench({});
  test::Program program(
      "/bin/sh", {"-c", test::abcal_program() + " run bench.toml --repeat 3 -o c --remount < /dev/null"},
      folder.path());
  EXPECT_EQ(program.wait(), 2);
  EXPECT_THAT(program.err(), HasSubstr("not a terminal"));
  EXPECT_FALSE(std::filesystem::exists(folder / "c-1.run"));
}

TEST_F(CampaignCommandTest, KeepsWhatIsMeasuredAndSaysHowToGoOn) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "c-1.run"}).exit_code, 0);
  // Files of a run are never overwritten; --go-on keeps complete runs.
  const test::ProgramResult refused = abcal(campaign());
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, AllOf(HasSubstr("c-1.run: exists already"), HasSubstr("--go-on")));
  const test::ProgramResult result = abcal(campaign({"--go-on"}));
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.err,
              AllOf(HasSubstr("Run 2 of 3"), HasSubstr("Run 3 of 3"), Not(HasSubstr("Run 1 of 3"))));
  // All there: only the summary.
  const test::ProgramResult again = abcal(campaign({"--go-on"}));
  EXPECT_EQ(again.out, result.out);
}

TEST_F(CampaignCommandTest, AFaultEndsItWithTheWayOn) {
  BenchText bench;
  // A run takes some 10 s of simulated time.
  test::write_file(folder / "bench.toml", bench.text() + "[[fault]]\nkind = \"no-output\"\nat_s = 15.0\n");
  const test::ProgramResult result = abcal(campaign());
  EXPECT_EQ(result.exit_code, 3) << result.err;
  EXPECT_THAT(result.err, AllOf(HasSubstr("The campaign ended in run"), HasSubstr("abcal resume c-"),
                                HasSubstr("--repeat 3 -o c --go-on")));
  EXPECT_EQ(result.out, "");
}

TEST_F(CampaignCommandTest, RunsOfAnotherBenchFileAreRefused) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "c-1.run"}).exit_code, 0);
  BenchText other;
  other.simulation = "seed = 5\n";
  write_bench(other);
  const test::ProgramResult result = abcal(campaign({"--go-on"}));
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, HasSubstr("a bench file other than"));
}

}  // namespace
}  // namespace abcal
