#include "app/laboratory/compare/compare_results.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <numeric>

#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/run_config.h"

namespace abcal {
namespace {

void require_one_item(const std::vector<ComparedResult>& results, std::vector<std::string>& notes) {
  const ComparedResult* known = nullptr;
  std::vector<std::string> unknown;
  for (const ComparedResult& result : results) {
    if (result.item_serial_number.empty()) {
      unknown.push_back(result.file);
    } else if (!known) {
      known = &result;
    } else if (known->item_serial_number != result.item_serial_number) {
      throw CompareError(
          fmt::format("{} is of {} and {} of {}: different items; required: results of one item (--any-item "
                      "compares all the same)",
                      known->file, known->item, result.file, result.item));
    }
  }
  if (!unknown.empty()) {
    notes.push_back(fmt::format("{}: no serial number; that the item is the same is taken for granted",
                                fmt::join(unknown, ", ")));
  }
}

/// Factors from the units of a record to those that it is compared in: sensitivities, then offsets.
Eigen::Matrix<double, 12, 1> factors_of(const ComparedResult& result) {
  const double response = meaning_of_response_unit(result.record->response_unit).factor / result.unit.factor;
  Eigen::Matrix<double, 12, 1> factors = Eigen::Matrix<double, 12, 1>::Constant(response);
  if (!result.per_g_loc) factors.head<9>() /= result.g_loc->value;
  return factors;
}

/// Whether two results are items of one run whose numbers are those of its common fit.
bool in_one_common_fit(const ComparedResult& first, const ComparedResult& second) {
  return first.run && first.run == second.run && first.item_of_run != second.item_of_run &&
         first.of_common_fit() && second.of_common_fit();
}

Covariance12 shared_covariance(const ComparedResult& first, const ComparedResult& second) {
  if (in_one_common_fit(first, second))
    return factors_of(first).asDiagonal() *
           first.run->joint.covariance(static_cast<std::size_t>(first.item_of_run) - 1,
                                       static_cast<std::size_t>(second.item_of_run) - 1) *
           factors_of(second).asDiagonal();
  for (const ComparedResult* result : {&first, &second}) {
    if (!result->record || result->estimator != kPublishedEstimator || !result->matrix) {
      throw CompareError(
          fmt::format("--shared: {} ({}) does not state which part of its uncertainty comes from the stage; "
                      "required: runs or CSV records, and the abc estimator",
                      result->file, result->what));
    }
  }
  if (on_same_stage(first, second) == SameStage::kNo) {
    throw CompareError(fmt::format("--shared: {} was measured on {}, {} on {}; required: one stage",
                                   first.file, first.stage, second.file, second.stage));
  }
  const AbcFormula formula = first.published ? AbcFormula::kPublished : AbcFormula::kLineResponse;
  return factors_of(first).asDiagonal() * shared_type_b(*first.record, *second.record, formula) *
         factors_of(second).asDiagonal();
}

std::string files_of(const std::vector<const ComparedResult*>& results) {
  std::string text;
  for (const ComparedResult* result : results) text += (text.empty() ? "" : ", ") + result->file;
  return text;
}

/// "a.csv does not name", of those results that leave the serial number of their stage open.
std::string without_stage(const std::vector<const ComparedResult*>& results) {
  std::vector<const ComparedResult*> silent;
  std::ranges::copy_if(results, std::back_inserter(silent),
                       [](const ComparedResult* result) { return result->stage_serial_number.empty(); });
  return files_of(silent) + (silent.size() == 1 ? " does not name" : " do not name");
}

/// For two results: what both took from one stage, and what was done about it.
void note_common_stage(const ComparedResult& first, const ComparedResult& second, bool subtracted,
                       std::vector<std::string>& notes) {
  if (in_one_common_fit(first, second)) {
    notes.push_back(
        fmt::format("{} and {} were measured together: what the stage did to both is known by their common "
                    "fit, and was subtracted from the uncertainty of the differences",
                    first.file, second.file));
  } else if (subtracted) {
    notes.push_back(
        fmt::format("{} and {}: what the same stage does to both (type B at equal angles; drift is each "
                    "run's own) was subtracted from the uncertainty of the differences{}. What the stage did "
                    "not do the same way twice (homing, temperature) is then a difference too",
                    first.file, second.file,
                    on_same_stage(first, second) == SameStage::kUnknown
                        ? "; that the stage is the same was taken from --shared"
                        : ", stage " + first.stage));
  } else if (on_same_stage(first, second) == SameStage::kYes) {
    notes.push_back(
        fmt::format("{} and {} were measured on the same stage ({}): its type B is common to both and was "
                    "NOT subtracted, so that E_n is too small{}",
                    first.file, second.file, first.stage,
                    first.record && second.record ? " (--shared subtracts it)" : ""));
  } else if (on_same_stage(first, second) == SameStage::kUnknown) {
    notes.push_back(
        fmt::format("whether {} and {} were measured on one stage cannot be known: {} its serial number; if "
                    "they were, its type B is common to both and E_n is too small",
                    first.file, second.file, without_stage({&first, &second})));
  }
}

/// For several results: which of them share a stage, and what this means for E_n and for the mean.
void note_common_stages(const std::vector<ComparedResult>& results, bool subtracted,
                        std::vector<std::string>& notes) {
  std::map<std::string, std::vector<const ComparedResult*>> of_stage;
  std::vector<const ComparedResult*> unknown;
  for (const ComparedResult& result : results) {
    if (result.stage_serial_number.empty()) {
      unknown.push_back(&result);
    } else {
      of_stage[result.stage].push_back(&result);
    }
  }
  for (const auto& [stage, on_it] : of_stage) {
    if (on_it.size() < 2) continue;
    const bool certified = std::ranges::any_of(on_it, [](const ComparedResult* r) { return !r->record; });
    notes.push_back(fmt::format(
        "{} were measured on the same stage ({}): its type B is common to them. It is not averaged down in "
        "the uncertainty of the mean{}. It was {} from the uncertainty of the differences{}",
        files_of(on_it), stage,
        certified ? "; certificates do not say which part is type B of the stage, so that the smaller "
                    "uncertainty of two is taken as common to both"
                  : "",
        subtracted ? "subtracted" : "NOT subtracted",
        subtracted ? "" : ", so that E_n and chi2 are too small"));
  }
  if (!unknown.empty() && !subtracted)
    notes.push_back(fmt::format(
        "whether {} {} measured on one stage with {} cannot be known: {} its serial number. The mean takes "
        "all as independent; if they share a stage, its uncertainty is too small, and so is E_n",
        files_of(unknown), unknown.size() == 1 ? "was" : "were",
        unknown.size() == results.size() ? "one another" : "the others", without_stage(unknown)));
}

std::string reason(const PairComparison& pair, const std::string& first, const std::string& second) {
  if (pair.intrinsic.degrees_of_freedom == 0)
    return fmt::format("{} and {} have no property in common", first, second);
  if (pair.rotation && !pair.rotation->same_handedness) {
    return fmt::format(
        "the axes u, v, w of {} and {} are of different handedness: one is reversed, or two are swapped",
        first, second);
  }
  const IntrinsicComparison& found = pair.intrinsic;
  std::vector<std::string> beyond;
  for (std::size_t i = 0; i < 9; ++i) {
    const double e_n = found.properties[i].e_n;
    if (std::abs(e_n) > 1.0) beyond.push_back(fmt::format("{} (E_n {:+.2f})", kIntrinsicSymbols[i], e_n));
  }
  std::string words = fmt::format(
      "P = {:.2g} that chance gives differences as large in {} properties together; required: at least {}",
      found.joint_probability, found.degrees_of_freedom, kAgreementLevel);
  if (beyond.empty()) return words + fmt::format(". The largest |E_n| is {:.2f}", found.largest_e_n);
  return words + fmt::format(". |E_n| above 1: {}; by chance {:.1f} of {} are expected",
                             fmt::join(beyond, ", "), found.expected_beyond(), found.degrees_of_freedom);
}

PairComparison compare_pair(const ComparedResult& first, const ComparedResult& second, bool shared_stage) {
  PairComparison pair;
  pair.common_fit = in_one_common_fit(first, second);
  shared_stage = shared_stage || pair.common_fit;
  const Covariance12 shared =
      shared_stage ? shared_covariance(first, second) : Covariance12(Covariance12::Zero());
  const Covariance9 shared_intrinsic = shared_stage
                                           ? Covariance9(intrinsic_jacobian(*first.matrix) * shared *
                                                         intrinsic_jacobian(*second.matrix).transpose())
                                           : Covariance9(Covariance9::Zero());
  pair.intrinsic =
      compare_intrinsic(first.values, first.covariance, second.values, second.covariance, shared_intrinsic);
  if (first.matrix && second.matrix) {
    pair.rotation =
        rotation_between(*first.matrix, first.output_covariance.topLeftCorner<9, 9>(), *second.matrix,
                         second.output_covariance.topLeftCorner<9, 9>(), shared.topLeftCorner<9, 9>());
  }
  pair.why = reason(pair, first.file, second.file);
  return pair;
}

std::string group_of(const ComparedResult& result, const std::string& group_by) {
  if (group_by == "day") return result.date.substr(0, 10);
  if (group_by == "stage") return result.stage;
  const auto found = result.labels.find(group_by);
  return found == result.labels.end() ? "" : found->second;
}

void find_groups(const std::string& group_by, ResultsComparison& comparison) {
  for (const std::size_t i : comparison.order) {
    const ComparedResult& result = comparison.results[i];
    const std::string name = group_of(result, group_by);
    if (name.empty()) {
      std::vector<std::string> known{"day", "stage"};
      for (const auto& [key, value] : result.labels) known.push_back(key);
      throw CompareError(
          fmt::format("--group-by {}: {} does not say; required: one of {} that every result has", group_by,
                      result.file, fmt::join(known, ", ")));
    }
    const auto place = std::find(comparison.group_names.begin(), comparison.group_names.end(), name);
    if (place == comparison.group_names.end()) {
      comparison.group_names.push_back(name);
      comparison.groups.push_back({i});
    } else {
      comparison.groups[static_cast<std::size_t>(place - comparison.group_names.begin())].push_back(i);
    }
  }
  if (comparison.groups.size() < 2 || comparison.groups.size() == comparison.results.size()) {
    throw CompareError(fmt::format(
        "--group-by {}: {} results make {} group(s); required: two groups, one of them with two results",
        group_by, comparison.results.size(), comparison.groups.size()));
  }
}

/// The known covariance of two results (the first in rows): of one with itself its own; of two,
/// what --shared subtracts.
Covariance9 intrinsic_covariance(const ResultsComparison& comparison, std::size_t i, std::size_t j) {
  const ComparedResult& first = comparison.results[i];
  const ComparedResult& second = comparison.results[j];
  if (i == j) return first.covariance;
  if (!comparison.shared_subtracted) return Covariance9::Zero();
  return intrinsic_jacobian(*first.matrix) * shared_covariance(first, second) *
         intrinsic_jacobian(*second.matrix).transpose();
}

/// Whether all results agree, and if not, the largest part of them that does.
std::optional<ConsistentSubset> consistency_of(ResultsComparison& comparison) {
  const std::size_t n = comparison.results.size();
  if (n > kMostConsistent) {
    comparison.notes.push_back(
        fmt::format("{} results: more than {} are not tested together, only in pairs", n, kMostConsistent));
    return std::nullopt;
  }
  std::vector<Eigen::Index> given;
  for (Eigen::Index p = 0; p < 9; ++p) {
    if (std::ranges::all_of(comparison.results, [&](const ComparedResult& result) {
          return std::isfinite(result.values(p)) && result.covariance(p, p) > 0.0;
        }))
      given.push_back(p);
  }
  if (given.empty()) {
    comparison.notes.emplace_back("no property is given by all results: they are compared in pairs only");
    return std::nullopt;
  }
  const auto size = static_cast<Eigen::Index>(given.size());
  std::vector<Eigen::VectorXd> values;
  Eigen::MatrixXd covariance(static_cast<Eigen::Index>(n) * size, static_cast<Eigen::Index>(n) * size);
  for (std::size_t i = 0; i < n; ++i) {
    values.emplace_back(comparison.results[i].values(given));
    for (std::size_t j = i; j < n; ++j) {
      const Eigen::MatrixXd block = intrinsic_covariance(comparison, i, j)(given, given);
      const auto row = static_cast<Eigen::Index>(i) * size, column = static_cast<Eigen::Index>(j) * size;
      covariance.block(row, column, size, size) = block;
      covariance.block(column, row, size, size) = block.transpose();
    }
  }
  ConsistentSubset found = largest_consistent_subset(values, covariance, kAgreementLevel);
  if (!found.covariances_used)
    comparison.notes.emplace_back(
        "the covariances given contradict one another (they are not positive definite): all results together "
        "are tested by their uncertainties alone");
  if (!found.exhaustive)
    comparison.notes.emplace_back(
        "there are too many subsets to try all: results that do not agree were taken out one by one");
  return found;
}

/// Covariances of each property between the results, in the order of the charts: what is known to be common,
/// and the largest part that may be.
struct PropertyCovariances {
  std::array<Eigen::MatrixXd, 9> known, largest;
};

/// The largest variances that two results may have in common. On one stage it is the type B part: as --shared
/// computes it if both are records of the published protocol, else all of the smaller one (of a certificate,
/// which does not state its type A part, all of its uncertainty). Otherwise what is known.
IntrinsicValues largest_common(const ComparedResult& first, const ComparedResult& second,
                               const IntrinsicValues& known) {
  if (on_same_stage(first, second) != SameStage::kYes || !known.isZero(0.0)) return known;
  if (first.record && second.record && first.estimator == kPublishedEstimator &&
      second.estimator == kPublishedEstimator && first.matrix && second.matrix) {
    return (intrinsic_jacobian(*first.matrix) * shared_covariance(first, second) *
            intrinsic_jacobian(*second.matrix).transpose())
        .diagonal();
  }
  const auto type_b_variances = [](const ComparedResult& result) -> IntrinsicValues {
    const IntrinsicValues type_a = result.type_a.value_or(IntrinsicValues::Zero());
    return (result.covariance.diagonal() - type_a.cwiseAbs2()).cwiseMax(0.0);
  };
  return type_b_variances(first).cwiseMin(type_b_variances(second));
}

PropertyCovariances property_covariances(const ResultsComparison& comparison) {
  const auto n = static_cast<Eigen::Index>(comparison.order.size());
  PropertyCovariances out;
  for (std::size_t p = 0; p < 9; ++p) out.known[p] = out.largest[p] = Eigen::MatrixXd(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = i; j < n; ++j) {
      const std::size_t a = comparison.order[static_cast<std::size_t>(i)];
      const std::size_t b = comparison.order[static_cast<std::size_t>(j)];
      const IntrinsicValues known = intrinsic_covariance(comparison, a, b).diagonal();
      const IntrinsicValues largest =
          i == j ? known : largest_common(comparison.results[a], comparison.results[b], known);
      for (std::size_t p = 0; p < 9; ++p) {
        const auto property = static_cast<Eigen::Index>(p);
        out.known[p](i, j) = out.known[p](j, i) = known(property);
        out.largest[p](i, j) = out.largest[p](j, i) = largest(property);
      }
    }
  }
  return out;
}

/// The mean with type B, correlated where results share a stage, of those results that agree; nothing where
/// an uncertainty is not given.
std::optional<RandomEffectsMean> mean_with_type_b(const ResultsComparison& comparison,
                                                  const std::vector<double>& values,
                                                  const PropertyCovariances& covariances,
                                                  std::size_t property) {
  MeanOptions options;
  options.largest_covariance = covariances.largest[property];
  if (comparison.consistency) {
    const std::vector<std::size_t>& outliers = comparison.consistency->outliers;
    for (std::size_t i = 0; i < comparison.order.size(); ++i) {
      if (std::ranges::find(outliers, comparison.order[i]) != outliers.end()) options.left_out.push_back(i);
    }
  }
  try {
    return random_effects_mean(values, covariances.known[property], options);
  } catch (const std::exception&) {
    return std::nullopt;  // A weighted mean requires uncertainties.
  }
}

PropertySeries series_of(const ResultsComparison& comparison, const PropertyCovariances& covariances,
                         std::size_t number, double ewma_weight) {
  const auto property = static_cast<Eigen::Index>(number);
  PropertySeries series;
  std::vector<double> type_a;
  bool all_given = true;
  for (const std::size_t i : comparison.order) {
    const ComparedResult& result = comparison.results[i];
    series.values.push_back(result.values(property));
    all_given = all_given && std::isfinite(series.values.back());
    if (result.type_a && (*result.type_a)(property) > 0.0) type_a.push_back((*result.type_a)(property));
  }
  if (!all_given) return series;
  if (type_a.size() == series.values.size()) series.spread = spread_between_runs(series.values, type_a);
  series.random_effects = mean_with_type_b(comparison, series.values, covariances, number);
  series.individuals = individuals_chart(series.values);
  series.ewma = ewma_chart(series.values, series.individuals->centre, series.individuals->standard_deviation,
                           ewma_weight);
  if (comparison.groups.empty()) return series;
  std::vector<std::vector<double>> groups;
  for (const std::vector<std::size_t>& group : comparison.groups) {
    groups.emplace_back();
    for (const std::size_t i : group) groups.back().push_back(comparison.results[i].values(property));
  }
  series.anova = one_way_anova(groups);
  series.means = mean_chart(groups);
  return series;
}

void put_in_order(ResultsComparison& comparison) {
  comparison.order.resize(comparison.results.size());
  std::iota(comparison.order.begin(), comparison.order.end(), 0U);
  const bool dated = std::all_of(comparison.results.begin(), comparison.results.end(),
                                 [](const ComparedResult& r) { return !r.date.empty(); });
  if (!dated) {
    comparison.notes.push_back("not every result has a date: control charts take them in the order given");
    return;
  }
  // Dates and times of ISO 8601 in UTC sort as text.
  std::stable_sort(comparison.order.begin(), comparison.order.end(), [&](std::size_t a, std::size_t b) {
    return comparison.results[a].date < comparison.results[b].date;
  });
}

}  // namespace

