#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "drivers/instrument/angle.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// One rotation experiment of the ABC analysis: its desired angles, and the weights that turn readings into
/// A, B, C.
struct RotationFit {
  std::vector<Angle> alpha;              ///< Desired angles alpha(n), N of them.
  Eigen::VectorXd sin_alpha, cos_alpha;  ///< N each.
  /// N x 3. (A, B, C) = weights^T r is the least-squares fit of A sin(alpha) + B cos(alpha) + C to readings
  /// r.
  Eigen::Matrix<double, Eigen::Dynamic, 3> weights;
};

/// The angles of the three experiments and the linear map from readings to A, B, C
/// (docs/theory/abc_protocol.md). Serves any number of angles, unequal experiments and incomplete circles.
class AbcDesign {
 public:
  /// N = steps angles alpha(n) = (n-1) step in each experiment. The paper's: 72 steps of 5 degrees.
  /// @throws std::invalid_argument if the angles do not determine A, B and C.
  static AbcDesign uniform(int steps = 72, Angle step = Angle::degrees(5.0));

  /// The angles that a run has (closing angles left out).
  /// @throws std::invalid_argument naming the experiment whose angles do not determine A, B and C.
  static AbcDesign of_record(const RunRecord& record);

  /// @throws std::invalid_argument as above.
  static AbcDesign of_angles(const std::array<std::vector<Angle>, 3>& alpha);

  const std::array<RotationFit, 3>& experiments() const { return experiments_; }
  int readings() const;  ///< Angles of all three experiments together.

  /// Contribution of one reading of accelerometer j at angle n (from 0) of experiment 1..3 to (s_jx, s_jy,
  /// s_jz, O_j), per R.
  Eigen::Vector4d share(int experiment, Eigen::Index n) const;

 private:
  std::array<RotationFit, 3> experiments_;
};

}  // namespace abcal
