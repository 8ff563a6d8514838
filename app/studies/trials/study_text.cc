#include "app/studies/trials/study_text.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "app/results/analysis/budget_words.h"
#include "app/results/analysis/result_text.h"
#include "app/system/text_layout.h"

namespace abcal {
namespace {

constexpr std::size_t kNoteWidth = 79;

std::string study_number(double value) {
  return std::isfinite(value) ? fmt::format("{:+.3e}", value) : "";
}

// Long sentences on lines of their own.
std::string note_lines(const std::string& text, const std::string& indent) {
  return text.empty() ? "" : wrapped(text, indent, indent, kNoteWidth);
}

std::string row(const char* matrix, std::string_view vector, const Eigen::Vector3d& ours,
                const std::optional<Eigen::Vector3d>& printed, const char* unit) {
  std::string text = fmt::format("  {:<7}{:<7}{:>11} {:>11} {:>11}", matrix, vector, study_number(ours(0)),
                                 study_number(ours(1)), study_number(ours(2)));
  if (printed) {
    text += fmt::format("  | {:>10} {:>10} {:>10}", study_number((*printed)(0)), study_number((*printed)(1)),
                        study_number((*printed)(2)));
  }
  return text + fmt::format("  {}\n", unit);
}

std::optional<Eigen::Vector3d> part(const std::optional<OutputVector>& vector, int first) {
  if (!vector) return std::nullopt;
  return Eigen::Vector3d(vector->segment<3>(first));
}

std::string heading(const char* first, const std::array<const char*, 3>& columns, bool printed,
                    const std::string& table) {
  std::string text = fmt::format("  {:<14}{:>11} {:>11} {:>11}", first, columns[0], columns[1], columns[2]);
  if (printed) text += fmt::format("  | {:<32}", table.empty() ? "" : "printed, " + table);
  return text + "  Unit\n";
}

constexpr const char* kResponseUnit = "R";
constexpr const char* kSensitivityUnit = "R/g_loc";

// The sensitivity matrix, as Tables 2 and 5 to 8 begin.
std::string matrix_rows(const StudyOutput& ours, const std::optional<StudyOutput>& printed,
                        const std::string& table) {
  const OutputVector v = to_vector(ours);
  std::optional<OutputVector> p;
  if (printed) p = to_vector(*printed);
  return heading("Matrix Vector", {"x component", "y component", "z component"}, printed.has_value(), table) +
         row("s", "s_u", v.segment<3>(0), part(p, 0), kSensitivityUnit) +
         row("", "s_v", v.segment<3>(3), part(p, 3), kSensitivityUnit) +
         row("", "s_w", v.segment<3>(6), part(p, 6), kSensitivityUnit);
}

// Layout of Tables 2 and 5 to 8.
std::string matrix_and_triples(const StudyOutput& ours, const std::optional<StudyOutput>& printed,
                               const std::string& table) {
  const OutputVector v = to_vector(ours);
  std::optional<OutputVector> p;
  if (printed) p = to_vector(*printed);
  std::string text = matrix_rows(ours, printed, table);
  text += heading("       Triple", {"u component", "v component", "w component"}, printed.has_value(), "");
  text += row("", "s", v.segment<3>(kFirstIntrinsicSensitivity), part(p, kFirstIntrinsicSensitivity),
              kSensitivityUnit);
  text += row("", "O", v.segment<3>(kFirstOffset), part(p, kFirstOffset), kResponseUnit);
  text += row("", "phi", v.segment<3>(kFirstIntrinsicAngle), part(p, kFirstIntrinsicAngle), "degree");
  return text;
}

// Layout of Table 2, which prints 15 decimals: ours above, the printed number below.
std::string all_digits(const StudyOutput& ours, const StudyOutput& printed, const std::string& table) {
  const OutputVector v = to_vector(ours), p = to_vector(printed);
  std::string text = fmt::format("  {:<22}{:>21} {:>21} {:>21}  Unit\n", "Matrix Vector", "x component",
                                 "y component", "z component");
  const auto add = [&](const char* name, int first, const char* unit) {
    text += fmt::format("         {:<15}{:>+21.15f} {:>+21.15f} {:>+21.15f}  {}\n", name, v(first),
                        v(first + 1), v(first + 2), unit);
    text += fmt::format("         {:<15}{:>+21.15f} {:>+21.15f} {:>+21.15f}\n", "  " + table, p(first),
                        p(first + 1), p(first + 2));
  };
  add("s_u", 0, "R/g_loc");
  add("s_v", 3, "R/g_loc");
  add("s_w", 6, "R/g_loc");
  text += fmt::format("  {:<22}{:>21} {:>21} {:>21}  Unit\n", "       Triple", "u component", "v component",
                      "w component");
  add("s", kFirstIntrinsicSensitivity, "R/g_loc");
  add("O", kFirstOffset, "R");
  add("phi", kFirstIntrinsicAngle, "degree");
  return text;
}

// Layout of Tables 3 and 4.
std::string means_and_deviations(const StudyCase& one) {
  const MonteCarloResult& result = *one.monte_carlo;
  const StudyOutput mean = to_output(OutputVector(result.mean));
  const StudyOutput deviation = to_output(OutputVector(result.standard_deviation));
  std::string text = "  Means of errors in the sensitivity matrix\n";
  text += matrix_rows(mean, one.published, one.table);
  text += "  Standard deviations of errors in the sensitivity matrix\n";
  text += matrix_rows(deviation, one.published_standard_deviation, one.table);
  text += fmt::format("  {:<14}{:>11} {:>11}", "Intrinsic", "Mean error", "Std. dev.");
  if (one.published) text += fmt::format("  | {:<21}", "printed");
  text += fmt::format("  {:<9}{}\n", "Unit", result.coverage.empty() ? "" : "95.45 % interval");
  // The paper's order: s, O, phi.
  for (const int first : {kFirstIntrinsicSensitivity, kFirstOffset, kFirstIntrinsicAngle}) {
    for (int k = first; k < first + 3; ++k) {
      text += fmt::format("  {:<14}{:>11} {:>11}", output_symbol(k), study_number(result.mean(k)),
                          study_number(result.standard_deviation(k)));
      if (one.published) {
        text += fmt::format("  | {:>10} {:>10}", study_number(to_vector(*one.published)(k)),
                            study_number(to_vector(*one.published_standard_deviation)(k)));
      }
      text += fmt::format("  {:<9}", output_unit(k, "R"));
      if (!result.coverage.empty()) {
        const CoverageInterval& interval = result.coverage[static_cast<std::size_t>(k)].symmetric;
        text += fmt::format("{} {}", study_number(interval.low), study_number(interval.high));
      }
      text += "\n";
    }
  }
  if (one.means_not_zero) {
    text += fmt::format(
        "  Means that differ from zero at 95 %: {} of 9 elements of s, {} of 9 intrinsic properties.\n",
        (*one.means_not_zero)[0], (*one.means_not_zero)[1]);
  }
  return text;
}

std::string csv_field(const std::string& text) {
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string csv_number(double value) {
  return std::isfinite(value) ? fmt::format("{:.17g}", value) : "";
}

constexpr double kLeastShown = 0.001;  // Share of the variance: 0.1 %.

/// An input without the number of its unknowns and without the text in parentheses.
std::string name_alone(const std::string& input) {
  return input.substr(0, std::min(input.find(" ("), input.find(", ")));
}

/// The budget of one output. Rows below 0.1 % of its variance are counted.
std::string budget_table(const RunUncertainty& study, int k) {
  const Budget& budget = study.budget;
  std::string text = fmt::format("\nBudget of {} ({}), the largest of its kind\n", output_symbol(k),
                                 output_unit(k, study.response_unit));
  text += fmt::format("  {:<31}{:>8} {:<7}{:<13}{:>9} {:>6}\n", "input", "u", "unit", "distribution",
                      "contrib.", "share");
  int left_out = 0;
  for (const BudgetLine& line : budget.lines) {
    if (budget.share(line, k) < kLeastShown) {
      ++left_out;
      continue;
    }
    text += fmt::format(
        "  {:<31}{:>8} {:<7}{:<13}{:>9.1e} {:>5.1f}%\n", name_alone(line.input),
        std::isfinite(line.standard_uncertainty) ? fmt::format("{:.1e}", line.standard_uncertainty) : "",
        line.unit, line.distribution, line.contribution(k), 100.0 * budget.share(line, k));
  }
  text += fmt::format("  {:<59}{:>9.1e}\n", "combined, to first order", budget.combined(k));
  if (left_out > 0) text += fmt::format("  {} further inputs have less than 0.1 % each.\n", left_out);
  for (const BudgetLine& line : budget.lines) {
    if (const std::string degrees = degrees_words(line, {k}); !degrees.empty())
      text += note_lines(fmt::format("Degrees of freedom: {} of {}.", degrees, name_alone(line.input)), "  ");
  }
  return text + note_lines(gravity_words(budget, k, study.response_unit), "  ");
}

/// Sources of the inputs of the budget.
std::string sources_text(const Budget& budget) {
  std::string text = "\nSources of the uncertainties:\n";
  for (const auto& [source, inputs] : budget_sources(budget))
    text += note_lines(fmt::format("{}: {}", source, inputs), "  ");
  return text;
}

std::string budget_text(const RunUncertainty& study) {
  std::string text;
  for (const int k : worst_of_each_kind(study.budget.combined)) text += budget_table(study, k);
  text += sources_text(study.budget);
  text += "\nNot covered by this budget:\n";
  for (const Message& item : study.budget.not_covered) text += note_lines("- " + item, "  ");
  for (const std::string& note : study.budget.notes) text += note_lines(note, "  ");
  return text;
}

std::string validation_text(const RunUncertainty& study) {
  if (study.validation.empty()) return {};
  std::string text = "\nValidation of the GUM framework against Monte Carlo (JCGM 101, section 8)\n";
  text += fmt::format("  {:<8}{:>10} {:>10} {:>10} {:>10}  {}\n", "", "U", "d_low", "d_high", "delta", "");
  for (int k = 0; k < kStudyOutputs; ++k) {
    const GumValidation& v = study.validation[static_cast<std::size_t>(k)];
    text += fmt::format("  {:<8}{:>10.2e} {:>10.2e} {:>10.2e} {:>10.2e}  {}{}\n", output_symbol(k),
                        v.expanded_uncertainty, v.d_low, v.d_high, v.tolerance,
                        v.validated ? "validated" : "not validated: use the Monte Carlo interval",
                        v.decided ? "" : " (too few trials to be sure)");
  }
  return text;
}

/// A joint or norm result: its statements, and Monte Carlo next to them.
std::string joint_text(const RunUncertainty& study) {
  const JointComparison& joint = *study.joint;
  const MonteCarloResult& made = study.combined;
  std::string text = fmt::format("Uncertainty of the {} result of {}\n", study.estimator, study.source);
  if (study.no_trials.empty()) {
    text += fmt::format("{} trials, seed {} (Philox4x32-10)\n", made.trials, study.seed);
    text += note_lines(kWhatIsChecked, "");
  } else {
    text += note_lines(study.no_trials, "");
  }
  const bool intervals = !made.coverage.empty();
  text += fmt::format("\n  {:<8}{:>13} {:>8} {:>8} {:>8} {:>10} {:>9}  {}\n", "", "", "stated", "stated",
                      made.trials >= 2 ? "trials" : "", intervals ? "95.45 %" : "", "", "");
  text += fmt::format("  {:<8}{:>13} {:>8} {:>8} {:>8} {:>10} {:>9}  {}\n", "", "value", "u", "U",
                      made.trials >= 2 ? "u" : "", intervals ? "from" : "", intervals ? "to" : "", "unit");
  for (int k = 0; k < kStudyOutputs; ++k) {
    if (std::isnan(to_vector(study.value)(k))) continue;
    std::string from, to;
    if (intervals) {
      const CoverageInterval& error = made.coverage[static_cast<std::size_t>(k)].symmetric;
      from = fmt::format("{:+.2e}", -error.high);
      to = fmt::format("{:+.2e}", -error.low);
    }
    const double u = joint.standard_uncertainty(k);
    text += fmt::format("  {:<8}{:>13} {:>8.1e} {:>8.1e} {:>8} {:>10} {:>9}  {}\n", output_symbol(k),
                        with_decimals(to_vector(study.value)(k), decimals_for(u), true), u, joint.expanded(k),
                        made.trials >= 2 ? fmt::format("{:.1e}", made.standard_deviation(k)) : "", from, to,
                        output_unit(k, study.response_unit));
  }
  if (intervals)
    text += note_lines(
        "From and to: the 95.45 % interval by Monte Carlo less the value, as value minus error gives it. U "
        "is "
        "stated: u times k for 95.45 % and the result's degrees of freedom.",
        "  ");
  text += note_lines(made.note, "  ");
  if (joint.solved_in_full > 0)
    text += note_lines(fmt::format("The trials are solved by the derivatives at the run's solution. {} were "
                                   "solved in full too: they differ by {:.1g} u (rms, the worst output).",
                                   joint.solved_in_full, joint.largest_deviation),
                       "  ");
  if (study.no_trials.empty() && study.warnings.empty())
    text += fmt::format("  No uncertainty differs by more than {:.0f} %.\n", 100.0 * kNamedDifference);
  for (const std::string& warning : study.warnings) text += note_lines("WARNING: " + warning, "  ");
  if (!study.validation.empty()) {
    const auto good = std::count_if(study.validation.begin(), study.validation.end(),
                                    [](const GumValidation& one) { return one.validated; });
    text += fmt::format("  JCGM 101, section 8: first order and normal are validated for {} of {} outputs.\n",
                        good, kStudyOutputs);
  }
  text += budget_text(study);
  if (study.interrupted) text += "\nInterrupted: the results up to then.\n";
  return text;
}

}  // namespace

std::string study_text(const StudyResult& study) {
  std::string text = fmt::format("{}\n", study.title);
  if (study.trials > 1) text += fmt::format("{} trials, seed {} (Philox4x32-10)\n", study.trials, study.seed);
  for (const StudyCase& one : study.cases) {
    if (one.one_of_many) continue;
    text += fmt::format("\n{}\n", one.name);
    if (one.published_truth && one.truth) {
      text += "  Values\n" + all_digits(*one.truth, *one.published_truth, one.table) + "  Errors\n";
    }
    if (one.error) text += matrix_and_triples(*one.error, one.published, one.table);
    if (one.monte_carlo) {
      if (one.monte_carlo->trials != study.trials) {
        text += fmt::format("  {} trials made.\n", one.monte_carlo->trials);
      }
      if (one.monte_carlo->trials >= 2) text += means_and_deviations(one);
      text += note_lines(one.monte_carlo->note, "  ");
    }
    if (one.largest_higher_harmonic) {
      text +=
          fmt::format("  Largest coefficient of harmonics 2 to 5: {:.1e} R\n", *one.largest_higher_harmonic);
    }
    text += note_lines(one.note, "  ");
  }
  for (const std::string& note : study.notes) text += note_lines(note, "");
  if (study.interrupted) text += "\nInterrupted: the results up to then.\n";
  return text;
}

std::string study_text(const RunUncertainty& study) {
  if (study.joint) return joint_text(study);
  const MonteCarloResult& b = study.type_b;
  std::string text = fmt::format("Uncertainty of the ABC result of {}\n", study.source);
  text += fmt::format(
      "Tolerances (degree): alignment {:g}, step {:g}, initial turn {:g}, zero {:g}; drift {:g} of the "
      "sensitivity\n",
      study.tolerances.alignment.deg(), study.tolerances.step.deg(), study.tolerances.initial_turn.deg(),
      study.tolerances.zero.deg(), study.tolerances.drift);
  text += fmt::format("{} trials, seed {} (Philox4x32-10)\n\n", b.trials, study.seed);
  const Eigen::VectorXd readings =
      (study.budget.covariance - study.budget.type_b_covariance).diagonal().cwiseMax(0.0);
  text +=
      fmt::format("  {:<8}{:>16} {:>10} {:>10} {:>10}  {:<24}{}\n", "", "value", "u type B", "u others",
                  "u combined", study.combined.coverage.empty() ? "" : "95.45 % interval (error)", "unit");
  for (int k = 0; k < kStudyOutputs; ++k) {
    std::string interval;
    if (!study.combined.coverage.empty()) {
      const CoverageInterval& symmetric = study.combined.coverage[static_cast<std::size_t>(k)].symmetric;
      interval = fmt::format("{} {}", study_number(symmetric.low), study_number(symmetric.high));
    }
    const int decimals = decimals_for(study.standard_uncertainty(k));
    text += fmt::format("  {:<8}{:>16} {:>10.2e} {:>10.2e} {:>10.2e}  {:<24}{}\n", output_symbol(k),
                        with_decimals(to_vector(study.value)(k), decimals, true), b.standard_deviation(k),
                        std::sqrt(readings(k)), study.standard_uncertainty(k), interval,
                        output_unit(k, study.response_unit));
  }
  text +=
      "  u type B: alignment, turns, zeros and steps, by the published equations; u others: readings and all "
      "other effects, to first order; combined: Monte Carlo";
  text += study.paper_preset ? " for the interval, the paper's bounds for u.\n" : " of the whole budget.\n";
  text += note_lines(study.combined.note, "  ");

  text += "\nType A evaluation (paper, section 6): s and O fitted with the system's errors drawn around ";
  text += study.acs_measured.empty() ? "zero (nothing measured), by their stated sizes\n"
                                     : fmt::format("those in the record of the stage (SHA-256 {})\n",
                                                   study.acs_measured.substr(0, 12));
  if (study.type_a.trials >= 2) {
    for (const int first : {0, 3, 6, 9, 12, 15}) {
      text += " ";
      for (int k = first; k < first + 3; ++k) {
        const double u = study.type_a.standard_deviation(k);
        text += fmt::format(" {:<7}{:>14} u {:.1e} ", output_symbol(k),
                            with_decimals(study.type_a.mean(k), decimals_for(u), true), u);
      }
      text += "\n";
    }
  }
  text += note_lines(study.type_a.note, "  ");

  text += budget_text(study);
  text += validation_text(study);
  if (study.paper_preset) {
    text += "\nPreset \"paper\": bounds of Geist & Gaitan 2021, section 5, scaled by the norm of the row\n";
    for (const std::string& warning : study.warnings) text += fmt::format("  warning: {}\n", warning);
    if (study.warnings.empty()) text += "  This bench stays within every bound.\n";
  }
  if (study.interrupted) text += "\nInterrupted: the results up to then.\n";
  return text;
}

std::string study_csv(const StudyResult& study) {
  std::string csv =
      "case,output,unit,error,mean,standard_deviation,symmetric_low,symmetric_high,shortest_low,shortest_"
      "high,paper,paper_standard_deviation\n";
  for (const StudyCase& one : study.cases) {
    for (int k = 0; k < kStudyOutputs; ++k) {
      csv += fmt::format("{},{},{},", csv_field(one.name), output_symbol(k), output_unit(k, "R"));
      csv += (one.error ? csv_number(to_vector(*one.error)(k)) : "") + ",";
      if (one.monte_carlo) {
        csv += csv_number(one.monte_carlo->mean(k)) + "," +
               csv_number(one.monte_carlo->standard_deviation(k)) + ",";
      } else {
        csv += ",,";
      }
      if (one.monte_carlo && !one.monte_carlo->coverage.empty()) {
        const Coverage& coverage = one.monte_carlo->coverage[static_cast<std::size_t>(k)];
        csv += csv_number(coverage.symmetric.low) + "," + csv_number(coverage.symmetric.high) + "," +
               csv_number(coverage.shortest.low) + "," + csv_number(coverage.shortest.high) + ",";
      } else {
        csv += ",,,,";
      }
      csv += (one.published ? csv_number(to_vector(*one.published)(k)) : "") + ",";
      csv += (one.published_standard_deviation ? csv_number(to_vector(*one.published_standard_deviation)(k))
                                               : "") +
             "\n";
    }
  }
  return csv;
}

}  // namespace abcal