bool ResultsComparison::agree() const {
  if (!consistency) return std::ranges::all_of(pairs, &PairComparison::agrees);
  return consistency->agree(kAgreementLevel) && std::ranges::all_of(pairs, [](const PairComparison& pair) {
           return !pair.rotation || pair.rotation->same_handedness;
         });
}

namespace {

/// Notes which quantity is compared, where another laboratory's may be another one.
void note_formulas(const std::vector<ComparedResult>& results, std::vector<std::string>& notes) {
  if (std::ranges::any_of(results, &ComparedResult::published)) {
    notes.emplace_back(
        "runs and CSVs are compared by the published formula (not corrected for k2 and k3), with the "
        "uncertainty of the paper: readings, alignment, turns, zeros and steps. These are not the line "
        "response");
    return;
  }
  if (std::ranges::all_of(results, [](const ComparedResult& result) { return result.estimator.empty(); }))
    return;
  for (const ComparedResult& result : results)
    if (result.estimator.empty())
      notes.push_back(
          fmt::format("{} is of another program and is compared with the line response; if it is an ABC "
                      "result by the published formula, --published compares it with the same quantity",
                      result.file));
}

/// Notes how many results were not computed for this comparison.
void note_stored(const std::vector<ComparedResult>& results, std::vector<std::string>& notes) {
  const auto stored = std::ranges::count_if(results, &ComparedResult::is_stored);
  if (stored > 0)
    notes.push_back(
        fmt::format("{} of {} results are those that this version of abcal stored with the runs (--refit "
                    "computes them from the readings)",
                    stored, results.size()));
}

/// Compares each result with the first, or with the first that is not an outlier.
void compare_pairs(ResultsComparison& comparison) {
  std::size_t reference = 0;
  while (comparison.consistency && std::ranges::find(comparison.consistency->outliers, reference) !=
                                       comparison.consistency->outliers.end())
    ++reference;
  const ComparedResult& first = comparison.results[reference];
  for (std::size_t i = 0; i < comparison.results.size(); ++i) {
    if (i == reference) continue;
    const ComparedResult& other = comparison.results[i];
    comparison.pairs.push_back(compare_pair(first, other, comparison.shared_subtracted));
    comparison.pairs.back().first = reference;
    comparison.pairs.back().second = i;
    if (first.record && other.record && first.what != other.what)
      comparison.notes.push_back(fmt::format("{} is by the {}, {} by the {}: both estimate the line response",
                                             first.file, first.what, other.file, other.what));
  }
}

}  // namespace

