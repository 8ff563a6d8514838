#include "app/system/child_process.h"
#include "app/system/detached_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <sstream>
#include <utility>

#include "app/system/interrupt.h"
#include "protocol/run/experiment_run.h"

extern char** environ;

namespace abcal {
namespace {

/// How the child begins: signals have their default handling, so that Ctrl-C ends it too, and no
/// descriptor of this program but the standard ones. Standard output goes to standard error.
class SpawnSettings {
 public:
  SpawnSettings() {
    ::posix_spawnattr_init(&attributes_);
    ::posix_spawn_file_actions_init(&actions_);
    sigset_t none, all;
    ::sigemptyset(&none);
    ::sigfillset(&all);
    ::posix_spawnattr_setsigmask(&attributes_, &none);
    ::posix_spawnattr_setsigdefault(&attributes_, &all);
    ::posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
  }
  SpawnSettings(const SpawnSettings&) = delete;
  SpawnSettings& operator=(const SpawnSettings&) = delete;
  ~SpawnSettings() {
    ::posix_spawn_file_actions_destroy(&actions_);
    ::posix_spawnattr_destroy(&attributes_);
  }
  void hide_words() {
    ::posix_spawn_file_actions_addopen(&actions_, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
  }
  void send_words_to(int descriptor) {
    ::posix_spawn_file_actions_adddup2(&actions_, descriptor, STDERR_FILENO);
  }

  void detach() {
    ::posix_spawnattr_setflags(&attributes_,
                               POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSID);
    ::posix_spawn_file_actions_addopen(&actions_, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  }
  /// The child has it as the first descriptor after the standard ones.
  void keep(int descriptor) {
    ::posix_spawn_file_actions_adddup2(&actions_, descriptor, kKept);
    first_closed_ = kKept + 1;
  }

  /// @throws ProgramMissing, std::runtime_error
  pid_t start(const Tool& tool, const std::vector<std::string>& arguments) {
    require_installed(tool);
    ::posix_spawn_file_actions_adddup2(&actions_, STDERR_FILENO, STDOUT_FILENO);
    ::posix_spawn_file_actions_addclosefrom_np(&actions_, first_closed_);
    std::vector<std::string> words{tool.program};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    pid_t child = 0;
    const int error =
        ::posix_spawnp(&child, tool.program.c_str(), &actions_, &attributes_, argv.data(), environ);
    if (error != 0)
      throw std::runtime_error(fmt::format("{} cannot be started: {}", tool.program, std::strerror(error)));
    return child;
  }

 private:
  static constexpr int kKept = STDERR_FILENO + 1;
  posix_spawnattr_t attributes_{};
  posix_spawn_file_actions_t actions_{};
  int first_closed_ = kKept;
};

/// @returns the exit code; 128 + signal if a signal ended it
/// @throws RunInterrupted (Ctrl-C meanwhile), std::runtime_error
int wait_for_end(pid_t child, const Tool& tool) {
  int status = 0;
  while (::waitpid(child, &status, 0) < 0) {
    if (errno != EINTR)
      throw std::runtime_error(fmt::format("waiting for {}: {}", tool.program, std::strerror(errno)));
  }
  if (interrupt_token().stop_requested())
    throw RunInterrupted(fmt::format("interrupted while {} was running", tool.program));
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

/// All bytes until the writer is gone; those beyond 64 kB are not kept.
std::string read_words(int descriptor) {
  constexpr std::size_t kMost = 65'536;
  std::string words;
  std::array<char, 4096> chunk{};
  for (;;) {
    const ssize_t count = ::read(descriptor, chunk.data(), chunk.size());
    if (count == 0 || (count < 0 && errno != EINTR)) break;
    if (count > 0)
      words.append(chunk.data(), std::min(static_cast<std::size_t>(count), kMost - words.size()));
  }
  while (words.ends_with('\n')) words.pop_back();
  return words;
}

}  // namespace

bool is_installed(const Tool& tool) {
  if (tool.program.find('/') != std::string::npos) return ::access(tool.program.c_str(), X_OK) == 0;
  const char* path = std::getenv("PATH");
  std::istringstream folders(path != nullptr ? path : "/usr/local/bin:/usr/bin:/bin");
  for (std::string folder; std::getline(folders, folder, ':');) {
    const std::filesystem::path file = std::filesystem::path(folder.empty() ? "." : folder) / tool.program;
    std::error_code ignored;
    if (std::filesystem::is_regular_file(file, ignored) && ::access(file.c_str(), X_OK) == 0) return true;
  }
  return false;
}

void require_installed(const Tool& tool) {
  if (is_installed(tool)) return;
  throw ProgramMissing(fmt::format("{} {}, which is not installed (Debian: apt install {})", tool.needed_by,
                                   tool.program, tool.package));
}

pid_t start_detached(const Tool& tool, const std::vector<std::string>& arguments, int descriptor) {
  SpawnSettings settings;
  settings.detach();
  if (descriptor >= 0) settings.keep(descriptor);
  return settings.start(tool, arguments);
}

int run_tool(const Tool& tool, const std::vector<std::string>& arguments, ToolOutput output) {
  SpawnSettings settings;
  if (output == ToolOutput::kHidden) settings.hide_words();
  return wait_for_end(settings.start(tool, arguments), tool);
}

ToolResult run_tool_for_words(const Tool& tool, const std::vector<std::string>& arguments) {
  std::array<int, 2> ends{};
  if (::pipe2(ends.data(), O_CLOEXEC) != 0)
    throw std::runtime_error(fmt::format("{} cannot be started: {}", tool.program, std::strerror(errno)));
  SpawnSettings settings;
  settings.send_words_to(ends[1]);
  pid_t child = 0;
  try {
    child = settings.start(tool, arguments);
  } catch (...) {
    ::close(ends[0]);
    ::close(ends[1]);
    throw;
  }
  ::close(ends[1]);
  std::string words = read_words(ends[0]);
  ::close(ends[0]);
  return {wait_for_end(child, tool), std::move(words)};
}

}  // namespace abcal
