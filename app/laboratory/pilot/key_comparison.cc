#include "app/laboratory/pilot/key_comparison.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "app/laboratory/compare/generalised_fit.h"
#include "app/laboratory/compare/random_effects.h"
#include "protocol/linear/products.h"
#include "protocol/statistics/distributions.h"
#include "protocol/uncertainty/coverage.h"
#include "protocol/uncertainty/random_stream.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::MatrixXi;
using Eigen::VectorXd;

void require_participants(const ParticipantResults& results) {
  const Index p = results.quantities;
  if (p < 1 || results.values.size() % p != 0 || results.participants() < 2 ||
      results.covariance.rows() != results.values.size() ||
      results.covariance.cols() != results.values.size() ||
      results.coverage_factors.size() != static_cast<std::size_t>(results.participants()))
    throw KeyComparisonError(
        "a reference value needs the results of two participants or more, with their covariance and coverage "
        "factors");
  if (!results.values.allFinite() || !results.covariance.allFinite() ||
      !(results.covariance.diagonal().array() > 0.0).all())
    throw KeyComparisonError("a result has no value, or no uncertainty above 0");
}

MatrixXi everything(const ParticipantResults& results) {
  return MatrixXi::Ones(results.participants(), results.quantities);
}

ConsistencyTest tested(double chi2, int degrees_of_freedom) {
  return {chi2, degrees_of_freedom, chi2_tail(chi2, degrees_of_freedom)};
}

/// Positions of one quantity in all results.
std::vector<Index> places_of(const ParticipantResults& results, Index quantity) {
  std::vector<Index> at;
  for (Index i = 0; i < results.participants(); ++i) at.push_back(i * results.quantities + quantity);
  return at;
}

/// The results of some quantities alone.
ParticipantResults part_of(const ParticipantResults& results, const std::vector<Index>& quantities) {
  std::vector<Index> at;
  for (Index i = 0; i < results.participants(); ++i)
    for (const Index q : quantities) at.push_back(i * results.quantities + q);
  return {.quantities = static_cast<Index>(quantities.size()),
          .values = results.values(at),
          .covariance = results.covariance(at, at),
          .coverage_factors = results.coverage_factors};
}

std::vector<VectorXd> listed(const ParticipantResults& results) {
  std::vector<VectorXd> list;
  for (Index i = 0; i < results.participants(); ++i)
    list.emplace_back(results.values.segment(i * results.quantities, results.quantities));
  return list;
}

/// Differences from a mean of chosen results, judged by `covariance`.
void set_differences(const ParticipantResults& results, const GeneralisedFit& mean,
                     const MatrixXd& mean_covariance, ReferenceValue& reference) {
  const Index p = results.quantities, n = results.participants();
  reference.values = mean.parameters;
  reference.covariance = mean_covariance;
  MatrixXd difference = MatrixXd::Identity(n * p, n * p);
  reference.differences.resize(n * p);
  for (Index i = 0; i < n; ++i) {
    difference.middleRows(i * p, p) -= mean.map;
    reference.differences.segment(i * p, p) = results.values.segment(i * p, p) - mean.parameters;
  }
  reference.difference_covariance = difference * results.covariance * difference.transpose();
  reference.expanded = reference.difference_covariance.diagonal().cwiseMax(0.0).cwiseSqrt();
  for (Index i = 0; i < n; ++i)
    reference.expanded.segment(i * p, p) *= results.coverage_factors[static_cast<std::size_t>(i)];
}

void take_mean(const ParticipantResults& results, ReferenceValue& reference) {
  const GeneralisedFit mean = generalised_mean(results.values, results.covariance, reference.contributes);
  set_differences(results, mean, mean.covariance, reference);
}

void take_subset(const ParticipantResults& results, double level, ReferenceValue& reference) {
  const ConsistentSubset subset = largest_consistent_subset(listed(results), results.covariance, level);
  if (!subset.found)
    throw KeyComparisonError(
        "no majority of the participants agrees, so that there is no consistent subset; required: procedure "
        "\"B\" or \"random-effects\", or a cause that is found");
  for (const std::size_t i : subset.outliers) reference.contributes.row(static_cast<Index>(i)).setZero();
  reference.alternatives = subset.alternatives;
  take_mean(results, reference);
}

