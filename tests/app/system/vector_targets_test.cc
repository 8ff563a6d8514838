#include "app/system/vector_targets.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

namespace abcal {
namespace {

TEST(VectorTargets, AreThoseThatHighwayFinds) {
#if HWY_ARCH_X86
  constexpr std::int64_t kLookedFor = HWY_SSSE3 | HWY_SSE4 | HWY_AVX2 | HWY_AVX3;
#else
  constexpr std::int64_t kLookedFor = HWY_ENABLED_BASELINE;
#endif
  EXPECT_EQ(vector_targets() & kLookedFor, hwy::SupportedTargets() & kLookedFor);
  EXPECT_EQ(vector_targets() & HWY_ENABLED_BASELINE, HWY_ENABLED_BASELINE);
}

}  // namespace
}  // namespace abcal
