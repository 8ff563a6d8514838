#include "drivers/wire/usbtmc_stream.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <deque>
#include <filesystem>
#include <fstream>
#include <future>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/open_stream.h"
#include "tests/drivers/wire/steady_clock.h"
#include "tests/support/error_of.h"
#include "tests/support/fake_clock.h"
#include "tests/support/temporary_folder.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// An instrument that sets MAV when its reply is there, and hangs if it is read before that.
class FakeDevice final : public UsbtmcDevice {
 public:
  explicit FakeDevice(Clock& clock) : clock_(clock) {}

  void say(std::string reply, Clock::Duration in) {
    replies.push_back({clock_.now() + in, std::move(reply)});
  }

  struct Reply {
    Clock::Instant at;
    std::string bytes;
  };
  std::deque<Reply> replies;
  std::vector<std::string> messages;
  std::deque<int> errors;  ///< Errors of the next calls, in order; 0: none.
  int reads_too_early = 0;
  int status_requests = 0;

  long write(std::string_view message) override {
    if (const int error = next_error(); error != 0) return error;
    messages.emplace_back(message);
    return static_cast<long>(message.size());
  }
  long read(char* buffer, std::size_t size) override {
    if (const int error = next_error(); error != 0) return error;
    if (!waits()) {
      ++reads_too_early;
      return -ETIMEDOUT;
    }
    std::string& bytes = replies.front().bytes;
    const std::size_t count = std::min(size, bytes.size());
    std::memcpy(buffer, bytes.data(), count);
    bytes.erase(0, count);
    if (bytes.empty()) replies.pop_front();
    return static_cast<long>(count);
  }
  int status_byte() override {
    ++status_requests;
    if (const int error = next_error(); error != 0) return error;
    return waits() ? 0x50 : 0x40;  // With a bit that must be ignored.
  }

 private:
  bool waits() const { return !replies.empty() && replies.front().at <= clock_.now(); }
  int next_error() {
    if (errors.empty()) return 0;
    const int error = errors.front();
    errors.pop_front();
    return error;
  }

  Clock& clock_;
};

class UsbtmcStreamTest : public ::testing::Test {
 protected:
  UsbtmcStreamTest() {
    auto owned = std::make_unique<FakeDevice>(clock_);
    device_ = owned.get();
    stream_ = std::make_unique<UsbtmcStream>(std::move(owned), "/dev/usbtmc7", clock_);
  }

  test::FakeClock clock_;
  FakeDevice* device_ = nullptr;
  std::unique_ptr<UsbtmcStream> stream_;
};

TEST_F(UsbtmcStreamTest, AWriteIsAMessage) {
  stream_->write("*IDN?\n");
  stream_->write("");
  stream_->write("READ?\n");
  EXPECT_THAT(device_->messages, ElementsAre("*IDN?\n", "READ?\n"));
  EXPECT_EQ(stream_->name(), "/dev/usbtmc7");
}

TEST_F(UsbtmcStreamTest, AReplyIsReadWhenItIsThereAndNotBefore) {
  const Clock::Instant begin = clock_.now();
  device_->say("+1.0\n", 301ms);
  const ReceivedBytes received = stream_->read_until(begin + 1s);
  EXPECT_EQ(received.bytes, "+1.0\n");
  EXPECT_EQ(received.arrival, clock_.now());
  EXPECT_GE(clock_.now() - begin, 301ms);
  EXPECT_LE(clock_.now() - begin, 303ms);
  EXPECT_EQ(device_->reads_too_early, 0);
  EXPECT_LE(device_->status_requests, 153) << "every 2 ms";
}

TEST_F(UsbtmcStreamTest, TheDeadlineIsKept) {
  const Clock::Instant deadline = clock_.now() + 101ms;
  device_->say("late\n", 102ms);
  EXPECT_EQ(stream_->read_until(deadline).bytes, "");
  EXPECT_EQ(clock_.now(), deadline);
  EXPECT_EQ(stream_->read_until(deadline - 1h).bytes, "");
  EXPECT_EQ(clock_.now(), deadline);
  clock_.advance(1ms);
  EXPECT_EQ(stream_->read_until(deadline - 1h).bytes, "late\n") << "what is there is given at any deadline";
}

