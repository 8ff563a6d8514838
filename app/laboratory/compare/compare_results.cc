#include "app/laboratory/compare/compare_results.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "protocol/estimators/shared/intrinsic_properties.h"

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
      throw CompareError(fmt::format(
          "{} is of {} and {} of {}: different items; required: results of one item (--any-item compares all "
          "the same)",
          known->file, known->item, result.file, result.item));
    }
  }
  if (!unknown.empty()) {
    notes.push_back(fmt::format("{}: no serial number; that the item is the same is taken for granted",
                                fmt::join(unknown, ", ")));
  }
}

/// Whether all dwells of two records have the same means: a record and its copy in another form.
bool same_readings(const RunRecord& first, const RunRecord& second) {
  return !first.dwells.empty() &&
         std::ranges::equal(first.dwells, second.dwells, [](const DwellRecord& a, const DwellRecord& b) {
           return a.experiment == b.experiment && a.n == b.n && a.closing == b.closing && a.mean == b.mean &&
                  a.u_mean == b.u_mean;
         });
}

/// Whether two results are of one measurement. Different items of one loaded run are not.
bool of_one_measurement(const ComparedResult& first, const ComparedResult& second) {
  if (first.run && first.run == second.run) return first.item_of_run == second.item_of_run;
  if (first.sha256 == second.sha256 && !first.sha256.empty()) return true;
  if (!first.chain.empty() && !second.chain.empty()) return first.chain == second.chain;
  return first.record && second.record && first.record->response_unit == second.record->response_unit &&
         same_readings(*first.record, *second.record);
}

/// Refuses a measurement that is named twice: it agrees with itself, and the uncertainty of the mean would be
/// too small.
void require_different_measurements(const std::vector<ComparedResult>& results) {
  std::vector<std::string> problems;
  for (std::size_t i = 1; i < results.size(); ++i) {
    const auto copied =
        std::find_if(results.begin(), results.begin() + static_cast<std::ptrdiff_t>(i),
                     [&](const ComparedResult& r) { return of_one_measurement(r, results[i]); });
    if (copied == results.begin() + static_cast<std::ptrdiff_t>(i)) continue;
    const bool items = copied->item_of_run != results[i].item_of_run;
    problems.push_back(copied->file == results[i].file
                           ? fmt::format("{} is named twice", results[i].file)
                           : fmt::format("{} and {} hold the same {}", copied->file, results[i].file,
                                         items ? "run, in two files" : "measurement"));
  }
  if (problems.empty()) return;
  throw CompareError(fmt::format("{}; required: each measurement once", fmt::join(problems, "; ")));
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
    if (!result->record || result->what != "abc estimator" || !result->matrix) {
      throw CompareError(
          fmt::format("--shared: {} ({}) does not state which part of its uncertainty comes from the stage; "
                      "required: runs "
                      "or CSV records, and the abc estimator",
                      result->file, result->what));
    }
  }
  if (!first.stage.empty() && !second.stage.empty() && first.stage != second.stage) {
    throw CompareError(fmt::format("--shared: {} was measured on {}, {} on {}; required: one stage",
                                   first.file, first.stage, second.file, second.stage));
  }
  return factors_of(first).asDiagonal() * shared_type_b(*first.record, *second.record) *
         factors_of(second).asDiagonal();
}

void note_common_stage(const ComparedResult& first, const ComparedResult& second, bool subtracted,
                       std::vector<std::string>& notes) {
  if (in_one_common_fit(first, second)) {
    notes.push_back(fmt::format(
        "{} and {} were measured together: what the stage did to both is known by their common fit, and was "
        "subtracted from the uncertainty of the differences",
        first.file, second.file));
  } else if (subtracted) {
    notes.push_back(fmt::format(
        "{} and {}: what the same stage does to both (type B at equal angles; drift is each run's own) was "
        "subtracted from the uncertainty of the differences{}. What the stage did not do the same way twice "
        "(homing, temperature) is then a difference too",
        first.file, second.file,
        first.stage.empty() || second.stage.empty() ? "; that the stage is the same was taken from --shared"
                                                    : ", stage " + first.stage));
  } else if (!first.stage.empty() && first.stage == second.stage) {
    notes.push_back(
        fmt::format("{} and {} were measured on the same stage ({}): its type B is common to both and was "
                    "NOT subtracted, so "
                    "that E_n is too small (--shared subtracts it)",
                    first.file, second.file, first.stage));
  }
}

