#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/random_stream.h"

namespace abcal {

/// One drawn world of an item in a run: the truth, and the readings that it gives. Relative units.
struct JointDraw {
  Eigen::VectorXd value;                   ///< The unknowns of the fit.
  Eigen::VectorXd stated;                  ///< Values that are stated of them: the means of their priors.
  std::vector<double> steps;               ///< Step errors without memory, of each reading (radian).
  std::vector<Eigen::Vector3d> came_from;  ///< Signs for the hysteresis, of the responses that were drawn.
  Eigen::VectorXd noise;                   ///< 3 N: white noise and process.
  Eigen::Vector3d process_mean = Eigen::Vector3d::Zero();  ///< Mean of the process over the run: part of O.
  Vector12 by_voltmeter = Vector12::Zero();                ///< Its error in s row by row and O (R).
};

/// Draws what a truth adds to the model of a fitted item in a run: noise, signs of the hysteresis, errors of
/// the voltmeter.
///
/// The noise: a process (tau, rho) with its posterior probability; white noise of Student's distribution
/// where the uncertainty of a reading is from the scatter of a dwell; where the fit estimated its size, that
/// is drawn for each output.
class DrawnReadings {
 public:
  /// @param own  a solution; it must outlive this
  DrawnReadings(const ItemFit& own, const RunRecord& record);

  const EffectModel& model() const { return model_; }
  const EffectSizes& sizes() const { return sizes_; }
  /// R of each output of the line response for one relative unit.
  const Vector12& units() const { return units_; }

  /// A number among the probable noises of the solution.
  std::size_t choose_noise(RandomStream& stream) const;
  void draw_noise(std::size_t noise, RandomStream& stream, JointDraw& draw) const;
  /// The fit takes both rules for the signs; an item follows one of them.
  void draw_signs(RandomStream& stream, JointDraw& draw) const;
  /// Errors that the voltmeter gives to s row by row and O (R); zero without draws where none is stated.
  Vector12 draw_voltmeter(RandomStream& stream) const;

  /// The readings of a drawn world (relative).
  Eigen::VectorXd readings_of(const JointDraw& draw) const;
  /// The readings as the fit takes them (R): those of the run with the values of a drawn world.
  std::vector<EffectReading> effect_readings_of(const JointDraw& draw) const;

 private:
  const ItemFit& own_;
  const EffectModel& model_;
  EffectSizes sizes_;
  Vector12 units_;
  Vector12 result_;                       ///< The line response of the run (R), for the voltmeter's share.
  std::vector<Eigen::Vector3d> degrees_;  ///< Degrees of freedom of each reading's u.
};

/// Degrees of freedom of the uncertainty that a dwell's scatter gives its means: the effective number of
/// readings less one. Infinite where it is not known (CSV), 3 at least (JCGM 101, 6.4.9.4: fewer have no
/// standard deviation); 0 where the resolution governs, so that the error is rectangular.
Eigen::Vector3d degrees_of_dwell(const DwellRecord& dwell);

}  // namespace abcal
