// The two functions of libhwy.so that code with dynamic dispatch calls. The program has its own, because
// every start with libhwy.so takes 5 ms for measuring the resolution of a clock that nothing here uses.

#include <hwy/targets.h>

#include "app/system/vector_targets.h"

namespace hwy {

// The names are Highway's. NOLINTBEGIN(readability-identifier-naming)
std::int64_t SupportedTargets() {
  return abcal::vector_targets();
}

ChosenTarget& GetChosenTarget() {
  static ChosenTarget chosen;
  return chosen;
}
// NOLINTEND(readability-identifier-naming)

}  // namespace hwy
