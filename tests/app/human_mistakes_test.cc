// Mistakes that people make in a bench file, as they were written down before any answer was: each is
// answered with the place, what is required, and the line as it may be meant. The other mistakes of a file
// are said at the same time.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/formats/toml_mistake.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

/// One mistake: a line of docs/examples/real.toml, how a person wrote it, and the answer.
struct HumanMistake {
  std::string name;
  std::string good;            ///< The line, without its comment.
  std::string written;         ///< In its place; more than one line is allowed.
  std::string answer;          ///< Words of the answer.
  std::string corrected = {};  ///< The line that is offered; empty: none.
};

std::ostream& operator<<(std::ostream& out, const HumanMistake& mistake) {
  return out << mistake.name;
}

const std::vector<HumanMistake>& human_mistakes() {
  static const std::vector<HumanMistake> mistakes{
      // Numbers as other countries and programs write them.
      {"DecimalComma", "step_deg = 5.0", "step_deg = 5,0", "a decimal comma", "step_deg = 5.0"},
      {"DecimalCommaOfMany", "temperature_degc = 23.0", "temperature_degc = 23,15", "a decimal comma",
       "temperature_degc = 23.15"},
      {"DecimalCommaWithExponent", "position_window_deg = 0.01", "position_window_deg = 1,0e-2",
       "a decimal comma", "position_window_deg = 1.0e-2"},
      {"NoZeroBeforeThePoint", "position_window_deg = 0.01", "position_window_deg = .01",
       "a number as TOML writes it", "position_window_deg = 0.01"},
      {"NoDigitBehindThePoint", "rate_hz = 100.0", "rate_hz = 100.", "a number as TOML writes it",
       "rate_hz = 100.0"},
      {"LeadingZero", "steps = 72", "steps = 072", "a number as TOML writes it", "steps = 72"},
      {"UnitBehindTheNumber", "step_deg = 5.0", "step_deg = 5.0 deg", "\"deg\" behind the number",
       "step_deg = 5.0"},
      {"UnitWithoutASpace", "settle_s = 5.0", "settle_s = 5s", "\"s\" behind the number", "settle_s = 5"},
      {"DegreeSign", "approach_deg = 1.0", "approach_deg = 1.0°", "\"°\" behind the number",
       "approach_deg = 1.0"},
      {"PercentSign", "humidity_percent = 45.0", "humidity_percent = 45 %", "\"%\" behind the number",
       "humidity_percent = 45"},
      {"UnitAndDecimalComma", "rate_hz = 100.0", "rate_hz = 100,0 Hz", "\"Hz\" behind the number",
       "rate_hz = 100.0"},
      {"NumberInQuotes", "steps = 72", "steps = \"72\"", "a whole number", "steps = 72"},
      {"RealNumberInQuotes", "step_deg = 5.0", "step_deg = \"5.0\"", "found \"5.0\"", "step_deg = 5.0"},
      {"NumberWithoutQuotes", "axis = \"1\"", "axis = 1", "text in quotes", "axis = \"1\""},
      {"WholeNumberWithAPoint", "steps = 72", "steps = 72.0", "a whole number"},
      // Truths.
      {"CapitalTrue", "closing_angle = true", "closing_angle = True", "in small letters",
       "closing_angle = true"},
      {"ShoutedFalse", "check_poses = true", "check_poses = FALSE", "in small letters",
       "check_poses = false"},
      {"Yes", "closing_angle = true", "closing_angle = yes", "true or false", "closing_angle = true"},
      {"Off", "check_poses = true", "check_poses = off", "true or false", "check_poses = false"},
      {"TruthInQuotes", "closing_angle = true", "closing_angle = \"true\"", "true or false",
       "closing_angle = true"},
      {"OneForTrue", "closing_angle = true", "closing_angle = 1", "true or false"},
      // Texts.
      {"NoQuotes", "driver = \"pi_gcs\"", "driver = pi_gcs", "text without quotes", "driver = \"pi_gcs\""},
      {"NoQuotesWithSpaces", "name = \"laboratory 1\"", "name = laboratory 1", "text without quotes",
       "name = \"laboratory 1\""},
      {"QuoteNotClosed", "driver = \"pi_gcs\"", "driver = \"pi_gcs", "quote is not closed",
       "driver = \"pi_gcs\""},
      {"MixedQuotes", "driver = \"pi_gcs\"", "driver = \"pi_gcs'", "quote is not closed",
       "driver = \"pi_gcs\""},
      {"TypographicQuotes", "driver = \"pi_gcs\"", "driver = “pi_gcs”", "typographic quotes",
       "driver = \"pi_gcs\""},
      {"GermanQuotes", "driver = \"pi_gcs\"", "driver = „pi_gcs“", "typographic quotes",
       "driver = \"pi_gcs\""},
      {"TypographicApostrophes", "driver = \"pi_gcs\"", "driver = ‘pi_gcs’", "typographic quotes",
       "driver = \"pi_gcs\""},
      {"Backslashes", "name = \"laboratory 1\"", "name = \"C:\\Users\\lab\"", "a backslash",
       "name = 'C:\\Users\\lab'"},
      {"PortOfWindows", "port = \"usb:1A72:1007\"", "port = COM3", "abcal instruments"},
      {"MakerAsTheDriver", "driver = \"pi_gcs\"", "driver = \"PI\"", "one of", "driver = \"pi_gcs\""},
      {"CommaBehindANumber", "steps = 72", "steps = 72,", "a comma at the end", "steps = 72"},
      {"CommaBehindAText", "driver = \"pi_gcs\"", "driver = \"pi_gcs\",", "a comma at the end",
       "driver = \"pi_gcs\""},
      {"KeyOfAnotherSection", "steps = 72", "steps = 72\ntravel_min_deg = -100.0",
       "or [stage.x] or [stage.z]"},
      {"PathWithoutQuotes", "port = \"usb:1A72:1007\"", "port = /dev/ttyUSB0", "text without quotes",
       "port = \"/dev/ttyUSB0\""},
      {"AddressWithoutQuotes", "port = \"usb:1A72:1007\"", "port = 192.168.1.5", "text without quotes",
       "port = \"192.168.1.5\""},
      {"UsbWithoutQuotes", "port = \"usb:1A72:1007\"", "port = usb:1A72:1007", "text without quotes",
       "port = \"usb:1A72:1007\""},
      // Lines.
      {"Colon", "steps = 72", "steps: 72", "key = value", "steps = 72"},
      {"TwoEqualsSigns", "steps = 72", "steps == 72", "key = value", "steps = 72"},
      {"NoEqualsSign", "steps = 72", "steps 72", "no equals sign", "steps = 72"},
      {"NoValue", "steps = 72", "steps =", "no value"},
      {"KeyTwice", "steps = 72", "steps = 72\nsteps = 36", "steps for the second time"},
      {"OpenSection", "[protocol]", "[protocol", "a section, [protocol]", "[protocol]"},
      {"RoundBracketAtTheEnd", "[protocol]", "[protocol)", "a section, [protocol]", "[protocol]"},
      {"OneBracketTooMany", "[protocol]", "[[protocol]", "a section, [[protocol]]", "[[protocol]]"},
      {"SectionWithAColon", "[protocol]", "[protocol]:", "a section, [protocol]", "[protocol]"},
      {"BracketAlone", "[protocol]", "[", "key = value under a [section]"},
      {"TwoBracketsAlone", "[protocol]", "[[", "key = value under a [section]"},
      {"NoKeyInBrackets", "[protocol]", "[@]", "key = value under a [section]"},
      {"SectionTwice", "[protocol]", "[operator]", "operator"},
      // Keys.
      {"KeyWithoutItsUnit", "rate_hz = 100.0", "rate = 100.0", "did you mean \"rate_hz\"", "rate_hz = 100.0"},
      {"GravityWithoutItsUnit", "g_loc_mps2 = 9.81234", "g_loc = 9.81234", "did you mean \"g_loc_mps2\"",
       "g_loc_mps2 = 9.81234"},
      {"SlipOfTheKeyboard", "settle_s = 5.0", "setle_s = 5.0", "did you mean \"settle_s\"", "settle_s = 5.0"},
      {"CapitalKey", "steps = 72", "Steps = 72", "did you mean \"steps\"", "steps = 72"},
      {"UnknownDriver", "driver = \"pi_gcs\"", "driver = \"pi_gsc\"", "one of", "driver = \"pi_gcs\""},
      {"DriverWithAHyphen", "driver = \"microstrain_mip\"", "driver = \"microstrain-mip\"", "one of",
       "driver = \"microstrain_mip\""},
      {"NumberOutOfRange", "steps = 72", "steps = 2", "found 2"},
      {"SignOfTwo", "sign = 1", "sign = 2", "sign"},
  };
  return mistakes;
}

