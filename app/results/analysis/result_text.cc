#include "app/results/analysis/result_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "app/document/number_text.h"
#include "app/results/analysis/coverage_words.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/published_text.h"
#include "app/results/analysis/report_data.h"
#include "app/system/terminal.h"
#include "protocol/quantities/output_names.h"

namespace abcal {

int decimals_for(double uncertainty) {
  if (!(uncertainty > 0.0) || !std::isfinite(uncertainty)) return 9;
  return std::clamp(-place_of_second_digit(uncertainty), -17, 17);
}

std::string with_decimals(double value, int decimals, bool with_sign) {
  double shown = value;
  if (decimals < 0) {
    const double unit = std::pow(10.0, -decimals);
    shown = std::round(value / unit) * unit;
  }
  return without_negative_zero(with_sign ? fmt::format("{:+.{}f}", shown, std::max(0, decimals))
                                         : fmt::format("{:.{}f}", shown, std::max(0, decimals)));
}

namespace {

std::string uncertainty_text(const std::optional<double>& u, int decimals) {
  if (!u || !std::isfinite(*u)) return "-";
  return with_decimals(*u, decimals);
}

/// A part of an uncertainty with two significant digits: a small type A next to a large type B is not zero.
std::string part_text(const std::optional<double>& u) {
  return u && std::isfinite(*u) ? fmt::format("{:.1e}", *u) : "-";
}

void row(std::string& text, const std::string& name, const Quantity& q, bool with_k = false) {
  if (!std::isfinite(q.value)) {
    text += fmt::format("  {:<8} {:>16}\n", name, "not determined");
    return;
  }
  const int decimals = decimals_for(q.standard_uncertainty);
  text +=
      fmt::format("  {:<8} {:>16} {:>14} {:>14} {:>14}  {}{}\n", name, with_decimals(q.value, decimals, true),
                  uncertainty_text(q.standard_uncertainty, decimals), part_text(q.type_a),
                  part_text(q.type_b), with_k ? fmt::format("{:>6.2f}  ", coverage_factor(q)) : "", q.unit);
}

/// The rows of the groups of a kind that have any number.
void rows_of(std::string& text, const CalibrationResult& result, QuantityKind kind) {
  for (const auto& [about, values] : found_groups(result, kind)) {
    if (std::ranges::none_of(values, [](const auto& one) { return std::isfinite(one.quantity.value); }))
      continue;
    for (const auto& [name, quantity] : values) row(text, name, quantity);
  }
}

void stage_errors(std::string& text, const CalibrationResult& result) {
  const JointResult& joint = *result.joint;
  text += "\nStage, found from the same readings\n";
  rows_of(text, result, QuantityKind::kStage);
  for (std::size_t i = 0; i < 3; ++i) {
    double squares = 0.0, uncertainty = 0.0, largest = 0.0;
    int count = 0;
    for (const Quantity& f : joint.step_error[i]) {
      if (!std::isfinite(f.value)) continue;
      squares += f.value * f.value;
      uncertainty = std::max(uncertainty, f.standard_uncertainty);
      largest = std::max(largest, std::abs(f.value));
      ++count;
    }
    if (count > 0) {
      text += fmt::format(
          "  f_{}(n)   rms {:.5f}, largest {:.5f} degree over {} angles; u at most {:.5f} degree\n", i + 1,
          std::sqrt(squares / count), largest, count, uncertainty);
    }
  }
  text += "Accelerometer, found from the same readings\n";
  rows_of(text, result, QuantityKind::kAccelerometer);
  if (!joint.nonlinearity_fitted) text += "  k2, k3   left out: the readings show no non-linearity\n";
}

/// Adds what the turning shows beside the response at rest.
void add_motion(std::string& text, const CalibrationResult& result) {
  text += "\nResponse relative to rest, of u, v, w (standard uncertainty)\n";
  for (const RateResponse& response : result.joint->motion->responses) {
    text += fmt::format("  {:>6.4g} degree/s, {:.4f} Hz  amplitude", response.rate_deg_per_s,
                        response.frequency_hz);
    for (const Quantity& q : response.amplitude) text += " " + value_with_uncertainty(q);
    text += "\n";
    text += fmt::format("  {:>27}  phase beyond that of a delay {} degree\n", "",
                        value_with_uncertainty(response.phase));
  }
  text += "Accelerometer and stage where it turns\n";
  rows_of(text, result, QuantityKind::kMotion);
}

/// The ABC result of each face, and the difference, which shows errors of the stage.
std::string faces_text(const FaceResults& faces) {
  std::string text = "\nBy each face alone (ABC); face 1 minus face 2 in standard uncertainties\n";
  const auto add = [&](const std::string& name, const auto& of) {
    const Quantity& difference = of(faces.difference);
    const Quantity &first = of(faces.face[0]), &second = of(faces.face[1]);
    const int decimals = decimals_for(first.standard_uncertainty);
    text +=
        fmt::format("  {:<8} {:>16} {:>16} {:>8.1f}  {}\n", name, with_decimals(first.value, decimals, true),
                    with_decimals(second.value, decimals, true),
                    difference.value / difference.standard_uncertainty, first.unit);
  };
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k)
      add(std::string(kOutputSymbols[3 * j + k]),
          [&](const LineResult& line) -> const Quantity& { return line.sensitivity_matrix[j][k]; });
  }
  for (std::size_t j = 0; j < 3; ++j)
    add(fmt::format("O_{}", kOutputNames[j]),
        [&](const LineResult& line) -> const Quantity& { return line.offset[j]; });
  return text;
}

}  // namespace

