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

/// Its derivative by a change `by` of w.
Eigen::Vector3d by_tilt(const Eigen::Vector3d& v, const Eigen::Vector3d& w, const Eigen::Vector3d& by) {
  const Eigen::Vector3d first = by.cross(v);
  return first + 0.5 * (by.cross(w.cross(v)) + w.cross(first));
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

Eigen::Vector3d StagePose::axis_in_platter() const {
  if (!about_x()) return Eigen::Vector3d::UnitZ();
  // The platter is turned about Z: the X axis is turned back in it.
  return {z.cos[1], -z.sin[1], 0.0};
}

StagePose StagePose::of(int experiment, int face, double sin_alpha, double cos_alpha) {
  const AngleHarmonics moving = AngleHarmonics::of(sin_alpha, cos_alpha);
  const double side = face == 2 ? -1.0 : 1.0;
  if (experiment == 1) return {1, face, moving, AngleHarmonics::of(0.0, side)};  // 0 or 180 degrees
  const AngleHarmonics standing = AngleHarmonics::of(-side, 0.0);                // -90 or 90 degrees
  if (experiment == 2) return {2, face, moving, standing};
  return {3, face, standing, moving};
}

namespace {

/// The inverse rotations of gravity, from the room to the item.
struct WayBack {
  WayBack(const StagePose& pose, const StageInputs& inputs)
      : zx(inputs(kInputZx)),
        zy(inputs(kInputZy)),
        xz(inputs(kInputXz)),
        up(std::sqrt(1.0 - zx * zx - zy * zy)),
        along(std::sqrt(1.0 - xz * xz)),
        x_axis(along, 0.0, xz),
        z_axis(zx, zy, up),
        tilt_x(0.0, inputs(kInputTiltXy), inputs(kInputTiltXz)),
        tilt_z(inputs(kInputTiltZx), inputs(kInputTiltZy), 0.0),
        tilt_x0(0.0, inputs(kInputTiltXyAtZero), inputs(kInputTiltXzAtZero)),
        tilt_z0(inputs(kInputTiltZxAtZero), inputs(kInputTiltZyAtZero), 0.0),
        x(turn_beyond(pose.x, inputs(kInputAngleX))),
        z(turn_beyond(pose.z, inputs(kInputAngleZ))) {
    above_x = tilted(Eigen::Vector3d::UnitZ(), -tilt_x);
    on_x = about_axis(above_x, x_axis, -x.sin, x.cos);
    above_z = tilted(on_x, -tilt_z);
    on_z = back_z(above_z);
    g = at_zero(on_z) + inputs.segment<3>(kInputForceX);
  }

  Eigen::Vector3d at_zero(const Eigen::Vector3d& v) const { return tilted(tilted(v, tilt_z0), tilt_x0); }
  Eigen::Vector3d back_z(const Eigen::Vector3d& v) const { return about_axis(v, z_axis, -z.sin, z.cos); }
  Eigen::Vector3d from_x(const Eigen::Vector3d& v) const { return at_zero(back_z(tilted(v, -tilt_z))); }
  Eigen::Vector3d by_tilt_x(const Eigen::Vector3d& by) const {
    return from_x(about_axis(by_tilt(Eigen::Vector3d::UnitZ(), -tilt_x, -by), x_axis, -x.sin, x.cos));
  }
  Eigen::Vector3d by_tilt_z(const Eigen::Vector3d& by) const {
    return at_zero(back_z(by_tilt(on_x, -tilt_z, -by)));
  }
  Eigen::Vector3d by_tilt_x0(const Eigen::Vector3d& by) const {
    return by_tilt(tilted(on_z, tilt_z0), tilt_x0, by);
  }
  Eigen::Vector3d by_tilt_z0(const Eigen::Vector3d& by) const {
    return tilted(by_tilt(on_z, tilt_z0, by), tilt_x0);
  }

  double zx, zy, xz, up, along;
  Eigen::Vector3d x_axis, z_axis, tilt_x, tilt_z, tilt_x0, tilt_z0;
  TurnAngle x, z;
  Eigen::Vector3d above_x, on_x, above_z, on_z, g;
};

}  // namespace

Eigen::Vector3d gravity_alone(const StagePose& pose, const StageInputs& inputs) {
  return WayBack(pose, inputs).g;
}

GravityAt gravity_at(const StagePose& pose, const StageInputs& inputs) {
  using Eigen::Vector3d;
  const WayBack way(pose, inputs);
  const TurnAngle& x = way.x;
  const TurnAngle& z = way.z;
  const Vector3d by_zx(1.0, 0.0, -way.zx / way.up);
  const Vector3d by_zy(0.0, 1.0, -way.zy / way.up);
  const Vector3d by_xz(-way.xz / way.along, 0.0, 1.0);
  GravityAt out;
  out.g = way.g;
  out.by_input.col(kInputZx) = way.at_zero(by_axis(way.above_z, way.z_axis, by_zx, -z.sin, z.cos));
  out.by_input.col(kInputZy) = way.at_zero(by_axis(way.above_z, way.z_axis, by_zy, -z.sin, z.cos));
  out.by_input.col(kInputXz) = way.from_x(by_axis(way.above_x, way.x_axis, by_xz, -x.sin, x.cos));
  out.by_input.col(kInputAngleX) = way.from_x(way.on_x.cross(way.x_axis));
  out.by_input.col(kInputAngleZ) = way.at_zero(way.on_z.cross(way.z_axis));
  out.by_input.col(kInputTiltXy) = way.by_tilt_x(Vector3d::UnitY());
  out.by_input.col(kInputTiltXz) = way.by_tilt_x(Vector3d::UnitZ());
  out.by_input.col(kInputTiltZx) = way.by_tilt_z(Vector3d::UnitX());
  out.by_input.col(kInputTiltZy) = way.by_tilt_z(Vector3d::UnitY());
  out.by_input.col(kInputTiltXyAtZero) = way.by_tilt_x0(Vector3d::UnitY());
  out.by_input.col(kInputTiltXzAtZero) = way.by_tilt_x0(Vector3d::UnitZ());
  out.by_input.col(kInputTiltZxAtZero) = way.by_tilt_z0(Vector3d::UnitX());
  out.by_input.col(kInputTiltZyAtZero) = way.by_tilt_z0(Vector3d::UnitY());
  out.by_input.middleCols<3>(kInputForceX).setIdentity();
  return out;
}

}  // namespace abcal
