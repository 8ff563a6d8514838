#include "protocol/model/stage_model.h"

#include <Eigen/Geometry>
#include <cmath>

namespace abcal {
namespace {

/// v turned by the small vector w, or back by it (-w).
Eigen::Vector3d tilted(const Eigen::Vector3d& v, const Eigen::Vector3d& w) {
  const Eigen::Vector3d first = w.cross(v);
  return v + first + 0.5 * w.cross(first);
}

/// v turned about `axis` by the angle with sine s and cosine c.
Eigen::Vector3d about_axis(const Eigen::Vector3d& v, const Eigen::Vector3d& axis, double s, double c) {
  return v * c + axis.cross(v) * s + axis * (axis.dot(v) * (1.0 - c));
}
/// Its derivative by a change `by` of the axis.
Eigen::Vector3d by_axis(const Eigen::Vector3d& v, const Eigen::Vector3d& axis, const Eigen::Vector3d& by,
                        double s, double c) {
  return by.cross(v) * s + (by * axis.dot(v) + axis * by.dot(v)) * (1.0 - c);
}

struct TurnAngle {
  double sin, cos;
};
TurnAngle turn_beyond(const AngleHarmonics& commanded, double extra) {
  const double s = std::sin(extra);
  const double c = std::cos(extra);
  return {commanded.sin[1] * c + commanded.cos[1] * s, commanded.cos[1] * c - commanded.sin[1] * s};
}

}  // namespace

AngleHarmonics AngleHarmonics::of(double sin_a, double cos_a) {
  AngleHarmonics out;
  out.cos[0] = 1.0;
  for (std::size_t m = 1; m <= kHarmonics; ++m) {
    out.sin[m] = out.sin[m - 1] * cos_a + out.cos[m - 1] * sin_a;
    out.cos[m] = out.cos[m - 1] * cos_a - out.sin[m - 1] * sin_a;
  }
  return out;
}

StagePose StagePose::of(int experiment, double sin_alpha, double cos_alpha) {
  const AngleHarmonics moving = AngleHarmonics::of(sin_alpha, cos_alpha);
  const AngleHarmonics back = AngleHarmonics::of(-1.0, 0.0);  // -90 degrees
  if (experiment == 1) return {1, moving, AngleHarmonics::of(0.0, 1.0)};
  if (experiment == 2) return {2, moving, back};
  return {3, back, moving};
}

GravityAt gravity_at(const StagePose& pose, const StageInputs& inputs) {
  const double zx = inputs(kInputZx);
  const double zy = inputs(kInputZy);
  const double xz = inputs(kInputXz);
  const double up = std::sqrt(1.0 - zx * zx - zy * zy);
  const double along = std::sqrt(1.0 - xz * xz);
  const Eigen::Vector3d x_axis(along, 0.0, xz);
  const Eigen::Vector3d z_axis(zx, zy, up);
  const Eigen::Vector3d tilt_x(0.0, inputs(kInputTiltXy), inputs(kInputTiltXz));
  const Eigen::Vector3d tilt_z(inputs(kInputTiltZx), inputs(kInputTiltZy), 0.0);
  const Eigen::Vector3d tilt_x0(0.0, inputs(kInputTiltXyAtZero), inputs(kInputTiltXzAtZero));
  const Eigen::Vector3d tilt_z0(inputs(kInputTiltZxAtZero), inputs(kInputTiltZyAtZero), 0.0);
  const TurnAngle x = turn_beyond(pose.x, inputs(kInputAngleX));
  const TurnAngle z = turn_beyond(pose.z, inputs(kInputAngleZ));

  // Gravity goes back through all that the item went through.
  const auto at_zero = [&](const Eigen::Vector3d& v) { return tilted(tilted(v, tilt_z0), tilt_x0); };
  const auto back_z = [&](const Eigen::Vector3d& v) { return about_axis(v, z_axis, -z.sin, z.cos); };
  const Eigen::Vector3d above_x = tilted(Eigen::Vector3d::UnitZ(), -tilt_x);
  const Eigen::Vector3d on_x = about_axis(above_x, x_axis, -x.sin, x.cos);
  const Eigen::Vector3d above_z = tilted(on_x, -tilt_z);
  const Eigen::Vector3d on_z = back_z(above_z);

  GravityAt out;
  out.g = at_zero(on_z);
  const auto from_x = [&](const Eigen::Vector3d& v) { return at_zero(back_z(tilted(v, -tilt_z))); };
  const auto from_tilt_x = [&](const Eigen::Vector3d& axis) {
    return from_x(about_axis(above_x.cross(axis), x_axis, -x.sin, x.cos));
  };
  using Eigen::Vector3d;
  out.by_input.col(kInputZx) = at_zero(by_axis(above_z, z_axis, Vector3d(1.0, 0.0, -zx / up), -z.sin, z.cos));
  out.by_input.col(kInputZy) = at_zero(by_axis(above_z, z_axis, Vector3d(0.0, 1.0, -zy / up), -z.sin, z.cos));
  out.by_input.col(kInputXz) =
      from_x(by_axis(above_x, x_axis, Vector3d(-xz / along, 0.0, 1.0), -x.sin, x.cos));
  out.by_input.col(kInputAngleX) = from_x(on_x.cross(x_axis));
  out.by_input.col(kInputAngleZ) = at_zero(on_z.cross(z_axis));
  out.by_input.col(kInputTiltXy) = from_tilt_x(Vector3d::UnitY());
  out.by_input.col(kInputTiltXz) = from_tilt_x(Vector3d::UnitZ());
  out.by_input.col(kInputTiltZx) = at_zero(back_z(on_x.cross(Vector3d::UnitX())));
  out.by_input.col(kInputTiltZy) = at_zero(back_z(on_x.cross(Vector3d::UnitY())));
  out.by_input.col(kInputTiltXyAtZero) = Vector3d::UnitY().cross(out.g);
  out.by_input.col(kInputTiltXzAtZero) = Vector3d::UnitZ().cross(out.g);
  out.by_input.col(kInputTiltZxAtZero) = Vector3d::UnitX().cross(out.g);
  out.by_input.col(kInputTiltZyAtZero) = Vector3d::UnitY().cross(out.g);
  return out;
}

}  // namespace abcal
