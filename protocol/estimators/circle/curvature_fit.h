#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "protocol/estimators/circle/diagnostics.h"
#include "protocol/estimators/circle/harmonic_fit.h"
#include "protocol/estimators/circle/sensitivity_matrix.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// k2 and k3 of every output from the residuals of three circles after constant and first harmonic, and their
/// effect on an ABC result. ABC uses three circles, the measurand is the line over all directions of gravity:
/// the difference, `correction` times k, is subtracted from every ABC result. It is linear in the readings.
/// k is relative to S_j (the output's row norm): the deviation is S_j (k2 y^2 + k3 y^3).
class CurvatureFit {
 public:
  using Vector6 = Eigen::Matrix<double, 6, 1>;  ///< k2_u, k3_u, k2_v, k3_v, k2_w, k3_w

  /// @param series, fits  nine each, index 3 (experiment - 1) + accelerometer; fits of one harmonic
  /// @param outputs       the linear response: its rows make the shapes
  /// @param wanted        for k2 and k3; false: stated as zero, left out
  CurvatureFit(std::span<const DwellRecord* const> dwells, std::span<const ReadingSeries> series,
               std::span<const HarmonicFit> fits, const AbcOutputs& outputs, std::array<bool, 2> wanted);

  const Vector6& k() const { return k_; }
  /// Result of the ABC equations for one unit of each k, minus the line response (R).
  const Eigen::Matrix<double, 12, 6>& correction() const { return correction_; }
  /// Covariance of k where readings are weighted with 1/u^2; else to be multiplied by their variance.
  const Eigen::Matrix<double, 6, 6>& cofactor() const { return cofactor_; }
  /// S y^2 and S y^3 of an output at every dwell (R): 2 x dwells.
  const Eigen::Matrix2Xd& shape(std::size_t output) const { return shape_[output]; }
  /// Derivatives of k2 and k3 of an output by its readings: 2 x dwells.
  const Eigen::Matrix2Xd& weights(std::size_t output) const { return weights_[output]; }
  /// The linear response (at zero) that belongs to a line response; the shapes follow from it.
  AbcOutputs at_zero(const AbcOutputs& line) const;
  /// Change of k for a change of the readings, dwell by dwell from `first` on.
  Vector6 change_of_k(std::size_t first, std::span<const Eigen::Vector3d> change) const;
  /// The series minus the effects of k2 and k3.
  std::array<ReadingSeries, 9> cleaned(std::span<const ReadingSeries> series) const;

 private:
  void fit_output(int output, std::span<const DwellRecord* const> dwells,
                  std::span<const ReadingSeries> series, std::span<const HarmonicFit> fits,
                  std::array<bool, 2> wanted);

  std::array<Eigen::Matrix2Xd, 3> shape_;    ///< For each output: S y^2, S y^3 at every dwell (R).
  std::array<Eigen::Matrix2Xd, 3> weights_;  ///< k = weights times readings.
  Vector6 k_ = Vector6::Zero();
  Eigen::Matrix<double, 12, 6> correction_ = Eigen::Matrix<double, 12, 6>::Zero();
  Eigen::Matrix<double, 6, 6> cofactor_ = Eigen::Matrix<double, 6, 6>::Zero();
};

}  // namespace abcal
