#include "protocol/estimators/shared/calibration_result.h"

#include <cmath>
#include <cstddef>

#include "drivers/text/names.h"
#include "protocol/statistics/distributions.h"

namespace abcal {

double coverage_factor(const Quantity& quantity, double probability) {
  return student_t_above(0.5 * (1.0 - probability), quantity.degrees_of_freedom);
}

std::string_view to_string(Verdict verdict) {
  static constexpr auto kNames = names<Verdict>(
      {{Verdict::kUsable, "usable"}, {Verdict::kDoubtful, "doubtful"}, {Verdict::kNotUsable, "not_usable"}});
  return kNames.of(verdict, "not_usable");
}

Eigen::Matrix3d CalibrationResult::sensitivity_values() const {
  Eigen::Matrix3d s = Eigen::Matrix3d::Constant(std::numeric_limits<double>::quiet_NaN());
  if (!sensitivity_matrix) return s;
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      s(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(k)) = (*sensitivity_matrix)[j][k].value;
    }
  }
  return s;
}

Eigen::Vector3d CalibrationResult::offset_values() const {
  return {offset[0].value, offset[1].value, offset[2].value};
}

}  // namespace abcal
