#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/stage_description_file.h"
#include "tests/support/project_paths.h"
#include "tests/support/test_data.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::string example() {
  std::ifstream file(test::source_folder() / "docs/examples/described_stage.toml");
  return {std::istreambuf_iterator<char>(file), {}};
}

std::string replaced(std::string text, const std::string& what, const std::string& with) {
  const std::size_t at = text.find(what);
  EXPECT_NE(at, std::string::npos) << what;
  return at == std::string::npos ? text : text.replace(at, what.size(), with);
}

std::string problems_of(const std::string& text) {
  std::vector<Problem> problems;
  parse_stage_description(text, "stage.toml", problems);
  return list_of(problems);
}

TEST(StageDescriptionTest, TheExampleAndTheShippedOnesHaveNoProblem) {
  EXPECT_EQ(problems_of(example()), "");
  ASSERT_FALSE(shipped_descriptions().empty());
  for (const ShippedDescription& shipped : shipped_descriptions())
    EXPECT_EQ(problems_of(std::string(shipped.text)), "") << shipped.name;
}

struct BadDescription {
  const char* name;
  const char* what;
  const char* with;
  const char* found;
  const char* required;
};

class BadDescriptionTest : public testing::TestWithParam<BadDescription> {};

TEST_P(BadDescriptionTest, IsRefusedWithLineAndRemedy) {
  const BadDescription& bad = GetParam();
  const std::string problems = problems_of(replaced(example(), bad.what, bad.with));
  EXPECT_THAT(problems, AllOf(HasSubstr("line "), HasSubstr(bad.found), HasSubstr(bad.required)));
}

