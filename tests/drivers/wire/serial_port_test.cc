#include "drivers/wire/serial_port.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/wait.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <future>
#include <thread>

#include "drivers/instrument/instrument_error.h"
#include "tests/drivers/wire/pseudo_terminal.h"
#include "tests/drivers/wire/steady_clock.h"

namespace abcal::wire {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr auto kPatience = 5s;  // Far beyond what any of this takes; a test that waits so long has failed.

class SerialPortTest : public ::testing::Test {
 protected:
  SerialPortTest() {
    std::string pattern = (fs::temp_directory_path() / "abcal-wire-XXXXXX").string();
    folder_ = ::mkdtemp(pattern.data());
  }
  ~SerialPortTest() override {
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }

  std::string read_all(ByteStream& port, std::size_t size) {
    std::string bytes;
    const Clock::Instant deadline = clock_.now() + kPatience;
    while (bytes.size() < size && clock_.now() < deadline) bytes += port.read_until(deadline).bytes;
    return bytes;
  }

  InstrumentError error_of_opening(const std::string& path, unsigned baud = 115200) {
    try {
      SerialPort port({.path = path, .baud = baud, .rts_cts = false}, clock_);
    } catch (const InstrumentError& error) {
      return error;
    }
    ADD_FAILURE() << path << " was opened";
    return {"", Fault::kImplausible, ""};
  }

  test::SteadyClock clock_;
  test::PseudoTerminal terminal_;
  fs::path folder_;
};

TEST_F(SerialPortTest, BytesGoThereAndBackUnchanged) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  std::string every_byte;
  for (int i = 0; i < 256; ++i) every_byte += static_cast<char>(i);  // No echo, no translation, no signals.
  port.write(every_byte);
  EXPECT_EQ(terminal_.read(256), every_byte);
  const Clock::Instant before = clock_.now();
  terminal_.write(every_byte);
  const ReceivedBytes received = port.read_until(clock_.now() + kPatience);
  EXPECT_GE(received.arrival, before);
  EXPECT_LE(received.arrival, clock_.now());
  EXPECT_EQ(received.bytes + read_all(port, 256 - received.bytes.size()), every_byte);
  EXPECT_EQ(port.name(), terminal_.path());
}

/// Can hold any thread but the one that made it.
class HoldingClock final : public Clock {
 public:
  Instant now() const override {
    if (std::this_thread::get_id() != owner_ && holds_) {
      held_ = true;
      held_.notify_all();
      holds_.wait(true);
    }
    return std::chrono::steady_clock::now();
  }
  UtcTime utc_now() const override { return std::chrono::system_clock::now(); }
  void sleep_until(Instant instant) override { std::this_thread::sleep_until(instant); }
  void hold() { holds_ = true; }
  void wait_until_it_holds() const { held_.wait(false); }
  void release() {
    holds_ = false;
    holds_.notify_all();
  }

 private:
  const std::thread::id owner_ = std::this_thread::get_id();
  std::atomic<bool> holds_ = false;
  mutable std::atomic<bool> held_ = false;
};

TEST_F(SerialPortTest, WhatTheSystemHoldsHasComeHoweverLateTheThreadThatFetchesIt) {
  HoldingClock clock;
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock);
  EXPECT_EQ(port.read_until(clock.now()).bytes, "") << "nothing has come";
  clock.hold();
  terminal_.write("a");
  clock.wait_until_it_holds();
  terminal_.write("b");
  int waiting = 0;
  while (::ioctl(port.descriptor(), FIONREAD, &waiting) == 0 && waiting == 0) std::this_thread::yield();
  auto late = std::async(std::launch::async, [&] {
    std::this_thread::sleep_for(50ms);
    clock.release();
  });
  EXPECT_EQ(port.read_until(clock.now()).bytes.substr(0, 1), "a");
}

TEST_F(SerialPortTest, BytesThatWaitForABusyReaderKeepTheirTimesOfArrival) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  const auto send = [&](const std::string& bytes) {
    terminal_.write(bytes);
    int waiting = 0;  // The bytes pass to the terminal, and from there to the program.
    const Clock::Instant later = clock_.now() + 20ms;
    while (clock_.now() < later || (::ioctl(port.descriptor(), FIONREAD, &waiting) == 0 && waiting > 0))
      std::this_thread::yield();
    return clock_.now();
  };
  const Clock::Instant before = clock_.now();
  const Clock::Instant between = send("ab");
  const Clock::Instant after = send("cde");
  const ReceivedBytes received = port.read_until(clock_.now());
  EXPECT_EQ(received.bytes, "abcde");
  ASSERT_EQ(received.groups.size(), 2U);
  EXPECT_EQ(received.groups[0].count, 2U);
  EXPECT_EQ(received.groups[1].count, 3U);
  EXPECT_TRUE(before <= received.groups[0].arrival && received.groups[0].arrival <= between);
  EXPECT_TRUE(between <= received.arrival && received.arrival <= after);
}

