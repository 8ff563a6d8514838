#pragma once

#include <Eigen/Core>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "protocol/estimators/norm/norm_fit.h"
#include "protocol/plan/effect_sizes.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// Trials of the norm fit (JCGM 101): each draws the effects of the item from their stated distributions, the
/// angles between its axes where they are stated, and the noise of the poses; it makes the readings of this
/// item at the directions that were found, and solves them in full. The error is the solution less the item
/// that was drawn. Where the residuals gave the scatter of the poses, it is drawn for each trial with its
/// degrees of freedom (6.4.9). All trials depend on seed and number alone.
class NormTrials {
 public:
  /// Stated directions get errors of their own, each of all poses of one direction.
  /// @param fit  must outlive this; at least 2 degrees of freedom of its scatter
  NormTrials(const NormFit& fit, const EffectSizes& sizes, std::uint64_t seed);

  /// A TrialBlock: errors of the 18 outputs; those of the matrix are zero where the fit has no orientation;
  /// angles in degrees.
  void operator()(std::uint64_t first, std::size_t count, double* out) const;

  /// Trials so far that had no solution, and count as their linear approximation.
  std::uint64_t not_converged() const { return not_converged_; }

 private:
  Eigen::VectorXd drawn_item(RandomStream& stream) const;
  /// A direction of each pose, in the gauge of the fit.
  std::vector<Eigen::Vector3d> drawn_directions(double scatter, RandomStream& stream) const;
  OutputVector error(std::uint64_t trial) const;

  const NormFit& fit_;
  const EffectSizes& sizes_;
  std::uint64_t seed_;
  mutable std::atomic<std::uint64_t> not_converged_ = 0;
};

}  // namespace abcal
