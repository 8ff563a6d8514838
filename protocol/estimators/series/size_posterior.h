#pragma once

#include <functional>

#include "protocol/record/stage_record.h"

namespace abcal {

/// The posterior of a standard deviation.
/// @param scale  sizes from a hundredth of it to twice as much are possible
/// @param before  its distribution before
/// @param log_likelihood  of the readings, given the size
SizeFound size_posterior(double scale, const SizeFound& before,
                         const std::function<double(double)>& log_likelihood);

}  // namespace abcal
