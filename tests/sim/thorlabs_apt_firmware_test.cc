#include "sim/firmware/thorlabs_apt_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::Each;
using testing::SizeIs;

struct AptMessage {
  unsigned id;
  unsigned source;
  unsigned second;  ///< Second parameter of a message without data.
  std::string data;
};

unsigned apt_word(const std::string& bytes, std::size_t at) {
  return static_cast<unsigned char>(bytes.at(at)) + 256U * static_cast<unsigned char>(bytes.at(at + 1));
}
std::int32_t apt_long(const std::string& bytes, std::size_t at) {
  return static_cast<std::int32_t>(apt_word(bytes, at) + 65536U * apt_word(bytes, at + 2));
}

/// Reads whole messages.
std::vector<AptMessage> apt_messages(const std::string& bytes) {
  std::vector<AptMessage> messages;
  for (std::size_t at = 0; at < bytes.size();) {
    const bool long_form = static_cast<unsigned char>(bytes.at(at + 4)) >= 0x80U;
    const std::size_t size = long_form ? apt_word(bytes, at + 2) : 0U;
    messages.push_back({apt_word(bytes, at), static_cast<unsigned char>(bytes.at(at + 5)),
                        static_cast<unsigned char>(bytes.at(at + 3)), bytes.substr(at + 6, size)});
    at += 6 + size;
  }
  return messages;
}

std::string apt_short(unsigned id, unsigned first = 1, unsigned second = 0, unsigned destination = 0x21) {
  return {static_cast<char>(id % 256U), static_cast<char>(id / 256U),   static_cast<char>(first),
          static_cast<char>(second),    static_cast<char>(destination), '\x01'};
}
std::string apt_data(unsigned id, const std::string& data, unsigned destination = 0x21) {
  return apt_short(id, static_cast<unsigned>(data.size()), 0, destination + 0x80U) + data;
}
std::string apt_position(std::int32_t counts) {
  std::string data("\x01\0", 2);
  for (int n = 0; n < 4; ++n) data.push_back(static_cast<char>(static_cast<std::uint32_t>(counts) >> 8 * n));
  return data;
}

class ThorlabsAptFirmwareTest : public testing::Test {
 protected:
  explicit ThorlabsAptFirmwareTest(ThorlabsAptSettings settings = {})
      : bench(std::make_shared<SimBench>(BenchTruth{})),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  std::vector<AptMessage> ask(const std::string& bytes) { return apt_messages(host.exchange(bytes)); }
  std::vector<AptMessage> listen(Clock::Duration time) { return apt_messages(host.listen(time)); }
  std::int32_t counts() { return apt_long(ask(apt_short(0x0411)).at(0).data, 2); }

  std::shared_ptr<SimBench> bench;
  ThorlabsAptFirmware firmware;
  FirmwareHost host;
};

TEST_F(ThorlabsAptFirmwareTest, TheStatusComesTenTimesASecondOnceItIsStarted) {
  EXPECT_THAT(listen(seconds(1)), SizeIs(0));
  host.send(apt_short(0x0011, 0, 0));
  host.send(apt_short(0x0443));
  std::vector<unsigned> bits;
  for (const AptMessage& message : listen(seconds(2) + milliseconds(5))) {
    if (message.id != 0x0491) continue;
    EXPECT_EQ(message.source, 0x21U);
    ASSERT_THAT(message.data, SizeIs(14));
    bits.push_back(static_cast<unsigned>(apt_long(message.data, 10)));
  }
  ASSERT_EQ(bits.size(), 20U);
  EXPECT_EQ(bits.front() & 0x600U, 0x200U) << "homing";
  EXPECT_EQ(bits.back() & 0x600U, 0x400U) << "homed";
  host.send(apt_short(0x0012, 0, 0));
  EXPECT_THAT(listen(seconds(1)), SizeIs(0));
}

TEST_F(ThorlabsAptFirmwareTest, WithoutServerAliveTheStatusEndsAfterFiftyMessages) {
  host.send(apt_short(0x0011, 0, 0, 0x11));  // the rack: both bays
  EXPECT_THAT(listen(seconds(20)), SizeIs(100));
  host.send(apt_short(0x0492, 0, 0));
  const auto more = listen(seconds(1));
  EXPECT_THAT(more, SizeIs(testing::AllOf(testing::Ge(10U), testing::Le(11U))));
  EXPECT_THAT(more, Each(testing::Field(&AptMessage::source, 0x21U)));
}

