#include "drivers/zaber_ascii/codec.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace abcal::zaber_ascii {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using wire::FrameCheck;

// Vectors of the zproto library.
TEST(ZaberAsciiCodecTest, TheVectorsOfTheChecksumHold) {
  EXPECT_EQ(checksum("01 tools echo"), 0x8F);
  EXPECT_EQ(command_line("1 tools echo"), "/1 tools echo:BF\n");
  EXPECT_EQ(command_line("get maxspeed"), "/get maxspeed:49\n");
  EXPECT_EQ(command_line("1"), "/1:CF\n");
  EXPECT_EQ(command_line("0 1"), "/0 1:7F\n");
  EXPECT_EQ(command_line("2 1"), "/2 1:7D\n");
  EXPECT_EQ(command(2, 0, 5, "get maxspeed"), "/2 0 5 get maxspeed:52\n");
  EXPECT_EQ(command(0, 0, 5, ""), "/0 0 5:2B\n");
  EXPECT_EQ(command_line("1 tools echo aaaaaaaaaa bbbbbbbbbb ccccccccc dddddddddd eeeeeeeeee\\"),
            "/1 tools echo aaaaaaaaaa bbbbbbbbbb ccccccccc dddddddddd eeeeeeeeee\\:D0\n");
  EXPECT_EQ(command_line("1 cont 1 ffffffffff gggggggggg hhhhhhhhhh iiiiiiiiii jjjjjjjjj"),
            "/1 cont 1 ffffffffff gggggggggg hhhhhhhhhh iiiiiiiiii jjjjjjjjj:24\n");
}

TEST(ZaberAsciiCodecTest, TheParserCasesOfZprotoHold) {
  auto message = parse_message("@01 2 OK IDLE -- 1.2 3.4", false);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(message->kind, MessageKind::kReply);
  EXPECT_EQ(message->device, 1);
  EXPECT_EQ(message->axis, 2);
  EXPECT_FALSE(message->id.has_value());
  EXPECT_TRUE(message->accepted);
  EXPECT_FALSE(message->busy);
  EXPECT_EQ(message->warning, "--");
  EXPECT_EQ(message->data, "1.2 3.4");
  EXPECT_FALSE(message->has_checksum);

  message = parse_message("@01 1 12 RJ IDLE -- BADCOMMAND", false);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(message->id, 12);
  EXPECT_FALSE(message->accepted);
  EXPECT_EQ(message->data, "BADCOMMAND");

  message = parse_message("#01 2", false);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(message->kind, MessageKind::kInfo);
  message = parse_message("#01 2 cont 56 message \\", false);
  ASSERT_TRUE(message.has_value());
  EXPECT_TRUE(message->continues);
  EXPECT_EQ(message->data, "cont 56 message");
  message = parse_message("!01 2 BUSY FF words go here\\", false);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(message->kind, MessageKind::kAlert);
  EXPECT_TRUE(message->busy);
  EXPECT_EQ(message->warning, "FF");

  for (const char* line :
       {"@OK IDLE --", "!01 2 IDLE --- ", " @01 2 OK IDLE -- 0", "@01 2 OK IDLE -- 0 ",
        "@01 2 OK IDLE -- \xFF", "\xFF@01 2 OK IDLE -- 0", "@01 2 OK IDLE --", "@1 2 OK IDLE -- 0",
        "@01 12 OK IDLE -- 0", "@01 2 OK WAIT -- 0", "@01 2 NO IDLE -- 0", "@01 2 OK IDLE F1 0",
        "@01  2 OK IDLE -- 0", "01 2 OK IDLE -- 0", "/01 2 get pos", "@", ""})
    EXPECT_FALSE(parse_message(line, false).has_value()) << line;
}

TEST(ZaberAsciiCodecTest, TheOtherRecordedLinesAreRead) {
  const auto stalled = parse_message("@01 0 OK IDLE FS 10000", false);
  ASSERT_TRUE(stalled.has_value());
  EXPECT_EQ(stalled->warning, "FS");
  EXPECT_TRUE(is_fault(stalled->warning));
  EXPECT_EQ(parse_number(stalled->data), 10000.0);
  EXPECT_TRUE(parse_message("@01 0 OK IDLE -- 0", false).has_value());
}

