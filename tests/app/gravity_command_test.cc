// abcal gravity as its users call it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "app/bench_file/bench_config.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using Json = nlohmann::json;

class GravityCommand : public testing::Test {
 protected:
  ProgramResult gravity(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "gravity");
    return test::run_program(arguments, folder.path());
  }
  test::TemporaryFolder folder;
};

constexpr const char* kInstruments =
    "[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n"
    "[accelerometer]\ndriver = \"microstrain_mip\"\nport = \"simulated\"\n";

TEST_F(GravityCommand, PrintsTheListedDigitsOfEveryFormula) {
  const std::vector<std::pair<std::string, std::string>> listed{{"grs80", "9.8124921225"},
                                                                {"wgs84", "9.8124906900"},
                                                                {"WELMEC", "9.8124837099"},
                                                                {"npl", "9.8124926597"}};
  for (const auto& [formula, value] : listed) {
    const ProgramResult result = gravity({"--latitude", "52.3", "--height", "80", "--formula", formula});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_THAT(result.out, HasSubstr("g_loc  " + value + " m/s2"));
    EXPECT_THAT(result.err, AllOf(HasSubstr("warning"), HasSubstr("survey")));
  }
}

TEST_F(GravityCommand, JsonHoldsTheUncertaintyAndTheWarning) {
  const ProgramResult result = gravity({"--latitude", "-45", "--height", "1000", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.err, "");
  const Json json = Json::parse(result.out);
  EXPECT_EQ(json["schema"], "abcal.gravity/1");
  EXPECT_EQ(json["formula"], "GRS80");
  const double value = json["g_loc"]["value"];
  EXPECT_NEAR(value, 9.8031143762, 0.5e-10);
  EXPECT_NEAR(json["g_loc"]["half_width"], 5e-5 * value, 1e-12);
  EXPECT_NEAR(json["g_loc"]["standard_uncertainty"], 5e-5 * value / std::sqrt(3.0), 1e-12);
  EXPECT_THAT(json["warning"], HasSubstr("survey"));
}

// The piece for the bench file and latitude and height in a bench file must mean the same.
TEST_F(GravityCommand, ThePieceForTheBenchFileReadsBack) {
  const ProgramResult result = gravity({"--latitude", "39.1333", "--height", "130", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const std::string piece = Json::parse(result.out)["bench"];
  const BenchConfig pasted = parse_bench(piece + kInstruments, "pasted");
  const BenchConfig formula =
      parse_bench("[bench]\nlatitude_deg = 39.1333\nheight_m = 130\n" + std::string(kInstruments), "formula");
  EXPECT_NEAR(pasted.g_loc.value_mps2, formula.g_loc.value_mps2, 0.5e-10);
  EXPECT_NEAR(pasted.g_loc.expanded_uncertainty_mps2, formula.g_loc.expanded_uncertainty_mps2, 0.5e-7);
  EXPECT_EQ(pasted.g_loc.coverage_factor, formula.g_loc.coverage_factor);
  EXPECT_EQ(pasted.g_loc.source, formula.g_loc.source);
}

TEST_F(GravityCommand, RefusesWhatIsNotAPlace) {
  const ProgramResult both = gravity({"--latitude", "91", "--height", "100000"});
  EXPECT_EQ(both.exit_code, 2);
  EXPECT_EQ(both.out, "");
  EXPECT_THAT(both.err, AllOf(HasSubstr("latitude 91"), HasSubstr("-90 to 90"), HasSubstr("height 100000"),
                              HasSubstr("-500 to 9000")));
  EXPECT_EQ(gravity({"--latitude", "nan", "--height", "0"}).exit_code, 2);
  EXPECT_EQ(gravity({"--latitude", "N52", "--height", "0"}).exit_code, 2);
  EXPECT_EQ(gravity({"--latitude", "52"}).exit_code, 2);
  const ProgramResult unknown = gravity({"--latitude", "52", "--height", "0", "--formula", "egm2008"});
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_THAT(unknown.err, AllOf(HasSubstr("--formula"), HasSubstr("grs80")));
}

}  // namespace
}  // namespace abcal
