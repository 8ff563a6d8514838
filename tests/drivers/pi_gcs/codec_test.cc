#include "drivers/pi_gcs/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace abcal::pi_gcs {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using wire::FrameCheck;

std::vector<std::string> lines_of(std::string_view reply) {
  auto lines = reply_lines(reply);
  EXPECT_TRUE(lines.has_value());
  return lines.value_or(std::vector<std::string>{});
}

TEST(PiGcsCodecTest, CommandsEndWithLineFeedAndSingleBytesDoNot) {
  EXPECT_EQ(command_line("POS? 1"), "POS? 1\n");
  EXPECT_EQ(single_byte(kStopAllAxes), "\x18");
  EXPECT_EQ(single_byte(kAskMotion), "\x05");
}

TEST(PiGcsCodecTest, ADaisyChainedControllerIsNamedFirst) {
  EXPECT_EQ(command_line("MOV 1 5", "2"), "2 MOV 1 5\n");
  const auto lines = reply_lines("0 2 1=10.0000 \n2=20.0000\n", "2");
  ASSERT_TRUE(lines.has_value());
  EXPECT_THAT(*lines, ElementsAre("1=10.0000", "2=20.0000"));
  EXPECT_FALSE(reply_lines("0 3 1=10.0000\n", "2").has_value()) << "another controller answered";
  EXPECT_FALSE(reply_lines("1=10.0000\n", "2").has_value());
}

TEST(PiGcsCodecTest, MovesAreWrittenAsPlainDecimals) {
  EXPECT_EQ(move_command("1", Angle::degrees(14.5)), "MOV 1 14.500000");
  EXPECT_EQ(move_command("2", Angle::degrees(-0.0)), "MOV 2 0.000000");
  EXPECT_EQ(move_command("2", Angle::degrees(-1e-9)), "MOV 2 0.000000");
  EXPECT_EQ(move_command("1", Angle::degrees(1e-5)), "MOV 1 0.000010");  // Not 1e-05.
}

TEST(PiGcsCodecTest, AReplyEndsAtALineFeedThatNoSpacePrecedes) {
  EXPECT_EQ(check_reply("1=1\n"), (wire::FrameVerdict{FrameCheck::kComplete, 4}));
  EXPECT_EQ(check_reply("1=10.0000 \n2=20.0000\n0\n"), (wire::FrameVerdict{FrameCheck::kComplete, 21}));
  EXPECT_EQ(check_reply("1=10.0000 \n"), (wire::FrameVerdict{FrameCheck::kNeedMore, 0}));
  EXPECT_EQ(check_reply(""), (wire::FrameVerdict{FrameCheck::kNeedMore, 0}));
}

TEST(PiGcsCodecTest, AReplyFedByteByByteIsCompleteOnlyAtItsLastByte) {
  const std::string reply = "1=10.0000 \n2=20.0000 \n3=-0.5\n";
  for (std::size_t size = 0; size < reply.size(); ++size) {
    EXPECT_EQ(check_reply(reply.substr(0, size)).check, FrameCheck::kNeedMore) << size;
  }
  EXPECT_EQ(check_reply(reply), (wire::FrameVerdict{FrameCheck::kComplete, reply.size()}));
}

TEST(PiGcsCodecTest, BytesWithoutEndAreNoReply) {
  EXPECT_EQ(check_reply(std::string(kLongestReply - 1, 'u')).check, FrameCheck::kNeedMore);
  EXPECT_EQ(check_reply(std::string(kLongestReply, 'u')).check, FrameCheck::kInvalid);
}

TEST(PiGcsCodecTest, AxisValuesOfOneAndOfManyLinesAreRead) {
  EXPECT_EQ(axis_number(lines_of("1=14.500000\n"), "1"), 14.5);
  const auto both = lines_of("1=10.0000 \n2=20.0000\n");
  EXPECT_EQ(axis_number(both, "1"), 10.0);
  EXPECT_EQ(axis_number(both, "2"), 20.0);
  EXPECT_FALSE(axis_number(both, "3").has_value());
  EXPECT_EQ(axis_number(lines_of("1=10.0000 \r\n2=+2.5e1\r\n"), "2"), 25.0);
  EXPECT_EQ(axis_value(lines_of("1=M-060.PD\n"), "1"), "M-060.PD");
}

