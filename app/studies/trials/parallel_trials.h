#pragma once

#include <cstddef>
#include <functional>
#include <stop_token>

namespace abcal {

/// Threads of a study, its interruption, and its progress.
struct ParallelTrials {
  int threads = 1;
  std::stop_token stop = {};
  std::function<void(int done, int planned)> progress = {};  ///< Called by one thread at a time.
  int between = 8;  ///< Number of trials between two reports of progress.
};

/// Takes the numbers 0 to count - 1, each once, on several threads. The first error that `work` throws is
/// thrown again.
/// @return how many were done; all below it were
std::size_t each_in_parallel(std::size_t count, const ParallelTrials& options,
                             const std::function<void(std::size_t)>& work);

}  // namespace abcal
