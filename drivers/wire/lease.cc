#include "drivers/wire/lease.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <pwd.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

#include "drivers/wire/device_file.h"
#include "drivers/wire/port_held.h"

namespace abcal::wire {
namespace {

constexpr const char* kFolder = "abcal";

std::string user_name(uid_t number) {
  const passwd* user = ::getpwuid(number);
  return user != nullptr ? user->pw_name : std::to_string(number);
}

/// Refuses a resource because the file of its lease, or their folder, is not what abcal makes: who holds the
/// resource cannot be known then.
/// @param shown  name of the resource
[[noreturn]] void throw_unknown(const std::string& shown, const std::filesystem::path& path, int error) {
  struct stat found {};
  std::string words = "cannot be used";
  if (::lstat(path.c_str(), &found) == 0) {
    const char* kind = S_ISLNK(found.st_mode)   ? "link"
                       : S_ISDIR(found.st_mode) ? "folder"
                       : S_ISREG(found.st_mode) ? "file"
                                                : "special file";
    words = fmt::format("is a {} of the user {} with the mode {:04o}", kind, user_name(found.st_uid),
                        found.st_mode & 07777U);
  }
  throw PortHeld(
      shown,
      fmt::format("whether another program uses it cannot be known: {} {} ({}); required: a {}. Ask "
                  "that user, or an administrator, to remove it while nothing uses the instrument",
                  path.string(), words, std::strerror(error),
                  path.filename() == kFolder ? "folder that all users may write to"
                                             : "file that all users may read and write"),
      {});
}

/// A folder that every user of this computer may write to; empty if there is none.
/// @param shown  as throw_unknown() takes it
std::filesystem::path lease_folder(const std::string& shown) {
  for (const char* parent : {"/run/lock", "/tmp"}) {
    const std::filesystem::path folder = std::filesystem::path(parent) / kFolder;
    // Every user may add a file, none may remove that of another. The mask of new files does not count for
    // chmod.
    if (::mkdir(folder.c_str(), 01777) == 0)
      ::chmod(folder.c_str(), 01777);
    else if (errno != EEXIST)
      continue;  // The parent is missing, or not for this user.
    // Programs that use different folders would not see each other: one that is there is the right one.
    struct stat found {};
    if (::lstat(folder.c_str(), &found) != 0 || !S_ISDIR(found.st_mode))
      throw_unknown(shown, folder, ENOTDIR);
    if (::access(folder.c_str(), W_OK | X_OK) != 0) throw_unknown(shown, folder, errno);
    return folder;
  }
  return {};
}

/// A resource may contain any bytes, because an instrument reports its serial number as free text. Bytes that
/// a file name or a terminal could take for something else are percent-encoded, so that no resource names a
/// file elsewhere and two resources have two names. Beyond the length that a file name may have, a name is
/// cut off: resources that agree so far count as one.
std::string file_name(const std::string& resource) {
  constexpr std::string_view kOthers = "._:-";
  constexpr std::size_t kLongest = 200;  // NAME_MAX is 255.
  std::string name;
  for (const char c : resource) {
    const auto byte = static_cast<unsigned char>(c);
    const bool stays = byte < 0x80 && (std::isalnum(byte) != 0 || kOthers.find(c) != std::string_view::npos);
    name += stays ? std::string(1, c) : fmt::format("%{:02X}", byte);
  }
  return name.substr(0, kLongest) + ".lease";
}

/// Opens the file of a lease, which may belong to another user.
/// @param shown  as throw_unknown() takes it
int open_file(const std::filesystem::path& path, const std::string& shown) {
  // A file of another user in a folder like this is not opened with O_CREAT (fs.protected_regular).
  const int flags = O_RDWR | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK;
  int opened = -1;
  for (int attempt = 0; attempt < 2 && opened < 0; ++attempt) {
    opened = ::open(path.c_str(), flags);
    if (opened >= 0 || errno != ENOENT) break;
    opened = ::open(path.c_str(), flags | O_CREAT | O_EXCL, 0666);
    if (opened >= 0) ::fchmod(opened, 0666);
  }
  struct stat found {};
  if (opened < 0) throw_unknown(shown, path, errno);
  if (::fstat(opened, &found) == 0 && S_ISREG(found.st_mode)) return opened;
  ::close(opened);
  throw_unknown(shown, path, EINVAL);
}

bool lock(int descriptor) {
  struct flock range {};
  range.l_type = F_WRLCK;
  range.l_whence = SEEK_SET;
  return ::fcntl(descriptor, F_OFD_SETLK, &range) == 0;
}

/// A file of a lease has three lines: the holder in words, its process, its program.
[[noreturn]] void throw_held(const std::string& shown, int descriptor) {
  std::array<char, 1000> bytes{};
  const ssize_t count = ::pread(descriptor, bytes.data(), bytes.size(), 0);
  std::istringstream text(std::string(bytes.data(), count > 0 ? static_cast<std::size_t>(count) : 0));
  std::string words;
  PortHolder holder;
  std::getline(text, words);
  std::getline(text, holder.pid);
  std::getline(text, holder.program);
  throw PortHeld(shown,
                 fmt::format("in use by {}; end that first", words.empty() ? "another program" : words),
                 {holder});
}

std::string own_words(std::string_view holder) {
  const std::time_t now = ::time(nullptr);
  std::tm utc{};
  ::gmtime_r(&now, &utc);
  std::array<char, 32> since{};
  ::strftime(since.data(), since.size(), "%Y-%m-%dT%H:%M:%SZ", &utc);
  std::string program;
  std::getline(std::ifstream("/proc/self/comm"), program);
  return fmt::format(
      "{} of the user {} since {}\n{}\n{}\n",
      holder.empty() ? fmt::format("{} (process {})", program, ::getpid()) : std::string(holder),
      user_name(::geteuid()), since.data(), ::getpid(), program);
}

/// @param shown  name of the resource in a refusal
std::shared_ptr<Lease> take_as(const std::string& resource, const std::string& shown,
                               std::string_view holder) {
  static std::mutex mutex;
  static std::map<std::string, std::weak_ptr<Lease>> taken;
  const std::lock_guard lock_taken(mutex);
  if (std::shared_ptr<Lease> present = taken[resource].lock()) return present;
  const std::filesystem::path folder = lease_folder(shown);
  const int descriptor = folder.empty() ? -1 : open_file(folder / file_name(resource), shown);
  if (descriptor >= 0 && !lock(descriptor)) {
    const int error = errno;
    const Descriptor refused(descriptor);  // Closed as it is: its text belongs to the holder.
    if (error == EAGAIN || error == EACCES) throw_held(shown, descriptor);
    throw_unknown(shown, folder / file_name(resource), error);
  }
  auto lease = std::make_shared<Lease>(descriptor);
  if (descriptor >= 0) {
    const std::string words = own_words(holder);
    if (::ftruncate(descriptor, 0) == 0) (void)!::pwrite(descriptor, words.data(), words.size(), 0);
  }
  taken[resource] = lease;
  return lease;
}

}  // namespace

std::shared_ptr<Lease> Lease::take(const std::string& resource, std::string_view holder) {
  return take_as(resource, resource, holder);
}

std::shared_ptr<Lease> Lease::take_device(const std::string& path, std::string_view holder) {
  std::error_code error;
  const std::filesystem::path device = std::filesystem::canonical(path, error);
  return error ? nullptr : take_as(device.string(), path, holder);
}

std::string Lease::of_instrument(std::string_view maker, std::string_view model,
                                 std::string_view serial_number) {
  return fmt::format("{} {}, serial number {}", maker, model, serial_number);
}

Lease::~Lease() {
  if (descriptor_ < 0) return;
  (void)!::ftruncate(descriptor_, 0);
  ::close(descriptor_);
}

}  // namespace abcal::wire
