#pragma once

#include <cstdint>

namespace abcal {

/// The instruction sets of this processor, as bits of Highway (HWY_AVX2 and so on): those for which the Monte
/// Carlo kernel has code of its own. Asks the processor and not libhwy.so.
std::int64_t vector_targets();

}  // namespace abcal
