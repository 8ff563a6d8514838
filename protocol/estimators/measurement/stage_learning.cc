#include "protocol/estimators/measurement/stage_learning.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <utility>

#include "protocol/estimators/measurement/size_posterior.h"
#include "protocol/linear/cholesky.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

/// Growth before anything is known of it: a tenth of the stated sizes in a month.
constexpr double kUsualGrowth = 0.1;
/// A direction is not tested where the readings reduce its variance by less than this share.
constexpr double kInformative = 1e-6;

/// The sizes of the stage, without those of the item.
EffectSizes sizes_of_stage(const EffectSizes& sizes) {
  EffectSizes out;
  for (const EffectSizeKey& key : effect_size_keys())
    if (key.section == "stage_uncertainty") key.set(out, key.get(sizes));
  return out;
}

/// The part of the stage to which an unknown of a run belongs.
std::string part_of(const RunInformation& run, Eigen::Index q) {
  if (q >= run.layout.count())
    return fmt::format("fine map of {}", run.visits[static_cast<std::size_t>(q - run.layout.count())].axis);
  const EffectUnknown& unknown = run.unknowns[static_cast<std::size_t>(q)];
  switch (const int part = repeat_part_of(unknown.name);
          part < 0 ? RepeatPart::kStep : static_cast<RepeatPart>(part)) {
    case RepeatPart::kHoming:
      return "zeros";
    case RepeatPart::kFloor:
      return "alignment";
    case RepeatPart::kTurn:
      return "initial turns";
    case RepeatPart::kStep:
      break;
  }
  return unknown.effect;
}

/// The unknowns of the stage in a run as a record predicts them.
struct Prediction {
  std::vector<Eigen::Index> q;   ///< Places of those that the record knows.
  std::vector<int> repeat_part;  ///< repeat_part_of() each of them.
  Eigen::VectorXd mean;
  Eigen::MatrixXd covariance;
};

Prediction predicted(const RunInformation& run, const StageState& before,
                     const Repeatabilities& repeatabilities) {
  Prediction out;
  std::vector<Eigen::Index> known;
  for (Eigen::Index q = run.layout.first_stage(); q < run.at.size(); ++q) {
    const bool is_visit = q >= run.layout.count();
    const std::string& name =
        run.unknowns[static_cast<std::size_t>(std::min(q, run.layout.count() - Eigen::Index{1}))].name;
    if (is_visit && run.in_motion) break;  // Its step errors are of this run alone.
    const Eigen::Index place =
        is_visit ? before.place_of(run.visits[static_cast<std::size_t>(q - run.layout.count())])
                 : before.place_of(name);
    if (place < 0) continue;
    out.q.push_back(q);
    known.push_back(place);
    const int part = is_visit ? static_cast<int>(RepeatPart::kStep) : repeat_part_of(name);
    out.repeat_part.push_back(part);
  }
  const auto count = static_cast<Eigen::Index>(known.size());
  out.mean.resize(count);
  out.covariance.resize(count, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Eigen::Index at = known[static_cast<std::size_t>(i)];
    out.mean(i) = before.mean(at);
    for (Eigen::Index k = 0; k < count; ++k)
      out.covariance(i, k) = before.covariance(at, known[static_cast<std::size_t>(k)]);
    if (const int part = out.repeat_part[static_cast<std::size_t>(i)]; part >= 0)
      out.covariance(i, i) += std::pow(repeatabilities[static_cast<std::size_t>(part)].rms, 2);
  }
  return out;
}

/// How the covariance of a difference depends on a size of what the stage does not repeat: by
/// (size^2 - size_0^2) `by_variance`, size_0 the one that the covariances have.
struct UncertainSize {
  Eigen::MatrixXd by_variance;
  double rms = 0.0;  ///< size_0
  std::vector<ProbableSize> sizes;
};

