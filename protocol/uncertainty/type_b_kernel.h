#pragma once

#include <cstddef>
#include <cstdint>

#include "protocol/uncertainty/type_b.h"

namespace abcal {

/// The vector code's room for amplitudes of the spectrum, for each experiment.
inline constexpr std::size_t kMostHarmonics = 512;

/// Trials first .. first + count - 1 of a plan, on the widest vectors of this machine; layout as TrialBlock.
void type_b_trials(const TypeBSampler::Plan& plan, std::uint64_t first, std::size_t count, double* out);

/// Only the normals of these trials (their sum to out[trial]), as a reference for the benchmark of the whole
/// trial.
void type_b_normals_only(std::uint64_t seed, std::uint32_t pairs, std::uint64_t first, std::size_t count,
                         double* out);

}  // namespace abcal
