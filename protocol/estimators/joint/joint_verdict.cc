#include "protocol/estimators/joint/joint_verdict.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/joint/norm_agreement.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/undetermined.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

/// A direction of an effect is not tested if the run reduces the prior's variance by less than this share.
constexpr double kInformative = 0.02;
/// The fit may absorb most of an effect that is stated as zero (it leaves 0.8 % of y^5, the fifth harmonic);
/// the remainder is known as well as any reading. Below this share it is round-off.
constexpr double kLeftByTheFit = 1e-6;
/// Least degrees of freedom of the whitened residuals at which their correlation is tested.
constexpr double kFewestFree = 20.0;
/// A process less probable than this is not reported.
constexpr double kProcessTold = 0.5;
/// A drift above this number of standard uncertainties is reported.
constexpr double kDriftTold = 3.0;
/// A chi2 is called low if one as low has a smaller probability: a false alarm in one of a thousand runs.
constexpr double kLowChi2 = 1e-3;

bool same_effect(const EffectUnknown& a, const EffectUnknown& b) {
  return a.effect == b.effect && a.output == b.output;
}

/// "hysteresis of u"
Message name_of(const EffectUnknown& unknown) {
  if (unknown.output < 0) return effect_words(unknown.effect);
  return {"{effect} of {output}", effect_words(unknown.effect), "uvw"[unknown.output]};
}

EffectTest test_effect(const EffectFit& fit, Eigen::Index first, Eigen::Index count) {
  const EffectUnknown& unknown = fit.unknowns[static_cast<std::size_t>(first)];
  EffectTest test;
  test.name = name_of(unknown);
  test.key = unknown.key;
  Eigen::VectorXd relative(count);
  Eigen::MatrixXd predicted = Eigen::MatrixXd::Identity(count, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const EffectUnknown& of_i = fit.unknowns[static_cast<std::size_t>(first + i)];
    relative(i) = (fit.value(first + i) - of_i.prior_mean) / of_i.prior_sd;
    for (Eigen::Index k = 0; k < count; ++k) {
      predicted(i, k) -= fit.covariance(first + i, first + k) /
                         (of_i.prior_sd * fit.unknowns[static_cast<std::size_t>(first + k)].prior_sd);
    }
  }
  test.times_stated = relative.norm() / std::sqrt(static_cast<double>(count));
  const SymmetricEigen eigen = symmetric_eigen(predicted);
  for (Eigen::Index i = 0; i < count; ++i) {
    const double share = eigen.values(i);
    if (share < kInformative) continue;
    const double along = eigen.vectors.col(i).dot(relative);
    test.chi2 += along * along / share;
    ++test.degrees_of_freedom;
  }
  if (test.degrees_of_freedom > 0) test.probability = chi2_tail(test.chi2, test.degrees_of_freedom);
  return test;
}

/// Tests the estimates of the step errors without memory against their stated size.
EffectTest test_steps(const EffectFit& fit, double step_sd) {
  EffectTest test;
  test.name = Message("step errors");
  test.key = "step_deg";
  double squares = 0.0;
  double expected = 0.0;
  for (std::size_t n = 0; n < fit.step_error.size(); ++n) {
    if (n < fit.step_factor.size() && fit.step_factor[n] != 1.0) continue;  // Not of the stated size.
    const double f = fit.step_error[n] / step_sd;
    const double u = fit.u_step_error[n] / step_sd;
    squares += f * f;
    expected += std::max(0.0, 1.0 - u * u);
  }
  test.degrees_of_freedom = static_cast<int>(std::floor(expected));
  if (test.degrees_of_freedom < 1) return test;
  test.chi2 = squares;
  test.times_stated = std::sqrt(squares / expected);
  test.probability = chi2_tail(squares, test.degrees_of_freedom);
  return test;
}

