#include "protocol/estimators/circle/abc_estimator.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "drivers/text/letters.h"
#include "protocol/estimators/circle/curvature_fit.h"
#include "protocol/estimators/circle/diagnostics.h"
#include "protocol/estimators/circle/first_order.h"
#include "protocol/estimators/circle/harmonic_fit.h"
#include "protocol/estimators/circle/sensitivity_matrix.h"
#include "protocol/estimators/circle/two_faces.h"
#include "protocol/estimators/shared/arrivals.h"
#include "protocol/estimators/shared/flagged_angles.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/run_time.h"
#include "protocol/estimators/shared/undetermined.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"
#include "protocol/linear/singular_values.h"
#include "protocol/plan/faces.h"

namespace abcal {

namespace {

constexpr int kDiagnosticHarmonics = 5;  // the paper's second fit: constant + five harmonics

using Covariance27 = Eigen::Matrix<double, 27, 27>;
using FitTable = std::array<HarmonicFit, 9>;  // index 3 (experiment - 1) + accelerometer
using SeriesTable = std::array<ReadingSeries, 9>;

Quantity quantity(double value, std::optional<double> variance_a, std::optional<double> variance_b,
                  std::string unit) {
  Quantity q;
  q.value = value;
  q.unit = std::move(unit);
  if (variance_a) q.type_a = std::sqrt(*variance_a);
  if (variance_b) q.type_b = std::sqrt(*variance_b);
  if (variance_a || variance_b)
    q.standard_uncertainty = std::sqrt(variance_a.value_or(0.0) + variance_b.value_or(0.0));
  return q;
}

template <typename Matrix>
std::optional<double> variance_at(const std::optional<Matrix>& covariance, Eigen::Index i) {
  if (!covariance) return std::nullopt;
  return (*covariance)(i, i);
}

/// The readings that the fits may use, and information on the others.
struct Selection {
  std::vector<const DwellRecord*> dwells;
  std::vector<double> time_fractions;
  std::vector<std::pair<const DwellRecord*, double>> closing;  // with its time fraction
  int not_finite = 0;
  bool with_uncertainty = false;  // every reading in use has u > 0
  bool some_uncertainty = false;
};

Selection select(const RunRecord& record) {
  Selection selection;
  const std::vector<double> t = run_time_fractions(record);
  bool all_positive = true;
  for (std::size_t i = 0; i < record.dwells.size(); ++i) {
    const DwellRecord& dwell = record.dwells[i];
    if (!dwell.mean.allFinite() || !std::isfinite(dwell.alpha.deg())) {
      ++selection.not_finite;
      continue;
    }
    if (dwell.closing) {
      selection.closing.emplace_back(&dwell, t[i]);
      continue;
    }
    selection.dwells.push_back(&dwell);
    selection.time_fractions.push_back(t[i]);
    const bool positive = dwell.u_mean && dwell.u_mean->allFinite() && (dwell.u_mean->array() > 0.0).all();
    all_positive = all_positive && positive;
    selection.some_uncertainty = selection.some_uncertainty || dwell.u_mean.has_value();
  }
  selection.with_uncertainty = all_positive && !selection.dwells.empty();
  return selection;
}

SeriesTable series_of(const Selection& selection) {
  SeriesTable table;
  for (int e = 0; e < 3; ++e) {
    for (int j = 0; j < 3; ++j) {
      ReadingSeries& series = table[static_cast<std::size_t>(3 * e + j)];
      series.experiment = e + 1;
      series.accelerometer = j;
      series.place_of.assign(selection.dwells.size(), -1);
    }
  }
  for (std::size_t i = 0; i < selection.dwells.size(); ++i) {
    const DwellRecord& dwell = *selection.dwells[i];
    for (int j = 0; j < 3; ++j) {
      ReadingSeries& series = table[static_cast<std::size_t>(3 * (dwell.experiment - 1) + j)];
      series.place_of[i] = static_cast<int>(series.readings.size());
      series.alpha.push_back(angle_in_face_1(dwell.experiment, dwell.face, dwell.alpha));
      series.readings.push_back(dwell.mean(j));
      if (selection.with_uncertainty) series.u.push_back((*dwell.u_mean)(j));
      if (dwell.motion) series.rate_radps.push_back(Angle::degrees(dwell.motion->rate_deg_per_s).rad());
    }
  }
  return table;
}

/// The effects as one output sees them, times their standard uncertainties (R).
struct OutputEffects {
  Eigen::MatrixXd together;  ///< Effects that act on many readings: dwells x effects.
  Eigen::VectorXd alone;     ///< For each dwell: variance of the effects on its reading alone (R^2).
};

/// Everything between the fits and the result.
struct Estimate {
  SeriesTable series;
  FitTable fits;
  AbcCoefficients coefficients;
  std::array<std::optional<double>, 3>
      reading_variance;                  // from the residuals; absent where weighted or no redundancy
  std::array<int, 3> reading_degrees{};  ///< Degrees of freedom of reading_variance.
  std::optional<Covariance27> covariance_a;
  Covariance27 covariance_b;
  std::vector<InputEffect> effects;            ///< All but k2 and k3.
  std::vector<InputEffect> curvature_effects;  ///< k2 and k3: effects that remain after the correction.
  std::optional<CurvatureFit> curvature;
  SeriesTable cleaned;                          ///< The series minus the effects of k2 and k3.
  FitTable cleaned_fits;                        ///< Fits with one harmonic.
  std::array<OutputEffects, 3> output_effects;  ///< All but k2 and k3, as each output sees them.
  std::vector<InputEffect> cleaned_effects;     ///< `effects` in the series minus the effects of k2 and k3.
  AbcOutputs outputs;                           ///< Corrected: the line response.
  double resolution = 0.0;
  std::string response_unit;
  std::optional<Covariance12> output_covariance_a;
  Covariance12 output_covariance_b = Covariance12::Zero();
  std::vector<EffectShare> shares;  ///< Shares of the effects in the diagonal of output_covariance_b.
};

Message not_determined(const ReadingSeries& series, const Message& reason) {
  return {"experiment {experiment}: {why}", series.experiment, reason};
}

// Variance of a reading of each accelerometer from the residuals of its three fits together.
void pool_variances(const FitTable& fits, const CurvatureFit& curvature, Estimate& estimate) {
  for (std::size_t j = 0; j < 3; ++j) {
    double sum_squares = 0.0;
    int degrees_of_freedom = 0;
    for (std::size_t e = 0; e < 3; ++e) {
      sum_squares += fits[3 * e + j].residual_sum_squares;
      degrees_of_freedom += fits[3 * e + j].degrees_of_freedom();
    }
    // k2 and k3, where they were estimated, were fitted to these residuals too.
    for (Eigen::Index m = 0; m < 2; ++m) {
      const Eigen::Index k = 2 * static_cast<Eigen::Index>(j) + m;
      if (curvature.cofactor()(k, k) > 0.0) --degrees_of_freedom;
    }
    estimate.reading_degrees[j] = std::max(0, degrees_of_freedom);
    if (degrees_of_freedom > 0) estimate.reading_variance[j] = sum_squares / degrees_of_freedom;
  }
}

// Type A covariance of one fit; absent where the scatter of a reading is not known.
std::optional<Eigen::MatrixXd> type_a_of(const HarmonicFit& fit, std::optional<double> reading_variance) {
  if (fit.weighted) return fit.cofactor;
  if (!reading_variance) return std::nullopt;
  return Eigen::MatrixXd(fit.cofactor * *reading_variance);
}

std::optional<Covariance27> type_a_of_coefficients(
    const FitTable& fits, const std::array<std::optional<double>, 3>& reading_variance) {
  Covariance27 covariance = Covariance27::Zero();
  for (std::size_t i = 0; i < fits.size(); ++i) {
    const std::optional<Eigen::MatrixXd> block = type_a_of(fits[i], reading_variance[i % 3]);
    if (!block) return std::nullopt;
    // The fit's order is constant, sin, cos; ours is A (sin), B (cos), C.
    constexpr std::array<Eigen::Index, 3> kFrom{1, 2, 0};
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b) {
        covariance(static_cast<Eigen::Index>(3 * i + a), static_cast<Eigen::Index>(3 * i + b)) =
            (*block)(kFrom[a], kFrom[b]);
      }
    }
  }
  return covariance;
}

