#include "drivers/wire/lease.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <stdexcept>
#include <string>

#include "drivers/wire/port_held.h"

namespace abcal::wire {
namespace {

/// An address that no other program uses: it contains the number of this process.
std::string resource() {
  return fmt::format("tcp:test.invalid:{}", ::getpid());
}

/// A process of its own that takes a lease when it is told to. It is started before this process takes one,
/// so that it inherits none.
class AnotherProgram {
 public:
  explicit AnotherProgram(const std::string& name) {
    if (::pipe(orders_.data()) != 0) throw std::runtime_error("no pipe");
    child_ = ::fork();
    if (child_ != 0) return;
    char order = 0;
    if (::read(orders_[0], &order, 1) != 1) ::_exit(3);
    try {
      const auto lease = Lease::take(name, "the other");
      ::_exit(0);
    } catch (const PortHeld& error) {
      ::_exit(std::string(error.what()).find("a run by A. B.") == std::string::npos ? 2 : 1);
    }
  }
  ~AnotherProgram() {
    ::close(orders_[0]);
    ::close(orders_[1]);
  }
  AnotherProgram(const AnotherProgram&) = delete;
  AnotherProgram& operator=(const AnotherProgram&) = delete;

  /// @return 0: granted; 1: refused with the words of the holder; 2: refused with others
  int take() {
    if (::write(orders_[1], "!", 1) != 1) return -1;
    int status = 0;
    ::waitpid(child_, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }

 private:
  std::array<int, 2> orders_{};
  pid_t child_ = -1;
};

TEST(LeaseTest, AnotherProgramIsRefusedWithTheWordsOfTheHolder) {
  AnotherProgram another(resource()), third(resource());
  const auto lease = Lease::take(resource(), "a run by A. B.");
  EXPECT_EQ(another.take(), 1);
  EXPECT_EQ(third.take(), 1) << "a refusal leaves the words as they are";
}

TEST(LeaseTest, AReleasedLeaseIsGranted) {
  AnotherProgram another(resource());
  Lease::take(resource(), "a run by A. B.").reset();
  EXPECT_EQ(another.take(), 0);
}

TEST(LeaseTest, WithinAProgramAResourceMayBeTakenSeveralTimes) {
  const auto first = Lease::take(resource(), "a run by A. B.");
  const auto second = Lease::take(resource(), "another connection");
  EXPECT_EQ(first, second);
}

}  // namespace
}  // namespace abcal::wire
