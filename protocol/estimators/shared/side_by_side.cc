#include "protocol/estimators/shared/side_by_side.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <thread>
#include <vector>

namespace abcal {

void side_by_side(std::size_t count, const std::function<void(std::size_t)>& each) {
  const std::size_t threads = std::min(count, std::max<std::size_t>(1, std::thread::hardware_concurrency()));
  std::vector<std::exception_ptr> failed(count);
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t i = next++; i < count; i = next++) {
      try {
        each(i);
      } catch (...) {
        failed[i] = std::current_exception();
      }
    }
  };
  {
    std::vector<std::jthread> others;
    for (std::size_t t = 1; t < threads; ++t) others.emplace_back(work);
    work();
  }
  for (const std::exception_ptr& exception : failed) {
    if (exception) std::rethrow_exception(exception);
  }
}

}  // namespace abcal