AbcCoefficients effect_on_coefficients(const InputEffect& effect, const SeriesTable& series,
                                       const FitTable& fits) {
  AbcCoefficients change;
  for (std::size_t i = 0; i < fits.size(); ++i) {
    const Eigen::Vector3d fit_change = effect_on_fit(effect, series[i], fits[i]);
    change.segment<3>(static_cast<Eigen::Index>(3 * i)) << fit_change(1), fit_change(2), fit_change(0);
  }
  return change;
}

// Change of the outputs minus the change of the measurand for one unit of the input.
Eigen::Matrix<double, 12, 1> effect_on_outputs(const InputEffect& effect, const Estimate& estimate) {
  const CurvatureFit& curvature = *estimate.curvature;
  return product_with_vector(abc_equations(),
                             effect_on_coefficients(effect, estimate.series, estimate.fits)) -
         product_with_vector(curvature.correction(),
                             curvature.change_of_k(effect.first_reading, effect.effect)) -
         effect.line;
}

void fill_output_covariances(Estimate& estimate, double resolution) {
  const Eigen::Matrix<double, 12, 27>& equations = abc_equations();
  const CurvatureFit& curvature = *estimate.curvature;
  if (estimate.covariance_a) {
    Eigen::Matrix<double, 6, 6> of_k = curvature.cofactor();
    for (Eigen::Index j = 0; j < 3; ++j) {
      if (!estimate.fits[static_cast<std::size_t>(j)].weighted)
        of_k.block<2, 2>(2 * j, 2 * j) *=
            estimate.reading_variance[static_cast<std::size_t>(j)].value_or(0.0);
    }
    estimate.output_covariance_a = carried_covariance(equations, *estimate.covariance_a) +
                                   carried_covariance(curvature.correction(), of_k);
  }
  Covariance12& covariance = estimate.output_covariance_b;
  covariance.setZero();
  for (const auto* list : {&estimate.effects, &estimate.curvature_effects}) {
    for (const InputEffect& effect : *list) {
      const Eigen::Matrix<double, 12, 1> change =
          effect.standard_uncertainty * effect_on_outputs(effect, estimate);
      covariance.noalias() += change * change.transpose();
      auto share = std::find_if(estimate.shares.begin(), estimate.shares.end(),
                                [&](const EffectShare& of) { return of.effect == effect.group; });
      if (share == estimate.shares.end()) {
        share = estimate.shares.emplace(share);
        share->effect = effect.group;
        share->key = effect.key;
      }
      share->covariance.diagonal() += change.cwiseAbs2();
    }
  }
  if (!(resolution > 0.0)) return;
  // Each reading has an independent rounding error.
  InputEffect rounding;
  for (std::size_t n = 0; n < estimate.series.front().place_of.size(); ++n) {
    for (int j = 0; j < 3; ++j) {
      rounding.first_reading = n;
      rounding.effect.assign(1, Eigen::Vector3d::Unit(j));
      const Eigen::Matrix<double, 12, 1> change =
          resolution / std::sqrt(12.0) * effect_on_outputs(rounding, estimate);
      covariance.noalias() += change * change.transpose();
    }
  }
}

Covariance27 type_b_of_coefficients(const Estimate& estimate, double resolution) {
  Covariance27 covariance = Covariance27::Zero();
  for (const InputEffect& effect : estimate.effects) {
    const AbcCoefficients change =
        effect.standard_uncertainty * effect_on_coefficients(effect, estimate.series, estimate.fits);
    covariance.noalias() += change * change.transpose();
  }
  if (resolution > 0.0) {
    constexpr std::array<Eigen::Index, 3> kFrom{1, 2, 0};
    for (std::size_t i = 0; i < estimate.fits.size(); ++i) {
      const Eigen::MatrixXd block = covariance_of_root(estimate.fits[i].estimator);
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b < 3; ++b) {
          covariance(static_cast<Eigen::Index>(3 * i + a), static_cast<Eigen::Index>(3 * i + b)) +=
              block(kFrom[a], kFrom[b]) * resolution * resolution / 12.0;
        }
      }
    }
  }
  return covariance;
}

/// Effective degrees of freedom (Welch-Satterthwaite, JCGM 100 G.4.1) of a linear combination of the twelve
/// outputs: type A has those of the residuals, type B and stated noise have infinitely many.
double effective_degrees(const Estimate& estimate, const Eigen::Matrix<double, 1, 12>& by_output,
                         double variance) {
  if (!estimate.output_covariance_a) return std::numeric_limits<double>::infinity();
  double sum = 0.0;
  for (int j = 0; j < 3; ++j) {
    const auto nu = estimate.reading_degrees[static_cast<std::size_t>(j)];
    if (nu == 0) continue;  // stated noise
    Eigen::Matrix<double, 1, 12> own = Eigen::Matrix<double, 1, 12>::Zero();
    own.segment<3>(3 * j) = by_output.segment<3>(3 * j);
    own(offset_index(j)) = by_output(offset_index(j));
    const double part = own.dot(product_with_vector(*estimate.output_covariance_a, own.transpose()));
    sum += part * part / nu;
  }
  return sum > 0.0 ? variance * variance / sum : std::numeric_limits<double>::infinity();
}

