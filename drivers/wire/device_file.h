#pragma once

#include <functional>
#include <string>
#include <utility>

/// Opening a port that is a file in /dev, with errors in words. Used inside this folder only, and only in .cc
/// files.
namespace abcal::wire {

/// Owns a file descriptor.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor();
  Descriptor(Descriptor&& other) noexcept : fd_(other.release()) {}
  Descriptor& operator=(Descriptor&&) = delete;
  int get() const { return fd_; }
  int release() { return std::exchange(fd_, -1); }

 private:
  int fd_;
};

[[noreturn]] void cannot_open(const std::string& path, const std::string& why);

/// @throws PortHeld that names the holder, if it is visible.
[[noreturn]] void held_by_another(const std::string& path);

/// The kind of device that a file must be, with texts for messages.
struct DeviceKind {
  std::string name;                            ///< "a serial port"
  std::function<std::string()> what_there_is;  ///< "connected are ...", for a message.
};

/// Opens a character device to read and write, without settings and without a lock.
/// @throws InstrumentError kCannotOpen: does not exist (lists the existing ones), is something else, not
/// permitted
///   (and which group is), held.
Descriptor open_device(const std::string& path, int flags, const DeviceKind& kind);

/// Locks it for this program alone against others that lock. @throws InstrumentError kCannotOpen.
void lock_device(const Descriptor& device, const std::string& path);

}  // namespace abcal::wire
