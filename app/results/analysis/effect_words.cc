#include "app/results/analysis/effect_words.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <string_view>

#include "protocol/estimators/measurement/measurement_result.h"

namespace abcal {

Message default_effects_words(const EffectSizes& sizes, Advice advice) {
  const std::vector<Term> unstated = unstated_effects(sizes);
  if (unstated.empty()) return {};
  std::vector<Message> effects(unstated.begin(), unstated.end());
  if (advice == Advice::kForOperator)
    effects.push_back(Message(
        "state them in [stage_uncertainty] and [item_uncertainty] of the bench file (docs/effects.md)"));
  return {"not stated, so default sizes are used: {effects}", effects};
}

std::vector<Message> uncovered_effects_words(const EffectSizes& sizes, Advice advice) {
  std::vector<Message> words;
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (key.uncovered.empty() || sizes.sources.contains(key.key) || key.get(sizes) > 0.0) continue;
    words.push_back(Message("not stated, so not covered: {effect}", key.uncovered));
    if (advice == Advice::kForOperator)
      words.back() =
          in_sequence({words.back(), Message("state its size, or 0, as [{section}] {key} (docs/effects.md)",
                                             key.section, key.key)});
  }
  return words;
}

std::vector<Message> effects_without_source(const EffectSizes& sizes) {
  // Words that read_effect_sizes() and the reader of bench files enter if no source is given; in brackets,
  // the form of the statement: "stated (rectangular, half-width 0.014)".
  const auto is_none = [](std::string_view source) {
    return source == "stated" || source.starts_with("stated (") || source == "tolerances" ||
           source.find_first_not_of(" \t\r\n") == std::string_view::npos;
  };
  std::vector<Message> words;
  for (const EffectSizeKey& key : effect_size_keys()) {
    const auto source = sizes.sources.find(key.key);
    if (key.get(sizes) > 0.0 && source != sizes.sources.end() && is_none(source->second))
      words.emplace_back(key.words);
  }
  return words;
}

std::vector<Message> further_notes(const CalibrationResult& result, const EffectSizes& sizes) {
  const EffectSizes behind = result.stage_record ? sizes_with_record(sizes) : sizes;
  std::vector<Message> elsewhere = uncovered_effects_words(behind, Advice::kNone);
  elsewhere.push_back(default_effects_words(behind, Advice::kNone));
  std::vector<Message> notes;
  for (const Message& note : result.diagnostics.notes) {
    if (std::ranges::find(elsewhere, note) == elsewhere.end() && !contains(result.why, note))
      notes.push_back(note);
  }
  return notes;
}

}  // namespace abcal
