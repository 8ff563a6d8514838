#pragma once

#include <gtest/gtest.h>

#include <ostream>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/halt.h"
#include "drivers/wire/readable_bytes.h"
#include "drivers/wire/reply_match.h"

namespace abcal::test {

/// Meaning of a received reply for one question of a HaltRecipe.
enum class Verdict {
  kOther,     ///< It answers something else.
  kMoving,    ///< It answers the question and does not report standstill.
  kStanding,  ///< It answers the question and reports standstill, or the question does not ask for that.
};

inline std::ostream& operator<<(std::ostream& out, Verdict verdict) {
  constexpr std::string_view kWords[] = {"another reply", "moving", "standing"};
  return out << kWords[static_cast<int>(verdict)];
}

struct ReplySample {
  std::string reply;
  Verdict verdict = Verdict::kOther;
};

inline Verdict verdict_on(const HaltRecipe& recipe, const HaltRecipe::Question& question,
                          std::string_view reply) {
  const auto fits = [&](const ReplyPattern& pattern) {
    return recipe.binary ? wire::occurs_in(pattern, reply) : wire::matches(pattern, reply);
  };
  if (!fits(question.reply)) return Verdict::kOther;
  return question.standing.empty() || fits(question.standing) ? Verdict::kStanding : Verdict::kMoving;
}

/// Replies as a controller sends them, without terminator, and the verdict on each.
inline void expect_verdicts(const HaltRecipe& recipe, const HaltRecipe::Question& question,
                            const std::vector<ReplySample>& samples) {
  for (const ReplySample& sample : samples)
    EXPECT_EQ(verdict_on(recipe, question, sample.reply), sample.verdict)
        << "to " << wire::bytes_as_text(question.bytes) << ": \"" << wire::bytes_as_text(sample.reply) << '"';
}

}  // namespace abcal::test
