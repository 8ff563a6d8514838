#include "drivers/wire/lease.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "drivers/wire/open_stream.h"
#include "drivers/wire/port_held.h"
#include "tests/drivers/wire/pseudo_terminal.h"
#include "tests/drivers/wire/steady_clock.h"
#include "tests/support/temporary_folder.h"

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
  explicit AnotherProgram(const std::string& name)
      : AnotherProgram([name] { (void)Lease::take(name, "the other"); }) {}

  /// @param take  takes a lease in that process
  explicit AnotherProgram(const std::function<void()>& take) {
    if (::pipe(orders_.data()) != 0) throw std::runtime_error("no pipe");
    child_ = ::fork();
    if (child_ != 0) return;
    ::close(orders_[1]);  // So that the end of the test ends this process.
    char order = 0;
    if (::read(orders_[0], &order, 1) != 1) ::_exit(3);
    try {
      take();
      ::_exit(0);
    } catch (const PortHeld& error) {
      ::_exit(std::string(error.what()).find("a run by A. B.") == std::string::npos ? 2 : 1);
    } catch (const std::exception&) {
      ::_exit(4);
    }
  }
  ~AnotherProgram() {
    ::close(orders_[0]);
    ::close(orders_[1]);
    if (child_ > 0) ::waitpid(child_, nullptr, 0);
  }
  AnotherProgram(const AnotherProgram&) = delete;
  AnotherProgram& operator=(const AnotherProgram&) = delete;

  /// @return 0: granted; 1: refused with the words of the holder; 2: refused with others
  int take() {
    if (::write(orders_[1], "!", 1) != 1) return -1;
    int status = 0;
    ::waitpid(std::exchange(child_, -1), &status, 0);
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

/// Serial numbers are free text. None leads to a file elsewhere, and two of them are two resources.
TEST(LeaseTest, EachSerialNumberIsAResourceOfItsOwn) {
  const auto numbered = [](const std::string& serial_number) {
    return Lease::of_instrument("Maker", fmt::format("model {}", ::getpid()), serial_number);
  };
  const std::vector<std::string> numbers{"12/3", "12_3", "../../../tmp/12", "12\n3", "\x1b[31m12",
                                         "\xff", "."};
  std::vector<std::shared_ptr<Lease>> leases;
  for (const std::string& number : numbers) {
    AnotherProgram same(numbered(number));
    {
      AnotherProgram unheld(numbered(number));
      EXPECT_EQ(unheld.take(), 0) << number << " is not the same as one before it";
    }
    leases.push_back(Lease::take(numbered(number), "a run by A. B."));
    EXPECT_EQ(same.take(), 1) << number;
  }
}

TEST(LeaseTest, ALongSerialNumberIsAResource) {
  const std::string long_one =
      Lease::of_instrument("Maker", std::to_string(::getpid()), std::string(5000, '/'));
  AnotherProgram another(long_one);
  const auto lease = Lease::take(long_one, "a run by A. B.");
  EXPECT_EQ(another.take(), 1);
}

/// A device is one resource by any name, and a program that finds it in use names its holder.
TEST(LeaseTest, ADeviceIsRefusedByALinkToItWithTheWordsOfTheHolder) {
  const test::TemporaryFolder folder;
  const test::PseudoTerminal terminal;
  std::filesystem::create_symlink(terminal.path(), folder / "by-id");
  test::SteadyClock clock;
  const auto opened = [&clock](const std::string& path, const std::string& holder) {
    return open_stream(path, {}, clock, holder);
  };
  AnotherProgram another([&] { (void)opened((folder / "by-id").string(), "the other"); });
  const auto port = opened(terminal.path(), "a run by A. B.");
  EXPECT_EQ(another.take(), 1);
}

}  // namespace
}  // namespace abcal::wire
