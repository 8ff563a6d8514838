// The frames of Modbus TCP and RTU as a host that is not the driver sends them, well formed or not.

#include "sim/firmware/watlow_f4_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <string>
#include <string_view>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using namespace std::string_literals;

/// Settings for answers without delay, so that an answer is complete before the next frame is sent.
WatlowF4Settings settings_of(bool tcp) {
  WatlowF4Settings settings;
  settings.tcp = tcp;
  settings.reply_delay = milliseconds(0);
  return settings;
}

/// A frame of Modbus TCP, byte by byte; `length` is what its head says.
std::string frame(char transaction, char protocol, char length, const std::string& unit_and_pdu) {
  return "\x01"s + transaction + "\0"s + protocol + "\0"s + length + unit_and_pdu;
}

/// Reads register 90, which is 138 in an F4T.
const std::string kRead = "\x01\x03\x00\x5a\x00\x01"s;
std::string request(char transaction) {
  return frame(transaction, 0, 6, kRead);
}
std::string answer(char transaction) {
  return frame(transaction, 0, 5, "\x01\x03\x02\x00\x8a"s);
}
std::string exception(char transaction, char function, char code) {
  return frame(transaction, 0, 3, "\x01"s + function + code);
}

class WatlowF4TcpTest : public testing::Test {
 protected:
  WatlowF4Firmware firmware{std::make_shared<SimBench>(BenchTruth{}), settings_of(true)};
  FirmwareHost host{firmware};
};

TEST_F(WatlowF4TcpTest, AnswersAFrame) {
  EXPECT_EQ(host.exchange(request(7)), answer(7));
}

TEST_F(WatlowF4TcpTest, AFrameMayComeInPiecesAndTwoInOnePiece) {
  for (const char byte : request(1).substr(0, 11)) EXPECT_EQ(host.exchange(std::string(1, byte)), "");
  EXPECT_EQ(host.exchange(request(1).substr(11)), answer(1));
  EXPECT_EQ(host.exchange(request(2) + request(3)), answer(2) + answer(3));
  EXPECT_EQ(host.exchange(request(4) + request(5).substr(0, 8)), answer(4));
  EXPECT_EQ(host.exchange(request(5).substr(8)), answer(5));
}

TEST_F(WatlowF4TcpTest, HalfAFrameIsForgotten) {
  EXPECT_EQ(host.exchange(request(1).substr(0, 9)), "");
  host.listen(milliseconds(60));
  EXPECT_EQ(host.exchange(request(2)), answer(2));
}

TEST_F(WatlowF4TcpTest, AFrameOfAnotherProtocolIsPassedOverWhole) {
  EXPECT_EQ(host.exchange(frame(1, 1, 6, kRead)), "");
  EXPECT_EQ(host.exchange(frame(2, 1, 6, kRead) + request(3)), answer(3));
  // The firmware trusts its length, but not its function: its content is not ours.
  EXPECT_EQ(host.exchange(frame(4, 1, 12, request(5)) + request(6)), answer(6));
}

TEST_F(WatlowF4TcpTest, AFrameForAnotherUnitIsPassedOver) {
  EXPECT_EQ(host.exchange(frame(1, 0, 6, "\x02"s + kRead.substr(1)) + request(2)), answer(2));
}

TEST_F(WatlowF4TcpTest, ALengthThatIsNotTheFunctionsIsAnIllegalValueAndTheNextFrameIsRead) {
  EXPECT_EQ(host.exchange(frame(1, 0, 8, kRead + "\0\0"s) + request(2)), exception(1, '\x83', 3) + answer(2));
  EXPECT_EQ(host.exchange(frame(3, 0, 4, kRead.substr(0, 4)) + request(4)),
            exception(3, '\x83', 3) + answer(4));
  EXPECT_EQ(host.exchange(frame(5, 0, 2, "\x01\x03"s)), exception(5, '\x83', 3));
  // Function 16 says itself how many bytes follow: 4, of which 2 come; and is cut before it says so.
  EXPECT_EQ(host.exchange(frame(6, 0, 9, "\x01\x10\x0a\xde\x00\x02\x04\x00\x00"s) + request(7)),
            exception(6, '\x90', 3) + answer(7));
  EXPECT_EQ(host.exchange(frame(8, 0, 4, "\x01\x10\x0a\xde"s) + request(9)),
            exception(8, '\x90', 3) + answer(9));
  EXPECT_EQ(firmware.unserved().all().front().command, "function 3 in 7 bytes");
  EXPECT_EQ(firmware.unserved().all().front().reaction, "exception 3");
}

TEST_F(WatlowF4TcpTest, AFunctionThatDoesNotExistIsSaidToBeSoWhateverItsLength) {
  EXPECT_EQ(host.exchange(frame(1, 0, 2, "\x01\x2b"s) + request(2)), exception(1, '\xab', 1) + answer(2));
  EXPECT_EQ(host.exchange(frame(3, 0, 5, "\x01\x2b\x0e\x01\x00"s) + request(4)),
            exception(3, '\xab', 1) + answer(4));
}

TEST_F(WatlowF4TcpTest, WithALengthThatNoFrameHasTheInputIsDropped) {
  EXPECT_EQ(host.exchange(frame(1, 0, 1, "\x01"s) + request(2)), "");
  EXPECT_EQ(host.exchange(request(3)), answer(3));
  EXPECT_EQ(host.exchange(frame(4, 0, 0, "") + request(5)), "");
  EXPECT_EQ(host.exchange(request(6)), answer(6));
  EXPECT_EQ(host.exchange(frame(7, 0, '\xff', kRead)), "");
  EXPECT_EQ(host.exchange(request(8)), answer(8));
  const std::string longest = "\x01\x2b"s + std::string(252, '\0');
  EXPECT_EQ(host.exchange(frame(9, 0, '\xfe', longest)), exception(9, '\xab', 1)) << "254 is allowed";
}

TEST(WatlowF4RtuTest, AnswersAFrameBehindADamagedOne) {
  WatlowF4Firmware firmware{std::make_shared<SimBench>(BenchTruth{}), settings_of(false)};
  FirmwareHost host{firmware};
  // Checksums by the rule of the Modbus over serial line guide.
  const std::string good = kRead + "\xa4\x19"s;
  EXPECT_EQ(host.exchange(good), "\x01\x03\x02\x00\x8a\x39\xe3"s);
  EXPECT_EQ(host.exchange(kRead + "\xa4\x18"s), "");
  host.listen(milliseconds(60));
  EXPECT_EQ(host.exchange(good), "\x01\x03\x02\x00\x8a\x39\xe3"s);
}

}  // namespace
}  // namespace abcal::sim
