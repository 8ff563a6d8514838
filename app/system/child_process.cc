#include "app/system/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <optional>
#include <sstream>
#include <utility>

#include "app/system/channel.h"
#include "app/system/descriptor.h"
#include "app/system/interrupt.h"
#include "app/system/last_signal.h"
#include "protocol/record/run_interrupted.h"

extern char** environ;

namespace abcal {
namespace {

using std::chrono::steady_clock;

std::optional<std::string> find_program(const Tool& tool) {
  const auto runs = [](const std::filesystem::path& file) {
    std::error_code ignored;
    return std::filesystem::is_regular_file(file, ignored) && ::access(file.c_str(), X_OK) == 0;
  };
  if (tool.program.find('/') != std::string::npos)
    return runs(tool.program) ? std::optional(tool.program) : std::nullopt;
  const char* path = std::getenv("PATH");
  std::istringstream folders(path != nullptr ? path : "/usr/local/bin:/usr/bin:/bin");
  for (std::string folder; std::getline(folders, folder, ':');) {
    const std::filesystem::path file = std::filesystem::path(folder.empty() ? "." : folder) / tool.program;
    if (runs(file)) return file.string();
  }
  return std::nullopt;
}

/// Descriptors of a program.
struct ChildStreams {
  int input = STDIN_FILENO;
  int words = STDERR_FILENO;  ///< Receives both outputs.
};

/// Pipe for the output of a program to us.
struct WordsPipe {
  explicit WordsPipe(const Tool& tool) {
    std::array<int, 2> ends{};
    if (::pipe2(ends.data(), O_CLOEXEC | O_NONBLOCK) != 0)
      throw std::runtime_error(fmt::format("{} cannot be started: {}", tool.program, std::strerror(errno)));
    reading = Descriptor(ends[0]);
    writing = Descriptor(ends[1]);
    // Only our end must not block.
    ::fcntl(writing.number(), F_SETFL, 0);
  }
  Descriptor reading, writing;
};

/// Runs in the child between fork and exec: only async-signal-safe calls. Signals get default handling.
[[noreturn]] void become(const char* program, char* const* argv, const ChildStreams& streams, pid_t parent) {
  ::setpgid(0, 0);
  // A program must not outlive abcal, even if abcal is killed.
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(127);
  for (int number = 1; number < NSIG; ++number) ::signal(number, SIG_DFL);
  sigset_t none;
  ::sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  if (::dup2(streams.input, STDIN_FILENO) < 0 || ::dup2(streams.words, STDERR_FILENO) < 0 ||
      ::dup2(streams.words, STDOUT_FILENO) < 0)
    ::_exit(127);
  ::close_range(STDERR_FILENO + 1, ~0U, 0);
  ::execve(program, argv, environ);
  ::_exit(127);
}

/// The input of a program, from us.
struct ChildInput {
  Descriptor* socket = nullptr;  ///< Closed at the end of the bytes; null: it has another.
  std::string_view bytes;
};

/// A running program; it does not outlive this.
class Child {
 public:
  Child(const Tool& tool, const std::vector<std::string>& arguments, const ChildStreams& streams)
      : tool_(tool) {
    require_installed(tool);
    const std::string program = find_program(tool).value();
    std::vector<std::string> strings{tool.program};
    strings.insert(strings.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& word : strings) argv.push_back(word.data());
    argv.push_back(nullptr);
    const pid_t parent = ::getpid();
    pid_ = ::fork();
    if (pid_ < 0)
      throw std::runtime_error(fmt::format("{} cannot be started: {}", tool.program, std::strerror(errno)));
    if (pid_ == 0) become(program.c_str(), argv.data(), streams, parent);
    ::setpgid(pid_, pid_);  // Whichever is first.
    ended_too_.emplace([group = pid_] { ::kill(-group, SIGKILL); });
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;
  ~Child() { stop(); }

  /// Waits for the end, and reads output from `words` meanwhile (-1: none).
  ToolResult wait(int words, std::chrono::seconds longest, const std::function<bool()>& cancelled = {},
                  ChildInput input = {}) {
    // The header of glibc 2.36 declares pidfd_open() for C alone.
    const Descriptor ended(static_cast<int>(::syscall(SYS_pidfd_open, pid_, 0)));
    if (ended.number() < 0)
      throw std::runtime_error(fmt::format("waiting for {}: {}", tool_.program, std::strerror(errno)));
    constexpr int kLookMs = 100;  // for Ctrl-C
    const auto deadline = steady_clock::now() + longest;
    std::array<pollfd, 3> wanted{pollfd{ended.number(), POLLIN, 0}, pollfd{words, POLLIN, 0},
                                 pollfd{input.socket != nullptr ? input.socket->number() : -1, POLLOUT, 0}};
    ToolResult result;
    while ((wanted[0].revents & POLLIN) == 0) {
      ::poll(wanted.data(), wanted.size(), kLookMs);
      if (wanted[1].revents != 0 && !read_some(words, result.words)) wanted[1].fd = -1;
      if (wanted[2].revents != 0 && !write_some(input)) wanted[2].fd = -1;
      if (last_interrupt_signal() != 0)
        throw RunInterrupted(Message("interrupted while {program} was at work", tool_.program));
      if (cancelled && cancelled())
        throw RunInterrupted(Message("cancelled while {program} was at work", tool_.program));
      if (steady_clock::now() > deadline)
        throw std::runtime_error(
            fmt::format("{} took longer than {} s and was ended", tool_.program, longest.count()));
    }
    const int status = stop();
    while (words >= 0 && read_some(words, result.words)) {
    }
    while (result.words.ends_with('\n')) result.words.pop_back();
    result.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    return result;
  }

 private:
  /// Ends it and the programs that it started. @return its status
  int stop() {
    if (pid_ <= 0) return 0;
    ended_too_.reset();  // Its number may soon be that of another process.
    ::kill(-pid_, SIGKILL);
    int status = 0;
    while (::waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
    }
    pid_ = -1;
    return status;
  }

  /// @return false: everything is written and the socket closed, or the reader has gone
  static bool write_some(ChildInput& input) {
    const ssize_t count =
        ::send(input.socket->number(), input.bytes.data(), input.bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (count < 0 && (errno == EAGAIN || errno == EINTR)) return true;
    input.bytes.remove_prefix(count < 0 ? input.bytes.size() : static_cast<std::size_t>(count));
    if (!input.bytes.empty()) return true;
    input.socket->close();
    return false;
  }

  /// Keeps the first 64 kB. @return false at the end, or if no bytes are available now
  static bool read_some(int words, std::string& kept) {
    constexpr std::size_t kMost = 65'536;
    std::array<char, 4096> chunk{};
    const ssize_t count = ::read(words, chunk.data(), chunk.size());
    if (count <= 0) return count < 0 && errno == EINTR;
    kept.append(chunk.data(), std::min(static_cast<std::size_t>(count), kMost - kept.size()));
    return true;
  }

  Tool tool_;
  pid_t pid_ = -1;
  std::optional<BeforeSignalEnds> ended_too_;  ///< Includes the programs that it started.
};

}  // namespace

bool is_installed(const Tool& tool) {
  return find_program(tool).has_value();
}

void require_installed(const Tool& tool) {
  if (is_installed(tool)) return;
  throw ProgramMissing(fmt::format("{} {}, which is not installed (Debian: apt install {})", tool.needed_by,
                                   tool.program, tool.package));
}

int run_tool(const Tool& tool, const std::vector<std::string>& arguments, ToolOutput output,
             std::chrono::seconds longest) {
  const Descriptor nowhere(output == ToolOutput::kHidden ? ::open("/dev/null", O_WRONLY | O_CLOEXEC) : -1);
  Child child(tool, arguments, {STDIN_FILENO, nowhere.number() >= 0 ? nowhere.number() : STDERR_FILENO});
  return child.wait(-1, longest).exit_code;
}

ToolResult run_tool_for_words(const Tool& tool, const std::vector<std::string>& arguments,
                              std::chrono::seconds longest, const std::function<bool()>& cancelled) {
  WordsPipe words(tool);
  Child child(tool, arguments, {STDIN_FILENO, words.writing.number()});
  words.writing.close();
  return child.wait(words.reading.number(), longest, cancelled);
}

struct ToolAwaitingInput::Running {
  Running(const Tool& tool, const std::vector<std::string>& arguments)
      : words(tool),
        input(channel_pair(ChannelKind::kBytes, tool.program + " cannot be started")),
        child(tool, arguments, {input.second.number(), words.writing.number()}) {
    words.writing.close();
    input.second.close();
  }

  WordsPipe words;
  /// Our end and that of the program. It is a socket, because writing to one whose reader has ended is an
  /// error and no signal.
  std::pair<Descriptor, Descriptor> input;
  Child child;
};

ToolAwaitingInput::ToolAwaitingInput(const Tool& tool, const std::vector<std::string>& arguments)
    : running_(std::make_unique<Running>(tool, arguments)) {}

ToolAwaitingInput::~ToolAwaitingInput() = default;

ToolResult ToolAwaitingInput::finish(std::string_view input, std::chrono::seconds longest,
                                     const std::function<bool()>& cancelled) {
  return running_->child.wait(running_->words.reading.number(), longest, cancelled,
                              {&running_->input.first, input});
}

}  // namespace abcal
