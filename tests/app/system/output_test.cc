#include "app/system/output.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <stdexcept>
#include <string>

#include "app/system/terminal.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::EndsWith;
using testing::HasSubstr;
using testing::StartsWith;

TEST(PrintableTextTest, ShowsWhatATerminalWouldObey) {
  EXPECT_EQ(printable_text("\x1b[2J\a\r\b\x7f"), R"(\u001b[2J\u0007\u000d\u0008\u007f)");
  EXPECT_EQ(printable_text("a\u0085b\u009bc"), R"(a\u0085b\u009bc)");  // C1: as good as an escape
  EXPECT_EQ(printable_text("\u202e\u2066\u200f\u061c\u2028"), R"(\u202e\u2066\u200f\u061c\u2028)");
  EXPECT_EQ(printable_text(std::string_view("\0", 1)), R"(\u0000)");
}

TEST(PrintableTextTest, LeavesTextAsItIs) {
  EXPECT_EQ(printable_text("line\n\tµm, Größe, 測定, 🜨"), "line\n\tµm, Größe, 測定, 🜨");
}

TEST(PrintableTextTest, ShowsBytesThatAreNotUtf8) {
  EXPECT_EQ(printable_text("a\xff\xc3"), R"(a\xff\xc3)");
  EXPECT_EQ(printable_text("\xc0\xaf"), R"(\xc0\xaf)");                  // "/" in two bytes
  EXPECT_EQ(printable_text("\xed\xa0\x80"), R"(\xed\xa0\x80)");          // a surrogate
  EXPECT_EQ(printable_text("\xf4\x90\x80\x80"), R"(\xf4\x90\x80\x80)");  // beyond Unicode
}

TEST(ShortenedTextTest, SaysHowMuchIsLeftOutAndCutsNoCharacter) {
  EXPECT_EQ(shortened_text("12345", 5), "12345");
  EXPECT_EQ(shortened_text("123456", 5), "12345... (1 bytes more)");
  EXPECT_EQ(shortened_text("123µ5", 4), "123... (3 bytes more)");
}

/// Replaces a standard descriptor during its lifetime.
class Replaced {
 public:
  Replaced(int descriptor, int by) : descriptor_(descriptor), kept_(::dup(descriptor)) {
    ::dup2(by, descriptor);
  }
  Replaced(const Replaced&) = delete;
  Replaced& operator=(const Replaced&) = delete;
  ~Replaced() {
    ::dup2(kept_, descriptor_);
    ::close(kept_);
  }

 private:
  int descriptor_, kept_;
};