/// Tests the unknowns of an effect that is stated as zero by the whitened residuals (score test).
EffectTest test_left_out(const EffectFit& fit, const ReadingRows& design, const Eigen::VectorXd& residual,
                         Eigen::Index first, Eigen::Index count) {
  const EffectUnknown& unknown = fit.left_out[static_cast<std::size_t>(first)];
  EffectTest test;
  test.name = name_of(unknown);
  test.key = unknown.key;
  test.stated_zero = true;
  const auto columns = fit.left_out_design.middleCols(first, count);
  const Eigen::VectorXd own = columns.colwise().squaredNorm().transpose();
  const Eigen::VectorXd scale =
      own.unaryExpr([](double square) { return square > 0.0 ? 1.0 / std::sqrt(square) : 0.0; });
  const Eigen::MatrixXd taken = transposed_product_by_rows(design, columns);  // absorbed by the fit
  const Eigen::MatrixXd left = scaled_on_both_sides(
      transposed_product_by_rows(columns, columns) - transposed_product(taken, taken), scale);
  const Eigen::VectorXd score = scale.cwiseProduct(transposed_product_by_rows_with_vector(columns, residual));
  const SymmetricEigen eigen = symmetric_eigen(left);
  for (Eigen::Index i = 0; i < count; ++i) {
    const double share = eigen.values(i);
    if (share < kLeftByTheFit) continue;
    const double along = eigen.vectors.col(i).dot(score);
    test.chi2 += along * along / share;
    ++test.degrees_of_freedom;
  }
  if (test.degrees_of_freedom > 0) test.probability = chi2_tail(test.chi2, test.degrees_of_freedom);
  return test;
}

/// Tests whether a larger size explains the readings better than a noise process.
EffectTest test_evidence(const SizeEvidence& evidence) {
  EffectTest test;
  test.name = Message("size");
  test.key = evidence.key;
  test.times_stated = evidence.times;
  test.probability = std::exp(-std::max(0.0, evidence.log_ratio));
  test.instead_of_noise = true;
  return test;
}

/// The covariance I - H of the whitened residuals of one output near its diagonal.
class ResidualBand {
 public:
  static constexpr Eigen::Index kBand = 6;
  ResidualBand(const ReadingRows& design, int output)
      : count_(design.rows() / 3), band_(count_, 2 * kBand + 1) {
    for (Eigen::Index n = 0; n < count_; ++n) {
      for (Eigen::Index m = std::max<Eigen::Index>(0, n - kBand); m <= std::min(count_ - 1, n + kBand); ++m) {
        band_(n, m - n + kBand) =
            (m == n ? 1.0 : 0.0) - design.row(3 * n + output).dot(design.row(3 * m + output));
      }
    }
  }
  Eigen::Index count() const { return count_; }
  double operator()(Eigen::Index a, Eigen::Index b) const {
    if (a < 0 || b < 0 || a >= count_ || b >= count_ || std::abs(b - a) > kBand) return 0.0;
    return band_(a, b - a + kBand);
  }

 private:
  Eigen::Index count_;
  Eigen::MatrixXd band_;
};

/// Sum of products of successive whitened residuals of one output, in standard deviations. The fit itself
/// correlates them: their covariance is I - H, a band of which is sufficient.
double lag_one(const EffectFit& fit, const ReadingRows& design, int output) {
  const ResidualBand at(design, output);
  double products = 0.0;
  double expected = 0.0;
  double variance = 0.0;
  double free = 0.0;
  for (Eigen::Index n = 0; n < at.count(); ++n) {
    free += at(n, n);
    if (n + 1 == at.count()) break;
    products += fit.whitened[static_cast<std::size_t>(n)](output) *
                fit.whitened[static_cast<std::size_t>(n + 1)](output);
    expected += at(n, n + 1);
    const Eigen::Index last = std::min(at.count() - 2, n + ResidualBand::kBand);
    for (Eigen::Index m = std::max<Eigen::Index>(0, n - ResidualBand::kBand); m <= last; ++m)
      variance += at(n, m) * at(n + 1, m + 1) + at(n, m + 1) * at(n + 1, m);
  }
  if (free < kFewestFree || !(variance > 0.0)) return 0.0;
  return (products - expected) / std::sqrt(variance);
}