void fill_outputs(const Estimate& estimate, CalibrationResult& result) {
  result.covariance_type_a = estimate.output_covariance_a;
  result.covariance_type_b = estimate.output_covariance_b;
  result.covariance = *result.covariance_type_b;
  if (result.covariance_type_a) *result.covariance += *result.covariance_type_a;

  const Eigen::Matrix3d s = sensitivity_matrix_of(estimate.outputs);
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(s);
  if (result.covariance_type_a) {
    result.covariance_intrinsic_type_a = carried_covariance(jacobian, *result.covariance_type_a);
  }
  result.covariance_intrinsic_type_b = carried_covariance(jacobian, *result.covariance_type_b);
  result.covariance_intrinsic = *result.covariance_intrinsic_type_b;
  if (result.covariance_intrinsic_type_a) *result.covariance_intrinsic += *result.covariance_intrinsic_type_a;

  const std::string per_g = result.response_unit.find('/') == std::string::npos
                                ? result.response_unit + "/g_loc"
                                : "(" + result.response_unit + ")/g_loc";
  const IntrinsicProperties intrinsic = intrinsic_properties(s);
  using Row = Eigen::Matrix<double, 1, 12>;
  const auto set_degrees = [&](Quantity& quantity, const Row& by_output) {
    quantity.degrees_of_freedom =
        effective_degrees(estimate, by_output, quantity.standard_uncertainty * quantity.standard_uncertainty);
  };
  result.sensitivity_matrix.emplace();
  for (int j = 0; j < 3; ++j) {
    const auto row = static_cast<std::size_t>(j);
    for (int k = 0; k < 3; ++k) {
      const Eigen::Index i = s_index(j, k);
      (*result.sensitivity_matrix)[row][static_cast<std::size_t>(k)] = quantity(
          s(j, k), variance_at(result.covariance_type_a, i), variance_at(result.covariance_type_b, i), per_g);
      set_degrees((*result.sensitivity_matrix)[row][static_cast<std::size_t>(k)], Row::Unit(i));
    }
    result.offset[row] =
        quantity(estimate.outputs(offset_index(j)), variance_at(result.covariance_type_a, offset_index(j)),
                 variance_at(result.covariance_type_b, offset_index(j)), result.response_unit);
    result.intrinsic_sensitivity[row] =
        quantity(intrinsic.sensitivity(j), variance_at(result.covariance_intrinsic_type_a, j),
                 variance_at(result.covariance_intrinsic_type_b, j), per_g);
    result.intrinsic_angle[row] =
        quantity(intrinsic.angle_deg(j), variance_at(result.covariance_intrinsic_type_a, 3 + j),
                 variance_at(result.covariance_intrinsic_type_b, 3 + j), "degree");
    set_degrees(result.offset[row], Row::Unit(offset_index(j)));
    set_degrees(result.intrinsic_sensitivity[row], jacobian.row(j));
    set_degrees(result.intrinsic_angle[row], jacobian.row(3 + j));
  }
}

/// Collects objections to the result, each as a sentence.
class Objections {
 public:
  void add(Message sentence) { sentences_.push_back(std::move(sentence)); }
  bool empty() const { return sentences_.empty(); }
  const std::vector<Message>& all() const { return sentences_; }
  Message in_one_sentence() const {
    constexpr std::size_t kShown = 3;
    if (sentences_.size() <= kShown) return in_sequence(sentences_);
    return {"{first}; and {more} more (see the notes)",
            std::vector<Message>(sentences_.begin(), sentences_.begin() + kShown),
            sentences_.size() - kShown};
  }

 private:
  std::vector<Message> sentences_;
};

/// Degrees of freedom of the scatter of an output's readings; infinite where it is stated.
double degrees_of_readings(const Estimate& estimate, std::size_t output) {
  return estimate.reading_variance[output] ? estimate.reading_degrees[output]
                                           : std::numeric_limits<double>::infinity();
}

/// Type A and B combined, with type A multiplied by `factor`.
double with_larger_type_a(const Quantity& quantity, double factor) {
  return std::hypot(quantity.type_a.value_or(0.0) * factor, quantity.type_b.value_or(0.0));
}

// True if the value exceeds its uncertainty and the rounding of numbers of this size. Where type A rests on
// few residuals its share of the limit is that of Student's distribution: 20 standard uncertainties for 6.
// (Effective degrees of freedom are not a substitute: a type A that is small by chance makes them large.)
bool contradicts_zero(const Quantity& quantity, double degrees_of_type_a, double scale) {
  Quantity of_type_a;
  of_type_a.degrees_of_freedom = degrees_of_type_a;
  const double level = coverage_factor(of_type_a, std::erf(kContradictionLevel / std::sqrt(2.0)));
  const double limit = kContradictionLevel * with_larger_type_a(quantity, level / kContradictionLevel);
  return std::abs(quantity.value) > limit + 1e-13 * scale;
}

Message times_uncertainty(const Quantity& quantity) {
  return Message("{value:.3g} {unit}, {times:.1f} times its standard uncertainty", quantity.value,
                 quantity.unit, std::abs(quantity.value) / quantity.standard_uncertainty);
}

double response_scale(const Estimate& estimate, std::size_t accelerometer) {
  const auto j = static_cast<int>(accelerometer);
  return sensitivity_matrix_of(estimate.outputs).row(j).norm() + std::abs(estimate.outputs(offset_index(j)));
}

std::optional<double> variance_of(const std::optional<Eigen::VectorXd>& variances, Eigen::Index i) {
  if (!variances) return std::nullopt;
  return (*variances)(i);
}

/// Derivatives of a fit's coefficients by the readings of its output: coefficients x dwells.
Eigen::MatrixXd by_dwell_of(const HarmonicFit& fit, const ReadingSeries& series) {
  Eigen::MatrixXd out =
      Eigen::MatrixXd::Zero(fit.coefficients.size(), static_cast<Eigen::Index>(series.place_of.size()));
  for (std::size_t n = 0; n < series.place_of.size(); ++n) {
    if (const int place = series.place_of[n]; place >= 0)
      out.col(static_cast<Eigen::Index>(n)) = fit.estimator.col(place);
  }
  return out;
}

/// As by_dwell_of(), for a fit to a series minus the effects of k2 and k3: these were estimated from all
/// readings of the output, so that an effect in one experiment reaches the others.
Eigen::MatrixXd cleaned_by_dwell(const HarmonicFit& fit, const ReadingSeries& series,
                                 const CurvatureFit& curvature) {
  const auto output = static_cast<std::size_t>(series.accelerometer);
  Eigen::MatrixXd out = by_dwell_of(fit, series);
  const Eigen::MatrixXd of_shape = product_transposed(out, curvature.shape(output));
  out -= product(of_shape, curvature.weights(output));
  return out;
}

struct Variances {
  std::optional<Eigen::VectorXd> a;  ///< Type A, of the readings; absent: scatter not known.
  Eigen::VectorXd b;                 ///< Type B, of the effects and the resolution.
};

