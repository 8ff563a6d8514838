#include "app/system/vector_targets.h"

#include <hwy/targets.h>

#if HWY_ARCH_X86
#include <cpuid.h>
#endif

namespace abcal {
namespace {

#if HWY_ARCH_X86
/// Clang's __builtin_cpu_supports() does not know these two.
bool has_f16c_and_lzcnt() {
  unsigned a = 0, b = 0, c = 0, d = 0;
  const bool f16c = __get_cpuid(1, &a, &b, &c, &d) != 0 && (c & bit_F16C) != 0;
  const bool lzcnt = __get_cpuid(0x80000001, &a, &b, &c, &d) != 0 && (c & bit_LZCNT) != 0;
  return f16c && lzcnt;
}
#endif

}  // namespace

std::int64_t vector_targets() {
  std::int64_t targets = HWY_ENABLED_BASELINE;
#if HWY_ARCH_X86
  // The groups are those of Highway. Its further targets, which differ in other instructions than ours, are
  // left out.
  const auto add = [&](bool supported, std::int64_t target) {
    if (supported) targets |= target;
    return supported;
  };
  __builtin_cpu_init();
  (void)(add(__builtin_cpu_supports("ssse3") != 0, HWY_SSSE3) &&
         add(__builtin_cpu_supports("sse4.1") && __builtin_cpu_supports("sse4.2") &&
                 __builtin_cpu_supports("aes") && __builtin_cpu_supports("pclmul"),
             HWY_SSE4) &&
         add(__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                 __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") && has_f16c_and_lzcnt(),
             HWY_AVX2) &&
         add(__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                 __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
                 __builtin_cpu_supports("avx512cd"),
             HWY_AVX3));
#endif
  return targets;
}

}  // namespace abcal
