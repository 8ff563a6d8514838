#pragma once

#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <stdexcept>
#include <string>
#include <string_view>

namespace abcal::test {

/// The instrument's end of a pseudo-terminal; path() is what a program opens.
class PseudoTerminal {
 public:
  PseudoTerminal() : fd_(::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC)) {
    if (fd_ < 0 || ::grantpt(fd_) != 0 || ::unlockpt(fd_) != 0)
      throw std::runtime_error("no pseudo-terminal");
    std::array<char, 128> name{};
    if (::ptsname_r(fd_, name.data(), name.size()) != 0) throw std::runtime_error("no pseudo-terminal name");
    path_ = name.data();
  }
  ~PseudoTerminal() { hang_up(); }
  PseudoTerminal(const PseudoTerminal&) = delete;
  PseudoTerminal& operator=(const PseudoTerminal&) = delete;

  const std::string& path() const { return path_; }

  void hang_up() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }

  /// Writes all, waiting for the reader.
  void write(std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t count = ::write(fd_, bytes.data(), bytes.size());
      if (count < 0 && errno == EINTR) continue;
      if (count <= 0) throw std::runtime_error("pseudo-terminal write failed");
      bytes.remove_prefix(static_cast<std::size_t>(count));
    }
  }

  /// Reads `size` bytes, or fewer if they do not come within 5 s.
  std::string read(std::size_t size) {
    std::string bytes;
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(5);
    while (bytes.size() < size && std::chrono::steady_clock::now() < deadline) {
      pollfd ready{fd_, POLLIN, 0};
      if (::poll(&ready, 1, 100) <= 0) continue;
      std::array<char, 4096> chunk{};
      const ssize_t count = ::read(fd_, chunk.data(), std::min(chunk.size(), size - bytes.size()));
      if (count <= 0) break;
      bytes.append(chunk.data(), static_cast<std::size_t>(count));
    }
    return bytes;
  }

 private:
  int fd_;
  std::string path_;
};

}  // namespace abcal::test