TEST_F(SerialPortTest, APortThatClosesDoesNotDisturbTheOthers) {
  test::PseudoTerminal other_terminal;
  SerialPort other({.path = other_terminal.path(), .baud = 115200, .rts_cts = false}, clock_);
  std::atomic<bool> over = false;
  auto stream = std::async(std::launch::async, [&] {
    for (int i = 0; !over; ++i) other_terminal.write(std::string(1, static_cast<char>('a' + i % 26)));
  });
  for (int i = 0; i < 20; ++i) {
    SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
    terminal_.write("x");
    EXPECT_EQ(read_all(port, 1), "x");
  }
  over = true;
  stream.get();
  std::string streamed;
  for (std::string more = "-"; !more.empty(); streamed += more)
    more = other.read_until(clock_.now() + 50ms).bytes;
  for (std::size_t i = 0; i < streamed.size(); ++i)
    ASSERT_EQ(streamed[i], static_cast<char>('a' + i % 26)) << i;
}

TEST_F(SerialPortTest, OpensALinkToAPseudoTerminalAndTakesFlowControl) {
  const std::string link = folder_ / "stage";
  fs::create_symlink(terminal_.path(), link);
  SerialPort port({.path = link, .baud = 19200, .rts_cts = true}, clock_);
  port.write("VE?\r");
  EXPECT_EQ(terminal_.read(4), "VE?\r");
  EXPECT_EQ(port.name(), link);
}

TEST_F(SerialPortTest, AReadEndsEmptyAtItsDeadline) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  const Clock::Instant deadline = clock_.now() + 20ms;
  EXPECT_EQ(port.read_until(deadline).bytes, "");
  EXPECT_GE(clock_.now(), deadline);
  EXPECT_EQ(port.read_until(clock_.now() - 1h).bytes, "");
  EXPECT_EQ(port.read_until(Clock::Instant::min()).bytes, "");
}

TEST_F(SerialPortTest, ABurstOfAMegabyteIsReadWithoutLoss) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  std::string burst(std::size_t{1} << 20, '\0');
  std::uint32_t state = 1;
  for (char& byte : burst) byte = static_cast<char>((state = state * 1664525U + 1013904223U) >> 24);
  auto writer = std::async(std::launch::async, [&] { terminal_.write(burst); });
  EXPECT_EQ(read_all(port, burst.size()), burst);
  writer.get();
  EXPECT_EQ(port.dropped_bytes(), 0U);
}

TEST_F(SerialPortTest, ABurstIsKeptForAReaderThatIsBusy) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  const std::string burst(std::size_t{1} << 20, 'u');
  terminal_.write(burst);  // Returns once the port's own thread has taken nearly all bytes: nobody reads.
  EXPECT_EQ(read_all(port, burst.size()).size(), burst.size());
}

TEST_F(SerialPortTest, AFullQueueCountsWhatItDrops) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_, 1000);
  terminal_.write(std::string(5000, 'u'));
  const Clock::Instant deadline = clock_.now() + kPatience;
  while (port.dropped_bytes() < 4000 && clock_.now() < deadline) std::this_thread::yield();
  EXPECT_EQ(port.dropped_bytes(), 4000U);
  EXPECT_EQ(port.read_until(deadline).bytes.size(), 1000U);
  terminal_.write("fresh");
  EXPECT_EQ(read_all(port, 5), "fresh");
}

TEST_F(SerialPortTest, DiscardThrowsAwayWhatHasArrived) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_, 5);
  terminal_.write("stale!");
  const Clock::Instant deadline = clock_.now() + kPatience;
  while (port.dropped_bytes() < 1 && clock_.now() < deadline)
    std::this_thread::yield();  // All bytes have arrived.
  port.discard_input();
  EXPECT_EQ(port.read_until(clock_.now()).bytes, "");
  terminal_.write("fresh");
  EXPECT_EQ(read_all(port, 5), "fresh");
  EXPECT_EQ(port.dropped_bytes(), 1U) << "discarded is not lost";
}

