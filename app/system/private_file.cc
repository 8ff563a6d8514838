#include "app/system/private_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <stdexcept>

#include "app/system/read_file.h"

namespace abcal {

void write_private_file(const std::filesystem::path& path, const std::string& content) {
  const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd < 0)
    throw std::runtime_error(fmt::format("{}: cannot be made: {}", path.string(), std::strerror(errno)));
  std::size_t at = 0;
  bool good = true;
  while (good && at < content.size()) {
    const ssize_t count = ::write(fd, content.data() + at, content.size() - at);
    good = count > 0 || (count < 0 && errno == EINTR);
    if (count > 0) at += static_cast<std::size_t>(count);
  }
  good = good && ::fsync(fd) == 0;
  const int error = errno;
  ::close(fd);
  if (good) return;
  ::unlink(path.c_str());
  throw std::runtime_error(fmt::format("{}: cannot be stored: {}", path.string(), std::strerror(error)));
}

std::string read_private_file(const std::filesystem::path& path, const std::string& kind) {
  namespace fs = std::filesystem;
  std::error_code error;
  const fs::perms mode = fs::status(path, error).permissions();
  if (error) throw std::invalid_argument(fmt::format("{} {}: {}", kind, path.string(), error.message()));
  if ((mode & (fs::perms::group_all | fs::perms::others_all)) != fs::perms::none)
    throw std::invalid_argument(fmt::format("{} {}: others may read or change it; required: chmod 600 {}",
                                            kind, path.string(), path.string()));
  return read_file(path);
}

}  // namespace abcal
