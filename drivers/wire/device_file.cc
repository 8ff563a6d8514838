#include "drivers/wire/device_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/port_held.h"
#include "drivers/wire/port_list.h"

namespace abcal::wire {
namespace {

namespace fs = std::filesystem;

void check_exists(const std::string& path, const DeviceKind& kind) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) {
    const int error = errno;
    std::error_code ignored;
    if (error == ENOENT && fs::is_symlink(fs::symlink_status(path, ignored))) {
      cannot_open(path,
                  fmt::format("a link to {}, which does not exist (unplugged, or the emulator has ended); {}",
                              fs::read_symlink(path, ignored).string(), kind.what_there_is()));
    }
    if (error == ENOENT || error == ENOTDIR) {
      cannot_open(path, fmt::format("does not exist; {}", kind.what_there_is()));
    }
    cannot_open(path, std::strerror(error));
  }
  if (S_ISDIR(status.st_mode)) cannot_open(path, "a folder, not " + kind.name);
  if (!S_ISCHR(status.st_mode)) cannot_open(path, "a file, not " + kind.name);
}

std::string not_permitted(const std::string& path) {
  const std::string group = owner_group(path);
  if (group.empty()) return "not permitted to this user";
  return fmt::format(
      "not permitted: it belongs to group {0}; run `sudo usermod -aG {0} $USER` and log in again", group);
}

}  // namespace

Descriptor::~Descriptor() {
  if (fd_ >= 0) ::close(fd_);
}

void cannot_open(const std::string& path, const std::string& why) {
  throw InstrumentError(path, Fault::kCannotOpen, why);
}

void held_by_another(const std::string& path) {
  const std::vector<PortHolder> holders = find_holders(path);
  throw PortHeld(path,
                 holders.empty()
                     ? "held by another program (which cannot be identified), or by this one: is the port "
                       "named twice in the bench file?"
                     : fmt::format("held by another program: {}; close that first", in_words(holders)),
                 holders);
}

Descriptor open_device(const std::string& path, int flags, const DeviceKind& kind) {
  check_exists(path, kind);
  Descriptor device(::open(path.c_str(), O_RDWR | O_CLOEXEC | flags));
  if (device.get() >= 0) return device;
  switch (errno) {
    case EACCES:
    case EPERM:
      cannot_open(path, not_permitted(path));
    case EBUSY:
      held_by_another(path);
    case ENXIO:
    case ENODEV:
    case EIO:
      cannot_open(path, fmt::format("no working port is behind it ({})", std::strerror(errno)));
    default:
      cannot_open(path, std::strerror(errno));
  }
}

void lock_device(const Descriptor& device, const std::string& path) {
  if (::flock(device.get(), LOCK_EX | LOCK_NB) == 0) return;
  if (errno == EWOULDBLOCK) held_by_another(path);
  cannot_open(path, fmt::format("cannot be locked: {}", std::strerror(errno)));
}

}  // namespace abcal::wire