bool own_coverage_factors(const CalibrationResult& result) {
  constexpr double kTold = 0.005;  // one that differs by less is printed as the common one
  const std::vector<NamedQuantity> all = outputs(result);
  return std::any_of(all.begin(), all.end(), [](const NamedQuantity& output) {
    return std::isfinite(output.quantity.standard_uncertainty) &&
           std::abs(coverage_factor(output.quantity) - kCoverageFactor) > kTold;
  });
}

std::string verdict_words(Verdict verdict) {
  std::string words(to_string(verdict));
  std::replace(words.begin(), words.end(), '_', ' ');
  return words;
}

std::string value_with_uncertainty(const Quantity& q) {
  if (!std::isfinite(q.value)) return "not determined";
  const int decimals = decimals_for(q.standard_uncertainty);
  return fmt::format("{} +- {}", with_decimals(q.value, decimals, true),
                     uncertainty_text(q.standard_uncertainty, decimals));
}

namespace {

void add_outputs(std::string& text, const CalibrationResult& result, std::FILE* stream) {
  // k of U = k u, for a coverage probability of 95.45 %.
  const bool with_k = own_coverage_factors(result);
  text += fmt::format("\n  {:<8} {:>16} {:>14} {:>14} {:>14}  {}{}\n", "quantity", "value", "std. unc.",
                      "type A", "type B", with_k ? "     k  " : "", "unit");
  for (const auto& [about, values] : found_groups(result, QuantityKind::kOutput)) {
    text += emphasised(stream, Emphasis::kHeading, std::string(about.heading.english())) + "\n";
    for (const auto& [name, quantity] : values) row(text, name, quantity, with_k);
  }
  if (with_k) {
    text +=
        "  U = k u for a coverage probability of 95.45 %: k is that of Student's distribution with the\n"
        "  degrees of freedom of each output.\n";
  }
}

void add_model_equation(std::string& text, const ModelEquation& equation) {
  text +=
      "\nModel equation at zero, K0 + K1 a + K2 a^2 + K3 a^3 along each output's own axis (not the result "
      "above, which is the line response)\n";
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t order = 0; order < 4; ++order) {
      if (const Quantity& k = equation.k[j][order]; std::isfinite(k.value))
        row(text, fmt::format("K{}_{}", order, kOutputNames[j]), k);
    }
  }
}

