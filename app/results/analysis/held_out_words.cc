#include "app/results/analysis/held_out_words.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/results/analysis/result_json.h"

namespace abcal {
namespace {

/// A probability below this is called more than chance: the level of all tests of a verdict together.
constexpr double kMoreThanChance = 1e-5;
constexpr Term kLimits{
    "the check is blind to the orientation of the matrix and to F_X, and it is not independent of g_loc"};

}  // namespace

Message held_out_words(const HeldOutNorm& norm) {
  std::vector<Message> sentences{
      Message("|a| on {poses} held-out poses, each predicted by a joint fit of the others ({folds} folds)",
              norm.poses, norm.folds),
      Message("by the customer's equation a = M (r - b) it deviates from g_loc by {rms:.1e} g_loc (rms), at "
              "most by {largest:.1e} g_loc",
              norm.rms, norm.largest),
      Message("with the fitted non-linearity and drift of the item by {rms:.1e} g_loc (rms), where the "
              "stated uncertainties give {expected:.1e} g_loc, which is {times:.2f} times its standard "
              "uncertainty (rms)",
              norm.rms_of_model, norm.rms_expected, norm.rms_in_u)};
  if (norm.probability < kMoreThanChance)
    sentences.push_back(
        Message("this is MORE THAN CHANCE (probability {probability:.1g}), so that the stated uncertainties "
                "are too small or the model does not describe this item",
                norm.probability));
  sentences.push_back(kLimits);
  return in_sequence(sentences);
}

nlohmann::ordered_json held_out_json(const HeldOutNorm& norm) {
  return {{"folds", norm.folds},
          {"poses", norm.poses},
          {"rms", json_number(norm.rms)},
          {"largest", json_number(norm.largest)},
          {"rms_of_model", json_number(norm.rms_of_model)},
          {"rms_expected", json_number(norm.rms_expected)},
          {"rms_in_u", json_number(norm.rms_in_u)},
          {"probability", json_number(norm.probability)},
          {"limits", kLimits.english()}};
}

}  // namespace abcal
