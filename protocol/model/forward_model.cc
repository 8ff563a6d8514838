#include "protocol/model/forward_model.h"

#include <Eigen/Geometry>
#include <stdexcept>
#include <string>

namespace abcal {

namespace {

// RRF(v, e, -a) as a function of a, split into a constant part and the parts that vary with cos a and with
// sin a.
GravityCircle circle_about(const Eigen::Vector3d& e, const Eigen::Vector3d& v) {
  const Eigen::Vector3d along = e * e.dot(v);
  return {along, v - along, v.cross(e)};
}

GravityCircle turned(const GravityCircle& circle, const Eigen::Vector3d& e, Angle a) {
  return {rodrigues(circle.centre, e, a), rodrigues(circle.cosine, e, a), rodrigues(circle.sine, e, a)};
}

}  // namespace

Eigen::Vector3d GravityCircle::at(Angle actual) const {
  const SinCos sc = sincos(actual);
  return centre + cosine * sc.cos + sine * sc.sin;
}

// The accelerometer turns, gravity stays: s turned by R, dotted with z, is s dotted with z turned back. So
// the rotations of docs/theory/model.md are undone on z, the last one first.
GravityCircle gravity_circle(int experiment, const AcsErrors& errors) {
  // Specific force at rest: up, not down (the platter pushes), 1 in units of g_loc.
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d x_axis = errors.alignment.x_axis();
  const Eigen::Vector3d z_axis = errors.alignment.z_axis();
  switch (experiment) {
    case 1:  // RRF(s, X, a)
      return circle_about(x_axis, up);
    case 2:  // RRF(RRF(s, Z, -90 + d2), X, a)
      return turned(circle_about(x_axis, up), z_axis, Angle::degrees(90.0) - errors.d2);
    case 3: {  // RRF(RRF(s, X, -90 + d3), RRF(Z, X, -90 + d3), a): Z rides on X
      const Angle initial_turn = Angle::degrees(-90.0) + errors.d3;
      return turned(circle_about(rodrigues(z_axis, x_axis, initial_turn), up), x_axis, -initial_turn);
    }
    default:
      throw std::invalid_argument("gravity circle of experiment " + std::to_string(experiment) +
                                  ": experiments are 1, 2, 3");
  }
}

Eigen::Vector3d gravity_in_aut(int experiment, int n, Angle alpha, const AcsErrors& errors) {
  return gravity_circle(experiment, errors).at(alpha + errors.rotation_error(experiment, n));
}

Eigen::Vector3d response(const AccelerometerModel& accelerometer, const Eigen::Vector3d& gravity, double t) {
  const Eigen::Array3d l_minus_o = (accelerometer.sensitivity_matrix * gravity).array();
  return (l_minus_o + accelerometer.offset.array() + accelerometer.k2.array() * l_minus_o.square() +
          accelerometer.k3.array() * l_minus_o.cube() + accelerometer.drift.array() * t)
      .matrix();
}

}  // namespace abcal