/// The deviate that a sum of products of successive residuals exceeds with this probability, on either side.
/// The excess kurtosis of a sum of `count` products is 18/count (Cornish and Fisher's expansion about the
/// normal deviate).
double deviate_of_products(double probability, std::size_t count) {
  const double z = -normal_quantile(0.5 * probability);
  return z + 18.0 / static_cast<double>(count) / 24.0 * (z * z * z - 3.0 * z);
}

template <class Test>
void for_each_effect(const std::vector<EffectUnknown>& unknowns, const Test& test) {
  const auto count = static_cast<Eigen::Index>(unknowns.size());
  for (Eigen::Index first = 0; first < count;) {
    Eigen::Index last = first + 1;
    const EffectUnknown& unknown = unknowns[static_cast<std::size_t>(first)];
    while (last < count && same_effect(unknown, unknowns[static_cast<std::size_t>(last)])) ++last;
    test(first, last - first);
    first = last;
  }
}

std::vector<EffectTest> test_unknowns(const EffectFit& fit) {
  std::vector<EffectTest> out;
  for_each_effect(fit.unknowns, [&](Eigen::Index first, Eigen::Index count) {
    if (std::isfinite(fit.unknowns[static_cast<std::size_t>(first)].prior_sd))
      out.push_back(test_effect(fit, first, count));
  });
  return out;
}

void add_steps(const EffectFit& fit, double step_sd, std::vector<EffectTest>& tests) {
  if (!fit.step_error.empty() && step_sd > 0.0 && fit.u_step_error.front() > 0.0)
    tests.push_back(test_steps(fit, step_sd));
}

Message words_about_noise(const EffectFit& fit, const RunRecord& record) {
  if (!wanders(fit)) return {};
  return Message(
      "the readings of {outputs} wander from angle to angle: {times:.2g} times their uncertainty, correlated "
      "over some {angles:.0f} angles (probability {probability:.3f}); it is in the uncertainties",
      record.source.empty() ? Message("this run") : Message("{run}", record.source), fit.noise.tau,
      fit.noise.rho, fit.noise.process_probability);
}

/// Keys of the effects that the run shows to be smaller than stated, and how many times; empty if none is
/// clearly so.
Message smaller_effects(const std::vector<EffectTest>& effects) {
  std::vector<const EffectTest*> smaller;
  for (const EffectTest& test : effects) {
    if (test.stated_zero || test.instead_of_noise || test.degrees_of_freedom < 1) continue;
    // The delay is removed from the angles before the fit: the remainder contains no information on its size.
    if (test.key == "delay_s") continue;
    const double below = chi2_lower_tail(test.chi2, test.degrees_of_freedom);
    if (below < kLowChi2 / static_cast<double>(effects.size()) && test.times_stated > 0.0)
      smaller.push_back(&test);
  }
  std::sort(smaller.begin(), smaller.end(),
            [](const EffectTest* a, const EffectTest* b) { return a->times_stated < b->times_stated; });
  constexpr std::size_t kNamed = 3;
  if (smaller.size() > kNamed) smaller.resize(kNamed);
  std::vector<Message> words;
  for (const EffectTest* test : smaller)
    words.push_back(Message("{key} {times:.2g}", test->key, 1.0 / test->times_stated));
  return in_sequence(words, ", ");
}

