#include "protocol/estimators/shared/objection.h"

namespace abcal {

void object_to(CalibrationResult& result, const Message& words) {
  const bool was_usable = result.verdict == Verdict::kUsable;
  result.why = was_usable ? words : in_sequence({words, result.why});
  if (was_usable) result.verdict = Verdict::kDoubtful;
}

}  // namespace abcal
