// The frames of Modbus TCP and RTU as a host that is not the driver sends them, well formed or not.

#include "sim/firmware/watlow_f4_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

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

/// Reads and writes registers over Modbus TCP, as ESPEC's library does.
class WatlowRegisters {
 public:
  explicit WatlowRegisters(WatlowF4Settings settings,
                           std::shared_ptr<SimBench> bench = std::make_shared<SimBench>(BenchTruth{}))
      : firmware_(std::move(bench), settings), host_(firmware_) {}

  std::vector<int> read(unsigned address, unsigned count = 1) {
    const std::string answer = ask("\x03"s + word(address) + word(count));
    std::vector<int> words;
    for (std::size_t at = 2; static_cast<unsigned char>(answer.at(0)) == 3 && at + 1 < answer.size(); at += 2)
      words.push_back(static_cast<unsigned char>(answer[at]) * 256 +
                      static_cast<unsigned char>(answer[at + 1]));
    return words;
  }
  /// The code of the exception; 0: written.
  int write(unsigned address, std::vector<unsigned> words) {
    std::string data;
    for (const unsigned each : words) data += word(each);
    const std::string answer = ask("\x10"s + word(address) + word(static_cast<unsigned>(words.size())) +
                                   static_cast<char>(data.size()) + data);
    return answer.at(0) == '\x10' ? 0 : answer.at(1);
  }
  FirmwareHost& host() { return host_; }
  WatlowF4Firmware& firmware() { return firmware_; }

 private:
  static std::string word(unsigned value) {
    return {static_cast<char>(value / 256U), static_cast<char>(value % 256U)};
  }
  std::string ask(const std::string& pdu) {
    return host_.exchange("\0\x01\0\0\0"s + static_cast<char>(pdu.size() + 1) + "\x01"s + pdu).substr(7);
  }
  WatlowF4Firmware firmware_;
  FirmwareHost host_;
};

WatlowF4Settings f4_over_tcp(bool second_loop = false) {
  WatlowF4Settings settings = settings_of(true);
  settings.f4t = false;
  settings.second_loop = second_loop;
  return settings;
}

TEST(WatlowF4RegistersTest, ServesWhatEspecsLibraryReadsOfAnF4t) {
  WatlowRegisters f4t(settings_of(true));
  EXPECT_EQ(f4t.read(2784, 2), (std::vector{0, 0})) << "power by hand";
  EXPECT_EQ(f4t.read(2814), std::vector{10}) << "automatic";
  EXPECT_EQ(f4t.read(16568), std::vector{62}) << "no profile runs";
  for (const unsigned slot : {0U, 4U}) {
    EXPECT_EQ(f4t.read(11250 + 60 * slot), std::vector{61});
    EXPECT_EQ(f4t.read(11264 + 60 * slot), std::vector{138});
    EXPECT_EQ(f4t.read(11288 + 60 * slot), std::vector{61});
  }
  for (unsigned alarm = 0; alarm < 8; ++alarm) EXPECT_EQ(f4t.read(1356 + 100 * alarm), std::vector{61});
  EXPECT_EQ(f4t.read(16536), std::vector{1540});
  EXPECT_EQ(f4t.read(16588), std::vector{0});
  EXPECT_EQ(f4t.read(16886, 20), std::vector<int>(20, 0));
  EXPECT_TRUE(f4t.firmware().unserved().all().empty());
  EXPECT_TRUE(f4t.read(11310).empty()) << "no card in slot 2";
  EXPECT_EQ(f4t.firmware().unserved().all().size(), 1U);
}

TEST(WatlowF4RegistersTest, TheClockOfAnF4tGoesOnFromWhereItIsSet) {
  WatlowRegisters f4t(settings_of(true));
  const std::vector<unsigned> noon{12, 34, 56, 2, 29, 2024};
  // In the order in which ESPEC's library writes them, one after the other.
  for (unsigned part = 0; part < 6; ++part) EXPECT_EQ(f4t.write(14664 + 2 * part, {noon[part]}), 0);
  f4t.host().listen(std::chrono::seconds(5));
  const std::vector<int> read = f4t.read(14664, 12);
  ASSERT_EQ(read.size(), 12U);
  EXPECT_EQ((std::vector{read[0], read[2], read[4], read[6], read[8], read[10]}),
            (std::vector{12, 35, 1, 2, 29, 2024}));
  EXPECT_EQ(f4t.write(14664, {24}), 3);
}

TEST(WatlowF4RegistersTest, TheClockOfAnF4IsADate) {
  WatlowRegisters f4(f4_over_tcp());
  EXPECT_EQ(f4.read(1916, 6), (std::vector{0, 0, 0, 1, 1, 2000}));
  EXPECT_EQ(f4.write(1916, {23, 59, 59, 12, 31, 2026}), 0);
  f4.host().listen(std::chrono::seconds(1));
  EXPECT_EQ(f4.read(1916, 6), (std::vector{0, 0, 0, 1, 1, 2027}));
}

TEST(WatlowF4RegistersTest, AnF4dHasASecondSetPointAndAnF4sHasNot) {
  EXPECT_EQ(WatlowRegisters(f4_over_tcp(false)).write(319, {0}), 2);
  WatlowRegisters f4d(f4_over_tcp(true));
  EXPECT_EQ(f4d.write(319, {450}), 0);
  EXPECT_EQ(f4d.read(319), std::vector{450});
}

TEST(WatlowF4RegistersTest, TheLoopThatIsOffHeatsNoAir) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  WatlowRegisters f4t(settings_of(true), bench);
  EXPECT_EQ(f4t.write(2782, {0x0000, 0x42A0}), 0);  // 80 degC
  EXPECT_EQ(f4t.write(6850, {1457}), 0);            // the key that starts it
  EXPECT_EQ(f4t.read(33718), std::vector{63});
  EXPECT_TRUE(bench->commanded_chamber().running);
  EXPECT_EQ(f4t.read(2808, 2), (std::vector{0, 0x42C8})) << "100 %";
  EXPECT_EQ(f4t.write(2730, {62}), 0);
  EXPECT_FALSE(bench->commanded_chamber().running);
  EXPECT_EQ(f4t.read(2814), std::vector{62});
  EXPECT_EQ(f4t.read(2808, 2), (std::vector{0, 0}));
  EXPECT_EQ(f4t.write(2730, {7}), 3);
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
