#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

namespace abcal {

/// Errors and stated standard uncertainties of one group of outputs over all simulated benches of a study.
struct ErrorGroup {
  double rms_u = 0.0;      ///< Root mean square of the stated standard uncertainties.
  double rms_error = 0.0;  ///< Likewise of the errors.
  double rms_z = 0.0;      ///< Root mean square of error / u.
  double coverage = 0.0;   ///< Share of 95 % intervals with the truth.
  double most_z = 0.0;     ///< Largest |error / u|.
  /// Probability of a mean of z^2 as far from 1 as this one if 1 is right, from resampled benches.
  double probability = 1.0;
  double limit = 0.0;  ///< Figure of the design that rms_u is to reach; 0: none.
};

/// Error and standard uncertainty of each output of the group, of one bench.
using ErrorsAndU = std::vector<std::pair<double, double>>;

/// @param benches  one entry each; empty: it has no solution
ErrorGroup error_group(std::span<const ErrorsAndU> benches, double limit, std::uint64_t seed);

/// The group for programs, as every study prints it.
nlohmann::ordered_json error_group_json(std::string_view name, std::string_view unit,
                                        const ErrorGroup& group);

}  // namespace abcal
