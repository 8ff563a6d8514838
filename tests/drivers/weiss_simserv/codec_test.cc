#include "drivers/weiss_simserv/codec.h"

#include <gtest/gtest.h>

namespace abcal::weiss_simserv {
namespace {

// The lines of docs/protocols/weiss_simserv.md, as hosts sent them.
TEST(WeissCodecTest, RequestsAreThoseOfTheHosts) {
  EXPECT_EQ(simserv_request(11004, {"1"}),
            "11004\xB6"
            "1\xB6"
            "1\r");
  EXPECT_EQ(simserv_request(11001, {"1", "-40"}),
            "11001\xB6"
            "1\xB6"
            "1\xB6"
            "-40\r");
  EXPECT_EQ(slope_command(1, 1.0, 0.0), "$01U 0001.0 0000.0 0000.0 0000.0\r");
  const auto reply = parse_simserv(
      "1\xB6"
      "22.9");
  ASSERT_TRUE(reply);
  EXPECT_EQ(reply->values, std::vector<std::string>{"22.9"});
  EXPECT_EQ(parse_simserv("-5")->code, -5);
  for (const char* line : {"", "x", "2", "0",
                           "1x\xB6"
                           "3"})
    EXPECT_FALSE(parse_simserv(line)) << line;
}

TEST(WeissCodecTest, NumbersOfAllChambersAreRead) {
  EXPECT_EQ(parse_number("-040.0"), -40.0);
  EXPECT_EQ(parse_number("0-40.0"), -40.0);
  EXPECT_EQ(parse_number("0023.4"), 23.4);
  EXPECT_EQ(parse_number("0000.0"), 0.0);
  for (const char* text : {"", "-", "0-", "--4", "4x", "nan", "1e3"})
    EXPECT_FALSE(parse_number(text)) << text;
}

TEST(WeissCodecTest, TheLayoutIsTheChambers) {
  const std::string text =
      "EXAMPLE OF AN ASCII E-STRING\r\n$01E CV01 CV02 SV01 MV01 DO00 DO01 DO02 <CR>\r\n"
      "CV01  value min:  -77.0   Value max:  182.0   Temperature\r\nCV02  value min: 0.0 Value max: 100.0 "
      "Humidity\r\n"
      "DO00  unused\r\nDO01  Start\r\nDO02  Humidity\r\n"
      "$01I<CR>\r\nCV01 CV01 CV02 CV02 SV01 MV01 MV01 DO00 DO01 DO02 DESCRIPTION:\r\n";
  const auto layout = parse_layout(text);
  ASSERT_TRUE(layout);
  EXPECT_EQ(layout->set_order.size(), 4U);
  EXPECT_EQ(layout->state_order.size(), 7U);
  EXPECT_EQ(layout->channels, 3U);
  EXPECT_EQ(layout->least_set_degc, -77.0);
  EXPECT_EQ(layout->start_channel, 1U);
  EXPECT_EQ(layout->humidity, 2U);
  const auto state = parse_state("0050.0 0024.6 0080.0 0066.7 0090.0 0000.0 0023.8 010");
  ASSERT_TRUE(state);
  EXPECT_EQ(values_of(*layout, *state, "CV01"), (std::vector<double>{50.0, 24.6}));
  EXPECT_EQ(set_command(1, *layout, *state, -40.0, "000"), "$01E -040.0 0080.0 0090.0 0000.0 000\r");
  EXPECT_FALSE(parse_layout("ASCII description of the protocol\r\n"));
}

}  // namespace
}  // namespace abcal::weiss_simserv