void add_poses(std::string& text, const NormResult& norm) {
  text += fmt::format(
      "\n{} poses used, {} left out; rms of |a|/g_loc - 1: {:.2e}{}; sphere coverage {:.2f}{}{}\n",
      norm.poses, norm.poses_left_out, norm.norm_rms,
      norm.direction_rms_deg ? fmt::format("; of the directions: {:.2g} degree", *norm.direction_rms_deg)
                             : "",
      norm.sphere_coverage, norm.coverage_words.empty() ? "" : ": ", norm.coverage_words);
}

void add_fits(std::string& text, const Diagnostics& d, const std::string& unit) {
  double worst_residual = 0.0;
  double worst_harmonic = 0.0;
  for (const FitDiagnostic& fit : d.fits) {
    worst_residual = std::max(worst_residual, fit.residual_rms);
    for (const Harmonic& h : fit.harmonics) {
      if (h.order < 2) continue;
      worst_harmonic = std::max(worst_harmonic, std::hypot(h.sin_amplitude.value, h.cos_amplitude.value));
    }
  }
  text += fmt::format(
      "\nFits: residual rms at most {:.2e} {}, harmonics 2-5 at most {:.2e} {}, reciprocal condition "
      "{:.2f}\n",
      worst_residual, unit, worst_harmonic, unit, d.reciprocal_condition);
}

void add_closures(std::string& text, const Diagnostics& d) {
  const auto in_units = [](const Closure& c) {
    return std::abs(c.value.value) / c.value.standard_uncertainty;
  };
  const auto worst =
      std::max_element(d.closures.begin(), d.closures.end(),
                       [&](const Closure& a, const Closure& b) { return in_units(a) < in_units(b); });
  text += fmt::format("Closures: largest {} of {} = {} {} ({:.1f} standard uncertainties)\n", worst->name,
                      kOutputNames.at(static_cast<std::size_t>(worst->accelerometer)),
                      value_with_uncertainty(worst->value), worst->value.unit, in_units(*worst));
}

/// A fit without step errors: its chi2 against the readings' noise is large on any real stage.
void add_chi2(std::string& text, const Diagnostics& d, bool fits_stage_errors) {
  text +=
      fits_stage_errors
          ? fmt::format("chi2 = {:.1f} for {} degrees of freedom{}\n", *d.chi2, d.degrees_of_freedom,
                        d.chi2_probability ? fmt::format(", probability {:.3g}", *d.chi2_probability) : "")
          : fmt::format(
                "Residuals are {:.1f} times those expected from the noise of the readings alone (they "
                "include the step errors of the stage)\n",
                std::sqrt(*d.chi2 / d.degrees_of_freedom));
}

void add_runs(std::string& text, const std::vector<SeriesMember>& runs, std::FILE* stream) {
  text += "\n" +
          emphasised(stream, Emphasis::kHeading,
                     "Runs (alone: how far the results of a run alone are from that of all, in u)") +
          "\n";
  for (const SeriesMember& run : runs) {
    text += fmt::format("  {}: {}; {}\n", run.source, run.mounting, verdict_words(run.verdict));
    for (const Apart& alone : run.alone)
      text +=
          fmt::format("    {:<6} alone: at most {:.1f}, in {}\n", alone.estimator, alone.in_u, alone.output);
  }
}

void add_checks(std::string& text, const Diagnostics& d, std::FILE* stream) {
  if (!d.checks.empty()) text += "Checks (found, limit)\n";
  for (const Check& check : d.checks) {
    if (!std::isfinite(check.found)) continue;  // not done: a note says why
    text +=
        fmt::format("  {:<26} {:>10.2e} {:>10.2e}  {}  {}\n", check.name, check.found, check.limit,
                    check.passed ? "passed" : emphasised(stream, Emphasis::kWarning, "FAILED"), check.unit);
  }
}

}  // namespace

