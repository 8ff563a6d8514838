#include "protocol/estimators/joint/item_fit.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cstddef>
#include <span>
#include <utility>

#include "protocol/estimators/shared/unusable_data.h"

namespace abcal {
namespace {

/// 15 readings for 12 unknowns without a prior, and something to test them by.
constexpr std::size_t kFewestAngles = 5;

/// A dead output has no sensitivity, and readings without scatter have no uncertainty.
std::vector<std::string> outputs_that_never_change(const std::vector<EffectReading>& readings) {
  std::vector<std::string> names;
  for (const auto& [j, name] : {std::pair{0, "u"}, {1, "v"}, {2, "w"}})
    if (std::all_of(readings.begin(), readings.end(),
                    [&, k = j](const EffectReading& at) { return at.value[k] == readings.front().value[k]; }))
      names.emplace_back(name);
  return names;
}

/// The solution, or the reason for its absence.
std::optional<EffectSolution> solve_or_reason(std::span<const EffectReading> readings,
                                              const EffectFitOptions& options, Message& why) {
  try {
    EffectSolution solution = solve_effects(readings, options);
    if (solution.fit.converged) return solution;
    why = Message(
        "the joint fit did not converge ({iterations} iterations): the readings are not those of the three "
        "experiments, or their angles are wrong",
        solution.fit.iterations);
  } catch (const UnusableData& error) {
    why = error.message();
  }
  return std::nullopt;
}

/// Noise from angle to angle that the norm of the readings does not show is not noise of the outputs: it
/// turns them together, as stage errors larger than stated do. The fit without that noise shows which errors.
std::vector<Message> hidden_by_process(std::span<const EffectReading> readings, const EffectFit& fit,
                                       const EffectFitOptions& options, const JointTests& tests,
                                       const std::string& response_unit) {
  constexpr double kNormIsSound = 1e-3;
  constexpr double kNormWanders = 3.0;  // standard deviations
  const NormAgreement& norm = tests.norm_against_joint;
  if (!options.white_known || !wanders(fit) || !norm.done || !(norm.norm_probability >= kNormIsSound) ||
      norm.norm_autocorrelation > kNormWanders)
    return {};
  EffectFitOptions white = options;
  white.noise_process = false;
  Message why;
  const std::optional<EffectSolution> solution = solve_or_reason(readings, white, why);
  if (!solution) return {};
  const EffectFit& without = solution->fit;
  const JointTests again = test_joint_fit(readings, without, white);
  std::vector<Message> found = contradictions_of(again, response_unit);
  if (!(again.chi2_probability >= again.level))
    found.push_back(Message("chi2 {chi2:.4g} for {degrees} degrees of freedom", without.chi2,
                            without.chi2_degrees_of_freedom));
  if (found.empty()) return {};
  return {
      Message("the readings wander from angle to angle, but their norm does not: the stage does more than "
              "is stated (without that noise: {found})",
              in_sequence(found))};
}

}  // namespace

EffectFitOptions fit_options(const CollectedReadings& data, const EffectSizes& sizes,
                             const JointOptions& options) {
  EffectFitOptions out{.sizes = sizes,
                       .measured_alignment = options.measured_alignment,
                       .nonlinearity = options.nonlinearity == Nonlinearity::kFitted,
                       .drift = options.drift,
                       .mean_step = options.mean_step,
                       .noise_process = options.noise_process,
                       .white_known = data.u_known,
                       .sweeps = data.sweeps,
                       .unit = options.unit};
  if (data.loss > 0.0) {
    // A first-order low-pass has 1 - c + 1.5 c^2 ...; others have other terms of this size.
    double& fourth = out.sizes.low_pass_fourth;
    fourth = std::hypot(fourth, 1.5 * data.loss * data.loss);
  }
  return out;
}

ItemFit fit_item(const RunRecord& record, const JointOptions& options) {
  ItemFit own;
  own.data = collect_readings(record, options.one_map_per_axis);
  own.options = fit_options(own.data, record.tolerances, options);
  if (own.data.readings.size() < kFewestAngles) {
    own.why = Message("{angles} usable angles; the joint estimator needs {needed} or more",
                      own.data.readings.size(), kFewestAngles);
    return own;
  }
  if (const auto still = outputs_that_never_change(own.data.readings); !still.empty()) {
    own.why = Message("accelerometer {accelerometer} does not respond: the same value at every angle",
                      fmt::format("{}", fmt::join(still, ", ")));
    return own;
  }
  own.solution = solve_or_reason(own.data.readings, own.options, own.why);
  if (!own.solution) return own;
  const EffectFit& fit = own.solution->fit;
  own.tests = test_joint_fit(own.data.readings, fit, own.options);
  own.hidden = hidden_by_process(own.data.readings, fit, own.options, own.tests, record.response_unit);
  return own;
}

}  // namespace abcal