/// chi2 in words, with what a low one means.
Message words_about_chi2(const EffectFit& fit, const JointTests& tests, Diagnostics& diagnostics) {
  const double above = chi2_tail(fit.chi2, fit.chi2_degrees_of_freedom);
  const double below = chi2_lower_tail(fit.chi2, fit.chi2_degrees_of_freedom);
  diagnostics.chi2 = fit.chi2;
  diagnostics.chi2_probability = above;
  diagnostics.low_chi2_probability = below;
  if (!(below < kLowChi2))
    return Message("chi2 {chi2:.4g} for {degrees} degrees of freedom (probability {probability:.2g})",
                   fit.chi2, fit.chi2_degrees_of_freedom, above);
  diagnostics.sizes_too_large = std::sqrt(fit.chi2_degrees_of_freedom / fit.chi2);
  diagnostics.notes.push_back(
      Message("chi2 is far below its degrees of freedom: the stated sizes of effects or the uncertainties of "
              "the readings are too large, {times:.3g} times over all; no uncertainty of the result is made "
              "smaller by it",
              *diagnostics.sizes_too_large));
  if (const Message smaller = smaller_effects(tests.effects); !smaller.empty())
    diagnostics.notes.push_back(Message(
        "stated sizes that are too large, and how many times by what this run shows: {sizes}", smaller));
  return Message(
      "chi2 {chi2:.4g} for {degrees} degrees of freedom, far below (probability of one as low "
      "{probability:.1g})",
      fit.chi2, fit.chi2_degrees_of_freedom, below);
}

/// Adds a note on the meaning of O where an offset drifted by more than its uncertainty explains.
void note_drifts(CalibrationResult& result) {
  for (std::size_t j = 0; j < 3; ++j) {
    const Quantity& end = result.joint->drift_at_end[j];
    if (!(std::abs(end.value) > kDriftTold * end.standard_uncertainty)) continue;
    result.diagnostics.notes.push_back(
        Message("the offset of {output} drifted: O_{of_output} is its mean over the run; at the end of the "
                "run it was {change:+.2g} {unit} from that (standard uncertainty {uncertainty:.1g} "
                "{u_unit}), {significance:.6g} {meaning}",
                "uvw"[j], "uvw"[j], end.value, end.unit, end.standard_uncertainty, end.unit,
                result.offset[j].value + end.value, end.unit));
  }
}

}  // namespace

Message words_of(const EffectTest& test) {
  if (test.stated_zero)
    return Message("{effect} is stated as zero, and is not ({test}; probability {probability:.1g})",
                   test.name, test.key, test.probability);
  if (test.instead_of_noise)
    return Message(
        "the readings wander from angle to angle, but {times} times the stated size explains them better "
        "than noise ({test}; probability below {probability:.1g})",
        test.times_stated, test.key, test.probability);
  return Message("{effect} is {times:.1f} times the stated size ({test}; probability {probability:.1g})",
                 test.name, test.times_stated, test.key, test.probability);
}

std::vector<EffectTest> test_sizes(const EffectFit& fit, double step_sd) {
  std::vector<EffectTest> out = test_unknowns(fit);
  add_steps(fit, step_sd, out);
  return out;
}

JointTests test_joint_fit(std::span<const EffectReading> readings, const EffectFit& fit,
                          const EffectFitOptions& options) {
  JointTests out;
  out.effects = test_unknowns(fit);
  const ReadingRows design = times_upper(fit.whitened_jacobian, fit.covariance_root);
  Eigen::VectorXd residual(3 * static_cast<Eigen::Index>(fit.whitened.size()));
  for (std::size_t n = 0; n < fit.whitened.size(); ++n)
    residual.segment<3>(3 * static_cast<Eigen::Index>(n)) = fit.whitened[n];
  for_each_effect(fit.left_out, [&](Eigen::Index first, Eigen::Index count) {
    out.effects.push_back(test_left_out(fit, design, residual, first, count));
  });
  add_steps(fit, options.sizes.step.rad(), out.effects);
  for (const SizeEvidence& evidence : fit.larger_sizes) out.effects.push_back(test_evidence(evidence));
  // The 5 others are chi2, three autocorrelations and the comparison with the norm fit.
  const auto tests = static_cast<double>(out.effects.size() + 5);
  out.level = kFamilyWiseFalseAlarm / tests;
  for (EffectTest& test : out.effects) test.passed = test.probability >= out.level;
  if (options.white_known) out.chi2_probability = chi2_tail(fit.chi2, fit.chi2_degrees_of_freedom);
  for (int j = 0; j < 3; ++j) out.autocorrelation[static_cast<std::size_t>(j)] = lag_one(fit, design, j);
  out.autocorrelation_limit = deviate_of_products(out.level, std::max<std::size_t>(1, fit.whitened.size()));
  out.norm_against_joint = compare_norm_with_joint(readings, fit, options);
  return out;
}

