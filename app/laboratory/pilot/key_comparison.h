#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/laboratory/compare/consistent_subset.h"

namespace abcal {

/// Results of n participants of the same p quantities, and what they have in common. Quantities may have
/// different units; every number is in the unit of its quantity.
struct ParticipantResults {
  Eigen::Index quantities = 0;  ///< p
  Eigen::VectorXd values;       ///< n p, participant by participant.
  Eigen::MatrixXd covariance;   ///< n p x n p: of each with itself, and of what two of them share.
  /// Coverage factor of each participant, for 95 %.
  std::vector<double> coverage_factors;

  Eigen::Index participants() const { return values.size() / quantities; }
};

/// How the reference value is made.
enum class ReferenceProcedure {
  kMean,          ///< A: generalised weighted mean of all (M. G. Cox, Metrologia 39, 589, 2002).
  kMedian,        ///< B: medians of draws from all results (Cox 2002).
  kMeanOrMedian,  ///< A where all participants agree, else B, as Cox 2002 advises.
  kSubset,        ///< Mean of the largest consistent subset of participants (Cox, Metrologia 44, 187, 2007).
  kSubsetPerQuantity,  ///< As kSubset, with a subset for each quantity alone.
  kRandomEffects,      ///< Mean with effects of the participants beyond their uncertainties.
};

/// Results from which no reference value follows: usage, with what to do.
class KeyComparisonError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

struct ReferenceOptions {
  ReferenceProcedure procedure = ReferenceProcedure::kMeanOrMedian;
  double level = 0.05;     ///< Participants agree if the probability of their chi2 is at least this.
  int draws = 100'000;     ///< Number of draws of procedure B.
  std::uint64_t seed = 1;  ///< Seed of these draws.
  /// Quantities that share one standard deviation of the participants' own effects: same kind and unit.
  std::vector<std::vector<Eigen::Index>> groups = {};
};

/// The reference values of p quantities.
struct ReferenceValue {
  ReferenceProcedure procedure = ReferenceProcedure::kMean;  ///< The one that was used.
  Eigen::VectorXd values;
  Eigen::MatrixXd covariance;
  /// n x p: 1 where a participant's result is a part of the reference value, else 0.
  Eigen::MatrixXi contributes;
  /// n p x n p and n p: covariance of the differences of the results from the reference value, and their
  /// expanded uncertainties for 95 %: k u with the participant's k; of procedure B half the shortest interval
  /// of the draws.
  Eigen::MatrixXd difference_covariance;
  Eigen::VectorXd expanded;
  Eigen::VectorXd differences;  ///< Degrees of equivalence D_i = x_i - x_ref.
  /// Standard deviations of the participants' own effects, p; zero but for kRandomEffects.
  Eigen::VectorXd between;
  /// Subsets: how many others of this size agree too.
  int alternatives = 0;
};

/// Agreement of all participants with their generalised mean.
struct ComparisonConsistency {
  ConsistencyTest joint;                     ///< All quantities together.
  std::vector<ConsistencyTest> of_quantity;  ///< Each alone.
  double birge(std::size_t quantity) const;  ///< Birge ratio, sqrt(chi2 / degrees of freedom).
};

/// @throws KeyComparisonError fewer than two participants, sizes that do not fit; std::invalid_argument as
/// generalised_mean()
ComparisonConsistency consistency_of_participants(const ParticipantResults& results);

/// Reference value and degrees of equivalence. For kRandomEffects the differences are judged by the stated
/// uncertainties, without the effects that these do not cover; `between` is that of between_variance() in
/// each group.
/// @throws as consistency_of_participants(); KeyComparisonError if a subset is wanted and no majority agrees
ReferenceValue reference_value(const ParticipantResults& results, const ReferenceOptions& options);

/// Degree of equivalence of two participants, D_ij = x_i - x_j, of p quantities.
struct PairEquivalence {
  Eigen::VectorXd difference;
  Eigen::MatrixXd covariance;
  Eigen::VectorXd expanded;  ///< k u for 95 %, with the larger k of the two.
};
PairEquivalence pair_equivalence(const ParticipantResults& results, Eigen::Index i, Eigen::Index j);

/// A participant's claims against the reference value.
struct ClaimTest {
  int beyond = 0;         ///< Quantities with |D| > U.
  ConsistencyTest joint;  ///< All its differences together.
};
std::vector<ClaimTest> test_claims(const ParticipantResults& results, const ReferenceValue& reference);

/// A participant whose result differs from those of the others by more than chance explains.
struct FaultyParticipant {
  std::size_t participant = 0;
  /// The quantity whose error alone explains the difference best; absent if no single one does so
  /// significantly.
  std::optional<Eigen::Index> quantity;
};

/// Participants whose differences are larger than chance explains. Each is compared with the mean of the
/// others of the largest consistent subset; if no majority agrees, nobody is named. Two tests share `level`
/// equally: chi2 of all quantities, and for each quantity the error that it alone would have, in its standard
/// uncertainty. With Bonferroni's limits (level / 2n and level / 2np) a round without faults names one with a
/// probability of at most `level`.
/// @return in ascending order
std::vector<FaultyParticipant> faulty_participants(const ParticipantResults& results, double level);

/// The faults that faulty_participants() finds: of each participant in each quantity alone the size of an
/// error with which the participant is named with a probability of at least `power`, if all others are right
/// and take part in the mean.
/// @return n p, in the units of the quantities
Eigen::VectorXd detectable_faults(const ParticipantResults& results, double level, double power);

/// Scores of a difference from the assigned value (ISO 13528:2022, 9.4 to 9.7).
struct Scores {
  double e_n = 0.0;         ///< D / U(D); |E_n| <= 1 agrees.
  double zeta = 0.0;        ///< D / u(D); |zeta| <= 2 agrees.
  std::optional<double> z;  ///< D / sigma_pt, if a standard deviation for proficiency assessment is given.
};
Scores scores_of(double difference, double u, double expanded, const std::optional<double>& sigma_pt);

/// A participant of both this and an earlier comparison.
struct LinkingParticipant {
  Eigen::Index participant = 0;
  Eigen::VectorXd difference;  ///< Its degrees of equivalence of the earlier comparison, p.
  Eigen::VectorXd u;           ///< Their standard uncertainties, with its instability since then.
};

/// Degrees of equivalence with respect to the reference value of the earlier comparison.
struct LinkedDifferences {
  Eigen::VectorXd shift;  ///< Added to all differences of this comparison, p.
  Eigen::MatrixXd shift_covariance;
  Eigen::VectorXd differences;  ///< n p
  Eigen::MatrixXd covariance;
};
/// Adds to all differences the generalised mean of those by which the linking participants' earlier ones
/// exceed their present ones.
/// @throws KeyComparisonError no linking participant, or sizes that do not fit
LinkedDifferences linked_differences(const ParticipantResults& results, const ReferenceValue& reference,
                                     const std::vector<LinkingParticipant>& linking);

}  // namespace abcal
