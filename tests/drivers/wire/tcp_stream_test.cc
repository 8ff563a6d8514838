#include "drivers/wire/tcp_stream.h"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <future>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/open_stream.h"
#include "tests/drivers/wire/steady_clock.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

constexpr auto kPatience = 5s;

/// An instrument's end of a TCP connection, on a free port of the loopback.
class Listener {
 public:
  Listener() : listening_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    void* const any = &address;
    if (::bind(listening_, static_cast<sockaddr*>(any), size) != 0 || ::listen(listening_, 1) != 0 ||
        ::getsockname(listening_, static_cast<sockaddr*>(any), &size) != 0) {
      throw std::runtime_error("cannot listen on the loopback");
    }
    port_ = ntohs(address.sin_port);
  }
  ~Listener() {
    hang_up();
    stop_listening();
  }
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;

  std::uint16_t port() const { return port_; }
  void accept() { connected_ = ::accept(listening_, nullptr, nullptr); }
  void stop_listening() {
    if (listening_ >= 0) ::close(listening_);
    listening_ = -1;
  }
  void hang_up() {
    if (connected_ >= 0) ::close(connected_);
    connected_ = -1;
  }
  void write(std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t count = ::send(connected_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (count <= 0) throw std::runtime_error("send failed");
      bytes.remove_prefix(static_cast<std::size_t>(count));
    }
  }
  std::string read(std::size_t size) {
    std::string bytes(size, '\0');
    const ssize_t count = ::recv(connected_, bytes.data(), size, MSG_WAITALL);
    bytes.resize(count < 0 ? 0 : static_cast<std::size_t>(count));
    return bytes;
  }

 private:
  int listening_;
  int connected_ = -1;
  std::uint16_t port_ = 0;
};

class TcpStreamTest : public ::testing::Test {
 protected:
  std::string read_all(ByteStream& stream, std::size_t size) {
    std::string bytes;
    const Clock::Instant deadline = clock_.now() + kPatience;
    while (bytes.size() < size && clock_.now() < deadline) bytes += stream.read_until(deadline).bytes;
    return bytes;
  }

  test::SteadyClock clock_;
  Listener listener_;
};

TEST_F(TcpStreamTest, BytesGoThereAndBackUnchanged) {
  TcpStream stream("127.0.0.1", listener_.port(), clock_);
  listener_.accept();
  stream.write("*IDN?\n");
  EXPECT_EQ(listener_.read(6), "*IDN?\n");
  listener_.write(std::string("\0\x18\xB1\n", 4));
  EXPECT_EQ(read_all(stream, 4), std::string("\0\x18\xB1\n", 4));
  EXPECT_EQ(stream.name(), "tcp:127.0.0.1:" + std::to_string(listener_.port()));
}

TEST_F(TcpStreamTest, ABurstOfAMegabyteIsReadWithoutLoss) {
  TcpStream stream("127.0.0.1", listener_.port(), clock_);
  listener_.accept();
  std::string burst(std::size_t{1} << 20, '\0');
  for (std::size_t i = 0; i < burst.size(); ++i) burst[i] = static_cast<char>((i * 2654435761U) >> 16);
  auto writer = std::async(std::launch::async, [&] { listener_.write(burst); });
  EXPECT_EQ(read_all(stream, burst.size()), burst);
  writer.get();
  EXPECT_EQ(stream.dropped_bytes(), 0U);
}

TEST_F(TcpStreamTest, WhatWasSentBeforeTheOtherSideClosedIsStillRead) {
  TcpStream stream("127.0.0.1", listener_.port(), clock_);
  listener_.accept();
  listener_.write("last");
  listener_.hang_up();
  EXPECT_EQ(read_all(stream, 4), "last");
  try {
    stream.read_until(clock_.now() + kPatience);
    ADD_FAILURE() << "no error from a closed connection";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kLinkLost);
  }
  EXPECT_THROW(stream.write("x"), InstrumentError);
}

/// Fails in any thread but the one that made it.
class FailingClock final : public Clock {
 public:
  Instant now() const override {
    if (std::this_thread::get_id() == owner_) return std::chrono::steady_clock::now();
    throw std::runtime_error("no time");
  }
  UtcTime utc_now() const override { return std::chrono::system_clock::now(); }
  void sleep_until(Instant instant) override { std::this_thread::sleep_until(instant); }

 private:
  std::thread::id owner_ = std::this_thread::get_id();
};

TEST_F(TcpStreamTest, APortWhoseBytesCannotBeKeptIsALostLinkAndTheOthersGoOn) {
  FailingClock clock;
  TcpStream stream("127.0.0.1", listener_.port(), clock);
  listener_.accept();
  Listener other_listener;
  TcpStream other("127.0.0.1", other_listener.port(), clock_);
  other_listener.accept();
  listener_.write("x");
  try {
    stream.read_until(clock_.now() + kPatience);
    ADD_FAILURE() << "it has no time of arrival";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kLinkLost);
    EXPECT_THAT(error.what(), HasSubstr("no time"));
  }
  EXPECT_THROW(stream.write("MOV 1 90\n"), InstrumentError);
  other_listener.write("on");
  EXPECT_EQ(read_all(other, 2), "on");
}

TEST_F(TcpStreamTest, NothingListeningCannotBeOpened) {
  const std::uint16_t port = listener_.port();
  listener_.stop_listening();
  try {
    TcpStream stream("127.0.0.1", port, clock_);
    ADD_FAILURE() << "connected to nothing";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kCannotOpen);
    EXPECT_THAT(error.what(), HasSubstr("nothing listens on port " + std::to_string(port)));
  }
}

TEST_F(TcpStreamTest, AHostThatDoesNotAnswerEndsAtTheDeadline) {
  // A listener whose queue of connections is full drops further ones silently, like a host that is off.
  std::vector<std::unique_ptr<TcpStream>> waiting;
  const Clock::Instant give_up = clock_.now() + kPatience;
  while (clock_.now() < give_up) {
    const Clock::Instant before = clock_.now();
    try {
      waiting.push_back(std::make_unique<TcpStream>("127.0.0.1", listener_.port(), clock_, 200ms));
    } catch (const InstrumentError& error) {
      EXPECT_EQ(error.fault(), Fault::kCannotOpen);
      EXPECT_THAT(error.what(), HasSubstr("no answer within 0.2 s"));
      EXPECT_GE(clock_.now() - before, 200ms);
      return;
    }
  }
  FAIL() << "the listener took every connection";
}

TEST_F(TcpStreamTest, IsOpenedByTheNameInABenchFile) {
  const auto stream = open_stream("tcp:127.0.0.1:" + std::to_string(listener_.port()), {}, clock_);
  listener_.accept();
  stream->write("x");
  EXPECT_EQ(listener_.read(1), "x");
}

}  // namespace
}  // namespace abcal::wire