class Pipe {
 public:
  Pipe() {
    if (::pipe2(ends_.data(), O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  ~Pipe() {
    close_reader();
    ::close(ends_[1]);
  }
  int writer() const { return ends_[1]; }
  void close_reader() {
    if (ends_[0] >= 0) ::close(ends_[0]);
    ends_[0] = -1;
  }
  /// Fills the pipe completely.
  void fill() const {
    const std::string block(4096, '.');
    set_blocking(ends_[1], false);
    while (::write(ends_[1], block.data(), block.size()) > 0) {
    }
    set_blocking(ends_[1], true);
  }
  /// Takes all text from the pipe.
  std::string drain() const {
    std::string text;
    std::array<char, 4096> block{};
    set_blocking(ends_[0], false);
    for (ssize_t n = 0; (n = ::read(ends_[0], block.data(), block.size())) > 0;)
      text.append(block.data(), static_cast<std::size_t>(n));
    return text;
  }

 private:
  static void set_blocking(int descriptor, bool blocking) {
    const int flags = ::fcntl(descriptor, F_GETFL);
    ::fcntl(descriptor, F_SETFL, blocking ? flags & ~O_NONBLOCK : flags | O_NONBLOCK);
  }
  std::array<int, 2> ends_{-1, -1};
};

TEST(OutputTest, WordsReachStandardErrorPrintableAndNotTooLong) {
  const Pipe pipe;
  {
    const Replaced replaced(STDERR_FILENO, pipe.writer());
    print_warning("driver \x1b]0;title\a");
    print_log("{}\n", std::string(100'000, 'x'));
  }
  const std::string text = pipe.drain();
  EXPECT_THAT(text, StartsWith("warning: driver \\u001b]0;title\\u0007\n"));
  EXPECT_LT(text.size(), 17'000U);
  EXPECT_THAT(text, EndsWith("bytes more)\n"));
}

TEST(OutputTest, AReaderThatIsGoneOrADescriptorThatIsClosedLosesWordsOnly) {
  std::signal(SIGPIPE, SIG_IGN);
  {
    Pipe pipe;
    pipe.close_reader();
    const Replaced replaced(STDERR_FILENO, pipe.writer());
    print_error("nobody reads this");
  }
  const int full = ::open("/dev/full", O_WRONLY | O_CLOEXEC);
  {
    const Replaced replaced(STDERR_FILENO, full);
    print_error("nobody reads this");
  }
  ::close(full);
}

// A terminal that was stopped with Ctrl-S, or a pager that waits.
TEST(OutputTest, AReaderThatDoesNotReadCostsOneSecondOnce) {
  const Pipe pipe;
  {
    const Replaced replaced(STDERR_FILENO, pipe.writer());
    print_log("what other tests lost is told now\n");
  }
  pipe.drain();
  pipe.fill();
  std::string read;
  {
    const Replaced replaced(STDERR_FILENO, pipe.writer());
    const auto start = std::chrono::steady_clock::now();
    print_log("first\n");
    EXPECT_LT(std::chrono::steady_clock::now() - start, 3s);
    const auto later = std::chrono::steady_clock::now();
    for (int i = 0; i < 100; ++i) print_log("further\n");
    EXPECT_LT(std::chrono::steady_clock::now() - later, 1s);
    pipe.drain();
    print_log("read again\n");
    read = pipe.drain();
  }
  EXPECT_THAT(read, HasSubstr("101 messages are missing here"));
  EXPECT_THAT(read, EndsWith("read again\n"));
}

TEST(OutputTest, EmphasisIsForATerminalOnly) {
  const Pipe pipe;
  {
    const Replaced replaced(STDERR_FILENO, pipe.writer());
    print_log("{}\n", emphasised(stderr, Emphasis::kBad, "bad"));
    print_log(
        "\xfb"
        "forged\xf8\n");
  }
  EXPECT_EQ(pipe.drain(), "bad\n\\xfbforged\\xf8\n");
}

// fmt::print throws if nobody reads, and a stream fails silently.
TEST(OutputTest, NothingElseOfAppPrints) {
  std::size_t looked_at = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(test::source_folder() / "app")) {
    const std::filesystem::path& file = entry.path();
    if (file.extension() != ".cc" && file.extension() != ".h") continue;
    ++looked_at;
    if (file.filename() == "output.cc") continue;  // the one place that does
    const std::string text = test::read_file(file);
    for (const char* word :
         {"fmt::print(", "std::cout", "std::cerr", "spdlog", "printf(", "std::puts(", "fputs("})
      EXPECT_EQ(text.find(word), std::string::npos)
          << file << " has " << word << "; required: app/system/output.h";
  }
  EXPECT_GT(looked_at, 100U);
}

// Last of all, as a lost result is remembered.
TEST(OutputTest, LostResultsGiveTheExitCodeOfAFailure) {
  EXPECT_EQ(finish_output(0), 0);
  const int full = ::open("/dev/full", O_WRONLY | O_CLOEXEC);
  {
    const Replaced replaced(STDOUT_FILENO, full);
    print_result("{}\n", 42);
  }
  ::close(full);
  const Pipe pipe;
  {
    const Replaced replaced(STDERR_FILENO, pipe.writer());
    EXPECT_EQ(finish_output(0), 1);
    EXPECT_EQ(finish_output(130), 130);
  }
  EXPECT_THAT(pipe.drain(),
              HasSubstr("could not be written to standard output, or not all of it: No space left"));
}

}  // namespace
}  // namespace abcal
