#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "drivers/wire/byte_stream.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::Pair;

const Clock::Instant kFirst(1s);
const Clock::Instant kSecond(2s);
const Clock::Instant kThird(3s);

std::vector<std::pair<std::string, Clock::Instant>> groups_of(const ReceivedBytes& received) {
  std::vector<std::pair<std::string, Clock::Instant>> groups;
  received.for_each_group([&](std::string_view bytes, Clock::Instant arrival) {
    groups.emplace_back(std::string(bytes), arrival);
  });
  return groups;
}

TEST(ReceivedBytesTest, EachGroupKeepsItsTime) {
  ReceivedBytes received;
  received.append("ab", kFirst);
  EXPECT_THAT(groups_of(received), ElementsAre(Pair("ab", kFirst)));
  received.append("", kSecond);
  received.append("c", kSecond);
  received.append("de", kSecond);
  received.append("f", kThird);
  EXPECT_EQ(received.bytes, "abcdef");
  EXPECT_EQ(received.arrival, kThird);
  EXPECT_THAT(groups_of(received), ElementsAre(Pair("ab", kFirst), Pair("cde", kSecond), Pair("f", kThird)));
}

TEST(ReceivedBytesTest, BytesThatCameTogetherAreOneGroup) {
  ReceivedBytes received;
  received.append("ab", kFirst);
  received.append("c", kFirst);
  EXPECT_THAT(groups_of(received), ElementsAre(Pair("abc", kFirst)));
  EXPECT_THAT(groups_of(ReceivedBytes{{}, kFirst}), ElementsAre(Pair("", kFirst)));
}

TEST(ReceivedBytesTest, TheOldestBytesCanBeDropped) {
  ReceivedBytes received;
  received.append("ab", kFirst);
  received.append("cde", kSecond);
  received.append("f", kThird);
  received.drop_front(3);
  EXPECT_THAT(groups_of(received), ElementsAre(Pair("de", kSecond), Pair("f", kThird)));
  received.drop_front(3);
  received.append("g", kThird);
  EXPECT_THAT(groups_of(received), ElementsAre(Pair("g", kThird)));
}

}  // namespace
}  // namespace abcal::wire