void take_subset_per_quantity(const ParticipantResults& results, double level, ReferenceValue& reference) {
  for (Index q = 0; q < results.quantities; ++q) {
    const ParticipantResults alone = part_of(results, {q});
    const ConsistentSubset subset = largest_consistent_subset(listed(alone), alone.covariance, level);
    if (!subset.found)
      throw KeyComparisonError(fmt::format(
          "quantity {}: no majority of the participants agrees, so that there is no consistent subset; "
          "required: procedure \"B\" or \"random-effects\", or a cause that is found",
          q + 1));
    for (const std::size_t i : subset.outliers) reference.contributes(static_cast<Index>(i), q) = 0;
    reference.alternatives += subset.alternatives;
  }
  take_mean(results, reference);
}

void take_random_effects(const ParticipantResults& results, const ReferenceOptions& options,
                         ReferenceValue& reference) {
  std::vector<std::vector<Index>> groups = options.groups;
  if (groups.empty())
    for (Index q = 0; q < results.quantities; ++q) groups.push_back({q});
  MatrixXd covariance = results.covariance;
  for (const std::vector<Index>& group : groups) {
    const ParticipantResults alone = part_of(results, group);
    const double variance = between_variance(alone.values, alone.covariance, alone.quantities);
    for (const Index q : group) {
      reference.between(q) = std::sqrt(variance);
      for (const Index at : places_of(results, q)) covariance(at, at) += variance;
    }
  }
  const GeneralisedFit mean = generalised_mean(results.values, covariance, reference.contributes);
  set_differences(results, mean, mean.covariance, reference);
}

/// The median of an even number of values is the mean of the two in the middle.
double middle_of(std::vector<double>& values) {
  const auto half = static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), values.begin() + half, values.end());
  const double upper = values[static_cast<std::size_t>(half)];
  if (values.size() % 2 == 1) return upper;
  return 0.5 * (upper + *std::max_element(values.begin(), values.begin() + half));
}

void take_median(const ParticipantResults& results, const ReferenceOptions& options,
                 ReferenceValue& reference) {
  const Index p = results.quantities, n = results.participants(), draws = options.draws;
  const VectorXd unit = results.covariance.diagonal().cwiseSqrt();
  const VectorXd inverse = unit.cwiseInverse();
  const Eigen::LLT<MatrixXd> factor(inverse.asDiagonal() * results.covariance * inverse.asDiagonal());
  if (factor.info() != Eigen::Success)
    throw KeyComparisonError(
        "the covariances of the results contradict one another: nothing can be drawn from them");
  const MatrixXd root = unit.asDiagonal() * MatrixXd(factor.matrixL());
  MatrixXd normals(n * p, draws), medians(p, draws);
  for (Index d = 0; d < draws; ++d) {
    RandomStream stream(options.seed, StreamPurpose::kComparison, static_cast<std::uint64_t>(d));
    for (Index k = 0; k < n * p; ++k) normals(k, d) = stream.normal();
  }
  // Drawn results from those of the first participant, then their differences from the median.
  MatrixXd differences = product(root, normals);
  differences.colwise() += results.values - results.values.head(p).replicate(n, 1);
  std::vector<double> column(static_cast<std::size_t>(n));
  for (Index d = 0; d < draws; ++d) {
    for (Index q = 0; q < p; ++q) {
      for (Index i = 0; i < n; ++i) column[static_cast<std::size_t>(i)] = differences(i * p + q, d);
      medians(q, d) = middle_of(column);
      for (Index i = 0; i < n; ++i) differences(i * p + q, d) -= medians(q, d);
    }
  }
  const auto centred_covariance = [&](MatrixXd& drawn) {
    drawn.colwise() -= VectorXd(drawn.rowwise().mean());
    return MatrixXd(covariance_of_root(drawn) / static_cast<double>(draws - 1));
  };
  reference.values = results.values.head(p) + VectorXd(medians.rowwise().mean());
  reference.covariance = centred_covariance(medians);
  reference.differences.resize(n * p);
  reference.expanded.resize(n * p);
  for (Index i = 0; i < n; ++i)
    reference.differences.segment(i * p, p) = results.values.segment(i * p, p) - reference.values;
  std::vector<double> row(static_cast<std::size_t>(draws));
  for (Index k = 0; k < n * p; ++k) {
    VectorXd::Map(row.data(), draws) = differences.row(k);
    const CoverageInterval shortest = coverage_of(row, 0.95).shortest;
    reference.expanded(k) = 0.5 * (shortest.high - shortest.low);
  }
  reference.difference_covariance = centred_covariance(differences);
}

/// chi2 of some differences by their covariance.
double chi2_of(const VectorXd& differences, const MatrixXd& covariance) {
  const VectorXd unit = covariance.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const VectorXd scaled = unit.cwiseProduct(differences);
  return scaled.dot(Eigen::LDLT<MatrixXd>(unit.asDiagonal() * covariance * unit.asDiagonal()).solve(scaled));
}