TEST(PiGcsCodecTest, AReplyOfAnotherShapeIsNoAnswer) {
  for (const std::string reply :
       {"0\n", "\n", "1\n", "=3\n", "2=14.5\n", "1=\n", "1=1x\n", "1=nan\n", "1=inf\n", "1=+-1\n", "1=++1\n",
        "1=1.5 2.5\n", "1=1 \n0\n", "(c)2013 Physik Instrumente, C-884\n", "\xB1\xFF\n"}) {
    EXPECT_FALSE(axis_number(lines_of(reply), "1").has_value()) << printable(reply);
  }
}

TEST(PiGcsCodecTest, FlagsAreZeroOrOneAndNothingElse) {
  EXPECT_EQ(axis_flag(lines_of("1=1\n"), "1"), true);
  EXPECT_EQ(axis_flag(lines_of("1=0\n"), "1"), false);
  for (const std::string reply : {"1=2\n", "1=1.0\n", "1=\n", "1\n", "11=1\n"}) {
    EXPECT_FALSE(axis_flag(lines_of(reply), "1").has_value()) << printable(reply);
  }
}

TEST(PiGcsCodecTest, ParametersAreFoundByNumberHoweverTheirNameIsWritten) {
  EXPECT_EQ(parameter_number(lines_of("14=10000\n"), 14), 10000.0);
  EXPECT_EQ(parameter_number(lines_of("1 14=10000\n"), 14), 10000.0);
  EXPECT_EQ(parameter_number(lines_of("1 0xE=10000\n"), 14), 10000.0);
  EXPECT_EQ(parameter_number(lines_of("0x0F=1\n"), 15), 1.0);
  EXPECT_FALSE(parameter_number(lines_of("1 15=1\n"), 14).has_value());
}

TEST(PiGcsCodecTest, ParametersMayBeText) {
  EXPECT_EQ(parameter_text(lines_of("1 0x7000601=DEG\n"), 0x7000601), "DEG");
  EXPECT_EQ(parameter_text(lines_of("1 117442049=DEG\n"), 0x7000601), "DEG");
}

TEST(PiGcsCodecTest, ANumberThatNoStageCanHaveIsADamagedReply) {
  EXPECT_EQ(axis_number(lines_of("1=1e9\n"), "1"), 1e9);
  EXPECT_FALSE(axis_number(lines_of("1=1e300\n"), "1").has_value());
  EXPECT_FALSE(axis_number(lines_of("1=-1e300\n"), "1").has_value());
}

TEST(PiGcsCodecTest, ErrorCodesAreWholeNumbersAndHaveWords) {
  EXPECT_EQ(parse_error_code(lines_of("0\n")), 0);
  EXPECT_EQ(parse_error_code(lines_of("15\n")), 15);
  EXPECT_EQ(parse_error_code(lines_of("-7\n")), -7);
  for (const std::string reply : {"\n", "1=0\n", "0x0\n", "0 \n0\n", "0.0\n", "99999999999\n"}) {
    EXPECT_FALSE(parse_error_code(lines_of(reply)).has_value()) << printable(reply);
  }
  EXPECT_EQ(error_text(15), "invalid axis identifier");
  EXPECT_EQ(error_text(5), "move without a reference, or with the servo off");
  EXPECT_EQ(error_text(4711), "unknown error");
}

TEST(PiGcsCodecTest, TheMotionMaskIsHexadecimal) {
  EXPECT_EQ(parse_motion_mask(lines_of("0\n")), 0U);
  EXPECT_EQ(parse_motion_mask(lines_of("A\n")), 10U);
  EXPECT_EQ(parse_motion_mask(lines_of("0x3\n")), 3U);
  for (const std::string reply : {"\n", "G\n", "1=1\n", "-1\n", "1.5\n"}) {
    EXPECT_FALSE(parse_motion_mask(lines_of(reply)).has_value()) << printable(reply);
  }
}

