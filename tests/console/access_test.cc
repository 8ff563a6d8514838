#include "app/console/access.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/temporary_folder.h"

namespace abcal::console {
namespace {

Caller local_caller() {
  Caller caller;
  caller.host = "127.0.0.1:8474";
  caller.address = "127.0.0.1";
  caller.port = ":8474";
  caller.loopback = true;
  return caller;
}

TEST(AccessTest, KnowsItsOwnNamesOnly) {
  Caller caller = local_caller();
  for (const char* ours : {"127.0.0.1:8474", "localhost:8474", "LocalHost:8474"}) {
    caller.host = ours;
    EXPECT_EQ(judge({}, caller), Access::kGranted) << ours;
  }
  for (const char* not_ours :
       {"", "127.0.0.1", "127.0.0.1:80", "localhost", "evil.example.org", "localhost:8474.evil.org",
        "evil.example.org:8474", "127.0.0.1:8474@evil.example.org"}) {
    caller.host = not_ours;
    EXPECT_EQ(judge({}, caller), Access::kWrongHost) << not_ours;
  }
}

TEST(AccessTest, ANameGivenByOptionIsOurs) {
  AccessRules rules;
  rules.hosts = {"bench7.example.org", "proxy.example.org:443"};
  Caller caller = local_caller();
  for (const char* ours : {"bench7.example.org", "bench7.example.org:8474", "proxy.example.org:443"}) {
    caller.host = ours;
    EXPECT_EQ(judge(rules, caller), Access::kGranted) << ours;
  }
  caller.host = "bench8.example.org:8474";
  EXPECT_EQ(judge(rules, caller), Access::kWrongHost);
}

TEST(AccessTest, OnlyItsOwnPageMaySteer) {
  Caller caller = local_caller();
  for (const char* ours : {"", "http://127.0.0.1:8474", "https://127.0.0.1:8474"}) {
    caller.origin = ours;
    EXPECT_EQ(judge({}, caller), Access::kGranted) << ours;
  }
  // Also the loopback under another name or port: another program's page.
  for (const char* other : {"null", "http://evil.example.org", "http://127.0.0.1", "http://127.0.0.1:8475",
                            "http://localhost:8474", "file://", "http://127.0.0.1:8474.evil.org"}) {
    caller.origin = other;
    EXPECT_EQ(judge({}, caller), Access::kWrongOrigin) << other;
  }
}

TEST(AccessTest, RequiresTheTokenWhereThereIsOne) {
  AccessRules rules;
  rules.token = "0123456789abcdef";
  Caller caller = local_caller();
  EXPECT_EQ(judge(rules, caller), Access::kNoToken);
  caller.authorization = "Bearer 0123456789abcdef";
  EXPECT_EQ(judge(rules, caller), Access::kGranted);
  for (const char* wrong : {"Bearer ", "Bearer 0123456789abcde", "Bearer 0123456789abcdef0",
                            "0123456789abcdef", "Basic 0123456789abcdef"}) {
    caller.authorization = wrong;
    EXPECT_EQ(judge(rules, caller), Access::kNoToken) << wrong;
  }
  caller.authorization = {};
  caller.cookie = "theme=dark; abcal_token=0123456789abcdef; other=1";
  EXPECT_EQ(judge(rules, caller), Access::kGranted);
  caller.cookie = "xabcal_token=0123456789abcdef";
  EXPECT_EQ(judge(rules, caller), Access::kNoToken);
}

TEST(AccessTest, NoTokenIsNoSecretThatEmptyTextCouldMatch) {
  EXPECT_FALSE(same_secret("", "0123456789abcdef"));
  EXPECT_TRUE(same_secret("0123456789abcdef", "0123456789abcdef"));
}

TEST(AccessTest, TokensAreLongAndNeverTheSame) {
  const std::string one = make_token(), other = make_token();
  EXPECT_EQ(one.size(), 64U);
  EXPECT_NE(one, other);
}

TEST(AccessTest, ATokenFileIsItsOwnersAlone) {
  namespace fs = std::filesystem;
  const test::TemporaryFolder folder;
  const fs::path path = folder / "token";
  const auto problem = [&] {
    try {
      return "read: " + read_token(path);
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
  };
  EXPECT_THAT(problem(), testing::HasSubstr("No such file"));
  std::ofstream(path) << "0123456789abcdef\n";
  fs::permissions(path, fs::perms::owner_read | fs::perms::owner_write | fs::perms::group_read);
  EXPECT_THAT(problem(), testing::HasSubstr("chmod 600"));
  fs::permissions(path, fs::perms::owner_read | fs::perms::owner_write);
  EXPECT_EQ(problem(), "read: 0123456789abcdef");
  std::ofstream(path) << "short\n";
  EXPECT_THAT(problem(), testing::HasSubstr("required: 16 to 256"));
  std::ofstream(path) << "0123456789abcdef; Path=/\n";
  EXPECT_THAT(problem(), testing::HasSubstr("no token"));
}

}  // namespace
}  // namespace abcal::console
