#include "app/system/detached_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <unistd.h>

#include <cstring>
#include <stdexcept>
#include <utility>

#include "app/system/channel.h"

extern char** environ;

namespace abcal {
namespace {

/// Settings of a detached program: its own session without terminal and standard input, signals with their
/// default handling, and no descriptor of this program but standard error and the one that it is given.
/// Standard output goes to standard error.
class DetachedSettings {
 public:
  explicit DetachedSettings(int descriptor) {
    ::posix_spawnattr_init(&attributes);
    ::posix_spawn_file_actions_init(&actions);
    sigset_t none, all;
    ::sigemptyset(&none);
    ::sigfillset(&all);
    ::posix_spawnattr_setsigmask(&attributes, &none);
    ::posix_spawnattr_setsigdefault(&attributes, &all);
    ::posix_spawnattr_setflags(&attributes,
                               POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSID);
    ::posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    constexpr int kKept = STDERR_FILENO + 1;
    if (descriptor >= 0) ::posix_spawn_file_actions_adddup2(&actions, descriptor, kKept);
    ::posix_spawn_file_actions_adddup2(&actions, STDERR_FILENO, STDOUT_FILENO);
    ::posix_spawn_file_actions_addclosefrom_np(&actions, descriptor >= 0 ? kKept + 1 : kKept);
  }
  DetachedSettings(const DetachedSettings&) = delete;
  DetachedSettings& operator=(const DetachedSettings&) = delete;
  ~DetachedSettings() {
    ::posix_spawn_file_actions_destroy(&actions);
    ::posix_spawnattr_destroy(&attributes);
  }

  posix_spawnattr_t attributes{};
  posix_spawn_file_actions_t actions{};
};

}  // namespace

pid_t start_detached(const Tool& tool, const std::vector<std::string>& arguments, int descriptor) {
  require_installed(tool);
  const DetachedSettings settings(descriptor);
  std::vector<std::string> words{tool.program};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  pid_t child = 0;
  const int error = ::posix_spawnp(&child, tool.program.c_str(), &settings.actions, &settings.attributes,
                                   argv.data(), environ);
  if (error != 0)
    throw std::runtime_error(fmt::format("{} cannot be started: {}", tool.program, std::strerror(error)));
  return child;
}

ConnectedProcess start_connected(const Tool& tool, const std::vector<std::string>& arguments) {
  auto [ours, theirs] = channel_pair(ChannelKind::kPackets, tool.program + " cannot be started");
  const pid_t process = start_detached(tool, arguments, theirs.number());
  return {std::move(ours), process};
}

}  // namespace abcal
