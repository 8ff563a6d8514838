#include "drivers/scpi_voltmeter/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>

namespace abcal::scpi {
namespace {

using ::testing::ElementsAre;
using ::testing::Eq;
using ::testing::Field;
using wire::FrameCheck;
using wire::FrameVerdict;

// Replies as docs/protocols/scpi_voltmeters.md quotes them.
constexpr std::string_view kKeysightScan = "+1.22994148E-02,-4.56000771E-01,+4.90120051E+00";
constexpr std::string_view kKeithleyReading = "+7.22491127E+00VDC,000";

TEST(ScpiReplyTest, EndsAtItsLineFeedHoweverManyBytesCome) {
  const std::string bytes = std::string(kKeysightScan) + "\r\n+0,\"No error\"\n";
  const std::size_t length = kKeysightScan.size() + 2;
  for (std::size_t n = 0; n <= bytes.size(); ++n) {
    const FrameVerdict expected =
        n < length ? FrameVerdict{FrameCheck::kNeedMore, 0} : FrameVerdict{FrameCheck::kComplete, length};
    EXPECT_EQ(check_reply(std::string_view(bytes).substr(0, n)), expected) << n;
  }
  EXPECT_EQ(text_of(bytes.substr(0, length)), kKeysightScan);
  EXPECT_EQ(text_of(bytes.substr(length)), "+0,\"No error\"");
}

TEST(ScpiReplyTest, IsNotEndless) {
  EXPECT_EQ(check_reply(std::string(kLongestReply - 1, '+')).check, FrameCheck::kNeedMore);
  EXPECT_EQ(check_reply(std::string(kLongestReply, '+')).check, FrameCheck::kInvalid);
  EXPECT_EQ(check_reply(std::string(kLongestReply, '+') + "\n").check, FrameCheck::kInvalid);
}

TEST(ScpiIdentityTest, HasFourWords) {
  EXPECT_EQ(parse_identity("HEWLETT-PACKARD,34970A,0,13-2-2"),
            (Identity{"HEWLETT-PACKARD", "34970A", "0", "13-2-2"}));
  EXPECT_EQ(parse_identity("KEITHLEY INSTRUMENTS INC.,MODEL 2700,1234567,B02  /A02"),
            (Identity{"KEITHLEY INSTRUMENTS INC.", "2700", "1234567", "B02  /A02"}));
  EXPECT_EQ(parse_identity("Agilent Technologies, 34972A, MY1, 1.16"),
            (Identity{"Agilent Technologies", "34972A", "MY1", "1.16"}));
  for (const char* text : {"", ",,,", "A,B,C", "A,B,C,D,E", ",34970A,0,1", "A,,0,1", "+0,\"No error\"",
                           "+5.0E-01,101,-2.5E-01,102", "A,B,C,D\x01"})
    EXPECT_EQ(parse_identity(text), std::nullopt) << text;
}

TEST(ScpiErrorTest, HasACodeAndWords) {
  EXPECT_EQ(parse_error("+0,\"No error\""), (ErrorReport{0, "No error"}));
  EXPECT_EQ(parse_error("0, \"no error\""), (ErrorReport{0, "no error"}));
  EXPECT_EQ(parse_error("-222,\"Data out of range\""), (ErrorReport{-222, "Data out of range"}));
  EXPECT_EQ(parse_error("-113,\"Undefined header; \"\"X,Y\"\"\""),
            (ErrorReport{-113, "Undefined header; \"X,Y\""}));
  for (const char* text : {"", "0", "0,", "0,no error", "0,\"", "0,\"no\" error\"", "+-1,\"x\"", "--1,\"x\"",
                           "1.5,\"x\"", "99999999999,\"x\"", "-113,\"x\"y", "HEWLETT-PACKARD,34970A,0,1"})
    EXPECT_EQ(parse_error(text), std::nullopt) << text;
}

TEST(ScpiReadingsTest, AreInTheOrderInWhichTheyCame) {
  EXPECT_THAT(
      parse_readings(kKeysightScan, false),
      Eq(std::vector<ChannelReading>{{0.0122994148, 0, {}}, {-0.456000771, 0, {}}, {4.90120051, 0, {}}}));
  EXPECT_THAT(parse_readings(kKeithleyReading, true), Eq(std::vector<ChannelReading>{{7.22491127, 0, 0}}));
  EXPECT_THAT(parse_readings("+5.0E-01,101,-2.5E-01,102", true),
              Eq(std::vector<ChannelReading>{{0.5, 0, 101}, {-0.25, 0, 102}}));
  EXPECT_THAT(parse_readings("+5.0E-01 VDC,101, 2.5 V , 3", true),
              Eq(std::vector<ChannelReading>{{0.5, 0, 101}, {2.5, 0, 3}}));
}

TEST(ScpiReadingsTest, NameTheChannelsOfA2001) {
  EXPECT_THAT(parse_readings("+1.5000000E+00VDC,01INTCHAN,-2.5000000E+00VDC,10INTCHAN", true),
              Eq(std::vector<ChannelReading>{{1.5, 0, 1}, {-2.5, 0, 10}}));
}

TEST(ScpiIdentityTest, TheWordModelMayBeInAnyCase) {
  EXPECT_EQ(parse_identity("KEITHLEY INSTRUMENTS INC.,Model 2001,4301578,B17  /A02  ")->model, "2001");
  EXPECT_EQ(parse_identity("KEITHLEY INSTRUMENTS INC.,model 2001,4301578,B17  /A02  ")->model, "2001");
}

TEST(ScpiReadingsTest, SayOverload) {
  EXPECT_THAT(parse_readings("+9.90000000E+37,-9.9E37,9.9e+37", false),
              Eq(std::vector<ChannelReading>{{0.0, 1, {}}, {0.0, -1, {}}, {0.0, 1, {}}}));
}

TEST(ScpiReadingsTest, AreRefusedIfOneOfThemIsNone) {
  for (const char* text : {"",
                           ",",
                           "1,",
                           ",1",
                           "1,,2",
                           "nan",
                           "inf",
                           "-inf",
                           "+-1",
                           "1e",
                           "1e999",
                           "9.91E37",
                           "1E31",
                           "0x10",
                           "1 VAC",
                           "1 OHM",
                           "1;2",
                           "1 2",
                           "+",
                           "V",
                           "+0,\"No error\"",
                           "HEWLETT-PACKARD,34970A,0,13-2-2",
                           "#214(@101,102,103)"})
    EXPECT_EQ(parse_readings(text, false), std::nullopt) << text;
  for (const char* text : {"1", "1,101,2", "1,-101", "1,101INT", "1,", "1,123456", "1,1.5", "101 ,1,VDC"})
    EXPECT_EQ(parse_readings(text, true), std::nullopt) << text;
}

TEST(ScpiBlockTest, IsAsLongAsItSays) {
  constexpr std::string_view kScanList = "#214(@101,102,103)";
  EXPECT_EQ(parse_block(kScanList), "(@101,102,103)");
  EXPECT_EQ(parse_block("#13(@)"), "(@)");
  EXPECT_EQ(parse_block("#10"), "");
  EXPECT_EQ(parse_block("#3003abc"), "abc");
  for (std::size_t n = 0; n < kScanList.size(); ++n)
    EXPECT_EQ(parse_block(kScanList.substr(0, n)), std::nullopt) << n;
  for (const char* text :
       {"#215(@101,102,103)", "#213(@101,102,103)", "#0(@)", "#a", "#1x(@)", "(@101)", "#9999999999"})
    EXPECT_EQ(parse_block(text), std::nullopt) << text;
}

TEST(ScpiChannelListTest, IsWrittenAndRead) {
  EXPECT_EQ(channel_list(std::array{101, 102, 103}), "(@101,102,103)");
  EXPECT_THAT(*parse_channel_list("(@101,102,103)"), ElementsAre(101, 102, 103));
  EXPECT_THAT(*parse_channel_list("(@1:3,7)"), ElementsAre(1, 2, 3, 7));
  EXPECT_THAT(*parse_channel_list("(@)"), ElementsAre());
  for (const char* text : {"", "(@", "(@)x", "(@,)", "(@1,)", "(@3:1)", "(@1:)", "(@1:2:3)", "(@-1)", "(@1 )",
                           "(@0:99999)", "101,102"})
    EXPECT_EQ(parse_channel_list(text), std::nullopt) << text;
}

}  // namespace
}  // namespace abcal::scpi