/// The mean of the participants that are chosen, without participant i.
ReferenceValue mean_of_others(const ParticipantResults& results, Index i,
                              const std::vector<std::size_t>& left_out) {
  ReferenceValue others;
  others.contributes = everything(results);
  for (const std::size_t out : left_out) others.contributes.row(static_cast<Index>(out)).setZero();
  others.contributes.row(i).setZero();
  take_mean(results, others);
  return others;
}

/// The errors that a participant's difference from the mean of the others implies, if only one quantity has
/// one.
struct SingleErrors {
  VectorXd deviates;  ///< For each quantity the error in units of its standard uncertainty.
  VectorXd u;         ///< Standard uncertainty of that error.
};
SingleErrors single_errors(const VectorXd& difference, const MatrixXd& covariance) {
  const VectorXd unit = covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<MatrixXd> factor(unit.asDiagonal() * covariance * unit.asDiagonal());
  const VectorXd scaled = factor.solve(unit.cwiseProduct(difference));
  const VectorXd weight = factor.solve(MatrixXd::Identity(unit.size(), unit.size())).diagonal().cwiseSqrt();
  return {scaled.cwiseQuotient(weight), unit.cwiseProduct(weight).cwiseInverse()};
}

/// Limits of the two tests that share a level.
struct NamingLimits {
  double joint_probability, deviate;
};
NamingLimits naming_limits(const ParticipantResults& results, double level) {
  const double of_each = 0.5 * level / static_cast<double>(results.participants());
  return {of_each, normal_quantile(1.0 - 0.5 * of_each / static_cast<double>(results.quantities))};
}

}  // namespace

double ComparisonConsistency::birge(std::size_t quantity) const {
  const ConsistencyTest& test = of_quantity.at(quantity);
  return std::sqrt(test.chi2 / static_cast<double>(test.degrees_of_freedom));
}

ComparisonConsistency consistency_of_participants(const ParticipantResults& results) {
  require_participants(results);
  ComparisonConsistency found;
  const GeneralisedFit all = generalised_mean(results.values, results.covariance, everything(results));
  found.joint = tested(all.chi2, all.degrees_of_freedom);
  for (Index q = 0; q < results.quantities; ++q) {
    const ParticipantResults alone = part_of(results, {q});
    const GeneralisedFit mean = generalised_mean(alone.values, alone.covariance, everything(alone));
    found.of_quantity.push_back(tested(mean.chi2, mean.degrees_of_freedom));
  }
  return found;
}

ReferenceValue reference_value(const ParticipantResults& results, const ReferenceOptions& options) {
  require_participants(results);
  ReferenceValue reference;
  reference.procedure = options.procedure;
  reference.contributes = everything(results);
  reference.between = VectorXd::Zero(results.quantities);
  if (options.procedure == ReferenceProcedure::kMeanOrMedian)
    reference.procedure = consistency_of_participants(results).joint.probability >= options.level
                              ? ReferenceProcedure::kMean
                              : ReferenceProcedure::kMedian;
  switch (reference.procedure) {
    case ReferenceProcedure::kMean:
    case ReferenceProcedure::kMeanOrMedian:
      take_mean(results, reference);
      break;
    case ReferenceProcedure::kMedian:
      take_median(results, options, reference);
      break;
    case ReferenceProcedure::kSubset:
      take_subset(results, options.level, reference);
      break;
    case ReferenceProcedure::kSubsetPerQuantity:
      take_subset_per_quantity(results, options.level, reference);
      break;
    case ReferenceProcedure::kRandomEffects:
      take_random_effects(results, options, reference);
      break;
  }
  return reference;
}

PairEquivalence pair_equivalence(const ParticipantResults& results, Index i, Index j) {
  const Index p = results.quantities;
  const auto block = [&](Index a, Index b) { return results.covariance.block(a * p, b * p, p, p); };
  PairEquivalence pair;
  pair.difference = results.values.segment(i * p, p) - results.values.segment(j * p, p);
  pair.covariance = block(i, i) + block(j, j) - block(i, j) - block(j, i);
  pair.expanded = std::max(results.coverage_factors.at(static_cast<std::size_t>(i)),
                           results.coverage_factors.at(static_cast<std::size_t>(j))) *
                  pair.covariance.diagonal().cwiseMax(0.0).cwiseSqrt();
  return pair;
}