/// Variances of linear functions (rows) of an output's readings (columns: dwells).
Variances variances_of(const Eigen::MatrixXd& by_dwell, const Estimate& estimate, std::size_t output) {
  const OutputEffects& effects = estimate.output_effects[output];
  const Eigen::MatrixXd squares = by_dwell.cwiseAbs2();
  Variances out;
  const Eigen::VectorXd sum = squares.rowwise().sum();
  out.b = product(by_dwell, effects.together).rowwise().squaredNorm() +
          product_with_vector(squares, effects.alone) +
          sum * (estimate.resolution * estimate.resolution / 12.0);
  if (estimate.reading_variance[output]) {
    out.a = sum * *estimate.reading_variance[output];
    return out;
  }
  Eigen::VectorXd of_reading = Eigen::VectorXd::Zero(by_dwell.cols());
  for (std::size_t i = output; i < estimate.series.size(); i += 3) {
    const ReadingSeries& series = estimate.series[i];
    if (series.u.empty()) return out;
    for (std::size_t n = 0; n < series.place_of.size(); ++n) {
      if (const int place = series.place_of[n]; place >= 0)
        of_reading(static_cast<Eigen::Index>(n)) =
            series.u[static_cast<std::size_t>(place)] * series.u[static_cast<std::size_t>(place)];
    }
  }
  out.a = product_with_vector(squares, of_reading);
  return out;
}

/// Fills the effects as each output sees them, and the effects in the series minus those of k2 and k3.
void arrange_effects(Estimate& estimate) {
  const auto dwells = static_cast<Eigen::Index>(estimate.series.front().place_of.size());
  const auto many = std::count_if(estimate.effects.begin(), estimate.effects.end(),
                                  [](const InputEffect& effect) { return effect.effect.size() > 1; });
  for (OutputEffects& of : estimate.output_effects)
    of = {Eigen::MatrixXd::Zero(dwells, many), Eigen::VectorXd::Zero(dwells)};
  estimate.cleaned_effects.clear();
  Eigen::Index column = 0;
  for (const InputEffect& effect : estimate.effects) {
    InputEffect& cleaned = estimate.cleaned_effects.emplace_back(effect);
    const auto first = static_cast<Eigen::Index>(effect.first_reading);
    const double u = effect.standard_uncertainty;
    if (effect.effect.size() == 1) {  // a step error; its effect by way of k2 and k3 is neglected
      for (std::size_t j = 0; j < 3; ++j) {
        const double change = u * effect.effect[0](static_cast<Eigen::Index>(j));
        estimate.output_effects[j].alone(first) += change * change;
      }
      continue;
    }
    const CurvatureFit::Vector6 of_k = estimate.curvature->change_of_k(effect.first_reading, effect.effect);
    cleaned.first_reading = 0;
    cleaned.effect.assign(static_cast<std::size_t>(dwells), Eigen::Vector3d::Zero());
    for (std::size_t n = 0; n < effect.effect.size(); ++n)
      cleaned.effect[effect.first_reading + n] = effect.effect[n];
    for (std::size_t j = 0; j < 3; ++j) {
      const auto row = static_cast<Eigen::Index>(j);
      for (std::size_t n = 0; n < effect.effect.size(); ++n)
        estimate.output_effects[j].together(first + static_cast<Eigen::Index>(n), column) =
            u * effect.effect[n](row);
      const Eigen::VectorXd taken =
          transposed_product_with_vector(estimate.curvature->shape(j), of_k.segment<2>(2 * row));
      for (Eigen::Index n = 0; n < dwells; ++n) cleaned.effect[static_cast<std::size_t>(n)](row) -= taken(n);
    }
    ++column;
  }
}

void fill_closures(const Estimate& estimate, CalibrationResult& result, Objections& objections) {
  const Eigen::Matrix<double, 15, 27>& equations = closure_equations();
  AbcCoefficients coefficients;
  std::array<Eigen::MatrixXd, 9> by_dwell;
  for (std::size_t i = 0; i < 9; ++i) {
    const Eigen::VectorXd& c = estimate.cleaned_fits[i].coefficients;
    coefficients.segment<3>(static_cast<Eigen::Index>(3 * i)) << c(1), c(2), c(0);
    by_dwell[i] = cleaned_by_dwell(estimate.cleaned_fits[i], estimate.series[i], *estimate.curvature);
  }
  const AbcClosures values = abc_closures(coefficients);
  for (std::size_t name = 0; name < kClosureNames.size(); ++name) {
    for (std::size_t j = 0; j < 3; ++j) {
      const auto i = static_cast<Eigen::Index>(3 * name + j);
      Eigen::MatrixXd of_closure = Eigen::MatrixXd::Zero(1, by_dwell.front().cols());
      for (std::size_t fit = j; fit < 9; fit += 3) {
        const auto at = static_cast<Eigen::Index>(3 * fit);
        of_closure += equations(i, at) * by_dwell[fit].row(1) + equations(i, at + 1) * by_dwell[fit].row(2) +
                      equations(i, at + 2) * by_dwell[fit].row(0);
      }
      const Variances variances = variances_of(of_closure, estimate, j);
      std::optional<double> a;
      if (variances.a) a = (*variances.a)(0);
      Closure closure{kClosureNames[name], static_cast<int>(j),
                      quantity(values(i), a, variances.b(0), result.response_unit)};
      if (contradicts_zero(closure.value, degrees_of_readings(estimate, j), response_scale(estimate, j))) {
        objections.add(Message("closure {closure} of {output} is {value}", closure.name, kOutputNames[j],
                               times_uncertainty(closure.value)));
      }
      result.diagnostics.closures.push_back(std::move(closure));
    }
  }
}

