#include "protocol/estimators/shared/objection.h"

namespace abcal {

void object_to(CalibrationResult& result, const std::string& words) {
  const bool was_usable = result.verdict == Verdict::kUsable;
  result.why = was_usable ? words : words + "; " + result.why;
  if (was_usable) result.verdict = Verdict::kDoubtful;
}

}  // namespace abcal