TEST_F(SerialPortTest, AWriteIsNeverTornByAnother) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  constexpr int kWrites = 200;
  const auto writer = [&](char letter) {
    for (int i = 0; i < kWrites; ++i) port.write(std::string(15, letter) + "\n");
  };
  auto a = std::async(std::launch::async, writer, 'a');
  auto b = std::async(std::launch::async, writer, 'b');
  const std::string seen = terminal_.read(2 * kWrites * 16);
  a.get();
  b.get();
  ASSERT_EQ(seen.size(), 2U * kWrites * 16U);
  for (std::size_t at = 0; at < seen.size(); at += 16) {
    EXPECT_EQ(seen.substr(at, 16), std::string(15, seen[at]) + "\n");
  }
}

TEST_F(SerialPortTest, AWriteThatNobodyTakesEndsAtItsDeadline) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  const Clock::Instant before = clock_.now();
  try {
    port.write(std::string(std::size_t{1} << 20, 'u'));  // Far more than a terminal holds.
    ADD_FAILURE() << "a megabyte that nobody reads was written";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kNoReply);
    EXPECT_THAT(error.what(), AllOf(HasSubstr("of 1048576 bytes within 2 s"), HasSubstr("RTS/CTS")));
  }
  EXPECT_GE(clock_.now() - before, 1900ms);
  EXPECT_LE(clock_.now() - before, 4s);
}

TEST_F(SerialPortTest, APortThatVanishesIsALostLinkAfterItsLastBytes) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  terminal_.write("last");
  EXPECT_EQ(read_all(port, 4), "last");
  terminal_.hang_up();
  try {
    EXPECT_EQ(port.read_until(clock_.now() + kPatience).bytes, "");
    ADD_FAILURE() << "no error from a port that is gone";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kLinkLost);
    EXPECT_EQ(error.instrument(), terminal_.path());
  }
  EXPECT_THROW(port.write("x"), InstrumentError);
  EXPECT_THROW(port.discard_input(), InstrumentError);
}

TEST_F(SerialPortTest, AReaderThatWaitsLearnsAtOnceThatThePortVanished) {
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  auto reader = std::async(std::launch::async, [&] {
    try {
      port.read_until(clock_.now() + 1h);
    } catch (const InstrumentError& error) {
      return error.fault();
    }
    return Fault::kNoReply;
  });
  terminal_.hang_up();
  ASSERT_EQ(reader.wait_for(kPatience), std::future_status::ready);
  EXPECT_EQ(reader.get(), Fault::kLinkLost);
}

TEST_F(SerialPortTest, CanBeOpenedAgainAfterItWasClosed) {
  for (int i = 0; i < 3; ++i) {
    SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
    port.write("x");
    EXPECT_EQ(terminal_.read(1), "x");
  }
  const int other = ::open(terminal_.path().c_str(), O_RDWR | O_NOCTTY);
  ASSERT_GE(other, 0);
  int exclusive = -1;
  EXPECT_EQ(::ioctl(other, TIOCGEXCL, &exclusive), 0);
  EXPECT_EQ(exclusive, 0) << "a pseudo-terminal must not stay locked when its user is gone";
  ::close(other);
}

TEST_F(SerialPortTest, WhatWaitedBeforeOpeningIsThrownAway) {
  const int other =
      ::open(terminal_.path().c_str(), O_RDWR | O_NOCTTY);  // Keeps the input when nobody reads.
  ASSERT_GE(other, 0);
  terminal_.write("somebody else's\n");
  SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  terminal_.write("mine");
  EXPECT_EQ(read_all(port, 4), "mine");
  ::close(other);
}

// ---- Opening errors

TEST_F(SerialPortTest, AHeldPortNamesItsHolder) {
  // Another program: takes the lock, says so, and waits for the end of its input.
  std::array<int, 2> to_child{};
  std::array<int, 2> from_child{};
  ASSERT_EQ(::pipe2(to_child.data(), O_CLOEXEC), 0);
  ASSERT_EQ(::pipe2(from_child.data(), O_CLOEXEC), 0);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    ::close(to_child[1]);
    const int fd = ::open(terminal_.path().c_str(), O_RDWR | O_NOCTTY);
    const char locked = fd >= 0 && ::flock(fd, LOCK_EX | LOCK_NB) == 0 ? 'y' : 'n';
    char ignored = 0;
    const bool told = ::write(from_child[1], &locked, 1) == 1;
    const bool ended = ::read(to_child[0], &ignored, 1) == 0;
    ::_exit(told && ended ? 0 : 1);
  }
  char locked = 'n';
  EXPECT_EQ(::read(from_child[0], &locked, 1), 1);
  EXPECT_EQ(locked, 'y');
  const InstrumentError error = error_of_opening(terminal_.path());
  EXPECT_EQ(error.fault(), Fault::kCannotOpen);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("held by another program: pid " + std::to_string(child)),
                                  HasSubstr("wire_test")));
  ::close(to_child[1]);
  int status = -1;
  EXPECT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  ::close(to_child[0]);
  ::close(from_child[0]);
  ::close(from_child[1]);
  EXPECT_NO_THROW(SerialPort({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_));
}

