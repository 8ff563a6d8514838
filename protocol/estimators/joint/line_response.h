#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/noise_search.h"

namespace abcal {

/// The line response at one noise; relative units.
struct LineAtNoise {
  Vector12 change = Vector12::Zero();  ///< Change of the model's line_values(), with the mean of the process.
  Covariance12 covariance = Covariance12::Zero();
  std::vector<Covariance12> shares;  ///< Contributions of the priors, group by group.
  ReadingRows gain;                  ///< 3 N x 12
};

/// The unknowns that make one line of a budget.
struct ShareGroups {
  std::vector<EffectShare> groups;
  std::vector<int> of_unknown;  ///< Group of each unknown; -1: no prior.
  int first_step = -1;          ///< Group of f_1, followed by f_2, f_3; -1: no step errors are eliminated.
};

ShareGroups share_groups(const EffectModel& model);

/// Adds what the signs of the hysteresis leave unknown to its share: it is part of the noise, and so of the
/// covariance already. The line has its gain.
void add_share_of_signs(const EffectModel& model, const ShareGroups& groups, LineAtNoise& line);

/// The line response averaged over the noises, with its degrees of freedom and the shares of the priors, into
/// `fit`; relative units.
/// @param base     the line response of which the lines state the changes
/// @param weights  of the lines; their sum is 1
void average_line(const Vector12& base, ShareGroups groups, std::span<const LineAtNoise> lines,
                  std::span<const double> weights, EffectFit& fit);

/// Readings that scatter less than stated may make a noise with a smaller white part probable. No variance of
/// the line response becomes smaller by it: each is at least that at the stated white noise alone.
void keep_stated_noise(const LineAtNoise& at_stated, EffectFit& fit);

/// The variance of an output's estimated white noise is known to 2/nu (relative, squared).
/// @param gain  derivative of the line response by the output's own readings, relative units
void add_degrees_of_estimated_noise(const EffectModel& model, const WhiteFound& found,
                                    const ReadingRows& gain, EffectFit& fit);

/// R of each of the twelve outputs for one relative unit.
Vector12 units_of_line(const Eigen::Vector3d& unit);

/// Converts the line response, its covariances and its gain from relative units to those of the readings.
void restore_units(EffectFit& fit);

}  // namespace abcal