TEST_F(UsbtmcStreamTest, ALongReplyComesInPieces) {
  std::string reply(10'000, '\0');
  for (std::size_t i = 0; i < reply.size(); ++i) reply[i] = static_cast<char>(i % 251);
  device_->say(reply, 0ms);
  std::string read;
  while (read.size() < reply.size()) {
    const std::string piece = stream_->read_until(clock_.now()).bytes;
    ASSERT_FALSE(piece.empty());
    read += piece;
  }
  EXPECT_EQ(read, reply);
}

TEST_F(UsbtmcStreamTest, DiscardThrowsAwayWhatIsThereAndDoesNotWait) {
  device_->say("stale\n", 0ms);
  device_->say("stale too\n", 0ms);
  device_->say("fresh\n", 1ms);
  const Clock::Instant begin = clock_.now();
  stream_->discard_input();
  EXPECT_EQ(clock_.now(), begin);
  EXPECT_EQ(stream_->read_until(begin + 1s).bytes, "fresh\n");
}

TEST_F(UsbtmcStreamTest, WhatPassesIsTriedAgain) {
  device_->say("+1.0\n", 0ms);
  device_->errors = {-EINTR, -ETIMEDOUT, 0, -EINTR, 0, -ETIMEDOUT};  // Status twice, then status and read.
  EXPECT_EQ(stream_->read_until(clock_.now() + 1s).bytes, "+1.0\n");
  EXPECT_TRUE(device_->errors.empty());
  device_->errors = {-EINTR, -EINTR};
  stream_->write("READ?\n");
  EXPECT_THAT(device_->messages, ElementsAre("READ?\n"));
}

TEST_F(UsbtmcStreamTest, ABusyInstrumentThatTakesNothingHasNotAnswered) {
  device_->errors = {-ETIMEDOUT};
  EXPECT_THAT(error_of([&] { stream_->write("READ?\n"); }, Fault::kNoReply), HasSubstr("none of 6 bytes"));
  EXPECT_NO_THROW(stream_->write("READ?\n"));
}

TEST_F(UsbtmcStreamTest, AnInstrumentThatIsUnpluggedIsALostLink) {
  for (const int error : {-ENODEV, -EPROTO, -EIO, -ESHUTDOWN}) {
    test::FakeClock clock;
    auto owned = std::make_unique<FakeDevice>(clock);
    owned->errors = {error};
    UsbtmcStream stream(std::move(owned), "/dev/usbtmc7", clock);
    EXPECT_THAT(error_of([&] { stream.read_until(clock.now() + 1s); }, Fault::kLinkLost),
                AllOf(HasSubstr("/dev/usbtmc7"), HasSubstr("unplugged"), HasSubstr(std::strerror(-error))));
    error_of([&] { stream.write("x"); }, Fault::kLinkLost);
    error_of([&] { stream.discard_input(); }, Fault::kLinkLost);
    error_of([&] { stream.read_until(clock.now() + 1s); }, Fault::kLinkLost);
  }
  device_->errors = {-ENODEV};
  error_of([&] { stream_->write("x"); }, Fault::kLinkLost);
  device_->say("x", 0ms);
  error_of([&] { stream_->read_until(clock_.now() + 1s); }, Fault::kLinkLost);
}

TEST_F(UsbtmcStreamTest, AnotherThreadMayWriteWhileOneWaits) {
  test::SteadyClock clock;
  auto owned = std::make_unique<FakeDevice>(clock);
  owned->say("reply\n", 50ms);
  UsbtmcStream stream(std::move(owned), "fake", clock);
  auto reader = std::async(std::launch::async, [&] { return stream.read_until(clock.now() + 5s).bytes; });
  for (int i = 0; i < 100; ++i) stream.write("ABOR\n");
  EXPECT_EQ(reader.get(), "reply\n");
}

// ---- Opening errors, of real files

class UsbtmcOpenTest : public ::testing::Test {
 protected:
  std::string error_of_opening(const std::string& port) {
    try {
      open_stream(port, {}, clock_);
    } catch (const InstrumentError& error) {
      EXPECT_EQ(error.fault(), Fault::kCannotOpen);
      return error.what();
    }
    ADD_FAILURE() << port << " was opened";
    return {};
  }

  test::SteadyClock clock_;
  test::TemporaryFolder folder_;
};

TEST_F(UsbtmcOpenTest, SaysThatThereIsNoSuchFileAndWhatThereIs) {
  for (const char* port : {"/dev/usbtmc-none", "usbtmc:/dev/usbtmc-none"}) {
    EXPECT_THAT(error_of_opening(port),
                AllOf(HasSubstr("/dev/usbtmc-none: cannot open: does not exist; "), HasSubstr("connected")));
  }
}

TEST_F(UsbtmcOpenTest, SaysThatItIsSomethingElse) {
  EXPECT_THAT(error_of_opening("usbtmc:/dev"), HasSubstr("a folder, not a USBTMC instrument"));
  const std::string file = folder_.path() / "file";
  std::ofstream(file) << "x";
  EXPECT_THAT(error_of_opening("usbtmc:" + file), HasSubstr("a file, not a USBTMC instrument"));
  EXPECT_THAT(error_of_opening("usbtmc:/dev/null"),
              AllOf(HasSubstr("not a USBTMC instrument"), HasSubstr("status byte"),
                    HasSubstr(std::strerror(ENOTTY))));
}

TEST_F(UsbtmcOpenTest, SaysThatALinkLeadsNowhere) {
  const std::string link = folder_.path() / "voltmeter";
  std::filesystem::create_symlink(folder_.path() / "gone", link);
  EXPECT_THAT(error_of_opening("usbtmc:" + link), HasSubstr("a link to"));
}

}  // namespace
}  // namespace abcal::wire
