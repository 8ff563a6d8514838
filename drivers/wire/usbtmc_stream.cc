#include "drivers/wire/usbtmc_stream.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <linux/usb/tmc.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/device_file.h"
#include "drivers/wire/lease.h"
#include "drivers/wire/port_list.h"

namespace abcal::wire {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::milliseconds kInterval(2);
constexpr std::uint32_t kExchangeTimeoutMs = 1000;
constexpr int kMessageAvailable = 0x10;
constexpr int kMostDiscarded = 100;  // An instrument has one reply waiting, not endlessly many.

std::string usbtmc_files_there_are() {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator file("/dev", error), end; !error && file != end; file.increment(error)) {
    const std::string name = file->path().filename().string();
    if (name.starts_with("usbtmc")) names.push_back(file->path().string());
  }
  if (names.empty()) {
    return "this machine has no USBTMC instrument connected now (or the kernel module usbtmc is not loaded: "
           "`sudo modprobe usbtmc`)";
  }
  std::sort(names.begin(), names.end());
  return fmt::format("connected are {}", fmt::join(names, ", "));
}

class DeviceFile final : public UsbtmcDevice {
 public:
  DeviceFile(const std::string& path, const std::string& holder)
      : lease_(Lease::take_device(path, holder)),
        file_(open_device(path, 0, {"a USBTMC instrument", usbtmc_files_there_are})) {
    // Kernels before 4.20 know no other timeout than their own 5 s.
    std::uint32_t timeout_ms = kExchangeTimeoutMs;
    ::ioctl(file_.get(), USBTMC_IOCTL_SET_TIMEOUT, &timeout_ms);
    if (const int status = status_byte(); status < 0) {
      cannot_open(path,
                  fmt::format("a device, but not a USBTMC instrument, or one that does not report whether a "
                              "reply is waiting (USB488 status byte; requires Linux 4.6 or newer): {}",
                              std::strerror(-status)));
    }
    lock_device(file_, path);
    // A program that took no lock may still fetch our replies.
    if (!find_holder(path).empty()) held_by_another(path);
  }

  long write(std::string_view message) override {
    const ssize_t written = ::write(file_.get(), message.data(), message.size());
    return written < 0 ? -errno : written;
  }
  long read(char* buffer, std::size_t size) override {
    const ssize_t count = ::read(file_.get(), buffer, size);
    return count < 0 ? -errno : count;
  }
  int status_byte() override {
    unsigned char status = 0;
    return ::ioctl(file_.get(), USBTMC488_IOCTL_READ_STB, &status) < 0 ? -errno : int{status};
  }

 private:
  const std::shared_ptr<Lease> lease_;  ///< Before the file: released after it is closed.
  Descriptor file_;
};

/// No answer in time, or a signal: the next try may succeed.
bool is_passing(long error) {
  return error == -ETIMEDOUT || error == -EINTR || error == -EAGAIN;
}

}  // namespace

UsbtmcStream::UsbtmcStream(const std::string& path, Clock& clock, const std::string& holder)
    : UsbtmcStream(std::make_unique<DeviceFile>(path, holder), path, clock) {
  discard_input();  // Waiting bytes were meant for the previous program.
}

UsbtmcStream::UsbtmcStream(std::unique_ptr<UsbtmcDevice> device, std::string name, Clock& clock)
    : device_(std::move(device)), name_(std::move(name)), clock_(clock) {}

void UsbtmcStream::lose(int error) {
  lost_because_ = fmt::format("unplugged or switched off ({})", std::strerror(error));
  throw InstrumentError(name_, Fault::kLinkLost, lost_because_);
}

void UsbtmcStream::throw_if_lost() const {
  if (!lost_because_.empty()) throw InstrumentError(name_, Fault::kLinkLost, lost_because_);
}

void UsbtmcStream::write(std::string_view bytes) {
  const std::lock_guard lock(mutex_);
  throw_if_lost();
  if (bytes.empty()) return;
  long written = device_->write(bytes);
  while (written == -EINTR) written = device_->write(bytes);
  if (is_passing(written))
    throw InstrumentError(name_, Fault::kNoReply, fmt::format("took none of {} bytes in time", bytes.size()));
  if (written < 0) lose(static_cast<int>(-written));
  if (static_cast<std::size_t>(written) != bytes.size()) {
    throw InstrumentError(name_, Fault::kNoReply,
                          fmt::format("took {} of {} bytes of one message", written, bytes.size()));
  }
}

/// A reply, or part of it; empty if none waits.
std::string UsbtmcStream::read_what_waits() {
  const std::lock_guard lock(mutex_);
  throw_if_lost();
  const int status = device_->status_byte();
  if (is_passing(status)) return {};
  if (status < 0) lose(-status);
  if ((status & kMessageAvailable) == 0) return {};
  std::array<char, 4096> buffer{};
  const long count = device_->read(buffer.data(), buffer.size());
  if (is_passing(count)) return {};
  if (count < 0) lose(static_cast<int>(-count));
  return {buffer.data(), static_cast<std::size_t>(count)};
}

ReceivedBytes UsbtmcStream::read_until(Clock::Instant deadline) {
  for (;;) {
    std::string bytes = read_what_waits();
    const Clock::Instant now = clock_.now();
    if (!bytes.empty() || now >= deadline) return {std::move(bytes), now};
    clock_.sleep_until(std::min(deadline, now + kInterval));
  }
}

void UsbtmcStream::discard_input() {
  for (int n = 0; n < kMostDiscarded && !read_what_waits().empty(); ++n) continue;
}

}  // namespace abcal::wire
