#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "app/laboratory/pilot/key_comparison.h"

namespace abcal {

/// One measurement of the artefact by a participant. The pilot measures several times, all others once.
struct ArtefactMeasurement {
  std::size_t participant = 0;
  double time = 0.0;           ///< Transfers or days since the start; one unit for all.
  Eigen::VectorXd values;      ///< p
  Eigen::MatrixXd covariance;  ///< p x p
  /// Standard uncertainties of the part that differs from one repeat of the participant to the next, p. The
  /// rest is common to its repeats. Read of a participant with several measurements only.
  Eigen::VectorXd repeatability;
};

/// An effect that several participants have in common: a stage record, a value of gravity, a check standard.
/// Its size is given by `u`, or, where it is not known, by a correlation that it may cause.
struct SharedSource {
  std::string name;
  std::vector<std::size_t> participants;
  Eigen::VectorXd u;  ///< Its standard uncertainty in each of the p quantities, a part of the stated ones.
  /// Whether it is one effect that moves all quantities together with the signs of `u` (gravity in three
  /// sensitivities). If not, it is p independent effects.
  bool together = false;
  /// In place of `u`: correlation from -1 to 1 of the participants' results in `quantities`, which it moves
  /// as each result's own correlations of these. Where these are the same for two participants, the results
  /// of one quantity have this correlation, else at most.
  std::optional<double> correlation = {};
  std::vector<Eigen::Index> quantities = {};
};

enum class DriftModel {
  kNone,        ///< The artefact has one value.
  kLine,        ///< It changes in proportion to time.
  kLineOrWalk,  ///< It changes in proportion to time or wanders, which of them is not known.
};

/// The prior distribution of a drift that is a line or a random walk. Each quantity has its own kind and its
/// own size: the standard deviation of its change between the pilot's first and last measurements. A line has
/// a normal rate of mean 0; a walk has independent normal increments with variances in proportion to time.
/// The kind has the probability `walk`, and all sizes are equally probable.
struct DriftPrior {
  double walk = 0.5;
  /// In repeatabilities of the pilot's first measurement. A size below a tenth has no effect on repeats, and
  /// a step of half a power of ten is less than the factor to which a few repeats determine a standard
  /// deviation.
  std::vector<double> sizes{0.1, 0.316, 1.0, 3.16, 10.0, 31.6, 100.0, 316.0, 1000.0};
};

/// A change of the artefact that no line explains.
struct ArtefactStep {
  std::size_t before = 0, after = 0;  ///< Positions of the pilot's measurements on both sides.
  Eigen::Index quantity = 0;          ///< The one that changed most against its repeatability.
  double change = 0.0;                ///< Change of that quantity between the two, drift taken off.
  double u = 0.0;                     ///< Standard uncertainty of the change.
  ConsistencyTest test;               ///< Test of the model without a step.
};

/// The results of all participants at one moment.
struct TransferredResults {
  /// In the order of participants. The pilot's is the value of its fit at `reference_time`.
  ParticipantResults results;
  double reference_time = 0.0;  ///< The mean time of the pilot's measurements.
  /// Mean change in a unit of time between the pilot's first and last measurements, p; zero without drift.
  Eigen::VectorXd rate;
  Eigen::MatrixXd rate_covariance;
  /// Posterior probability that a quantity wanders, p; empty if a walk is not considered.
  Eigen::VectorXd walk_probability;
  ConsistencyTest constant;  ///< Test of one value for all repeats.
  std::optional<ConsistencyTest>
      line;  ///< With a line; absent for fewer than three repeats, or no drift model.
  /// Absent where a walk is considered: a step is an increment of it.
  std::optional<ArtefactStep> step;
};

/// Covariance of all measurements: of each with itself; of a participant's repeats all but their
/// repeatability; of different participants their shared sources.
/// @throws KeyComparisonError a repeatability that is not above 0 or above the stated uncertainty; a shared
/// source whose sizes do not fit; a correlation with which the covariance is not positive definite
Eigen::MatrixXd measurements_covariance(const std::vector<ArtefactMeasurement>& measurements,
                                        const std::vector<SharedSource>& shared);

/// Brings all results to the mean time of the pilot's measurements, by the drift that these show
/// (generalised least squares), with the covariances that this makes. With kLineOrWalk and three or more
/// repeats the corrections of lines and walks of all sizes are averaged, weighted by prior and marginal
/// likelihood (J. A. Hoeting et al., Statist. Sci. 14, 382, 1999); covariances include the differences
/// between these models. Kinds and sizes of different quantities are taken as independent, and each is judged
/// by the repeats of its quantity. Two repeats determine a line only, as with kLine.
/// @param measurements  in the order of time; each participant from 0 to the largest has one at least
/// @param coverage_factors  of each participant
/// @param level  a step is reported if the probability of the model without it is below this
/// @throws KeyComparisonError a participant other than the pilot with several measurements or without any, a
/// line through fewer than two measurements of the pilot, sizes that do not fit, a prior that is none
TransferredResults transferred_results(const std::vector<ArtefactMeasurement>& measurements,
                                       const std::vector<SharedSource>& shared,
                                       const std::vector<double>& coverage_factors, std::size_t pilot,
                                       DriftModel model, double level, const DriftPrior& prior = {});

}  // namespace abcal