void fill_closing_differences(const Selection& selection, const Estimate& estimate, CalibrationResult& result,
                              Objections& objections) {
  for (const auto& [closing, closing_time] : selection.closing) {
    for (std::size_t i = 0; i < selection.dwells.size(); ++i) {
      const DwellRecord& first = *selection.dwells[i];
      const bool same_pose = first.experiment == closing->experiment &&
                             std::remainder(first.alpha.deg() - closing->alpha.deg(), 360.0) == 0.0;
      if (!same_pose) continue;
      for (std::size_t j = 0; j < 3; ++j) {
        const auto row = static_cast<Eigen::Index>(j);
        std::optional<double> a = estimate.reading_variance[j];
        if (a) *a *= 2.0;
        double degrees = degrees_of_readings(estimate, j);
        if (first.u_mean && closing->u_mean) {
          degrees = std::numeric_limits<double>::infinity();
          a = (*first.u_mean)(row) * (*first.u_mean)(row) + (*closing->u_mean)(row) * (*closing->u_mean)(row);
        }
        // Type B: the allowed drift over the time between the two, and the return of the stage within its
        // step tolerance.
        double b = 0.0;
        const double size = sensitivity_matrix_of(estimate.outputs).row(row).norm();
        const Eigen::Vector3d y =
            Eigen::Vector3d::Constant((first.mean(row) - estimate.outputs(9 + row)) / size);
        const ItemPoint before{selection.time_fractions[i], y, Eigen::Vector3d::Zero()};
        const ItemPoint after{closing_time, y, Eigen::Vector3d::Ones()};
        for (const InputEffect& effect : estimate.effects) {
          double change = 0.0;
          if (effect.output == static_cast<int>(j)) {
            const ItemEffect& item = *effect.item;
            change = item.share(after, effect.output, effect.item_unknown).value -
                     item.share(before, effect.output, effect.item_unknown).value;
          } else if (effect.effect.size() == 1 && effect.first_reading == i) {
            change = effect.effect[0](row);
          }
          b += change * change * effect.standard_uncertainty * effect.standard_uncertainty;
        }
        ClosingDifference difference{
            closing->experiment, static_cast<int>(j),
            quantity(closing->mean(row) - first.mean(row), a, b, result.response_unit)};
        if (contradicts_zero(difference.value, degrees, response_scale(estimate, j))) {
          objections.add(
              Message("experiment {experiment}: {output} at the closing angle differs from the first angle "
                      "by {difference} (drift)",
                      difference.experiment, kOutputNames[j], times_uncertainty(difference.value)));
        }
        result.diagnostics.closing_differences.push_back(std::move(difference));
      }
      break;
    }
  }
}

void fill_faces(const RunRecord& record, const Selection& selection, const Estimate& estimate,
                CalibrationResult& result, Objections& objections) {
  if (!has_two_faces(record) || is_at_constant_rate(record)) return;
  try {
    result.faces =
        results_of_faces({selection.dwells, estimate.cleaned, estimate.cleaned_fits, &*estimate.curvature,
                          estimate.effects, estimate.reading_variance, estimate.outputs, estimate.resolution,
                          result.response_unit, (*result.sensitivity_matrix)[0][0].unit});
  } catch (const UndeterminedFit& error) {
    result.diagnostics.notes.push_back(Message("the two faces were not compared: {why}", error.message()));
    return;
  }
  static constexpr std::array<const char*, 4> kNames{"s_{}x", "s_{}y", "s_{}z", "O_{}"};
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t i = 0; i < kNames.size(); ++i) {
      const LineResult& of = result.faces->difference;
      const Quantity& difference = i < 3 ? of.sensitivity_matrix[j][i] : of.offset[j];
      if (!contradicts_zero(difference, degrees_of_readings(estimate, j), response_scale(estimate, j)))
        continue;
      objections.add(Message("{output} of face 1 and of face 2 differ by {difference} (the stage)",
                             fmt::format(fmt::runtime(kNames[i]), kOutputNames[j]),
                             times_uncertainty(difference)));
    }
  }
}

// Harmonics of the second fit with their uncertainties, from readings (type A) and tolerances (type B).
std::vector<Harmonic> harmonics_of(const HarmonicFit& fit, const Eigen::MatrixXd& by_dwell,
                                   std::size_t output, const Estimate& estimate) {
  const Variances variances = variances_of(by_dwell, estimate, output);
  const auto coefficient = [&](Eigen::Index i) {
    return quantity(fit.coefficients(i), variance_of(variances.a, i), variances.b(i), estimate.response_unit);
  };
  std::vector<Harmonic> harmonics;
  Harmonic& constant = harmonics.emplace_back();
  constant.cos_amplitude = coefficient(0);
  for (int k = 1; k <= fit.harmonics; ++k) {
    harmonics.push_back({k, coefficient(2 * k - 1), coefficient(2 * k)});
  }
  return harmonics;
}

// The amplitude squared in units of its uncertainty is chi2 with two degrees of freedom, or, where type A has
// nu of its own, twice F: exp(-x/2) and (1 + x/nu)^(-nu/2) = erfc(level / sqrt 2), the same tail as
// kContradictionLevel for one normal variable.
bool beyond_noise(const Harmonic& harmonic, double degrees_of_type_a, double scale) {
  const double log_tail = std::log(std::erfc(kContradictionLevel / std::sqrt(2.0)));
  const double limit = -2.0 * log_tail;
  const double nu = degrees_of_type_a;
  const double larger = std::isfinite(nu) ? std::sqrt(nu * std::expm1(limit / nu) / limit) : 1.0;
  const double s = harmonic.sin_amplitude.value;
  const double c = harmonic.cos_amplitude.value;
  if (std::hypot(s, c) <= 1e-13 * scale) return false;
  const double s_ratio = s / with_larger_type_a(harmonic.sin_amplitude, larger);
  const double c_ratio = c / with_larger_type_a(harmonic.cos_amplitude, larger);
  return s_ratio * s_ratio + c_ratio * c_ratio > limit;
}

void judge_harmonics(const FitDiagnostic& diagnostic, const Estimate& estimate, CalibrationResult& result,
                     Objections& objections) {
  const auto j = static_cast<std::size_t>(diagnostic.accelerometer);
  for (const Harmonic& harmonic : diagnostic.harmonics) {
    if (harmonic.order < 2 ||
        !beyond_noise(harmonic, degrees_of_readings(estimate, j), response_scale(estimate, j)))
      continue;
    const double amplitude = std::hypot(harmonic.sin_amplitude.value, harmonic.cos_amplitude.value);
    const Message sentence(
        "experiment {experiment}: harmonic {harmonic} of {output} has an amplitude of {amplitude:.3g} "
        "{unit}, beyond its uncertainty (non-linearity or synchronous step errors)",
        diagnostic.experiment, harmonic.order, kOutputNames[j], amplitude, result.response_unit);
    // Errors of the result for a non-linearity of this size (docs/theory/uncertainty.md): K2/2 is the second
    // harmonic and K2/3 the offset's error; K3/4 is the third harmonic and 3 K3/4 the sensitivity's. Within
    // the stated uncertainty (k = 2) they only cause a note.
    const double in_offset = harmonic.order == 2 ? amplitude * 2.0 / 3.0 : 0.0;
    const double in_sensitivity = harmonic.order == 3 ? amplitude * 3.0 : 0.0;
    if (in_offset > 2.0 * result.offset[j].standard_uncertainty ||
        in_sensitivity > 2.0 * result.intrinsic_sensitivity[j].standard_uncertainty) {
      objections.add(sentence);
    } else {
      result.diagnostics.notes.push_back(sentence);
    }
  }
}