INSTANTIATE_TEST_SUITE_P(
    All, BadDescriptionTest,
    testing::Values(
        BadDescription{"UnknownField", "+ {speed}", "+ {speeed}", "{speeed}", "{speed}"},
        BadDescription{"UnknownKey", "gap_s = 0.05", "gap_ms = 50", "gap_ms", "gap_s"},
        BadDescription{"UnitWithoutScale", "unit = \"deg\"", "unit = \"count\"", "\"count\" without a scale",
                       "units_per_degree"},
        BadDescription{"OneReplyTwoMeanings", "- {digits2} {text}", "{text}", "can be an acknowledgement too",
                       "no reply fits both"},
        BadDescription{"MotionThatIsRest", "{hex4 none 0002}", "{hex4}", "a reply that is also `moving`",
                       "never taken for rest"},
        BadDescription{"SpeedInAMove", "{angle:.4f}", "{angle:.4f} {speed:.1f}", "{speed} in", "{angle}"},
        BadDescription{"IncrementWithoutItsPath", "{angle:.4f}", "{increment:.4f}", "{increment} in",
                       "{angle}"},
        BadDescription{"NumberInPrepare", "SV {axis} 1", "SV {axis} {angle:.0f}", "{angle} in", "no number"},
        BadDescription{"UnknownFieldInTheHalt", "send = \"HA\"", "send = \"HA {axes}\"", "{axes}", "{axis}"},
        BadDescription{"NoSpoil", "spoil = \" ?\"", "", "[halt] spoil", "half-written command"},
        BadDescription{"IdentityThatIsARefusal", "- 11 {text}", "+ {text} sn={text} fw={text}",
                       "that of the first [[identify]] too", "late replies"},
        BadDescription{"UnknownEmulator", "model = \"RT-2\"\nfirmware", "driver = \"zaber_asci\"\nfirmware",
                       "zaber_asci", "zaber_ascii"},
        BadDescription{"NoHalt", "send = \"HA\"", "", "no command", "a stage that cannot be halted"},
        BadDescription{"NoAcknowledgementOfAMove", "send = \"GO {axis} {angle:.4f}\"\nexpect = \"+\"",
                       "send = \"GO {axis} {angle:.4f}\"", "which nothing acknowledges", "read_back"},
        BadDescription{"NoAcknowledgementOfAHalt", "stopped = \"+ {hex4 none 0002}\"", "", "[status] stopped",
                       "text in quotes"},
        BadDescription{"ContinuousWithoutWrap", "wraps_deg = 360 ", "# ", "true without wraps_deg",
                       "wraps_deg = 360"},
        BadDescription{"WrapWithoutPath", "path = \"shortest\"", "", "360 without path", "path = "},
        BadDescription{"MoveWithoutAngle", "GO {axis} {angle:.4f}", "GO {axis}", "no command with {angle}",
                       "[[move]]"},
        BadDescription{"NumberWithoutDecimals", "{angle:.4f}", "{angle}", "the decimals", "{angle:.4f}"},
        BadDescription{"NoAxis", "PO {axis}", "PO", "without {axis}", "names with one name"},
        BadDescription{"NoSource", "sources = [\"RT-2 two-axis table, remote control (made up)\"]", "",
                       "sources", "where the facts are from"},
        BadDescription{"MaskInPlaceOfBits", "+ {hex4 some 0002}", "+ {decimal some 2}", "{decimal some 2}",
                       "{decimal some bits 0 3}"},
        BadDescription{"SilentSpeed", "send = \"VE {axis} {speed:.3f}\"\nexpect = \"+\"",
                       "send = \"VE {axis} {speed:.3f}\"\nsilent = true", "true in [[set_speed]]",
                       "read_back"},
        BadDescription{"SilentAndAcknowledged", "send = \"GO {axis} {angle:.4f}\"",
                       "send = \"GO {axis} {angle:.4f}\"\nsilent = true", "true, and expect or read_back",
                       "one of"},
        BadDescription{"SilentWithoutAQuestion", "send = \"GO {axis} {angle:.4f}\"\nexpect = \"+\"",
                       "send = \"GO {axis} {angle:.4f}\"\nsilent = true", "commands with silent = true",
                       "[error_query]"},
        BadDescription{"ErrorThatIsNone", "[halt]",
                       "[error_query]\nsend = \"ER\"\nnone = \"0\"\n[[error_query.fault]]\nexpect = "
                       "\"{digits}\"\nfault = \"refused\"\n[halt]",
                       "can be `none` too", "no reply fits both"},
        BadDescription{"HalfCommandInAGap", "spoil = \" ?\"", "half_command = \"executed\"",
                       "with [transport] gap_s", "spoil"},
        BadDescription{"HalfCommandAndSpoil", "spoil = \" ?\"", "spoil = \" ?\"\nhalf_command = \"executed\"",
                       "\"executed\", and spoil", "half_command alone"},
        BadDescription{"PlaceInAnAcknowledgement", "send = \"GO {axis} {angle:.4f}\"\nexpect = \"+\"",
                       "send = \"GO {axis} {angle:.4f}\"\nexpect = \"{before ,}+{after ,}\"",
                       "a reply for all axes", "[status]"},
        BadDescription{"PlaceInMotionOnly", "moving = \"+ {hex4 some 0002}\"",
                       "moving = \"{before}{hex1 some 2}{after}\"", "in one of moving and stopped",
                       "in both"},
        BadDescription{"ByHandAndASearch", "send = \"ST {axis}\"\nyes",
                       "send = \"ST {axis}\"\nby_hand = true\nyes", "true, and always or [[home]]",
                       "one of them"},
        BadDescription{"SpeedThatNoMoveCarries", "send = \"VE {axis}\"\nexpect = \"+ {speed}\"",
                       "deg_per_s = 10", "deg_per_s", "a [[move]] with {speed}"},
        BadDescription{"AllAnglesWithoutPlaces", "{angle:.4f}", "{angles:.4f}", "with {angles} in [[move]]",
                       "{before ,} and {after ,}"},
        BadDescription{"AnswerThatIsTheLastLine", "reply_s = 1.0",
                       "reply_s = 1.0\nlast_line = \"+ {number}\"", "the last line of a reply too",
                       "no reply fits both"},
        BadDescription{"LimitThatIsNoPowerOfTen", "+ {hex4 none 0002}", "+ {number below 0.02}",
                       "{number below 0.02}", "0.01"},
        BadDescription{"ByteAbove255", "send = \"HA\"", "raw = \"\\u0100\"", "above U+00FF", "0x85"},
        BadDescription{"WrongSchema", "abcal.stage/1", "abcal.stage/9", "abcal.stage/9", "abcal.stage/1"}),
    [](const auto& one) { return std::string(one.param.name); });

TEST(StageDescriptionTest, AllProblemsAreReportedAtOnce) {
  std::string text = replaced(example(), "+ {speed}", "+ {speeed}");
  text = replaced(text, "gap_s = 0.05", "gap_ms = 50");
  text = replaced(text, "send = \"HA\"", "");
  EXPECT_THAT(problems_of(text),
              AllOf(HasSubstr("speeed"), HasSubstr("gap_ms"), HasSubstr("cannot be halted")));
}