/// Differences d with the prior covariance P and the posterior one Q: d' (P - Q)^+ d. Where a size is
/// uncertain, the probability is the mean over its distribution, as Student's t is for a variance from few
/// values.
EffectTest test_part(const Message& name, const Eigen::VectorXd& difference, const Eigen::MatrixXd& prior,
                     const Eigen::MatrixXd& posterior, const UncertainSize& uncertain = {}) {
  EffectTest test;
  test.name = name;
  test.key = "record";
  const Eigen::VectorXd scale = prior.diagonal().cwiseSqrt().cwiseInverse();
  const SymmetricEigen eigen =
      generalized_eigen(scaled_on_both_sides(prior - posterior, scale), scaled_on_both_sides(prior, scale));
  std::vector<Eigen::Index> shown;
  for (Eigen::Index i = 0; i < difference.size(); ++i)
    if (eigen.values(i) >= kInformative) shown.push_back(i);
  const auto count = static_cast<Eigen::Index>(shown.size());
  test.degrees_of_freedom = static_cast<int>(count);
  if (count == 0) return test;
  // Rows of `whiten` times d have the variance 1: the vectors v have v' P v = 1 in the scaled unknowns.
  Eigen::MatrixXd whiten(count, difference.size());
  for (Eigen::Index i = 0; i < count; ++i) {
    const Eigen::Index at = shown[static_cast<std::size_t>(i)];
    whiten.row(i) = eigen.vectors.col(at).cwiseProduct(scale).transpose() / std::sqrt(eigen.values(at));
  }
  Eigen::VectorXd z = product_with_vector(whiten, difference);
  test.chi2 = z.squaredNorm();
  test.times_stated = std::sqrt(test.chi2 / test.degrees_of_freedom);
  test.probability = chi2_tail(test.chi2, test.degrees_of_freedom);
  if (uncertain.sizes.size() < 2) return test;
  const SymmetricEigen by_size = symmetric_eigen(carried_covariance(whiten, uncertain.by_variance));
  z = transposed_product_with_vector(by_size.vectors, z);
  test.probability = 0.0;
  for (const ProbableSize& one : uncertain.sizes) {
    constexpr double kLeastVariance = 1e-6;  // The readings and the state leave more.
    const double more = one.size * one.size - uncertain.rms * uncertain.rms;
    const double chi2 =
        (z.array().square() / (1.0 + more * by_size.values.array()).max(kLeastVariance)).sum();
    test.probability += one.probability * chi2_tail(chi2, test.degrees_of_freedom);
  }
  return test;
}

template <class Index>
Eigen::MatrixXd block_of(const Eigen::MatrixXd& matrix, const std::vector<Index>& places) {
  const auto count = static_cast<Eigen::Index>(places.size());
  Eigen::MatrixXd out(count, count);
  for (Eigen::Index i = 0; i < count; ++i)
    for (Eigen::Index k = 0; k < count; ++k)
      out(i, k) = matrix(places[static_cast<std::size_t>(i)], places[static_cast<std::size_t>(k)]);
  return out;
}

/// The unknown that is furthest from the record, in standard deviations of its prediction.
std::string furthest(const RunInformation& run, const InRunFit& found, const StageState& before,
                     const Repeatabilities& repeatabilities) {
  const Prediction record = predicted(run, before, repeatabilities);
  double most = 0.0;
  Eigen::Index at = -1;
  for (std::size_t i = 0; i < record.q.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    const double away =
        std::abs(found.value(record.q[i]) - record.mean(k)) / std::sqrt(record.covariance(k, k));
    if (away > most) {
      most = away;
      at = record.q[i];
    }
  }
  if (at < 0) return {};
  if (at < run.layout.count()) return run.unknowns[static_cast<std::size_t>(at)].name;
  return name_of_map(run.visits[static_cast<std::size_t>(at - run.layout.count())]);
}

}  // namespace