void fill_fits(const Estimate& estimate, CalibrationResult& result, Objections& objections) {
  Diagnostics& diagnostics = result.diagnostics;
  diagnostics.rank = 3;
  diagnostics.reciprocal_condition = 1.0;
  double chi2 = 0.0;
  bool weighted = true;
  std::vector<Message> no_harmonics;
  for (std::size_t i = 0; i < estimate.fits.size(); ++i) {
    const HarmonicFit& fit = estimate.fits[i];
    const ReadingSeries& series = estimate.series[i];
    const auto j = static_cast<std::size_t>(series.accelerometer);
    FitDiagnostic diagnostic;
    diagnostic.experiment = series.experiment;
    diagnostic.accelerometer = series.accelerometer;
    const auto coefficient = [&](AbcTerm term) {
      const Eigen::Index at = abc_index(series.experiment, series.accelerometer, term);
      return quantity(estimate.coefficients(at), variance_at(estimate.covariance_a, at),
                      estimate.covariance_b(at, at), result.response_unit);
    };
    diagnostic.sine = coefficient(kA);
    diagnostic.cosine = coefficient(kB);
    diagnostic.constant = coefficient(kC);
    diagnostic.angles = static_cast<int>(series.readings.size());
    diagnostic.degrees_of_freedom = fit.degrees_of_freedom();
    diagnostic.residual_rms = std::sqrt(fit.residuals.squaredNorm() / static_cast<double>(diagnostic.angles));
    if (fit.weighted) diagnostic.chi2 = fit.residual_sum_squares;
    chi2 += fit.residual_sum_squares;
    weighted = weighted && fit.weighted;
    diagnostics.degrees_of_freedom += diagnostic.degrees_of_freedom;
    diagnostics.rank = std::min(diagnostics.rank, fit.rank);
    diagnostics.reciprocal_condition = std::min(diagnostics.reciprocal_condition, fit.reciprocal_condition);

    const HarmonicFit& cleaned = estimate.cleaned_fits[i];
    const ResidualTest test =
        test_residuals(estimate.cleaned[i], cleaned, estimate.cleaned_effects, estimate.resolution);
    if (test.deviate > kContradictionLevel) {
      objections.add(
          Message("experiment {experiment}: the residuals of {output} are {rms:.3g} {unit} rms where "
                  "{explained:.3g} is explained by noise and tolerances",
                  series.experiment, kOutputNames[j],
                  std::sqrt(cleaned.residuals.squaredNorm() / static_cast<double>(diagnostic.angles)),
                  result.response_unit, test.expected_rms));
    }
    try {
      const HarmonicFit second =
          fit_harmonics(series.alpha, series.readings, series.u, kDiagnosticHarmonics, series.by_motion);
      diagnostic.harmonics = harmonics_of(second, by_dwell_of(second, series), j, estimate);
      diagnostic.harmonics_residual_rms =
          std::sqrt(second.residuals.squaredNorm() / static_cast<double>(diagnostic.angles));
      FitDiagnostic without_curvature = diagnostic;
      const HarmonicFit of_cleaned = fit_harmonics(series.alpha, estimate.cleaned[i].readings, series.u,
                                                   kDiagnosticHarmonics, series.by_motion);
      without_curvature.harmonics =
          harmonics_of(of_cleaned, cleaned_by_dwell(of_cleaned, series, *estimate.curvature), j, estimate);
      judge_harmonics(without_curvature, estimate, result, objections);
    } catch (const UndeterminedFit& error) {
      const Message why("experiment {experiment}: harmonics 2 to 5 not examined: {why}", series.experiment,
                        error.message());
      if (std::ranges::find(no_harmonics, why) == no_harmonics.end()) no_harmonics.push_back(why);
    }
    diagnostics.fits.push_back(std::move(diagnostic));
  }
  diagnostics.notes.insert(diagnostics.notes.end(), no_harmonics.begin(), no_harmonics.end());
  if (weighted) diagnostics.chi2 = chi2;
}

void fill_flags(const RunRecord& record, const Selection& selection, CalibrationResult& result,
                Objections& objections) {
  Diagnostics& diagnostics = result.diagnostics;
  diagnostics.angles_used = static_cast<int>(selection.dwells.size());
  count_flags(record, diagnostics);
  if (Message words = words_about_flags(record, kSuspectFlags); !words.empty())
    objections.add(std::move(words));
  if (selection.not_finite > 0) {
    objections.add(Message("{angles} of {all} angles left out because a mean is not a finite number",
                           selection.not_finite, record.dwells.size()));
  }
}

void note_missing_angles(const RunRecord& record, const Selection& selection, CalibrationResult& result) {
  for (int experiment = 1; experiment <= 3; ++experiment) {
    std::set<int> measured;
    for (const DwellRecord* dwell : selection.dwells) {
      if (dwell->experiment == experiment) measured.insert(dwell->n);
    }
    if (static_cast<int>(measured.size()) < record.steps) {
      result.diagnostics.notes.push_back(
          Message("experiment {experiment}: {measured} of {planned} angles measured", experiment,
                  measured.size(), record.steps));
    }
  }
}

void note_type_a(const Selection& selection, const Estimate& estimate, CalibrationResult& result,
                 Objections& objections) {
  if (selection.with_uncertainty) return;
  if (!estimate.covariance_a) {
    objections.add(
        Message("there is no type A uncertainty: the readings carry none and leave no redundancy"));
    return;
  }
  result.diagnostics.notes.push_back(
      Message("type A is taken from the residuals of the fits, which hold step errors too, because {why}",
              selection.some_uncertainty ? Message("some readings carry no standard uncertainty above zero")
                                         : Message("the readings carry no standard uncertainty")));
}

// The reason why the record cannot be analysed; empty if it may be.
Message refusal(const RunRecord& record, const Selection& selection) {
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.closing) continue;
    if (dwell.experiment < 1 || dwell.experiment > 3 || dwell.n < 1) {
      return {
          "the record has an angle of experiment {experiment}, n = {n}; experiments are 1, 2, 3 and n starts "
          "at 1",
          dwell.experiment, dwell.n};
    }
  }
  for (int experiment = 1; experiment <= 3; ++experiment) {
    const bool measured =
        std::any_of(selection.dwells.begin(), selection.dwells.end(),
                    [&](const DwellRecord* dwell) { return dwell->experiment == experiment; });
    if (!measured) {
      if (selection.not_finite > 0)
        return {
            "experiment {experiment} has no angles with finite readings; all three experiments are required",
            experiment};
      return {"experiment {experiment} has no angles; all three experiments are required", experiment};
    }
  }
  for (const EffectSizeKey& key : effect_size_keys()) {
    const double size = key.get(record.tolerances);
    if (!(size >= 0.0 && std::isfinite(size)))
      return {"a tolerance ({key}) is {size}; finite numbers >= 0 are required", key.key, size};
  }
  return {};
}

/// "4 + 4 + 4"
std::string angles_of_experiments(const Selection& selection) {
  std::array<int, 3> angles{};
  for (const DwellRecord* dwell : selection.dwells)
    ++angles.at(static_cast<std::size_t>(dwell->experiment) - 1);
  return fmt::format("{}", fmt::join(angles, " + "));
}

