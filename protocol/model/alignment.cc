#include "protocol/model/alignment.h"

#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

namespace abcal {

namespace {

// v cos a + (e x v) sin a + e (e . v) (1 - cos a)
Eigen::Vector3d turn(const Eigen::Vector3d& v, const Eigen::Vector3d& e, double sin_a, double cos_a,
                     double one_minus_cos_a) {
  return v * cos_a + e.cross(v) * sin_a + e * (e.dot(v) * one_minus_cos_a);
}

}  // namespace

Eigen::Vector3d rodrigues(const Eigen::Vector3d& v, const Eigen::Vector3d& e, Angle a) {
  const SinCos sc = sincos(a);
  return turn(v, e, sc.sin, sc.cos, 1.0 - sc.cos);
}

Eigen::Vector3d Alignment::z_axis() const {
  return {zx, zy, std::sqrt(1.0 - zx * zx - zy * zy)};
}

Eigen::Vector3d Alignment::x_axis() const {
  return {std::sqrt(1.0 - xz * xz), 0.0, xz};
}

Eigen::Matrix3d tilted(const Eigen::Matrix3d& platter_sensitivity, const Alignment& alignment) {
  // z x Z = (-Zy, Zx, 0); its length is sin Theta_E, and z . Z = Z_z = cos Theta_E: no angle is needed.
  const double sin_theta = std::hypot(alignment.zx, alignment.zy);
  if (sin_theta == 0.0) return platter_sensitivity;  // E is not defined, and nothing tilts
  const Eigen::Vector3d e(-alignment.zy / sin_theta, alignment.zx / sin_theta, 0.0);
  const double cos_theta = alignment.z_axis().z();
  const double one_minus_cos = sin_theta * sin_theta / (1.0 + cos_theta);  // 1 - cos without cancellation
  Eigen::Matrix3d s;
  for (Eigen::Index j = 0; j < 3; ++j) {
    s.row(j) =
        turn(platter_sensitivity.row(j).transpose(), e, sin_theta, cos_theta, one_minus_cos).transpose();
  }
  return s;
}

Angle AcsErrors::rotation_error(int experiment, int n) const {
  if (experiment < 1 || experiment > 3 || n < 1) {
    throw std::invalid_argument("rotation error of experiment " + std::to_string(experiment) +
                                ", n = " + std::to_string(n) + ": experiments are 1, 2, 3 and n starts at 1");
  }
  const std::vector<Angle>& f = step_errors[static_cast<std::size_t>(experiment - 1)];
  const auto index = static_cast<std::size_t>(n - 1);
  const Angle mean = experiment == 3 ? mean_step_z : mean_step_x;
  return index < f.size() ? mean + f[index] : mean;
}

}  // namespace abcal
