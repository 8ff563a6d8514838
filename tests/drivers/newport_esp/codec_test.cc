#include "drivers/newport_esp/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace abcal::newport_esp {
namespace {

using ::testing::HasSubstr;
using wire::FrameCheck;

TEST(NewportEspCodecTest, CommandsEndWithCarriageReturn) {
  EXPECT_EQ(command_line("VE?"), "VE?\r");
  EXPECT_EQ(command_line(move_command("1", Angle::degrees(5.0))), "1PA5.000000\r");
}

TEST(NewportEspCodecTest, MovesAreWrittenAsPlainDecimals) {
  EXPECT_EQ(move_command("2", Angle::degrees(-0.0)), "2PA0.000000");
  EXPECT_EQ(move_command("2", Angle::degrees(-1e-9)), "2PA0.000000");
  EXPECT_EQ(move_command("1", Angle::degrees(1e-5)), "1PA0.000010");  // Not 1e-05.
  EXPECT_EQ(move_command("1", Angle::degrees(-359.9999996)), "1PA-360.000000");
}

TEST(NewportEspCodecTest, ALineEndsAtAnyOfTheEndsInUse) {
  EXPECT_EQ(check_reply("1\r\n"), (wire::FrameVerdict{FrameCheck::kComplete, 3}));
  EXPECT_EQ(check_reply("1\r"), (wire::FrameVerdict{FrameCheck::kComplete, 2}));
  EXPECT_EQ(check_reply("1\n0\r\n"), (wire::FrameVerdict{FrameCheck::kComplete, 2}));
  EXPECT_EQ(check_reply("\n"), (wire::FrameVerdict{FrameCheck::kComplete, 1}));
  EXPECT_EQ(check_reply(""), (wire::FrameVerdict{FrameCheck::kNeedMore, 0}));
  EXPECT_EQ(check_reply(std::string(kLongestReply - 1, '1')).check, FrameCheck::kNeedMore);
  EXPECT_EQ(check_reply(std::string(kLongestReply, '1')).check, FrameCheck::kInvalid);
}

TEST(NewportEspCodecTest, ALineFedByteByByteIsCompleteOnlyAtItsEnd) {
  const std::string line = "0, 450322, NO ERROR DETECTED\r";
  for (std::size_t size = 0; size < line.size(); ++size)
    EXPECT_EQ(check_reply(line.substr(0, size)).check, FrameCheck::kNeedMore) << size;
  EXPECT_EQ(check_reply(line), (wire::FrameVerdict{FrameCheck::kComplete, line.size()}));
}

// The lines of the EPICS trace and of the manual's examples.
TEST(NewportEspCodecTest, TheRecordedRepliesAreRead) {
  const auto identity = parse_identity("ESP301 Version 3.0.1 6/1/99");
  ASSERT_TRUE(identity.has_value());
  EXPECT_EQ(identity->model, "ESP301");
  EXPECT_EQ(identity->firmware, "3.0.1 6/1/99");

  const auto none = parse_error_report("0, 87498347, NO ERROR DETECTED");
  ASSERT_TRUE(none.has_value());
  EXPECT_EQ(none->code, 0);
  EXPECT_EQ(none->time_stamp, 87498347U);
  EXPECT_EQ(none->text, "NO ERROR DETECTED");
  const auto axis = parse_error_report("9, 87498349, ERROR");
  ASSERT_TRUE(axis.has_value());
  EXPECT_EQ(axis->code, 9);

  EXPECT_EQ(parse_unit("7"), kUnitDegrees);
  EXPECT_EQ(parse_flag("1"), true);
  EXPECT_EQ(parse_flag("0"), false);
  EXPECT_EQ(parse_number("0.00000"), 0.0);
  EXPECT_EQ(parse_number("0.0001"), 0.0001);
  EXPECT_EQ(parse_number("+12.34500"), 12.345);

  const auto stage = parse_stage_identity("URS100BCC, SN12345");
  ASSERT_TRUE(stage.has_value());
  EXPECT_EQ(stage->model, "URS100BCC");
  EXPECT_EQ(stage->serial_number, "12345");
}

TEST(NewportEspCodecTest, LinesOfAnotherShapeAreNoAnswer) {
  for (const char* text : {"", "0", "0,", "0, 1", "0, 1,", "x, 1, NO ERROR", "0, x, NO ERROR", "-1, 1, ERROR",
                           "0, -1, NO ERROR", "99999, 1, ERROR", "ESP301 Version 3.0.1 6/1/99"})
    EXPECT_FALSE(parse_error_report(text).has_value()) << text;
  for (const char* text : {"", "nan", "inf", "1x", "1 2", "1,2", "24H", "+-1", "++1", "1e300", "-1e300"})
    EXPECT_FALSE(parse_number(text).has_value()) << text;
  for (const char* text : {"", "2", "1.0", "01", "-1"}) EXPECT_FALSE(parse_flag(text).has_value()) << text;
  for (const char* text : {"", "12", "-1", "7.0", "deg"}) EXPECT_FALSE(parse_unit(text).has_value()) << text;
  for (const char* text : {"", "ESP", "XPS-C8", "(c)2013 Physik Instrumente, C-884", "ESP200 Version 1"})
    EXPECT_FALSE(parse_identity(text).has_value()) << text;
}

TEST(NewportEspCodecTest, UnprintableLinesAreNoText) {
  EXPECT_EQ(line_text(" 1 \r\n"), "1");
  EXPECT_EQ(line_text("\r\n"), "");
  EXPECT_FALSE(line_text("1\xFF\r\n").has_value());
  EXPECT_FALSE(line_text(std::string_view("\0\r", 2)).has_value());
}

TEST(NewportEspCodecTest, UnsolicitedLinesAreThoseThatEpicsSkips) {
  for (const char* text : {"E35", "E42", "E38 LABEL"}) EXPECT_TRUE(is_unsolicited(text)) << text;
  for (const char* text : {"E34", "E43", "E3", "E350", "ESP301 Version", "38", "", "E"})
    EXPECT_FALSE(is_unsolicited(text)) << text;
}

TEST(NewportEspCodecTest, ErrorCodesHaveWordsAndAnAxis) {
  EXPECT_EQ(error_text(0), "no error");
  EXPECT_EQ(error_text(9), "axis number out of range");
  EXPECT_EQ(error_text(402), "axis 4: amplifier fault");  // Example of the manual.
  EXPECT_EQ(error_text(103), "axis 1: following error");
  EXPECT_EQ(error_text(207), "axis 2: negative software limit");
  EXPECT_THAT(error_text(299), HasSubstr("unknown error"));
  EXPECT_EQ(error_axis(9), 0);
  EXPECT_EQ(error_axis(113), 1);
}

}  // namespace
}  // namespace abcal::newport_esp