void judge_effects(const RunRecord& record, const Estimate& estimate, CalibrationResult& result,
                   Objections& objections) {
  const Eigen::Vector3d unit = sensitivity_matrix_of(estimate.outputs).rowwise().norm();
  for (const Undetermined& outputs : undetermined_outputs(judged_outputs(result, estimate.shares, unit),
                                                          record.tolerances, EffectsAre::kStated)) {
    if (outputs.doubtful) {
      objections.add(outputs.words);
    } else {
      result.diagnostics.notes.push_back(outputs.words);
    }
  }
}

void judge_matrix(const Estimate& estimate, Objections& objections) {
  Eigen::Matrix3d unit = sensitivity_matrix_of(estimate.outputs);
  for (Eigen::Index j = 0; j < 3; ++j) unit.row(j).normalize();
  const Eigen::Vector3d singular = singular_values(unit);
  constexpr double kNearlyInOnePlane =
      1e-2;  // half a degree out of one plane: no triaxial accelerometer is built so
  if (!(singular(2) > kNearlyInOnePlane * singular(0))) {
    objections.add(
        Message("the three axes of the accelerometer lie nearly in one plane; are two outputs the same?"));
  }
}

// Names an output that does not respond to gravity: its intrinsic properties do not exist. Empty: none.
Message dead_output(const Estimate& estimate) {
  const Eigen::Matrix3d s = sensitivity_matrix_of(estimate.outputs);
  for (Eigen::Index j = 0; j < 3; ++j) {
    double type_a = 0.0;
    if (estimate.covariance_a) {
      type_a =
          std::sqrt(carried_covariance(abc_equations().middleRows<3>(3 * j), *estimate.covariance_a).trace());
    }
    const double response = s.row(j).norm();
    const double round_off = 1e-12 * std::abs(estimate.outputs(9 + j));
    if (!(response > std::max(kContradictionLevel * type_a, round_off))) {
      return Message(
          "output {output} does not follow gravity: its sensitivity is {sensitivity:.3g}, not above its "
          "scatter",
          kOutputNames[j], response);
    }
  }
  return {};
}

// Names an output without any response: k2 and k3 have no direction there. Empty: none.
Message dead_or_flat(const AbcOutputs& outputs) {
  for (int j = 0; j < 3; ++j) {
    const double response = sensitivity_matrix_of(outputs).row(j).norm();
    if (!(response > 1e-12 * std::abs(outputs(offset_index(j))))) {
      return Message(
          "output {output} does not follow gravity: its sensitivity is {sensitivity:.3g}, not above its "
          "scatter",
          kOutputNames[j], response);
    }
  }
  return {};
}

/// Iterates: the shapes of k2 and k3 follow from the linear response at zero, which follows from k2 and k3.
/// Each pass makes the error of the shapes smaller by a factor of k.
void correct_for_curvature(const RunRecord& record, const Selection& selection, Estimate& estimate) {
  constexpr int kMostPasses = 5;
  constexpr double kFound = 1e-10;  // relative to S, far below any noise
  const AbcOutputs seen = estimate.outputs;
  AbcOutputs at_zero = seen;
  for (int pass = 0; pass < kMostPasses; ++pass) {
    const CurvatureFit& curvature =
        estimate.curvature.emplace(selection.dwells, estimate.series, estimate.fits, at_zero,
                                   std::array{record.tolerances.k2 > 0.0, record.tolerances.k3 > 0.0});
    estimate.outputs = seen - product_with_vector(curvature.correction(), curvature.k());
    const AbcOutputs before = at_zero;
    at_zero = curvature.at_zero(estimate.outputs);
    double left = 0.0;
    for (int j = 0; j < 3; ++j) {
      const double moved = (at_zero - before).segment<3>(3 * j).norm() / at_zero.segment<3>(3 * j).norm();
      left = std::max(left, moved * curvature.k().segment<2>(2 * j).cwiseAbs().maxCoeff());
    }
    if (!(left > kFound)) break;
  }
}

/// Type A covariance of the coefficients with the scatter of the plain fits, where the readings state none.
std::optional<Covariance27> type_a_of_plain_fits(const Estimate& estimate) {
  std::array<std::optional<double>, 3> variance;
  for (std::size_t j = 0; j < 3 && !estimate.fits[j].weighted; ++j) {
    double squares = 0.0;
    int degrees = 0;
    for (std::size_t i = j; i < estimate.fits.size(); i += 3) {
      squares += estimate.fits[i].residual_sum_squares;
      degrees += estimate.fits[i].degrees_of_freedom();
    }
    if (degrees > 0) variance[j] = squares / degrees;
  }
  return type_a_of_coefficients(estimate.fits, variance);
}

PublishedResult published_result(const Estimate& estimate, const CalibrationResult& result) {
  const Eigen::Matrix<double, 12, 27>& equations = abc_equations();
  std::optional<Covariance12> a;
  if (const std::optional<Covariance27> of = type_a_of_plain_fits(estimate))
    a = Covariance12(carried_covariance(equations, *of));
  std::optional<Covariance12> b = Covariance12(Covariance12::Zero());
  for (const InputEffect& effect : estimate.effects) {
    if (!in_published_protocol(effect.key)) continue;
    const Eigen::Matrix<double, 12, 1> change =
        effect.standard_uncertainty *
        product_with_vector(equations, effect_on_coefficients(effect, estimate.series, estimate.fits));
    b->noalias() += change * change.transpose();
  }
  PublishedResult out;
  const AbcOutputs values = abc_outputs(estimate.coefficients);
  const Eigen::Matrix3d s = sensitivity_matrix_of(values);
  const IntrinsicProperties intrinsic = intrinsic_properties(s);
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(s);
  std::optional<Covariance9> a9, b9 = Covariance9(carried_covariance(jacobian, *b));
  if (a) a9 = Covariance9(carried_covariance(jacobian, *a));
  out.covariance = a ? Covariance12(*a + *b) : *b;
  out.covariance_intrinsic = a9 ? Covariance9(*a9 + *b9) : *b9;
  const std::string& per_g = (*result.sensitivity_matrix)[0][0].unit;
  for (int j = 0; j < 3; ++j) {
    const auto row = static_cast<std::size_t>(j);
    for (int k = 0; k < 3; ++k) {
      const Eigen::Index i = s_index(j, k);
      out.sensitivity_matrix[row][static_cast<std::size_t>(k)] =
          quantity(s(j, k), variance_at(a, i), variance_at(b, i), per_g);
    }
    out.offset[row] = quantity(values(offset_index(j)), variance_at(a, offset_index(j)),
                               variance_at(b, offset_index(j)), result.response_unit);
    out.intrinsic_sensitivity[row] =
        quantity(intrinsic.sensitivity(j), variance_at(a9, j), variance_at(b9, j), per_g);
    out.intrinsic_angle[row] =
        quantity(intrinsic.angle_deg(j), variance_at(a9, 3 + j), variance_at(b9, 3 + j), "degree");
  }
  return out;
}

