#include "app/measure/session/host_clock.h"

#include <sys/timex.h>
#include <time.h>

#include <chrono>
#include <fstream>

namespace abcal {

HostClock read_host_clock() {
  HostClock host;
  std::ifstream("/proc/sys/kernel/random/boot_id") >> host.boot_id;
  timespec since_boot{};
  if (::clock_gettime(CLOCK_BOOTTIME, &since_boot) == 0)
    host.since_boot = std::chrono::seconds(since_boot.tv_sec) + std::chrono::nanoseconds(since_boot.tv_nsec);
  // Reads only: no mode is set.
  timex service{};
  const int state = ::adjtimex(&service);
  if (state >= 0 && state != TIME_ERROR) {
    const double unit_s = (service.status & STA_NANO) != 0 ? 1e-9 : 1e-6;
    host.offset_s = -unit_s * static_cast<double>(service.offset);
    host.error_s = 1e-6 * static_cast<double>(service.maxerror);
  }
  return host;
}

}  // namespace abcal