TEST_F(ThorlabsAptFirmwareTest, JogsByItsStepOrUntilItIsStopped) {
  const auto jog = ask(apt_short(0x0417)).at(0);
  EXPECT_EQ(jog.id, 0x0418U);
  ASSERT_THAT(jog.data, SizeIs(22));
  const std::int32_t step = apt_long(jog.data, 4);
  EXPECT_GT(step, 0);
  host.send(apt_short(0x046A, 1, 2));
  const auto done = listen(seconds(5));
  ASSERT_THAT(done, SizeIs(1));
  EXPECT_EQ(done[0].id, 0x0464U);
  EXPECT_EQ(counts(), -step);
  std::string continuous = jog.data;
  continuous[2] = '\x01';
  host.send(apt_data(0x0416, continuous));
  host.send(apt_short(0x046A, 1, 1));
  EXPECT_THAT(listen(seconds(2)), SizeIs(0));
  EXPECT_EQ(static_cast<unsigned>(apt_long(ask(apt_short(0x0429)).at(0).data, 2)) & 0xC0U, 0x40U)
      << "jogging";
  host.send(apt_short(0x0465, 1, 2));
  EXPECT_EQ(listen(seconds(5)).at(0).id, 0x0466U);
}

TEST_F(ThorlabsAptFirmwareTest, AMoveWithoutDataGoesWhereItWasSet) {
  host.send(apt_data(0x0450, apt_position(10000)));
  EXPECT_EQ(apt_long(ask(apt_short(0x0451)).at(0).data, 2), 10000);
  host.send(apt_short(0x0453));
  listen(seconds(5));
  EXPECT_EQ(counts(), 10000);
  host.send(apt_data(0x0445, apt_position(-4000)));
  EXPECT_EQ(apt_long(ask(apt_short(0x0446)).at(0).data, 2), -4000);
  host.send(apt_short(0x0448));
  listen(seconds(5));
  EXPECT_NEAR(counts(), 6000, 1);  // The encoder rounds.
}

// Sizes as thorlabs-apt-protocol reads them.
TEST_F(ThorlabsAptFirmwareTest, ParametersHaveTheSizesThatHostsRead) {
  struct Size {
    unsigned request;
    std::size_t size;
  };
  for (const Size& each :
       {Size{0x0446, 6}, Size{0x0451, 6}, Size{0x04A1, 20}, Size{0x04B1, 26}, Size{0x04B4, 4},
        Size{0x04B7, 16}, Size{0x04D5, 18}, Size{0x04D8, 28}, Size{0x04DB, 14}, Size{0x04E1, 12},
        Size{0x04E4, 12}, Size{0x04E7, 20}, Size{0x04EA, 18}, Size{0x04F5, 4}, Size{0x042B, 4},
        Size{0x0501, 0}, Size{0x0214, 0}}) {
    const auto answer = ask(apt_short(each.request));
    ASSERT_THAT(answer, SizeIs(1)) << each.request;
    EXPECT_EQ(answer[0].id, each.request + 1);
    EXPECT_THAT(answer[0].data, SizeIs(each.size)) << each.request;
  }
  host.send(apt_short(0x0500, 1, 0x14));
  EXPECT_EQ(ask(apt_short(0x0501)).at(0).second, 0x14U);
  EXPECT_TRUE(firmware.unserved().all().empty());
}

TEST_F(ThorlabsAptFirmwareTest, AHostCanSuspendTheEndsOfMotions) {
  host.send(apt_short(0x046B, 0, 0));
  host.send(apt_data(0x0453, apt_position(10000)));
  EXPECT_THAT(listen(seconds(5)), SizeIs(0));
  host.send(apt_short(0x046C, 0, 0));
  host.send(apt_data(0x0453, apt_position(0)));
  EXPECT_THAT(listen(seconds(5)), SizeIs(1));
}

TEST_F(ThorlabsAptFirmwareTest, AnUnknownMessageIsListedWithItsBytes) {
  host.send(apt_data(0x0FFF, "ab"));
  const auto unserved = firmware.unserved().all();
  ASSERT_THAT(unserved, SizeIs(1));
  EXPECT_EQ(unserved[0].command, "0FFF");
  EXPECT_EQ(unserved[0].bytes, apt_data(0x0FFF, "ab"));
}

class ThorlabsAptUnitTest : public ThorlabsAptFirmwareTest {
 protected:
  ThorlabsAptUnitTest()
      : ThorlabsAptFirmwareTest({.axis_names = {"1", ""},
                                 .model = "K10CR1",
                                 .counts_per_degree = 409600.0 / 3.0,
                                 .velocity_per_count_s = 53.68,
                                 .servo = false}) {}
};

TEST_F(ThorlabsAptUnitTest, AK10cr1HomesBackwardsToItsReverseSwitch) {
  const auto homing = apt_messages(host.exchange(apt_short(0x0441, 1, 0, 0x50))).at(0);
  EXPECT_EQ(apt_word(homing.data, 2), 2U);
  EXPECT_EQ(apt_word(homing.data, 4), 1U);
  EXPECT_GT(apt_long(homing.data, 6), 0);
}

TEST_F(ThorlabsAptUnitTest, AStepperNeedsNoServerAlive) {
  host.send(apt_short(0x0011, 0, 0, 0x50));
  const auto updates = listen(seconds(10) + milliseconds(5));
  EXPECT_THAT(updates, SizeIs(100));
  EXPECT_THAT(updates, Each(testing::Field(&AptMessage::id, 0x0481U)));
}

}  // namespace
}  // namespace abcal::sim