std::vector<ClaimTest> test_claims(const ParticipantResults& results, const ReferenceValue& reference) {
  const Index p = results.quantities;
  std::vector<ClaimTest> claims;
  for (Index i = 0; i < results.participants(); ++i) {
    const VectorXd difference = reference.differences.segment(i * p, p);
    ClaimTest& claim = claims.emplace_back();
    for (Index q = 0; q < p; ++q)
      if (std::abs(difference(q)) > reference.expanded(i * p + q)) ++claim.beyond;
    claim.joint = tested(chi2_of(difference, reference.difference_covariance.block(i * p, i * p, p, p)),
                         static_cast<int>(p));
  }
  return claims;
}

std::vector<FaultyParticipant> faulty_participants(const ParticipantResults& results, double level) {
  require_participants(results);
  const Index p = results.quantities, n = results.participants();
  std::vector<FaultyParticipant> faulty;
  if (n < 3) return faulty;
  const ConsistentSubset subset = largest_consistent_subset(listed(results), results.covariance, level);
  if (!subset.found) return faulty;
  const NamingLimits limits = naming_limits(results, level);
  for (Index i = 0; i < n; ++i) {
    const ReferenceValue others = mean_of_others(results, i, subset.outliers);
    const VectorXd difference = others.differences.segment(i * p, p);
    const MatrixXd covariance = others.difference_covariance.block(i * p, i * p, p, p);
    Index quantity = 0;
    const bool single =
        single_errors(difference, covariance).deviates.cwiseAbs().maxCoeff(&quantity) > limits.deviate;
    if (!single &&
        chi2_tail(chi2_of(difference, covariance), static_cast<int>(p)) >= limits.joint_probability)
      continue;
    faulty.push_back({static_cast<std::size_t>(i), single ? std::optional(quantity) : std::nullopt});
  }
  return faulty;
}

VectorXd detectable_faults(const ParticipantResults& results, double level, double power) {
  require_participants(results);
  const Index p = results.quantities, n = results.participants();
  const double deviate = naming_limits(results, level).deviate + normal_quantile(power);
  VectorXd faults(n * p);
  for (Index i = 0; i < n; ++i) {
    const ReferenceValue others = mean_of_others(results, i, {});
    faults.segment(i * p, p) = deviate * single_errors(others.differences.segment(i * p, p),
                                                       others.difference_covariance.block(i * p, i * p, p, p))
                                             .u;
  }
  return faults;
}

Scores scores_of(double difference, double u, double expanded, const std::optional<double>& sigma_pt) {
  Scores scores{difference / expanded, difference / u, std::nullopt};
  if (sigma_pt) scores.z = difference / *sigma_pt;
  return scores;
}

LinkedDifferences linked_differences(const ParticipantResults& results, const ReferenceValue& reference,
                                     const std::vector<LinkingParticipant>& linking) {
  const Index p = results.quantities, n = results.participants(), m = static_cast<Index>(linking.size());
  if (m == 0) throw KeyComparisonError("a link needs a participant of both comparisons");
  // Earlier minus present differences, with their covariance.
  ParticipantResults excess{.quantities = p,
                            .values = VectorXd(m * p),
                            .covariance = MatrixXd(m * p, m * p),
                            .coverage_factors = std::vector<double>(linking.size(), 2.0)};
  MatrixXd picked = MatrixXd::Zero(m * p, n * p);
  for (Index a = 0; a < m; ++a) {
    const LinkingParticipant& one = linking[static_cast<std::size_t>(a)];
    if (one.participant < 0 || one.participant >= n || one.difference.size() != p || one.u.size() != p ||
        !(one.u.array() > 0.0).all())
      throw KeyComparisonError(
          "a link needs the earlier degree of equivalence of every quantity with its uncertainty");
    picked.block(a * p, one.participant * p, p, p).setIdentity();
    excess.values.segment(a * p, p) = one.difference - reference.differences.segment(one.participant * p, p);
  }
  excess.covariance = picked * reference.difference_covariance * picked.transpose();
  VectorXd earlier(m * p);
  for (Index a = 0; a < m; ++a)
    earlier.segment(a * p, p) = linking[static_cast<std::size_t>(a)].u.cwiseAbs2();
  excess.covariance.diagonal() += earlier;
  const GeneralisedFit mean = generalised_mean(excess.values, excess.covariance, everything(excess));
  LinkedDifferences linked;
  linked.shift = mean.parameters;
  linked.shift_covariance = mean.covariance;
  linked.differences = reference.differences + mean.parameters.replicate(n, 1);
  const MatrixXd to_all = mean.map.replicate(n, 1);  // n p x m p
  const MatrixXd jacobian = MatrixXd::Identity(n * p, n * p) - to_all * picked;
  linked.covariance = jacobian * reference.difference_covariance * jacobian.transpose() +
                      to_all * earlier.asDiagonal() * to_all.transpose();
  return linked;
}

}  // namespace abcal