std::string reason(const PairComparison& pair, const std::string& first, const std::string& second) {
  if (pair.intrinsic.degrees_of_freedom == 0)
    return fmt::format("{} and {} have no property in common", first, second);
  if (pair.rotation && !pair.rotation->same_handedness) {
    return fmt::format(
        "the axes u, v, w of {} and {} are of different handedness: one is reversed, or two are swapped",
        first, second);
  }
  std::vector<std::string> beyond;
  for (std::size_t i = 0; i < 9; ++i) {
    const double e_n = pair.intrinsic.properties[i].e_n;
    if (std::abs(e_n) > 1.0) beyond.push_back(fmt::format("{} (E_n {:+.2f})", kIntrinsicNames[i], e_n));
  }
  if (beyond.empty()) {
    return fmt::format("all {} properties agree: the largest |E_n| is {:.2f}; required: at most 1",
                       pair.intrinsic.degrees_of_freedom, pair.intrinsic.largest_e_n);
  }
  return fmt::format("{} of {} properties differ: {}; required: |E_n| at most 1", beyond.size(),
                     pair.intrinsic.degrees_of_freedom, fmt::join(beyond, ", "));
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

/// Common variance of two results of one property. On one stage it is the type B part: as --shared computes
/// it if both are records, else all of the smaller one.
double common_variance(const ComparedResult& first, const ComparedResult& second, Eigen::Index property) {
  if (first.stage.empty() || first.stage != second.stage) return 0.0;
  if (first.record && second.record && first.what == "abc estimator" && second.what == "abc estimator" &&
      first.matrix && second.matrix) {
    const Covariance12 shared = shared_covariance(first, second);
    return (intrinsic_jacobian(*first.matrix) * shared * intrinsic_jacobian(*second.matrix).transpose())(
        property, property);
  }
  const auto type_b_variance = [&](const ComparedResult& result) {
    const double type_a = result.type_a ? (*result.type_a)(property) : 0.0;
    return std::max(0.0, result.covariance(property, property) - type_a * type_a);
  };
  return std::min(type_b_variance(first), type_b_variance(second));
}

/// The mean with type B, correlated where results share a stage; nothing where an uncertainty is not given.
std::optional<RandomEffectsMean> mean_with_type_b(const ResultsComparison& comparison,
                                                  const std::vector<double>& values, Eigen::Index property) {
  const auto n = static_cast<Eigen::Index>(values.size());
  Eigen::MatrixXd covariance(n, n);
  const auto result = [&](Eigen::Index i) -> const ComparedResult& {
    return comparison.results[comparison.order[static_cast<std::size_t>(i)]];
  };
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j)
      covariance(i, j) = i == j ? result(i).covariance(property, property)
                                : common_variance(result(std::min(i, j)), result(std::max(i, j)), property);
  }
  try {
    return random_effects_mean(values, covariance);
  } catch (const std::exception&) {
    return std::nullopt;  // A weighted mean requires uncertainties.
  }
}

PropertySeries series_of(const ResultsComparison& comparison, Eigen::Index property, double ewma_weight) {
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
  series.random_effects = mean_with_type_b(comparison, series.values, property);
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
  return std::all_of(pairs.begin(), pairs.end(), [](const PairComparison& pair) { return pair.agrees(); });
}

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
  const ComparedResult& first = comparison.results.front();
  comparison.units = units_of_properties(first);
  comparison.shared_subtracted = options.shared_stage;
  for (std::size_t i = 1; i < comparison.results.size(); ++i) {
    comparison.pairs.push_back(compare_pair(first, comparison.results[i], options.shared_stage));
    comparison.pairs.back().second = i;
    const ComparedResult& other = comparison.results[i];
    if (first.record && other.record && first.what != other.what)
      comparison.notes.push_back(fmt::format("{} is by the {}, {} by the {}: both estimate the line response",
                                             first.file, first.what, other.file, other.what));
    note_common_stage(first, comparison.results[i], options.shared_stage, comparison.notes);
  }
  if (of_one_run) {
    if (!options.group_by.empty())
      throw CompareError("--group-by: items of one run make no groups; required: runs of one item");
    return comparison;  // Means and charts are those of one item over time.
  }
  if (comparison.results.size() < 3) {
    if (!options.group_by.empty())
      throw CompareError("--group-by: two results make no groups; at least three are required");
    return comparison;
  }
  put_in_order(comparison);
  if (!options.group_by.empty()) find_groups(options.group_by, comparison);
  comparison.series.emplace();
  for (std::size_t i = 0; i < 9; ++i)
    (*comparison.series)[i] = series_of(comparison, static_cast<Eigen::Index>(i), options.ewma_weight);
  return comparison;
}

}  // namespace abcal
