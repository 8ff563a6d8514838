// Channels between processes: addresses, packets, descriptors that come with them.

#include "app/system/channel.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kMost = 100;

TEST(Channel, ThePathOfASocketMayBeLong) {
  const test::TemporaryFolder folder;
  const std::filesystem::path long_folder = folder / std::string(200, 'x');
  std::filesystem::create_directory(long_folder);
  const Descriptor listener = listen_at(long_folder / "socket", ChannelKind::kPackets, 0600);
  struct stat status {};
  ASSERT_EQ(::stat((long_folder / "socket").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600U);
  EXPECT_FALSE(accept_from(listener)) << "nobody has connected yet";
  const Descriptor ours = connect_to(long_folder / "socket", ChannelKind::kPackets);
  const auto theirs = accept_from(listener);
  ASSERT_TRUE(theirs);
  EXPECT_EQ(peer_user(theirs->number()), ::geteuid());
  EXPECT_FALSE(receive_packet(theirs->number(), kMost)) << "never waits";
  ASSERT_TRUE(send_packet(ours.number(), "a packet"));
  ASSERT_TRUE(wait_until_readable(theirs->number(), 10s));
  EXPECT_EQ(receive_packet(theirs->number(), kMost)->bytes, "a packet");
}

TEST(Channel, AFailureNamesThePathAndTheReason) {
  const test::TemporaryFolder folder;
  const auto failure = [&](const std::filesystem::path& path) -> std::string {
    try {
      (void)connect_to(path, ChannelKind::kBytes);
      return "";
    } catch (const std::system_error& error) {
      return error.what();
    }
  };
  for (const char* path : {"none", "no/folder"})
    EXPECT_EQ(failure(folder / path), (folder / path).string() + ": No such file or directory");
  const std::string too_long(200, 'x');
  EXPECT_EQ(failure(folder / too_long), (folder / too_long).string() + ": File name too long");
  EXPECT_THROW((void)listen_at(folder.path(), ChannelKind::kBytes, 0600), std::system_error);
}

TEST(Channel, APacketThatIsTooLongIsCutAndItsLengthIsKnown) {
  const auto [ours, theirs] = channel_pair(ChannelKind::kPackets, "a test");
  ASSERT_TRUE(send_packet(ours.number(), std::string(kMost + 1, 'x')));
  ASSERT_TRUE(send_packet(ours.number(), "the next"));
  const auto cut = receive_packet(theirs.number(), kMost);
  ASSERT_TRUE(cut);
  EXPECT_EQ(cut->bytes, std::string(kMost, 'x'));
  EXPECT_EQ(cut->length, kMost + 1);
  EXPECT_EQ(receive_packet(theirs.number(), kMost)->bytes, "the next");
}

TEST(Channel, DescriptorsArriveOnlyWhereTheyAreWanted) {
  auto [ours, theirs] = channel_pair(ChannelKind::kPackets, "a test");
  auto [one, other] = channel_pair(ChannelKind::kBytes, "a test");
  std::vector<Descriptor> sent, received;
  sent.push_back(std::move(one));
  ASSERT_TRUE(send_packet(ours.number(), "wanted", sent));
  ASSERT_TRUE(receive_packet(theirs.number(), kMost, &received));
  ASSERT_EQ(received.size(), 1U);
  ASSERT_TRUE(send_packet(ours.number(), "not wanted", sent));
  ASSERT_TRUE(receive_packet(theirs.number(), kMost));
  sent.clear();
  EXPECT_FALSE(wait_until_readable(other.number(), 0ms)) << "the one that was received is open";
  received.clear();
  EXPECT_TRUE(wait_until_readable(other.number(), 10s)) << "no end is open any more";
}

TEST(Channel, TheEndOfTheOtherSideIsNoPacket) {
  auto [ours, theirs] = channel_pair(ChannelKind::kPackets, "a test");
  EXPECT_FALSE(wait_until_readable(theirs.number(), 1ms));
  ours.close();
  EXPECT_TRUE(wait_until_readable(theirs.number(), 10s));
  EXPECT_FALSE(receive_packet(theirs.number(), kMost));
  EXPECT_FALSE(send_packet(theirs.number(), "to nobody"));
}

}  // namespace
}  // namespace abcal