std::vector<EffectTest> test_state(const RunInformation& run, const InRunFit& found, const StageState& before,
                                   const Repeatabilities& repeatabilities) {
  const Prediction record = predicted(run, before, repeatabilities);
  std::vector<EffectTest> out;
  std::vector<std::string> parts;
  // The shift of the unknowns is A times the error of their prediction, and noise: A = I - Q P^-1.
  const Eigen::VectorXd scale = record.covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Cholesky prior(scaled_on_both_sides(record.covariance, scale));
  Eigen::MatrixXd follows;
  if (prior.positive_definite())
    follows = Eigen::MatrixXd::Identity(scale.size(), scale.size()) -
              scaled_columns(
                  prior.solve(scaled_rows(scale, block_of(found.covariance, record.q))).transpose(), scale);
  for (const Eigen::Index q : record.q)
    if (const std::string part = part_of(run, q); std::ranges::find(parts, part) == parts.end())
      parts.push_back(part);
  for (const std::string& part : parts) {
    std::vector<std::size_t> of_part;
    std::vector<Eigen::Index> places;
    for (std::size_t i = 0; i < record.q.size(); ++i) {
      if (part_of(run, record.q[i]) != part) continue;
      of_part.push_back(i);
      places.push_back(record.q[i]);
    }
    Eigen::VectorXd difference(static_cast<Eigen::Index>(places.size()));
    for (std::size_t i = 0; i < places.size(); ++i)
      difference(static_cast<Eigen::Index>(i)) =
          found.value(places[i]) - record.mean(static_cast<Eigen::Index>(of_part[i]));
    std::vector<Eigen::Index> own(of_part.begin(), of_part.end());
    UncertainSize uncertain;
    if (const int repeats = record.repeat_part[of_part.front()]; repeats >= 0 && follows.size() > 0) {
      const SizeFound& size = repeatabilities[static_cast<std::size_t>(repeats)];
      Eigen::MatrixXd by_error = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(own.size()), scale.size());
      for (std::size_t i = 0; i < own.size(); ++i)
        for (Eigen::Index k = 0; k < scale.size(); ++k)
          if (record.repeat_part[static_cast<std::size_t>(k)] == repeats)
            by_error(static_cast<Eigen::Index>(i), k) = follows(own[i], k);
      uncertain = {covariance_of_root(by_error), size.rms, probable_sizes(size)};
    }
    out.push_back(test_part(Message("{part}", part), difference, block_of(record.covariance, own),
                            block_of(found.covariance, places), uncertain));
  }
  return out;
}

std::vector<EffectTest> compare_states(const StageState& earlier, const StageState& later,
                                       bool is_continued) {
  const auto part_of_place = [&](Eigen::Index place) -> std::string {
    if (place >= static_cast<Eigen::Index>(earlier.names.size()))
      return fmt::format("fine map of {}",
                         earlier.angles[static_cast<std::size_t>(place) - earlier.names.size()].axis);
    const std::string& name = earlier.names[static_cast<std::size_t>(place)];
    for (const StageEffect& effect : stage_effects())
      for (int i = 0; i < effect.count; ++i)
        if (unknown_name(effect, i) == name) return std::string(effect.name);
    return name;
  };
  std::vector<std::string> parts;
  std::map<std::string, std::vector<std::pair<Eigen::Index, Eigen::Index>>> places;
  for (Eigen::Index i = 0; i < earlier.size(); ++i) {
    const auto at = static_cast<std::size_t>(i);
    const Eigen::Index other = at < earlier.names.size()
                                   ? later.place_of(earlier.names[at])
                                   : later.place_of(earlier.angles[at - earlier.names.size()]);
    if (other < 0) continue;
    const std::string part = part_of_place(i);
    if (!places.contains(part)) parts.push_back(part);
    places[part].emplace_back(i, other);
  }
  std::vector<EffectTest> out;
  for (const std::string& part : parts) {
    std::vector<Eigen::Index> before, after;
    for (const auto& [a, b] : places[part]) {
      before.push_back(a);
      after.push_back(b);
    }
    Eigen::VectorXd difference(static_cast<Eigen::Index>(before.size()));
    for (std::size_t i = 0; i < before.size(); ++i)
      difference(static_cast<Eigen::Index>(i)) = later.mean(after[i]) - earlier.mean(before[i]);
    const Eigen::MatrixXd of_earlier = block_of(earlier.covariance, before);
    const Eigen::MatrixXd of_later = block_of(later.covariance, after);
    // Independent ones: the covariance of the difference is the sum.
    out.push_back(is_continued ? test_part(Message("{part}", part), difference, of_earlier, of_later)
                               : test_part(Message("{part}", part), difference, of_earlier + of_later,
                                           Eigen::MatrixXd::Zero(of_later.rows(), of_later.cols())));
  }
  return out;
}

