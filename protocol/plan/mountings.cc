#include "protocol/plan/mountings.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace abcal {
namespace {

Eigen::Matrix3d turned(const Eigen::Vector3d& axis, double angle) {
  // Entries of a turn of a cube are -1, 0 and 1: exactly so.
  return Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix().array().round().matrix();
}

/// Each of the three turns that exchange the axes in turn, followed by each of these. In the other order six
/// mountings give angles with a u that is 4 % larger.
std::vector<Eigen::Matrix3d> with_exchanged_axes(const std::vector<Eigen::Matrix3d>& then) {
  const Eigen::Vector3d diagonal = Eigen::Vector3d::Ones();
  std::vector<Eigen::Matrix3d> out;
  for (const int thirds : {0, 1, 2})
    for (const Eigen::Matrix3d& turn : then)
      out.emplace_back(turn * turned(diagonal, thirds * 2.0 * std::numbers::pi / 3.0));
  return out;
}

}  // namespace

std::vector<Eigen::Matrix3d> mounting_turns(int count) {
  constexpr double kHalfTurn = std::numbers::pi;
  const Eigen::Matrix3d none = Eigen::Matrix3d::Identity();
  const auto x = Eigen::Vector3d::UnitX(), y = Eigen::Vector3d::UnitY(), z = Eigen::Vector3d::UnitZ();
  switch (count) {
    case 2:
      return {none, turned(x, kHalfTurn / 2.0)};
    case 3:
      return with_exchanged_axes({none});
    case 6:
      return with_exchanged_axes({none, turned(z, kHalfTurn)});
    case 12:
      return with_exchanged_axes({none, turned(x, kHalfTurn), turned(y, kHalfTurn), turned(z, kHalfTurn)});
    default:
      throw std::invalid_argument(fmt::format("{} mountings; required: 2, 3, 6 or 12", count));
  }
}

const std::vector<Eigen::Matrix3d>& turns_of_cube() {
  static const std::vector<Eigen::Matrix3d> turns = [] {
    std::vector<Eigen::Matrix3d> out;
    std::array<int, 3> axis{0, 1, 2};
    do {
      for (unsigned signs = 0; signs < 8; ++signs) {
        Eigen::Matrix3d turn = Eigen::Matrix3d::Zero();
        for (unsigned k = 0; k < 3; ++k)
          turn(axis[k], static_cast<Eigen::Index>(k)) = (signs >> k & 1U) != 0U ? -1.0 : 1.0;
        if (turn.determinant() > 0.0) out.push_back(turn);
      }
    } while (std::next_permutation(axis.begin(), axis.end()));
    return out;
  }();
  return turns;
}

Message turn_in_words(const Eigen::Matrix3d& turn) {
  const Eigen::AngleAxisd turned(turn);
  const double degrees = std::round(turned.angle() * 180.0 / std::numbers::pi);
  if (degrees == 0.0) return Message("as in the first run");
  std::string axis;
  for (Eigen::Index k = 0; k < 3; ++k) {
    const double along = turned.axis()(k);
    if (std::abs(along) < 0.1) continue;
    axis += fmt::format("{}{}", along < 0.0 ? "-" : (axis.empty() ? "" : "+"), "XYZ"[k]);
  }
  return {"turned by {degrees:g} degrees about {axis}", degrees, axis};
}

std::optional<std::string> mounting_words(const Eigen::Matrix3d& directions) {
  constexpr double kTolerance = 1e-9;
  std::string words;
  for (Eigen::Index j = 0; j < 3; ++j) {
    Eigen::Index axis = 0;
    const double along = std::abs(directions.row(j).cwiseAbs().maxCoeff(&axis));
    if (std::abs(along - 1.0) > kTolerance) return std::nullopt;
    words += fmt::format("{}{}{}", j == 0 ? "" : " ", directions(j, axis) < 0.0 ? "-" : "", "xyz"[axis]);
  }
  return words;
}

}  // namespace abcal