std::string with_checksum(const std::string& content) {
  return fmt::format("@{}:{:02X}", content, checksum(content));
}

TEST(ZaberAsciiCodecTest, AChecksumIsVerifiedAndMayBeRequired) {
  const auto message = parse_message(with_checksum("01 1 05 OK BUSY WR 123456"), true);
  ASSERT_TRUE(message.has_value());
  EXPECT_TRUE(message->has_checksum);
  EXPECT_EQ(message->data, "123456");
  EXPECT_FALSE(parse_message("@01 1 05 OK BUSY WR 123456", true).has_value());
  EXPECT_FALSE(parse_message("@01 1 05 OK BUSY WR 123456:00", false).has_value());
}

TEST(ZaberAsciiCodecTest, AnySingleByteErrorInAChecksummedReplyIsRejected) {
  for (const std::string& content :
       {std::string("01 1 05 OK IDLE -- 123456"), std::string("02 1 99 OK BUSY WR 02 WR NC"),
        std::string("01 0 42 RJ IDLE -- BADDATA")}) {
    const std::string line = with_checksum(content) + "\r\n";
    for (std::size_t at = 0; at + 2 < line.size(); ++at) {
      for (int value = 0; value < 256; ++value) {
        std::string changed = line;
        changed[at] = static_cast<char>(value);
        if (changed == line) continue;
        // Decodes in the order of the driver: lines, then messages.
        for (std::string_view rest = changed; !rest.empty();) {
          const auto verdict = check_line(rest);
          ASSERT_EQ(verdict.check, FrameCheck::kComplete);
          const auto message = find_message(rest.substr(0, verdict.length), true);
          EXPECT_FALSE(message && message->kind == MessageKind::kReply) << printable(changed);
          rest.remove_prefix(verdict.length);
        }
      }
    }
  }
}

TEST(ZaberAsciiCodecTest, ALineFedByteByByteIsCompleteOnlyAtItsEnd) {
  const std::string line = "@01 0 OK IDLE -- 0\r";
  for (std::size_t size = 0; size < line.size(); ++size)
    EXPECT_EQ(check_line(line.substr(0, size)).check, FrameCheck::kNeedMore) << size;
  EXPECT_EQ(check_line(line), (wire::FrameVerdict{FrameCheck::kComplete, line.size()}));
  EXPECT_EQ(check_line(line + "\n"), (wire::FrameVerdict{FrameCheck::kComplete, line.size() + 1}));
  EXPECT_EQ(check_line(std::string(kLongestLine, '@')).check, FrameCheck::kInvalid);
}

TEST(ZaberAsciiCodecTest, AMessageIsFoundBehindGarbageOnlyIfItsChecksumHolds) {
  const std::string good = with_checksum("01 1 05 OK IDLE -- 1");
  EXPECT_TRUE(find_message("\x75\x65@\xFF" + good + "\r\n", false).has_value());
  EXPECT_TRUE(find_message("@01 1 04 OK ID" + good + "\r\n", true).has_value());
  EXPECT_FALSE(find_message("garbage@01 1 05 OK IDLE -- 1\r\n", false).has_value());
}

TEST(ZaberAsciiCodecTest, WarningsAreCountedFlags) {
  EXPECT_THAT(*parse_warnings("00"), IsEmpty());
  EXPECT_THAT(*parse_warnings("02 WR NC"), ElementsAre("WR", "NC"));
  for (const char* data : {"", "0", "01", "01 WR NC", "02 WR", "01 W", "01 WRX", "1 WR", "WR"})
    EXPECT_FALSE(parse_warnings(data).has_value()) << data;
  EXPECT_EQ(warning_text("FS"), "stalled and stopped");
  EXPECT_EQ(warning_text("ZZ"), "of unknown meaning");
  EXPECT_EQ(rejection_text("STATUSBUSY"), "it is not permitted while the axis moves");
}

TEST(ZaberAsciiCodecTest, NumbersFillTheText) {
  EXPECT_EQ(parse_number("-384000"), -384000.0);
  EXPECT_EQ(parse_number("1.5"), 1.5);
  for (const char* text : {"", "NA", "1 2", "nan", "1x", "1e300"})
    EXPECT_FALSE(parse_number(text).has_value()) << text;
}

}  // namespace
}  // namespace abcal::zaber_ascii
