#include "app/studies/trials/parallel_trials.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace abcal {

std::size_t each_in_parallel(std::size_t count, const ParallelTrials& options,
                             const std::function<void(std::size_t)>& work) {
  std::atomic<std::size_t> next{0};
  std::exception_ptr failure;
  std::mutex mutex;
  const auto take_some = [&] {
    try {
      while (!options.stop.stop_requested()) {
        const std::size_t i = next++;
        if (i >= count) break;
        work(i);
        if (options.progress && i % static_cast<std::size_t>(options.between) == 0) {
          const std::lock_guard lock(mutex);
          options.progress(static_cast<int>(i) + 1, static_cast<int>(count));
        }
      }
    } catch (...) {
      const std::lock_guard lock(mutex);
      failure = std::current_exception();  // rethrown below
      next = count;
    }
  };
  {
    std::vector<std::jthread> helpers;
    for (int i = 1; i < options.threads; ++i) helpers.emplace_back(take_some);
    take_some();
  }
  if (failure) std::rethrow_exception(failure);
  return std::min(count, next.load());
}

}  // namespace abcal