TEST(PiGcsCodecTest, TheStatusWordsAreFourDigitsAnAxis) {
  const auto status = parse_status(lines_of("0x300150041000\n"));
  ASSERT_TRUE(status.has_value());
  ASSERT_EQ(status->size(), 3U);
  EXPECT_TRUE((*status)[0].moving && (*status)[0].servo_on && (*status)[0].negative_limit);
  EXPECT_FALSE((*status)[0].homing || (*status)[0].positive_limit);
  EXPECT_TRUE((*status)[1].homing && (*status)[1].servo_on && (*status)[1].positive_limit);
  EXPECT_FALSE((*status)[1].moving || (*status)[1].negative_limit);
  EXPECT_TRUE((*status)[2].servo_on);
  for (const std::string reply : {"1000\n", "0x\n", "0x100\n", "0x10000\n", "0x100g\n", "0\n", "\n"}) {
    EXPECT_FALSE(parse_status(lines_of(reply)).has_value()) << printable(reply);
  }
}

TEST(PiGcsCodecTest, ReadyIsOneOfTwoBytes) {
  EXPECT_EQ(parse_ready('\xB1'), true);
  EXPECT_EQ(parse_ready('\xB0'), false);
  EXPECT_FALSE(parse_ready('1').has_value());
}

TEST(PiGcsCodecTest, IdentityIsReadInTheNewAndTheOldForm) {
  const auto identity =
      parse_identity(lines_of("(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 123456, 1.2.3\n"));
  ASSERT_TRUE(identity.has_value());
  EXPECT_EQ(identity->maker, "Physik Instrumente (PI) GmbH & Co. KG");
  EXPECT_EQ(identity->model, "C-884.4DC");
  EXPECT_EQ(identity->serial_number, "123456");
  EXPECT_EQ(identity->firmware, "1.2.3");
  const auto old =
      parse_identity(lines_of("(c)2013 Physik Instrumente(PI) Karlsruhe, E-861 Version 7.2.0\n"));
  ASSERT_TRUE(old.has_value());
  EXPECT_EQ(old->maker, "Physik Instrumente(PI) Karlsruhe");
  EXPECT_EQ(old->model, "E-861");
  EXPECT_EQ(old->firmware, "7.2.0");
  EXPECT_EQ(old->serial_number, "");
  const auto sparse = parse_identity(lines_of("(c)Physik Instrumente, E-861  Version  7.2.0\n"));
  ASSERT_TRUE(sparse.has_value());
  EXPECT_EQ(sparse->maker, "Physik Instrumente");
  EXPECT_EQ(sparse->model, "E-861");
  EXPECT_EQ(sparse->firmware, "7.2.0");
}

TEST(PiGcsCodecTest, OtherInstrumentsAreNotTakenForPi) {
  for (const std::string reply :
       {"ESP301 Version 3.0.1 6/1/99\n", "Keysight Technologies,34465A,MY54500001,A.02.14\n",
        "Somebody, not Physik Instrumente, 1\n", "0\n", "\n"}) {
    EXPECT_FALSE(parse_identity(lines_of(reply)).has_value()) << printable(reply);
  }
}

TEST(PiGcsCodecTest, OnlyDegreesAreDegrees) {
  EXPECT_TRUE(is_degrees("DEG"));
  EXPECT_TRUE(is_degrees("deg"));
  EXPECT_FALSE(is_degrees("MM"));
  EXPECT_FALSE(is_degrees("RAD"));
  EXPECT_FALSE(is_degrees(""));
}

TEST(PiGcsCodecTest, BytesInMessagesCanBeRead) {
  EXPECT_EQ(printable("1=1 \n\x18\xB1\r"), "1=1 \\n\\x18\\xb1\\r");
  EXPECT_THAT(printable(std::string(1000, 'u')), HasSubstr("..."));
}

}  // namespace
}  // namespace abcal::pi_gcs
