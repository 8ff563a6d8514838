#pragma once

#include <sys/resource.h>

namespace abcal::test {

/// Processor time, of user and system together, in seconds.
/// @param whose  RUSAGE_SELF: of this program; RUSAGE_CHILDREN: of those that it has started and that have
/// ended
inline double processor_seconds(int whose) {
  rusage usage{};
  ::getrusage(whose, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

}  // namespace abcal::test
