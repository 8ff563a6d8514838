#include "app/system/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <sstream>

#include "app/system/interrupt.h"
#include "protocol/run/experiment_run.h"

extern char** environ;

namespace abcal {
namespace {

/// How the child begins: signals as in a program that nobody changed, so that Ctrl-C ends it too.
class SpawnSettings {
 public:
  explicit SpawnSettings(ToolOutput output) {
    ::posix_spawnattr_init(&attributes_);
    ::posix_spawn_file_actions_init(&actions_);
    sigset_t none, all;
    ::sigemptyset(&none);
    ::sigfillset(&all);
    ::posix_spawnattr_setsigmask(&attributes_, &none);
    ::posix_spawnattr_setsigdefault(&attributes_, &all);
    ::posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    if (output == ToolOutput::kHidden)
      ::posix_spawn_file_actions_addopen(&actions_, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
    ::posix_spawn_file_actions_adddup2(&actions_, STDERR_FILENO, STDOUT_FILENO);
  }
  SpawnSettings(const SpawnSettings&) = delete;
  SpawnSettings& operator=(const SpawnSettings&) = delete;
  ~SpawnSettings() {
    ::posix_spawn_file_actions_destroy(&actions_);
    ::posix_spawnattr_destroy(&attributes_);
  }
  const posix_spawnattr_t* attributes() const { return &attributes_; }
  const posix_spawn_file_actions_t* actions() const { return &actions_; }

 private:
  posix_spawnattr_t attributes_{};
  posix_spawn_file_actions_t actions_{};
};

}  // namespace

bool is_installed(const Tool& tool) {
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

int run_tool(const Tool& tool, const std::vector<std::string>& arguments, ToolOutput output) {
  require_installed(tool);
  std::vector<std::string> words{tool.program};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  const SpawnSettings settings(output);
  pid_t child = 0;
  if (const int error = ::posix_spawnp(&child, tool.program.c_str(), settings.actions(),
                                       settings.attributes(), argv.data(), environ);
      error != 0) {
    throw std::runtime_error(fmt::format("{} cannot be started: {}", tool.program, std::strerror(error)));
  }
  int status = 0;
  while (::waitpid(child, &status, 0) < 0) {
    if (errno != EINTR)
      throw std::runtime_error(fmt::format("waiting for {}: {}", tool.program, std::strerror(errno)));
  }
  if (interrupt_token().stop_requested())
    throw RunInterrupted(fmt::format("interrupted while {} was at work", tool.program));
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

}  // namespace abcal
