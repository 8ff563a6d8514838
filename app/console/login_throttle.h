#pragma once

#include <map>
#include <mutex>
#include <string>

#include "drivers/instrument/clock.h"

namespace abcal::console {

/// Slows down guessing of passwords: after five failures each further attempt has to wait, twice as long each
/// time, at most a minute. Failures count for a person at an address, and for the address (counted_address():
/// of IPv6 the network). Safe to use from several threads.
class LoginThrottle {
 public:
  static constexpr int kFree = 5;  ///< Number of failures from which attempts have to wait.

  /// How long an attempt has to wait; zero: not at all.
  Clock::Duration wait(const std::string& name, const std::string& address, Clock::Instant now) const;
  void failed(const std::string& name, const std::string& address, Clock::Instant now);
  /// Forgets the failures of this person at this address; the count of the address stays.
  void succeeded(const std::string& name, const std::string& address);

 private:
  struct Count {
    int failures = 0;
    Clock::Instant last{};
    Clock::Instant next{};  ///< No attempt is allowed before.
  };
  void count(const std::string& key, Clock::Instant now);

  mutable std::mutex mutex_;
  std::map<std::string, Count> counts_;
};

}  // namespace abcal::console