std::string result_text(const CalibrationResult& result, std::FILE* stream) {
  const Emphasis emphasis = result.verdict == Verdict::kUsable     ? Emphasis::kGood
                            : result.verdict == Verdict::kDoubtful ? Emphasis::kWarning
                                                                   : Emphasis::kBad;
  std::string text =
      fmt::format("{} {} ({} estimator): {}\n", emphasised(stream, Emphasis::kHeading, "Result:"),
                  emphasised(stream, emphasis, verdict_words(result.verdict)), result.estimator, result.why);
  const Diagnostics& d = result.diagnostics;
  for (const Message& note : d.notes) text += "  note: " + note + "\n";
  if (result.verdict == Verdict::kNotUsable) return text;  // No numbers without a usable verdict.

  if (std::isfinite(result.g_loc.value)) {
    text += fmt::format("g_loc = {} m/s2 (k = 1; {})\n", value_with_uncertainty(result.g_loc),
                        result.g_loc_source.empty() ? "source not stated" : result.g_loc_source);
  }
  add_outputs(text, result, stream);
  if (!result.series.empty()) add_runs(text, result.series, stream);
  if (result.faces) text += faces_text(*result.faces);
  if (result.published) text += published_text(*result.published);
  if (result.model_equation) add_model_equation(text, *result.model_equation);
  if (result.joint) stage_errors(text, result);
  if (result.joint && result.joint->motion) add_motion(text, result);
  if (result.norm) add_poses(text, *result.norm);
  if (!d.fits.empty()) add_fits(text, d, result.response_unit);
  if (!d.closures.empty()) add_closures(text, d);
  if (d.chi2 && d.degrees_of_freedom > 0)
    add_chi2(text, d, find_estimator(result.estimator).fits_stage_errors);
  add_checks(text, d, stream);
  text += fmt::format("{} angles used, {} flagged", d.angles_used, d.angles_flagged);
  for (const FlagCount& flag : d.flags) text += fmt::format("; {}: {}", flag.flag, flag.dwells);
  return text + "\n";
}

std::string comparison_text(const std::vector<CalibrationResult>& results, std::string_view estimator) {
  std::string text = fmt::format("  {:<8}", "quantity");
  for (const CalibrationResult& result : results) {
    text += fmt::format(" {:>30}", fmt::format("{} ({})", result.estimator, to_string(result.verdict)));
  }
  text += "   difference / std. unc.\n";
  std::vector<std::vector<NamedQuantity>> columns;
  for (const CalibrationResult& result : results) columns.push_back(outputs(result));
  const auto reported = static_cast<std::size_t>(&result_of(results, estimator) - results.data());
  for (std::size_t row_index = 0; row_index < columns.front().size(); ++row_index) {
    text += fmt::format("  {:<8}", columns.front()[row_index].name);
    for (std::size_t c = 0; c < columns.size(); ++c) {
      const Quantity& q = columns[c][row_index].quantity;
      const bool shown = results[c].verdict != Verdict::kNotUsable && std::isfinite(q.value);
      text += fmt::format(" {:>30}", shown ? value_with_uncertainty(q) : "-");
    }
    text += "  ";
    for (std::size_t c = 0; c < columns.size(); ++c) {
      if (c == reported) continue;
      const Quantity& a = columns[reported][row_index].quantity;
      const Quantity& b = columns[c][row_index].quantity;
      const double u = std::hypot(a.standard_uncertainty, b.standard_uncertainty);
      const double difference = (b.value - a.value) / u;
      text += std::isfinite(difference) ? fmt::format(" {:>+6.2f}", difference) : fmt::format(" {:>6}", "-");
    }
    text += "\n";
  }
  return text;
}

}  // namespace abcal