// Fills fits, outputs and the effects of the tolerances, before any judgement. Returns the reason if that is
// impossible, else an empty string.
Message estimate_from(const RunRecord& record, const Selection& selection, Estimate& estimate) {
  estimate.series = series_of(selection);
  for (std::size_t i = 0; i < estimate.fits.size(); ++i) {
    ReadingSeries& series = estimate.series[i];
    try {
      estimate.fits[i] = fit_harmonics(series.alpha, series.readings, series.u, 1);
      // The columns are those of the sine at rest, which the second pass knows.
      for (int pass = 0; pass < 2 && !series.rate_radps.empty(); ++pass) {
        series.by_motion = columns_of_motion(estimate.fits[i], series.rate_radps);
        estimate.fits[i] = fit_harmonics(series.alpha, series.readings, series.u, 1, series.by_motion);
      }
    } catch (const UndeterminedFit& error) {
      return not_determined(series, error.message());
    }
    const Eigen::VectorXd& c = estimate.fits[i].coefficients;
    estimate.coefficients.segment<3>(static_cast<Eigen::Index>(3 * i)) << c(1), c(2), c(0);
  }
  estimate.outputs = abc_outputs(estimate.coefficients);
  const Message dead = dead_or_flat(estimate.outputs);
  if (!dead.empty()) return dead;
  correct_for_curvature(record, selection, estimate);
  estimate.cleaned = estimate.curvature->cleaned(estimate.series);
  for (std::size_t i = 0; i < estimate.fits.size(); ++i) {
    const ReadingSeries& series = estimate.cleaned[i];
    estimate.cleaned_fits[i] = fit_harmonics(series.alpha, series.readings, series.u, 1, series.by_motion);
  }
  if (!selection.with_uncertainty) pool_variances(estimate.cleaned_fits, *estimate.curvature, estimate);
  estimate.covariance_a = type_a_of_coefficients(estimate.fits, estimate.reading_variance);
  Message reason = dead_output(estimate);
  if (!reason.empty()) return reason;

  AccelerometerModel accelerometer;
  accelerometer.sensitivity_matrix = sensitivity_matrix_of(estimate.outputs);
  accelerometer.offset = offset_of(estimate.outputs);
  const std::vector<ReadingArrival> arrivals = arrivals_at(record, selection.dwells);
  estimate.effects = first_order_effects({selection.dwells, selection.time_fractions, arrivals},
                                         accelerometer, record.tolerances, record.response_unit);
  const auto curved = std::stable_partition(
      estimate.effects.begin(), estimate.effects.end(),
      [](const InputEffect& effect) { return effect.group != "k2" && effect.group != "k3"; });
  estimate.curvature_effects.assign(std::make_move_iterator(curved),
                                    std::make_move_iterator(estimate.effects.end()));
  estimate.effects.erase(curved, estimate.effects.end());
  arrange_effects(estimate);
  return {};
}

void fill_gravity(const RunRecord& record, CalibrationResult& result) {
  result.g_loc.unit = "m/s2";
  if (!record.g_loc_known) return;
  result.g_loc.value = record.g_loc.value_mps2;
  result.g_loc.type_b = record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor;
  result.g_loc.standard_uncertainty = *result.g_loc.type_b;
  result.g_loc_source = record.g_loc.source;
}

}  // namespace

CalibrationResult analyse_abc(const RunRecord& record, const AnalysisOptions& options) {
  CalibrationResult result;
  result.estimator = "abc";
  result.source = record.source;
  result.response_unit = record.response_unit;
  fill_gravity(record, result);
  const double resolution = options.resolution.value_or(0.0);
  if (!(resolution >= 0.0 && std::isfinite(resolution))) {
    result.why = Message("the resolution is {resolution}; a finite number >= 0 is required", resolution);
    return result;
  }

  const Selection selection = select(record);
  result.why = refusal(record, selection);
  if (!result.why.empty()) return result;

  Estimate estimate;
  result.why = estimate_from(record, selection, estimate);
  if (!result.why.empty()) return result;
  estimate.resolution = resolution;
  estimate.response_unit = record.response_unit;
  estimate.covariance_b = type_b_of_coefficients(estimate, resolution);
  fill_output_covariances(estimate, resolution);
  result.unstated_effects = unstated_effects(record.tolerances);

  Objections objections;
  fill_outputs(estimate, result);
  result.published = published_result(estimate, result);
  fill_flags(record, selection, result, objections);
  fill_fits(estimate, result, objections);
  fill_closures(estimate, result, objections);
  fill_faces(record, selection, estimate, result, objections);
  fill_closing_differences(selection, estimate, result, objections);
  judge_matrix(estimate, objections);
  judge_effects(record, estimate, result, objections);
  note_missing_angles(record, selection, result);
  note_type_a(selection, estimate, result, objections);
  add_voltmeter(record.tolerances, result);  // After the checks: no reading shows its gain.

  if (!objections.empty()) {
    result.verdict = Verdict::kDoubtful;
    result.why = objections.in_one_sentence();
    result.diagnostics.notes.insert(result.diagnostics.notes.begin(), objections.all().begin(),
                                    objections.all().end());
    return result;
  }
  result.verdict = Verdict::kUsable;
  result.why = Message(
      "{angles} angles in three experiments ({experiments}) determine the result, and nothing found "
      "contradicts the stated uncertainties",
      selection.dwells.size(), angles_of_experiments(selection));
  return result;
}

bool in_published_protocol(std::string_view key) {
  static constexpr std::array<std::string_view, 4> kOfThePaper{"alignment_deg", "initial_turn_deg",
                                                               "zero_deg", "step_deg"};
  return std::find(kOfThePaper.begin(), kOfThePaper.end(), key) != kOfThePaper.end();
}

std::vector<OutputEffect> type_b_effects(const RunRecord& record) {
  const Selection selection = select(record);
  std::string reason = refusal(record, selection);
  Estimate estimate;
  if (reason.empty()) reason = estimate_from(record, selection, estimate);
  if (!reason.empty()) throw std::invalid_argument(reason);
  std::vector<OutputEffect> effects;
  effects.reserve(estimate.effects.size());
  for (const auto* list : {&estimate.effects, &estimate.curvature_effects}) {
    for (const InputEffect& effect : *list) {
      effects.push_back(
          {effect.name, effect.group, effect.key, effect.unit, effect.item != nullptr,
           effect.standard_uncertainty, effect.standard_uncertainty * effect_on_outputs(effect, estimate),
           effect.standard_uncertainty *
               product_with_vector(abc_equations(),
                                   effect_on_coefficients(effect, estimate.series, estimate.fits))});
    }
  }
  return effects;
}

}  // namespace abcal