std::vector<Message> contradicted_sizes(const JointTests& tests) {
  std::vector<Message> out;
  for (const EffectTest& test : tests.effects) {
    if (!test.passed) out.push_back(words_of(test));
  }
  return out;
}

std::vector<Message> contradictions_of(const JointTests& tests, const std::string& response_unit) {
  std::vector<Message> out = contradicted_sizes(tests);
  if (tests.norm_against_joint.probability < tests.level)
    out.push_back(words_of(tests.norm_against_joint, response_unit));
  for (std::size_t j = 0; j < 3; ++j) {
    if (std::abs(tests.autocorrelation[j]) <= tests.autocorrelation_limit) continue;
    out.push_back(
        Message("successive residuals of {outputs} are correlated ({deviations:.1f} standard deviations): "
                "the model does not explain the readings",
                "uvw"[j], tests.autocorrelation[j]));
  }
  return out;
}

bool wanders(const EffectFit& fit) {
  return fit.noise.process_probability > kProcessTold && fit.noise.tau > 0.0;
}

void judge_joint(const EffectFit& fit, const ItemFit& own, const RunRecord& record,
                 CalibrationResult& result) {
  const EffectFitOptions& options = own.options;
  const JointTests& tests = own.tests;
  Diagnostics& diagnostics = result.diagnostics;
  result.joint->effects = tests.effects;
  result.joint->contradicted_sizes = contradicted_sizes(tests);
  result.joint->norm_against_joint = tests.norm_against_joint;
  std::vector<Message> contradictions;
  Message about_chi2;
  if (options.white_known) {
    about_chi2 = words_about_chi2(fit, tests, diagnostics);
    if (!(diagnostics.chi2_probability >= tests.level)) {
      contradictions.push_back(
          Message("{chi2}: the model does not explain the readings within their uncertainties", about_chi2));
    }
  } else {
    const Eigen::Vector3d u = fit.noise.white.cwiseProduct(own.data.readings.front().u);
    about_chi2 = Message(
        "the readings carry no uncertainty: noise {u:.2g}, {v:.2g}, {w:.2g} {unit} estimated from the "
        "residuals, so chi2 cannot test the model",
        u(0), u(1), u(2), record.response_unit);
    diagnostics.notes.push_back(about_chi2);
  }
  for (Message& words : contradictions_of(tests, record.response_unit))
    contradictions.push_back(std::move(words));
  const Message about_nonlinearity = result.joint->nonlinearity_fitted
                                         ? Message("non-linearity fitted")
                                         : Message("non-linearity left out, as asked");
  diagnostics.notes.push_back(about_nonlinearity);
  note_drifts(result);
  if (!tests.norm_against_joint.done)
    diagnostics.notes.push_back(
        Message("the norm fit could not be compared with this one: {why}", tests.norm_against_joint.why_not));
  if (Message words = words_about_noise(fit, record); !words.empty())
    diagnostics.notes.push_back(std::move(words));
  for (const Undetermined& outputs : undetermined_outputs(judged_outputs(result, fit.shares, fit.unit),
                                                          record.tolerances, EffectsAre::kEstimated))
    (outputs.doubtful ? contradictions : diagnostics.notes).push_back(outputs.words);
  if (!options.mean_step) {
    contradictions.push_back(
        Message("the mean step errors were left out, so the orientation about X is not what it seems"));
  }
  if (contradictions.empty()) {
    result.verdict = Verdict::kUsable;
    result.why = in_sequence({about_chi2, about_nonlinearity});
  } else {
    result.verdict = Verdict::kDoubtful;
    result.why = in_sequence({in_sequence(contradictions), about_nonlinearity});
  }
}

}  // namespace abcal
