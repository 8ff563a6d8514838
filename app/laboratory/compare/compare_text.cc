#include "app/laboratory/compare/compare_text.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>

#include "app/results/analysis/result_text.h"
#include "app/system/output.h"
#include "app/system/terminal.h"
#include "app/system/text_layout.h"
#include "drivers/text/letters.h"

namespace abcal {
namespace {

std::string with_u(double value, double u) {
  Quantity quantity;
  quantity.value = value;
  quantity.standard_uncertainty = u;
  return value_with_uncertainty(quantity);
}

std::string property_of(const ComparedResult& result, std::size_t i) {
  const auto at = static_cast<Eigen::Index>(i);
  if (!std::isfinite(result.values(at))) return "not given";
  return with_u(result.values(at), std::sqrt(result.covariance(at, at)));
}

std::string heading(std::FILE* stream, const std::string& text) {
  return fmt::format("\n{}\n", emphasised(stream, Emphasis::kHeading, text));
}

void list_results(const ResultsComparison& comparison, std::string& text) {
  for (std::size_t i = 0; i < comparison.results.size(); ++i) {
    const ComparedResult& r = comparison.results[i];
    text += fmt::format("  {:>2}  {}: {}, {}", i + 1, r.file, r.kind,
                        r.what.empty() ? "without a number" : r.what);
    if (!r.date.empty()) text += ", " + r.date;
    if (!r.item.empty()) text += "; item " + r.item;
    if (!r.stage.empty()) text += "; stage " + r.stage;
    text += "\n";
    for (const std::string& note : r.notes) text += "      note: " + note + "\n";
  }
}

/// The verdict on results, and what it rests on, in lines of a terminal.
std::string verdict_lines(const std::string& whose, bool agree, const std::string& why, std::FILE* stream) {
  const std::string verdict = agree ? "agree" : "do NOT agree";
  const std::string text =
      wrapped(printable_line(fmt::format("{} {}: {}", whose, verdict, why)), "", "  ", kTerminalColumns);
  return whose + " " + emphasised(stream, agree ? Emphasis::kGood : Emphasis::kBad, verdict) +
         text.substr(whose.size() + 1 + verdict.size());
}

std::string test_words(const ConsistencyTest& test) {
  return fmt::format(
      "P = {:.2g} that chance gives differences as large (chi2 = {:.1f} for {} degrees of freedom)",
      test.probability, test.chi2, test.degrees_of_freedom);
}

/// For several results: which one is the outlier.
std::string outlier_lines(const ResultsComparison& comparison) {
  const ConsistentSubset& found = *comparison.consistency;
  if (found.agree(kAgreementLevel)) return {};
  std::string words;
  if (!found.found) {
    words = "No majority of them agrees: which are right cannot be known from these results.";
  } else {
    std::vector<std::string> names;
    for (const std::size_t i : found.outliers)
      names.push_back(fmt::format("{} ({})", i + 1, printable_line(comparison.results[i].file)));
    words = fmt::format("{}: {}. Without {} the other {} agree: {}. Means and E_n are those of the {}.",
                        names.size() == 1 ? "Outlier" : "Outliers", fmt::join(names, ", "),
                        names.size() == 1 ? "it" : "them", comparison.results.size() - names.size(),
                        test_words(found.subset), comparison.results.size() - names.size());
    if (found.alternatives > 0)
      words += fmt::format(
          " {} other choice{} of as many would agree too, with a larger chi2: more results are needed to be "
          "sure.",
          found.alternatives, found.alternatives == 1 ? "" : "s");
  }
  return wrapped(words, "  ", "  ", kTerminalColumns);
}

void verdicts(const ResultsComparison& comparison, std::FILE* stream, std::string& text) {
  if (comparison.consistency) {
    text += verdict_lines(fmt::format("{} results", comparison.results.size()), comparison.agree(),
                          fmt::format("{}; required: at least {}", test_words(comparison.consistency->all),
                                      kAgreementLevel),
                          stream) +
            outlier_lines(comparison);
  }
  for (const PairComparison& pair : comparison.pairs) {
    // With several results the pairs give no verdict, except on handedness, which no test of numbers shows.
    if (comparison.consistency && (!pair.rotation || pair.rotation->same_handedness)) continue;
    text += verdict_lines(fmt::format("{} and {}", pair.first + 1, pair.second + 1), pair.agrees(), pair.why,
                          stream);
  }
}

void pair_table(const ResultsComparison& comparison, const PairComparison& pair, std::string& text) {
  const ComparedResult& first = comparison.results[pair.first];
  const ComparedResult& second = comparison.results[pair.second];
  text += fmt::format("  {:<7} {:>26} {:>26} {:>26} {:>7} {:>7}  {}\n", "", std::to_string(pair.first + 1),
                      std::to_string(pair.second + 1), "difference", "zeta", "E_n", "unit");
  for (std::size_t i = 0; i < 9; ++i) {
    const PropertyDifference& p = pair.intrinsic.properties[i];
    text += fmt::format("  {:<7} {:>26} {:>26}", kIntrinsicSymbols[i], property_of(first, i),
                        property_of(second, i));
    if (std::isfinite(p.e_n)) {
      text += fmt::format(" {:>26} {:>+7.2f} {:>+7.2f}  {}\n", with_u(p.difference, p.standard_uncertainty),
                          p.zeta, p.e_n, comparison.units[i]);
    } else {
      text += fmt::format(" {:>26}\n", "not compared");
    }
  }
  text += "  +- is one standard uncertainty; E_n uses expanded uncertainties (k = 2)\n";
  if (pair.intrinsic.chi2) {
    text += fmt::format("  all {} together: chi2 = {:.2f}, P = {:.3g} that chance gives as much or more\n",
                        pair.intrinsic.degrees_of_freedom, *pair.intrinsic.chi2,
                        *pair.intrinsic.chi2_probability);
  }
}

void mounting(const ResultsComparison& comparison, const PairComparison& pair, std::string& text) {
  if (!pair.rotation || !pair.rotation->same_handedness) return;
  const RotationBetween& rotation = *pair.rotation;
  text += fmt::format("  from {} to {} the accelerometer was turned by {} degree", pair.first + 1,
                      pair.second + 1, with_u(rotation.angle_deg, rotation.angle_standard_uncertainty_deg));
  if (rotation.axis) {
    text += fmt::format(" about ({:+.4f}, {:+.4f}, {:+.4f}), a direction known to {:.2g} degree\n",
                        rotation.axis->x(), rotation.axis->y(), rotation.axis->z(),
                        rotation.axis_standard_uncertainty_deg);
  } else {
    text += "; within its uncertainty, so that no axis is known\n";
  }
  text += fmt::format("  difference of the matrices after turning {} back ({})\n", pair.second + 1,
                      comparison.units.front());
  for (int j = 0; j < 3; ++j) {
    text += fmt::format("    {} ", kOutputNames[j]);
    for (int k = 0; k < 3; ++k) {
      text += fmt::format(" {:>26}",
                          with_u(rotation.residual(j, k), rotation.residual_standard_uncertainty(j, k)));
    }
    text += "\n";
  }
}

std::string digits(double value) {
  return fmt::format("{:.3g}", value);
}

void spread_table(const ResultsComparison& comparison, std::FILE* stream, std::string& text) {
  text += heading(stream, fmt::format("{} results of one item", comparison.results.size()));
  text += fmt::format("  {:<7} {:>28} {:>11} {:>11} {:>11} {:>9}  {}\n", "", "mean", "std. dev.", "type A",
                      "between", "P(chi2)", "unit");
  for (std::size_t i = 0; i < 9; ++i) {
    const PropertySeries& series = (*comparison.series)[i];
    if (!series.individuals) {
      text += fmt::format("  {:<7} {:>28}\n", kIntrinsicSymbols[i], "not given by all");
    } else if (const auto& s = series.spread) {
      text += fmt::format("  {:<7} {:>28} {:>11} {:>11} {:>11} {:>9.2g}  {}\n", kIntrinsicSymbols[i],
                          with_u(s->mean, s->mean_standard_uncertainty), digits(s->standard_deviation),
                          digits(s->within), digits(s->between), s->chi2_probability, comparison.units[i]);
    } else {
      text += fmt::format("  {:<7} {:>28.9g} {:>11} {:>11} {:>11} {:>9}  {}\n", kIntrinsicSymbols[i],
                          series.individuals->centre, digits(series.individuals->standard_deviation), "-",
                          "-", "-", comparison.units[i]);
    }
  }
  text +=
      "  between: what the scatter of the readings (type A) does not explain of the scatter of the results\n";
}

void random_effects_table(const ResultsComparison& comparison, std::FILE* stream, std::string& text) {
  text += heading(stream, "Mean with type B (random effects)");
  text +=
      fmt::format("  {:<7} {:>28} {:>11}  {:<10} {}\n", "", "mean", "between", "unit", "E_n of each result");
  for (std::size_t i = 0; i < 9; ++i) {
    const auto& r = (*comparison.series)[i].random_effects;
    if (!r) continue;
    std::string errors;
    for (std::size_t k = 0; k < r->normalised_error.size(); ++k)
      errors +=
          fmt::format("{}{}: {:+.2f}", k == 0 ? "" : ", ", comparison.order[k] + 1, r->normalised_error[k]);
    text += fmt::format("  {:<7} {:>28} {:>11}  {:<10} {}\n", kIntrinsicSymbols[i],
                        with_u(r->mean, r->standard_uncertainty), digits(r->between), comparison.units[i],
                        errors);
  }
  text +=
      "  between: what the stated uncertainties do not explain; what one stage does to all is not averaged "
      "down\n";
  if (comparison.consistency && !comparison.consistency->outliers.empty())
    text += "  the outliers are no part of the mean; their E_n is against it\n";
}

void anova_table(const ResultsComparison& comparison, std::FILE* stream, std::string& text) {
  if (comparison.groups.empty()) return;
  text += heading(stream, fmt::format("{} groups", comparison.groups.size()));
  for (std::size_t g = 0; g < comparison.groups.size(); ++g) {
    text += fmt::format("  {}:", comparison.group_names[g]);
    for (const std::size_t i : comparison.groups[g]) text += fmt::format(" {}", i + 1);
    text += "\n";
  }
  text += fmt::format("  {:<7} {:>28} {:>13} {:>13} {:>15} {:>9} {:>9}  {}\n", "", "mean", "repeatability",
                      "between", "reproducibility", "F", "P(F)", "unit");
  for (std::size_t i = 0; i < 9; ++i) {
    const auto& a = (*comparison.series)[i].anova;
    if (!a) continue;
    text += fmt::format("  {:<7} {:>28} {:>13} {:>13} {:>15} {:>9.3g} {:>9.2g}  {}\n", kIntrinsicSymbols[i],
                        with_u(a->mean, a->mean_standard_uncertainty), digits(a->repeatability),
                        digits(a->between), digits(a->reproducibility), a->f, a->f_probability,
                        comparison.units[i]);
  }
}

std::string points_outside(const ControlChart& chart, const std::vector<std::string>& names) {
  if (!chart.has_spread()) return "no spread: the limits have no width";
  std::string outside;
  for (std::size_t k = 0; k < chart.points.size(); ++k) {
    if (!chart.inside(k)) outside += (outside.empty() ? "" : ", ") + names[k];
  }
  return outside.empty() ? "in control" : "OUTSIDE: " + outside;
}

void chart_table(const ResultsComparison& comparison, std::FILE* stream, std::string& text) {
  text += heading(stream, "Control charts (limits: three standard deviations)");
  std::vector<std::string> numbers;
  for (const std::size_t i : comparison.order) numbers.push_back(std::to_string(i + 1));
  const auto line = [&](std::string_view name, const char* kind, const ControlChart& chart,
                        const std::vector<std::string>& names, const std::string& unit) {
    const ChartPoint& last = chart.points.back();
    const int decimals = std::max(0, decimals_for(chart.standard_deviation));
    text += fmt::format("  {:<7} {:<7} {:>15.{}f} .. {:>15.{}f}  {:<10} {}\n", name, kind, last.lower,
                        decimals, last.upper, decimals, unit, points_outside(chart, names));
  };
  for (std::size_t i = 0; i < 9; ++i) {
    const PropertySeries& series = (*comparison.series)[i];
    if (series.individuals)
      line(kIntrinsicSymbols[i], "single", *series.individuals, numbers, comparison.units[i]);
    if (series.means) line("", "x-bar", *series.means, comparison.group_names, comparison.units[i]);
    if (series.ewma) line("", "EWMA", *series.ewma, numbers, comparison.units[i]);
  }
  text += "  limits are those of the last point\n";
}

}  // namespace

std::string compare_text(const ResultsComparison& comparison, std::FILE* stream) {
  std::string text;
  verdicts(comparison, stream, text);
  text += "\n";
  list_results(comparison, text);
  for (const PairComparison& pair : comparison.pairs) {
    text += heading(stream, fmt::format("{} and {}", pair.first + 1, pair.second + 1));
    pair_table(comparison, pair, text);
    mounting(comparison, pair, text);
  }
  if (comparison.series) {
    spread_table(comparison, stream, text);
    random_effects_table(comparison, stream, text);
    anova_table(comparison, stream, text);
    chart_table(comparison, stream, text);
  }
  if (!comparison.notes.empty()) text += "\n";
  for (const std::string& note : comparison.notes) text += "note: " + note + "\n";
  return text;
}

}  // namespace abcal
