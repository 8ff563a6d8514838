#include "drivers/newport_xps/codec.h"

#include <gtest/gtest.h>

namespace abcal::newport_xps {
namespace {

using wire::FrameCheck;

constexpr std::string_view kPosition = "0,12.5,-3.25,EndOfAPI";

TEST(NewportXpsCodecTest, AReplyEndsWithItsEndAndNotBefore) {
  for (std::size_t length = 0; length < kPosition.size(); ++length)
    EXPECT_EQ(check_reply(kPosition.substr(0, length)).check, FrameCheck::kNeedMore) << length;
  const std::string two = std::string(kPosition) + "0,,EndOfAPI";
  EXPECT_EQ(check_reply(two), (wire::FrameVerdict{FrameCheck::kComplete, kPosition.size()}));
  EXPECT_EQ(check_reply(std::string(kLongestReply, 'x')).check, FrameCheck::kInvalid);
}

TEST(NewportXpsCodecTest, ReadsCodeAndValues) {
  const auto position = parse_reply(kPosition);
  ASSERT_TRUE(position);
  EXPECT_EQ(position->code, 0);
  EXPECT_EQ(position->values, "12.5,-3.25");
  EXPECT_EQ(parse_numbers(position->values, 2), (std::vector{12.5, -3.25}));
  EXPECT_FALSE(parse_numbers(position->values, 1));
  EXPECT_FALSE(parse_numbers(position->values, 3));

  const auto nothing = parse_reply("0,,EndOfAPI");
  ASSERT_TRUE(nothing);
  EXPECT_EQ(nothing->values, "");

  const auto error = parse_reply("-22,GroupInitialize(G),EndOfAPI");
  ASSERT_TRUE(error);
  EXPECT_EQ(error->code, -22);
  EXPECT_EQ(error->values, "GroupInitialize(G)");
}

TEST(NewportXpsCodecTest, WhatIsNoReplyIsNotTakenForOne) {
  EXPECT_FALSE(parse_reply(",,EndOfAPI"));
  EXPECT_FALSE(parse_reply("zero,1,EndOfAPI"));
  EXPECT_FALSE(parse_reply("7,1,EndOfAPI"));  // The only positive error is 1, TCL.
  EXPECT_FALSE(parse_reply("-99999,1,EndOfAPI"));
  EXPECT_FALSE(parse_reply("0,1\x01,EndOfAPI"));
  EXPECT_FALSE(parse_reply("0,1,EndOfAP"));
  EXPECT_FALSE(parse_numbers("1e300", 1));
  EXPECT_FALSE(parse_numbers("nan", 1));
  EXPECT_FALSE(parse_numbers("", 1));
  EXPECT_FALSE(parse_state("-1"));
  EXPECT_FALSE(parse_state("12.0"));
}

TEST(NewportXpsCodecTest, ReadsIdentities) {
  const auto c8 = parse_identity("XPS-C8 Firmware V2.6.0");
  ASSERT_TRUE(c8);
  EXPECT_EQ(c8->model, "XPS-C8");
  EXPECT_EQ(c8->firmware, "V2.6.0");
  const auto d = parse_identity("XPS-D-N13006");
  ASSERT_TRUE(d);
  EXPECT_EQ(d->model, "XPS-D-N13006");
  EXPECT_EQ(d->firmware, "");
  EXPECT_FALSE(parse_identity("ESP301 Version 3.0"));
}

TEST(NewportXpsCodecTest, StatesMeanWhatTheManualSays) {
  EXPECT_EQ(meaning_of(0), GroupState::kNotInitialised);
  EXPECT_EQ(meaning_of(7), GroupState::kNotInitialised);
  EXPECT_EQ(meaning_of(10), GroupState::kReady);
  EXPECT_EQ(meaning_of(12), GroupState::kReady);
  EXPECT_EQ(meaning_of(20), GroupState::kDisabled);
  EXPECT_EQ(meaning_of(38), GroupState::kDisabled);
  EXPECT_EQ(meaning_of(42), GroupState::kNotReferenced);
  EXPECT_EQ(meaning_of(43), GroupState::kHoming);
  EXPECT_EQ(meaning_of(44), GroupState::kMoving);
  EXPECT_EQ(meaning_of(51), GroupState::kMoving);
  EXPECT_EQ(state_text(44), "moving");
  EXPECT_EQ(error_text(-35), "the target is outside the travel limits");
}

}  // namespace
}  // namespace abcal::newport_xps
