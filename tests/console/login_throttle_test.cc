#include "app/console/login_throttle.h"

#include <gtest/gtest.h>

namespace abcal::console {
namespace {

using namespace std::chrono_literals;

class LoginThrottleTest : public testing::Test {
 protected:
  void fail(int times, const std::string& name = "N. N.", const std::string& address = "192.0.2.1") {
    for (int i = 0; i < times; ++i) throttle.failed(name, address, now);
  }
  Clock::Duration wait(const std::string& name = "N. N.", const std::string& address = "192.0.2.1") {
    return throttle.wait(name, address, now);
  }

  LoginThrottle throttle;
  Clock::Instant now{1h};
};

TEST_F(LoginThrottleTest, FourFailuresCostNothingAndFiveDo) {
  fail(LoginThrottle::kFree - 1);
  EXPECT_LE(wait(), 0s);
  fail(1);
  EXPECT_EQ(wait(), 1s);
  now += 1s;
  EXPECT_LE(wait(), 0s);
}

TEST_F(LoginThrottleTest, EachFurtherFailureTakesTwiceAsLongAtMostAMinute) {
  fail(LoginThrottle::kFree);
  for (const auto expected : {2s, 4s, 8s, 16s, 32s, 60s, 60s, 60s}) {
    fail(1);
    EXPECT_EQ(wait(), expected);
  }
}

TEST_F(LoginThrottleTest, OthersAtOtherAddressesDoNotWait) {
  fail(8);
  EXPECT_LE(wait("N. N.", "192.0.2.2"), 0s) << "the same person elsewhere";
  EXPECT_GT(wait("M. M."), 0s) << "other names at the same address are guesses, too";
}

/// A subscriber has 2^64 addresses of IPv6.
TEST_F(LoginThrottleTest, AnAddressOfIpv6CountsByItsNetwork) {
  for (int i = 0; i < 8; ++i) fail(1, "N. N.", "2001:db8:0:1::" + std::to_string(i));
  EXPECT_GT(wait("N. N.", "2001:db8:0:1:ffff::9"), 0s) << "the same network";
  EXPECT_GT(wait("M. M.", "2001:db8:0:1:ffff::9"), 0s) << "other names there are guesses, too";
  EXPECT_LE(wait("N. N.", "2001:db8:0:2::1"), 0s) << "another network";
}

TEST_F(LoginThrottleTest, ASuccessOrAQuarterOfAnHourMakesUpForFailures) {
  fail(4);
  throttle.succeeded("N. N.", "192.0.2.1");
  now += 16min;
  fail(4);
  EXPECT_LE(wait(), 0s);
}

TEST_F(LoginThrottleTest, AFloodOfNamesIsForgottenFromItsBeginning) {
  for (int i = 0; i < 5000; ++i) {
    now += 1us;
    throttle.failed(std::to_string(i), "192.0.2." + std::to_string(i), now);
  }
  fail(5);
  EXPECT_EQ(wait(), 1s);
}

}  // namespace
}  // namespace abcal::console
