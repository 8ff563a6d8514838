#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

struct ItemFit;

/// Probability that any of the tests of one verdict contradicts a sound run.
inline constexpr double kFamilyWiseFalseAlarm = 1e-5;

/// Results of the tests of a joint fit.
struct JointTests {
  std::vector<EffectTest> effects;
  double chi2_probability = 1.0;
  /// Sum of the products of successive whitened residuals of u, v, w, less the part caused by the fit itself,
  /// in standard deviations; 0 where too few residuals are free.
  std::array<double, 3> autocorrelation{};
  double autocorrelation_limit = 0.0;
  NormAgreement norm_against_joint;
  double level = 0.0;  ///< Level of one test: the family-wise level over the number of tests.
};

/// A test for each effect (of each output, for effects of the item): the posterior mean against its
/// predictive covariance, prior covariance minus posterior covariance, in the directions on which the run has
/// information; one for the step errors without memory; the autocorrelation of the whitened residuals of each
/// output; chi2; the norm fit of the same readings.
JointTests test_joint_fit(std::span<const EffectReading> readings, const EffectFit& fit,
                          const EffectFitOptions& options);

/// Whether the readings wander from angle to angle (a noise process is probable), which the result reports.
bool wanders(const EffectFit& fit);

/// Tests of the sizes alone: each effect that is an unknown of the fit, and the step errors without memory
/// where they have a size. `passed` is left for the caller.
/// @param step_sd  standard deviation of these step errors (radian)
std::vector<EffectTest> test_sizes(const EffectFit& fit, double step_sd);

/// "wobble of X is 9.3 times the stated size (wobble_urad; probability 1e-12)".
Message words_of(const EffectTest& test);

/// The stated sizes that the run contradicts, in words. They concern every result that rests on them.
std::vector<Message> contradicted_sizes(const JointTests& tests);

/// One sentence for each failed test of a size, of the norm fit and of the autocorrelation.
std::vector<Message> contradictions_of(const JointTests& tests, const std::string& response_unit);

/// Fills in the verdict, its reasons and the notes of a result.
/// @param fit  the fit of the result
/// @param own  the item's own fit, whose tests decide
void judge_joint(const EffectFit& fit, const ItemFit& own, const RunRecord& record,
                 CalibrationResult& result);

}  // namespace abcal
