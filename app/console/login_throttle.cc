#include "app/console/login_throttle.h"

#include <algorithm>

#include "app/console/silent_connections.h"

namespace abcal::console {
namespace {

constexpr Clock::Duration kFirstWait = std::chrono::seconds(1);
constexpr Clock::Duration kLongestWait = std::chrono::seconds(60);
/// Time after the last failure until failures are forgotten.
constexpr Clock::Duration kForgotten = std::chrono::minutes(15);
constexpr std::size_t kMostCounts = 2000;
constexpr std::size_t kLongestKey = 200;

std::string key_of(const std::string& name, const std::string& address) {
  return counted_address(address) + "\n" + name.substr(0, kLongestKey);
}

}  // namespace

Clock::Duration LoginThrottle::wait(const std::string& name, const std::string& address,
                                    Clock::Instant now) const {
  const std::lock_guard lock(mutex_);
  Clock::Duration longest{};
  for (const std::string& key : {key_of(name, address), counted_address(address)}) {
    const auto found = counts_.find(key);
    if (found != counts_.end()) longest = std::max(longest, found->second.next - now);
  }
  return longest;
}

void LoginThrottle::count(const std::string& key, Clock::Instant now) {
  Count& count = counts_[key];
  if (count.failures > 0 && now - count.last > kForgotten) count = {};
  ++count.failures;
  count.last = now;
  if (count.failures < kFree) return;
  Clock::Duration wait = kFirstWait;
  for (int k = kFree; k < count.failures && wait < kLongestWait; ++k) wait *= 2;
  count.next = now + std::min(wait, kLongestWait);
}

void LoginThrottle::failed(const std::string& name, const std::string& address, Clock::Instant now) {
  const std::lock_guard lock(mutex_);
  std::erase_if(counts_, [&](const auto& each) { return now - each.second.last > kForgotten; });
  // Limits the memory that a flood of names or addresses takes; the oldest failures are forgotten.
  while (counts_.size() + 2 > kMostCounts)
    counts_.erase(std::min_element(counts_.begin(), counts_.end(), [](const auto& a, const auto& b) {
      return a.second.last < b.second.last;
    }));
  count(key_of(name, address), now);
  count(counted_address(address), now);
}

void LoginThrottle::succeeded(const std::string& name, const std::string& address) {
  const std::lock_guard lock(mutex_);
  counts_.erase(key_of(name, address));
}

}  // namespace abcal::console
