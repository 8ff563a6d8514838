#include "app/results/analysis/effect_words.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <string_view>

#include "protocol/estimators/series/series_result.h"

namespace abcal {

std::string default_effects_words(const EffectSizes& sizes, Advice advice) {
  const std::vector<std::string> effects = unstated_effects(sizes);
  if (effects.empty()) return {};
  return fmt::format("not stated, so default sizes are used: {}{}", fmt::join(effects, "; "),
                     advice == Advice::kForOperator
                         ? "; state them in [stage_uncertainty] and [item_uncertainty] of the bench file "
                           "(docs/effects.md)"
                         : "");
}

std::vector<std::string> uncovered_effects_words(const EffectSizes& sizes, Advice advice) {
  std::vector<std::string> words;
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (key.uncovered.empty() || sizes.sources.contains(key.key) || key.get(sizes) > 0.0) continue;
    words.push_back(fmt::format("not stated, so not covered: {}", key.uncovered));
    if (advice == Advice::kForOperator)
      words.back() +=
          fmt::format("; state its size, or 0, as [{}] {} (docs/effects.md)", key.section, key.key);
  }
  return words;
}

std::vector<std::string> effects_without_source(const EffectSizes& sizes) {
  // Words that read_effect_sizes() and the reader of bench files enter if no source is given; in brackets,
  // the form of the statement: "stated (rectangular, half-width 0.014)".
  const auto is_none = [](std::string_view source) {
    return source == "stated" || source.starts_with("stated (") || source == "tolerances" ||
           source.find_first_not_of(" \t\r\n") == std::string_view::npos;
  };
  std::vector<std::string> words;
  for (const EffectSizeKey& key : effect_size_keys()) {
    const auto source = sizes.sources.find(key.key);
    if (key.get(sizes) > 0.0 && source != sizes.sources.end() && is_none(source->second))
      words.emplace_back(key.words);
  }
  return words;
}

std::vector<std::string> further_notes(const CalibrationResult& result, const EffectSizes& sizes) {
  const EffectSizes behind = result.stage_record ? sizes_with_record(sizes) : sizes;
  std::vector<std::string> elsewhere = uncovered_effects_words(behind, Advice::kNone);
  elsewhere.push_back(default_effects_words(behind, Advice::kNone));
  std::vector<std::string> notes;
  for (const std::string& note : result.diagnostics.notes) {
    if (std::ranges::find(elsewhere, note) == elsewhere.end() && result.why.find(note) == std::string::npos)
      notes.push_back(note);
  }
  return notes;
}

}  // namespace abcal
