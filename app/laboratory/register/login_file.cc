#include "app/laboratory/register/login_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <stdexcept>

namespace abcal::lab {

std::filesystem::path state_folder() {
  if (const char* state = std::getenv("XDG_STATE_HOME"); state != nullptr && *state == '/')
    return std::filesystem::path(state) / "abcal";
  if (const char* home = std::getenv("HOME"); home != nullptr && *home == '/')
    return std::filesystem::path(home) / ".local/state/abcal";
  throw std::runtime_error("nothing can be kept: neither HOME nor XDG_STATE_HOME names a folder");
}

std::filesystem::path login_file_path(const std::string& register_identity) {
  return state_folder() / ("login-" + register_identity);
}

void write_login(const LoginFile& login) {
  const std::filesystem::path path = login_file_path(login.register_identity);
  std::filesystem::create_directories(path.parent_path());
  const std::filesystem::path draft = fmt::format("{}.new-{}", path.string(), ::getpid());
  const int fd = ::open(draft.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0600);
  const std::string text = login.token + "\n";
  const bool written = fd >= 0 && ::fchmod(fd, 0600) == 0 &&
                       ::write(fd, text.data(), text.size()) == static_cast<ssize_t>(text.size());
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (!written || ::rename(draft.c_str(), path.c_str()) != 0)
    throw std::runtime_error(
        fmt::format("{}: the login cannot be kept: {}", path.string(), std::strerror(error)));
}

std::optional<LoginFile> read_login(const std::string& register_identity) {
  const std::filesystem::path path = login_file_path(register_identity);
  struct stat facts {};
  if (::stat(path.c_str(), &facts) != 0) return std::nullopt;
  if ((facts.st_mode & (S_IRWXG | S_IRWXO)) != 0U || facts.st_uid != ::geteuid())
    throw std::runtime_error(
        fmt::format("{}: belongs to or can be read by others; required: log in again", path.string()));
  LoginFile login{register_identity, {}};
  std::ifstream file(path);
  std::getline(file, login.token);
  if (login.token.empty()) return std::nullopt;
  return login;
}

void remove_login(const std::string& register_identity) {
  std::error_code ignored;
  std::filesystem::remove(login_file_path(register_identity), ignored);
}

}  // namespace abcal::lab
