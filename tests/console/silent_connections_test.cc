#include "app/console/silent_connections.h"

#include <gtest/gtest.h>

#include <vector>

namespace abcal::console {
namespace {

class SilentConnectionsTest : public testing::Test {
 protected:
  SilentConnections::Ticket arrive(const std::string& address) {
    const auto number = static_cast<int>(++arrivals);
    return silent.add(address, [this, number] { ended.push_back(number); });
  }

  SilentConnections silent{{4, 2}};
  std::size_t arrivals = 0;
  std::vector<int> ended;
};

TEST_F(SilentConnectionsTest, TheOldestOfTheAddressThatHasTooManyGivesWay) {
  arrive("a");
  arrive("b");
  arrive("a");
  arrive("a");
  EXPECT_EQ(ended, std::vector<int>{1});
  arrive("b");
  EXPECT_EQ(ended, std::vector<int>{1});
}

TEST_F(SilentConnectionsTest, BeyondAllTheOldestGivesWay) {
  for (const char* address : {"a", "b", "c", "d", "e"}) arrive(address);
  EXPECT_EQ(ended, std::vector<int>{1});
  EXPECT_EQ(silent.size(), 4U);
}

TEST_F(SilentConnectionsTest, WhoHasSaidWhoTheyAreDoesNotCount) {
  const auto first = arrive("a");
  arrive("a");
  silent.remove(first);
  arrive("a");
  EXPECT_TRUE(ended.empty());
}

TEST_F(SilentConnectionsTest, AProxyIsNotLimitedByItself) {
  for (int i = 0; i < 4; ++i) arrive("");
  EXPECT_TRUE(ended.empty());
}

TEST_F(SilentConnectionsTest, ASubscribersNetworkIsOneAddress) {
  EXPECT_EQ(counted_address("192.0.2.1"), "192.0.2.1");
  EXPECT_EQ(counted_address("2001:db8:1:2:3:4:5:6"), counted_address("2001:db8:1:2::9"));
  EXPECT_NE(counted_address("2001:db8:1:2::9"), counted_address("2001:db8:1:3::9"));
}

}  // namespace
}  // namespace abcal::console