std::string example() {
  return test::read_file(test::source_folder() / "docs/examples/real.toml");
}

/// The example with a line changed.
std::string with(const HumanMistake& mistake) {
  std::string text = example();
  const std::size_t at = text.find("\n" + mistake.good);
  if (at == std::string::npos) return {};
  const std::size_t end = text.find('\n', at + 1);
  return text.replace(at + 1, end - at - 1, mistake.written);
}

std::string answer_to(const std::string& toml) {
  try {
    (void)parse_bench(toml, "my_bench.toml");
  } catch (const BenchError& error) {
    return error.what();
  }
  return "accepted";
}

class HumanMistakesTest : public testing::TestWithParam<HumanMistake> {};
INSTANTIATE_TEST_SUITE_P(All, HumanMistakesTest, testing::ValuesIn(human_mistakes()),
                         [](const auto& test) { return test.param.name; });

TEST_P(HumanMistakesTest, IsAnsweredWithItsLineAndTheRightOne) {
  const std::string text = with(GetParam());
  ASSERT_NE(text, "") << "the example has no line " << GetParam().good;
  const std::string answer = answer_to(text);
  EXPECT_THAT(answer, HasSubstr(GetParam().answer));
  EXPECT_THAT(answer, Not(HasSubstr("Error while parsing"))) << "words of the parser";
  const std::string written = GetParam().written.substr(GetParam().written.rfind('\n') + 1);
  EXPECT_THAT(answer, HasSubstr("\n      " + written)) << "the line itself";
  if (GetParam().corrected.empty()) {
    EXPECT_THAT(answer, Not(HasSubstr("as it may be meant")));
  } else {
    EXPECT_THAT(answer, HasSubstr("\n      " + GetParam().corrected + "   <- as it may be meant"));
  }
}

