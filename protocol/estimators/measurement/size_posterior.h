#pragma once

#include <functional>
#include <vector>

#include "protocol/record/stage_record.h"

namespace abcal {

/// The posterior of a standard deviation.
/// @param scale  sizes from a hundredth of it to twice as much are possible
/// @param before  its distribution before
/// @param log_likelihood  of the readings, given the size
SizeFound size_posterior(double scale, const SizeFound& before,
                         const std::function<double(double)>& log_likelihood);

/// A size with its probability.
struct ProbableSize {
  double size = 0.0;
  double probability = 0.0;
};

/// The distribution of a size as a list; the probabilities add up to 1.
std::vector<ProbableSize> probable_sizes(const SizeFound& size);

}  // namespace abcal
