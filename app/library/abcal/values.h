#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "abcal/export.h"

namespace abcal::v1 {
/// Numbers of one kind with their uncertainties: a matrix, or one column. All members have the same size.
/// NaN: not determined, or not evaluated.
struct Values {
  Eigen::MatrixXd value;
  Eigen::MatrixXd u;                   ///< Standard uncertainty: type A and type B combined.
  Eigen::MatrixXd type_a;              ///< From the scatter of the readings.
  Eigen::MatrixXd type_b;              ///< From other knowledge of the stage and the instrument.
  Eigen::MatrixXd degrees_of_freedom;  ///< Effective, of `u`; infinite where it rests on stated values.
  std::string unit;                    ///< "g/g_loc", "degree", ...

  bool empty() const { return value.size() == 0; }
};

/// A square matrix whose rows and columns have names. Empty where nothing was determined.
struct Covariance {
  std::vector<std::string> labels;  ///< "s_ux" ... "s_wz", "O_u", "O_v", "O_w"; or "s_u" ... "phi_uv" ...
  std::vector<std::string> units;   ///< Units of the quantities; an element has the product of two.
  Eigen::VectorXd values;           ///< The quantities themselves.
  Eigen::MatrixXd matrix;

  bool empty() const { return matrix.size() == 0; }
};

}  // namespace abcal::v1