TEST_F(SerialPortTest, TheSamePortTwiceIsRefused) {
  const SerialPort first({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
  const std::string link = folder_ / "again";
  fs::create_symlink(terminal_.path(), link);
  const InstrumentError error = error_of_opening(link);
  EXPECT_EQ(error.fault(), Fault::kCannotOpen);
  EXPECT_THAT(error.what(), HasSubstr("named twice in the bench file"));
}

TEST_F(SerialPortTest, APortThatDoesNotExistSaysWhatThereIs) {
  const InstrumentError error = error_of_opening("/dev/ttyUSB-none");
  EXPECT_EQ(error.fault(), Fault::kCannotOpen);
  EXPECT_THAT(error.what(),
              AllOf(HasSubstr("/dev/ttyUSB-none"), HasSubstr("does not exist"), HasSubstr("connected")));
}

TEST_F(SerialPortTest, ALinkToNowhereSaysWhereItLeads) {
  const std::string link = folder_ / "stage";
  fs::create_symlink("/dev/pts/none", link);
  EXPECT_THAT(error_of_opening(link).what(),
              AllOf(HasSubstr("a link to /dev/pts/none, which does not exist"), HasSubstr("emulator")));
}

TEST_F(SerialPortTest, WhatIsNoSerialPortIsSaidToBeNone) {
  const std::string file = folder_ / "file";
  std::ofstream(file) << "not a port";
  EXPECT_THAT(error_of_opening(file).what(), HasSubstr("a file, not a serial port"));
  EXPECT_THAT(error_of_opening(folder_).what(), HasSubstr("a folder, not a serial port"));
  EXPECT_THAT(error_of_opening("/dev/null").what(), HasSubstr("a device, but not a serial port"));
  for (const std::string& path : {file, folder_.string(), std::string("/dev/null")}) {
    EXPECT_EQ(error_of_opening(path).fault(), Fault::kCannotOpen);
  }
}

TEST_F(SerialPortTest, ABaudRateThatThereIsNotIsNamed) {
  const InstrumentError error = error_of_opening(terminal_.path(), 12345);
  EXPECT_EQ(error.fault(), Fault::kCannotOpen);
  EXPECT_THAT(error.what(), HasSubstr("does not accept 12345 baud"));
}

TEST_F(SerialPortTest, APortThatIsNotPermittedSaysWhichGroupIs) {
  // Root may open everything, so the opening happens in a child that has given that up.
  if (::geteuid() == 0) {
    std::array<int, 2> from_child{};
    ASSERT_EQ(::pipe2(from_child.data(), O_CLOEXEC), 0);
    ASSERT_EQ(::chmod(terminal_.path().c_str(), 0600), 0);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      std::string text = "opened";
      if (::setgid(65534) != 0 || ::setuid(65534) != 0) ::_exit(2);
      try {
        SerialPort port({.path = terminal_.path(), .baud = 115200, .rts_cts = false}, clock_);
      } catch (const InstrumentError& error) {
        text = error.what();
      }
      ::_exit(::write(from_child[1], text.data(), text.size()) == static_cast<ssize_t>(text.size()) ? 0 : 3);
    }
    ::close(from_child[1]);
    std::array<char, 1000> text{};
    EXPECT_GT(::read(from_child[0], text.data(), text.size() - 1), 0);
    int status = -1;
    EXPECT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_EQ(status, 0);
    ::close(from_child[0]);
    EXPECT_THAT(text.data(), AllOf(HasSubstr("cannot open: not permitted: it belongs to group "),
                                   HasSubstr("usermod -aG"), Not(HasSubstr("unknown"))));
  } else {
    ASSERT_EQ(::chmod(terminal_.path().c_str(), 0), 0);
    EXPECT_THAT(error_of_opening(terminal_.path()).what(), HasSubstr("not permitted: it belongs to group "));
  }
}

}  // namespace
}  // namespace abcal::wire
