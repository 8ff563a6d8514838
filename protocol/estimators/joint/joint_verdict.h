#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

struct ItemFit;

/// All tests of one verdict together contradict a sound run so often.
inline constexpr double kFamilyWiseFalseAlarm = 1e-5;

/// What the tests of a joint fit found.
struct JointTests {
  std::vector<EffectTest> effects;
  double chi2_probability = 1.0;
  /// Of the products of successive whitened residuals of u, v, w, beyond what the fit itself makes of them,
  /// in standard deviations; 0 where too few residuals are free.
  std::array<double, 3> autocorrelation{};
  double autocorrelation_limit = 0.0;
  NormAgreement norm_against_joint;
  double level = 0.0;  ///< Of one test: the family-wise level over the number of tests.
};

/// A test for each effect (of each output, for effects of the item): the posterior mean against its
/// predictive covariance, prior covariance minus posterior covariance, in the directions of which the run
/// tells something; one for the step errors without memory; the autocorrelation of the whitened residuals of
/// each output; chi2; the norm fit of the same readings.
JointTests test_joint_fit(std::span<const EffectReading> readings, const EffectFit& fit,
                          const EffectFitOptions& options);

/// Whether the readings wander from angle to angle, so that the result says so.
bool wanders(const EffectFit& fit);

/// The first of these tests alone: each effect that is an unknown of the fit, and the step errors without
/// memory where they have a size. `passed` is not decided.
/// @param step_sd  their standard deviation (radian)
std::vector<EffectTest> test_sizes(const EffectFit& fit, double step_sd);

/// "wobble of X is 9.3 times the stated size (wobble_urad; probability 1e-12)".
std::string words_of(const EffectTest& test);

/// The stated sizes that the run contradicts, in words: what every result that rests on them inherits.
std::vector<std::string> contradicted_sizes(const JointTests& tests);

/// "wobble of X is 9.3 times its stated size (wobble_urad), probability 1e-12": for those that failed.
std::vector<std::string> contradictions_of(const JointTests& tests, const std::string& response_unit);

/// Fills in the verdict, its reasons and the notes of a result.
/// @param fit  that of the result
/// @param own  the item's own fit, whose tests decide
void judge_joint(const EffectFit& fit, const ItemFit& own, const RunRecord& record,
                 CalibrationResult& result);

}  // namespace abcal