TEST(StageDescriptionTest, AScaleIsStatedOnceAndAPlaceHasAName) {
  std::string text = replaced(example(), "unit = \"deg\"", "unit = \"count\"\nunits_per_degree = 10");
  text = replaced(text, "[halt]", "[scale]\nin_bench_file = true\n[halt]");
  EXPECT_THAT(problems_of(text), AllOf(HasSubstr("10, and [scale]"), HasSubstr("one of both")));
  text = replaced(example(), "names = [\"O\", \"I\"]", "names = [\"O\"]");
  text = replaced(text, "+ {angle}", "{before ,}{angle}{after ,}");
  EXPECT_THAT(problems_of(text),
              AllOf(HasSubstr("without the names of the axes"), HasSubstr("in the order of its replies")));
}

TEST(StageDescriptionTest, ABenchStatesTheScaleThatItsDescriptionLeavesOpen) {
  const auto words = [](const std::string& axis) -> std::string {
    try {
      const BenchConfig config = parse_bench(
          "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"described\"\nport = \"simulated\"\n"
          "description = \"owis_ps90\"\n[stage.x]\naxis = \"1\"\n" +
              axis + "[stage.z]\naxis = \"2\"\n" + axis + "[accelerometer]\ndriver = \"simulated\"\n",
          "bench");
      return parse_bench(write_bench(config), "run") == config ? "same" : "other";
    } catch (const BenchError& error) {
      return error.what();
    }
  };
  EXPECT_EQ(words("units_per_degree = 1234.5\n"), "same");
  EXPECT_THAT(words(""), AllOf(HasSubstr("[stage.x] units_per_degree"), HasSubstr("motor, gear and steps")));
}

constexpr const char* kBench =
    "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"described\"\nport = \"simulated\"\n"
    "description = \"zaber_ascii\"\n[accelerometer]\ndriver = \"simulated\"\n";

TEST(StageDescriptionTest, ABenchKeepsTheTextOfItsDescription) {
  const BenchConfig config = parse_bench(kBench, "bench");
  EXPECT_THAT(config.stage.description_text, HasSubstr("get limit.cycle.dist"));
  const BenchConfig again = parse_bench(write_bench(config), "run");
  EXPECT_EQ(again.stage.description_text, config.stage.description_text);
  EXPECT_EQ(stage_description_of(again.stage).sha256, stage_description_of(config.stage).sha256);
}

TEST(StageDescriptionTest, ABenchWithoutItOrWithABadOneIsRefused) {
  const auto words = [](const std::string& text) -> std::string {
    try {
      parse_bench(text, "bench");
    } catch (const BenchError& error) {
      return error.what();
    }
    return {};
  };
  EXPECT_THAT(words(replaced(kBench, "description = \"zaber_ascii\"\n", "")),
              HasSubstr("[stage] description"));
  EXPECT_THAT(words(replaced(kBench, "\"zaber_ascii\"", "\"zaber_asci\"")),
              AllOf(HasSubstr("zaber_asci"), HasSubstr("one of \"acutrol3000\"")));
  EXPECT_THAT(words(replaced(kBench, "\"described\"", "\"zaber_ascii\"")),
              HasSubstr("driver = \"described\""));
}

// Every command of the example is in the manual that it describes.
TEST(StageDescriptionTest, TheExampleSaysWhatItsManualSays) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "described/manual.md");
  std::ifstream file(path);
  const std::string manual{std::istreambuf_iterator<char>(file), {}};
  std::vector<Problem> problems;
  const StageDescription description = parse_stage_description(example(), "example", problems);
  std::vector<DescribedExchange> all = description.identify;
  for (const auto* more :
       {&description.prepare, &description.home, &description.move, &description.set_speed})
    all.insert(all.end(), more->begin(), more->end());
  all.push_back(description.position);
  all.push_back(description.status);
  for (const DescribedExchange& each : all) {
    const std::string command = each.send.text().substr(0, 2);
    EXPECT_THAT(manual, HasSubstr("| `" + command)) << each.send.text();
  }
  EXPECT_THAT(manual, HasSubstr("| `" + description.halt.substr(0, 2)));
}

}  // namespace
}  // namespace abcal
