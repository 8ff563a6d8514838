#pragma once

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>

namespace abcal::test {

/// Whether a process holds SQLite's shared lock on a file: 510 bytes, from 2 bytes behind 1 GiB on. A child
/// asks, because a process never sees its own POSIX locks.
inline bool shared_lock_is_held(const std::filesystem::path& path) {
  const pid_t asking = ::fork();
  if (asking == 0) {
    const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    struct flock range {};
    range.l_type = F_WRLCK;
    range.l_whence = SEEK_SET;
    range.l_start = 0x40000002;
    range.l_len = 510;
    ::_exit(::fcntl(file, F_GETLK, &range) == 0 && range.l_type != F_UNLCK ? 0 : 1);
  }
  int status = 1;
  ::waitpid(asking, &status, 0);
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

}  // namespace abcal::test
