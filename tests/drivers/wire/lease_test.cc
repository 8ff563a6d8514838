#include "drivers/wire/lease.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pwd.h>
#include <sys/stat.h>
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

/// Files in the place of a lease's, each of which keeps its holder from being known.
class UnreadableLeaseTest : public testing::Test {
 protected:
  UnreadableLeaseTest() {
    (void)Lease::take(name, "a run by A. B.");  // It makes the file.
    for (const char* parent : {"/run/lock", "/tmp"}) {
      const auto file = std::filesystem::path(parent) / "abcal" / (name + ".lease");
      if (std::filesystem::exists(file)) path = file;
    }
    std::filesystem::remove(path);
  }
  ~UnreadableLeaseTest() override { std::filesystem::remove(path); }

  /// Answer to a program of another user that takes the lease; empty: it is granted.
  std::string refusal() const {
    std::array<int, 2> words{};
    if (::pipe(words.data()) != 0) return "no pipe";
    const pid_t child = ::fork();
    if (child == 0) {
      constexpr uid_t kNobody = 65534;
      std::string told;
      if (::geteuid() == 0 && ::setuid(kNobody) != 0) told = "no other user";
      try {
        (void)Lease::take(name, "the other");
      } catch (const PortHeld& error) {
        told = error.what();
      }
      (void)!::write(words[1], told.data(), told.size());
      ::_exit(0);
    }
    ::close(words[1]);
    std::array<char, 2000> told{};
    const ssize_t count = ::read(words[0], told.data(), told.size());
    ::close(words[0]);
    ::waitpid(child, nullptr, 0);
    return {told.data(), count > 0 ? static_cast<std::size_t>(count) : 0U};
  }

  const std::string name = resource();
  std::filesystem::path path;
};

TEST_F(UnreadableLeaseTest, IsRefusedWithItsOwnerAndWhatToDo) {
  const test::TemporaryFolder folder;
  const std::string owner = ::getpwuid(::geteuid())->pw_name;
  const auto expect_refused = [&](const std::string& kind) {
    EXPECT_THAT(refusal(),
                testing::AllOf(testing::HasSubstr(path.string() + " is a " + kind + " of the user " + owner),
                               testing::HasSubstr("required: a file that all users may read and write")))
        << kind;
    std::filesystem::remove(path);
  };
  EXPECT_EQ(refusal(), "") << "where nothing is in its place";
  std::filesystem::remove(path);
  std::filesystem::create_symlink(folder / "nowhere", path);
  expect_refused("link");
  std::filesystem::create_directory(path);
  expect_refused("folder");
  ASSERT_EQ(::mkfifo(path.c_str(), 0666), 0);
  ::chmod(path.c_str(), 0666);
  expect_refused("special file");
  if (::geteuid() != 0) GTEST_SKIP() << "only root can make a file that its own program cannot read";
  const int made = ::open(path.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0600);
  ASSERT_GE(made, 0);
  ::close(made);
  expect_refused("file");
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