// A corrected line is accepted: by itself it leaves no mistake in the file, at least none of that line.
TEST_P(HumanMistakesTest, WhatIsOfferedIsAccepted) {
  if (GetParam().corrected.empty()) return;  // Nothing is offered.
  HumanMistake corrected = GetParam();
  corrected.written = corrected.corrected;
  const std::string answer = answer_to(with(corrected));
  if (GetParam().name == "OneBracketTooMany") {  // Two brackets are TOML; this section is no list.
    EXPECT_THAT(answer, HasSubstr("[protocol]"));
  } else {
    EXPECT_EQ(answer, "accepted");
  }
}

TEST(HumanMistakesTest, APortIsOneOfThisComputerAndOfOneInstrument) {
  const auto answer = [](const std::string& name, const std::string& good, const std::string& written) {
    return answer_to(with({name, good, written, ""}));
  };
  EXPECT_THAT(answer("PortOfWindows", "port = \"usb:1A72:1007\"", "port = \"COM3\""),
              AllOf(HasSubstr("line 39, [stage] port: found \"COM3\""), HasSubstr("abcal instruments")));
  EXPECT_THAT(answer("PortOfTheStage", "port = \"usb:199B:3065\"", "port = \"usb:1A72:1007\""),
              AllOf(HasSubstr("[accelerometer] port"), HasSubstr("one port has one instrument")));
}

TEST(HumanMistakesTest, AllMistakesOfAFileAreSaidAtOnce) {
  std::string text = example();
  for (const auto& [good, written] :
       std::vector<std::pair<std::string, std::string>>{{"driver = \"pi_gcs\"", "driver = pi_gcs"},
                                                        {"steps = 72", "steps = 72 angles"},
                                                        {"rate_hz", "rate"},
                                                        {"closing_angle = true", "closing_angle = True"}})
    text.replace(text.find(good), good.size(), written);
  const std::string answer = answer_to(text);
  EXPECT_THAT(answer, HasSubstr("4 problems"));
  for (const char* words : {"text without quotes", "\"angles\" behind the number", "did you mean \"rate_hz\"",
                            "in small letters"})
    EXPECT_THAT(answer, HasSubstr(words));
}

TEST(HumanMistakesTest, ARunFileInThePlaceOfABenchFileIsSaidSo) {
  const std::string answer =
      answer_to(std::string("SQLite format 3\0\x10\0", 18) + std::string(2000, '\x01'));
  EXPECT_THAT(answer, HasSubstr("a run file"));
  EXPECT_THAT(answer, HasSubstr("abcal resume"));
}

TEST(HumanMistakesTest, ALineThatNobodyUnderstandsIsShownAndNothingIsGuessed) {
  std::string text = example();
  text.insert(text.find("steps = 72"), "%% $$ ??\n");
  const std::string answer = answer_to(text);
  EXPECT_THAT(answer, HasSubstr("1 problem\n"));
  EXPECT_THAT(answer, HasSubstr("%% $$ ??"));
  EXPECT_THAT(answer, Not(HasSubstr("as it may be meant")));
}

TEST(HumanMistakesTest, ALineWithBytesForATerminalIsShownWithoutThem) {
  std::string text = example();
  text.insert(text.find("steps = 72"), "key = \x1b[2Jred\n");
  EXPECT_THAT(answer_to(text), Not(HasSubstr("\x1b")));
}

}  // namespace
}  // namespace abcal