ResultsComparison compare_results(std::vector<ComparedResult> results, const CompareOptions& options) {
  if (results.size() < 2)
    throw CompareError(fmt::format("{} result(s) to compare; at least 2 are required", results.size()));
  require_different_measurements(results);
  ResultsComparison comparison;
  comparison.results = std::move(results);
  // A person who names items of one run compares different ones on purpose.
  const bool of_one_run = std::ranges::all_of(comparison.results, [&](const ComparedResult& result) {
    return result.run && result.run == comparison.results.front().run;
  });
  if (!options.any_item && !of_one_run) require_one_item(comparison.results, comparison.notes);
  for (std::string& note : convert_to_common_units(comparison.results))
    comparison.notes.push_back(std::move(note));
  comparison.units = units_of_properties(comparison.results.front());
  note_formulas(comparison.results, comparison.notes);
  note_stored(comparison.results, comparison.notes);
  comparison.shared_subtracted = options.shared_stage;
  const bool several = comparison.results.size() > 2 && !of_one_run;
  if (several) comparison.consistency = consistency_of(comparison);
  compare_pairs(comparison);
  if (several) {
    note_common_stages(comparison.results, options.shared_stage, comparison.notes);
  } else {
    for (const PairComparison& pair : comparison.pairs)
      note_common_stage(comparison.results[pair.first], comparison.results[pair.second], options.shared_stage,
                        comparison.notes);
  }
  if (!several) {  // Means and charts are those of one item over time.
    if (!options.group_by.empty())
      throw CompareError(of_one_run
                             ? "--group-by: items of one run make no groups; required: runs of one item"
                             : "--group-by: two results make no groups; at least three are required");
    return comparison;
  }
  put_in_order(comparison);
  if (!options.group_by.empty()) find_groups(options.group_by, comparison);
  comparison.series.emplace();
  const PropertyCovariances covariances = property_covariances(comparison);
  for (std::size_t i = 0; i < 9; ++i)
    (*comparison.series)[i] = series_of(comparison, covariances, i, options.ewma_weight);
  return comparison;
}

}  // namespace abcal
