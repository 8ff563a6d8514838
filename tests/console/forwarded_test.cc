#include "app/console/forwarded.h"

#include <gtest/gtest.h>

namespace abcal::console {
namespace {

const std::vector<std::string> kProxies{"127.0.0.1", "2001:db8::1"};

std::string x_forwarded(std::string_view header) {
  return forwarded_client({{}, header}, kProxies).value_or("nothing");
}
std::string forwarded(std::string_view header) {
  return forwarded_client({header, {}}, kProxies).value_or("nothing");
}

TEST(ForwardedTest, TheLastThatIsNoProxyOfOursIsTheClient) {
  EXPECT_EQ(x_forwarded("192.0.2.1"), "192.0.2.1");
  EXPECT_EQ(x_forwarded("198.51.100.9, 192.0.2.1"), "192.0.2.1")
      << "what stands before, the client may have written";
  EXPECT_EQ(x_forwarded("192.0.2.1, 127.0.0.1, 2001:db8::1"), "192.0.2.1");
  EXPECT_EQ(x_forwarded("192.0.2.1:4711"), "192.0.2.1");
  EXPECT_EQ(x_forwarded("[2001:db8::7]:4711"), "2001:db8::7");
  EXPECT_EQ(x_forwarded("::ffff:192.0.2.1"), "192.0.2.1");
  EXPECT_EQ(forwarded("for=192.0.2.1;proto=https;by=203.0.113.43"), "192.0.2.1");
  EXPECT_EQ(forwarded("for=198.51.100.9, For=\"[2001:db8:cafe::17]:4711\""), "2001:db8:cafe::17");
}

TEST(ForwardedTest, WhatCannotBeReadOrReliedOnIsNothing) {
  for (const char* header :
       {"unknown", "192.0.2.1, unknown", "192.0.2.1,", "localhost", "[::1", "1", "192.0.2.1 192.0.2.2"})
    EXPECT_EQ(x_forwarded(header), "nothing") << header;
  for (const char* header : {"for=_hidden", "for=unknown", "proto=https", "192.0.2.1", "for=192.0.2.1, by=x"})
    EXPECT_EQ(forwarded(header), "nothing") << header;
  EXPECT_FALSE(forwarded_client({{}, {}}, kProxies));
  EXPECT_FALSE(forwarded_client({"for=192.0.2.1", "192.0.2.2"}, kProxies)) << "two that need not agree";
}

TEST(ForwardedTest, AddressesAreWrittenInOneWay) {
  EXPECT_EQ(plain_address("2001:DB8:0::1"), "2001:db8::1");
  EXPECT_EQ(plain_address("::ffff:127.0.0.1"), "127.0.0.1");
  EXPECT_FALSE(plain_address("bench.example.org"));
  EXPECT_FALSE(plain_address(""));
}

}  // namespace
}  // namespace abcal::console