void judge_record(std::vector<EffectTest>& tests) {
  std::vector<EffectTest*> order;
  for (EffectTest& test : tests) {
    test.passed = true;
    if (test.degrees_of_freedom > 0) order.push_back(&test);
  }
  std::ranges::sort(order, {}, &EffectTest::probability);
  for (std::size_t i = 0; i < order.size(); ++i) {
    if (order[i]->probability > kRecordFalseAlarm / static_cast<double>(order.size() - i)) break;
    order[i]->passed = false;
  }
}

StageLearned learn_stage(std::span<const MeasuredItem> runs, const std::optional<StageRecord>& before,
                         double months) {
  StageLearned out;
  MeasurementOptions options;
  SizeFound growth = half_normal(kUsualGrowth);
  if (before) {
    // How much the stage may have changed follows from these runs as well.
    if (months > 0.0)
      growth = size_posterior(kUsualGrowth * 10.0, before->growth, [&](double share) {
        StageRecord tried = *before;
        tried.growth.rms = share;
        return fit_measurement(runs, with_record(tried, months)).log_likelihood;
      });
    else
      growth = before->growth;
    StageRecord known = *before;
    known.growth = growth;
    options = with_record(known, months);
    options.estimate_repeatabilities = true;
  }
  out.fit = fit_measurement(runs, options);
  out.record.sizes = before ? before->sizes : sizes_of_stage(runs.front().information->sizes);
  out.record.growth = growth;
  if (!out.fit.converged) return out;
  out.record.state = out.fit.stage;
  out.record.repeatabilities = out.fit.repeatabilities;
  if (before) {
    for (std::size_t k = 0; k < runs.size(); ++k) {
      std::vector<EffectTest> tests =
          test_state(*runs[k].information, out.fit.in_runs[k], *options.stage, *options.repeatabilities);
      judge_record(tests);
      for (EffectTest& test : tests)
        if (!test.passed) out.changes.push_back(std::move(test));
    }
  }
  return out;
}

MeasurementOptions with_record(const StageRecord& record, double months) {
  MeasurementOptions options;
  options.stage = state_after(record, months);
  options.repeatabilities = record.repeatabilities;
  options.estimate_repeatabilities = false;
  return options;
}

MeasurementOptions options_of(const StageRecordInUse& use) {
  return use.record ? with_record(*use.record, use.age_months) : MeasurementOptions{};
}

EffectFit common_fit(const EffectFit& own, const MeasuredItem& first, const MeasurementFit& fit) {
  const FittedItem& item = fit.items[static_cast<std::size_t>(first.item)];
  const InRunFit& run = fit.in_runs[item.first];
  EffectFit out = own;
  const Eigen::Index unknowns = first.information->layout.count();
  out.value = run.value.head(unknowns);
  out.covariance = run.covariance.topLeftCorner(unknowns, unknowns);
  out.line = item.line;
  out.covariance_line = item.covariance_line;
  out.covariance_line_type_b = Covariance12::Zero();
  for (const EffectShare& share : item.shares) out.covariance_line_type_b += share.covariance;
  out.shares = item.shares;
  if (item.degrees_of_freedom) out.degrees_of_freedom = *item.degrees_of_freedom;
  if (item.gain.size() > 0) out.gain = item.gain;
  if (fit.items.size() == 1) {
    out.chi2 = fit.chi2;
    out.chi2_degrees_of_freedom = fit.degrees_of_freedom;
  }
  out.iterations = fit.iterations;
  out.reciprocal_condition = fit.reciprocal_condition;
  for (std::size_t n = 0; n < out.step_error.size(); ++n) {
    const Eigen::Index at = unknowns + static_cast<Eigen::Index>(n);
    out.step_error[n] = run.value(at);
    out.u_step_error[n] = std::sqrt(run.covariance(at, at));
  }
  return out;
}

std::vector<EffectTest> test_run(const RunInformation& run, const InRunFit& found, const StageState& before,
                                 const Repeatabilities& repeatabilities, std::string& largest) {
  std::vector<EffectTest> out = test_state(run, found, before, repeatabilities);
  judge_record(out);
  if (std::ranges::any_of(out, [](const EffectTest& test) { return !test.passed; }))
    largest = furthest(run, found, before, repeatabilities);
  return out;
}

}  // namespace abcal
