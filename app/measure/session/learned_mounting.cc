#include "app/measure/session/learned_mounting.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "drivers/text/letters.h"
#include "protocol/linear/singular_values.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/mountings.h"

namespace abcal {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Changes = Eigen::Matrix<double, 3, 2>;  ///< Due to the turn of X, and to that of Z after it.

// An axis that turns gravity by less than this part of what it should does not turn the item: the axes are
// perpendicular to within degrees on any stage, and each turn changes the readings by a quarter g_loc at
// least.
constexpr double kLeastTurn = 0.25;
// With one dead output at least a quarter of each turn is left, and less if the item is tilted.
constexpr double kLeastOfDead = 0.1;
// If the unit does not imply the response: a turn that changes the readings by less of their length is not
// detected.
constexpr double kLeastPartOfReadings = 0.05;
// As of `abcal check`: room for a tilt, sensitivities and angles that are not nominal.
constexpr double kLargestResidual = 0.2;
// Sensitivities of real items are within some per cent of nominal; another unit or range is a factor of 2 or
// more.
constexpr double kResponseTolerance = 0.2;
// In g_loc. The wrong side is wrong by 1.9.
constexpr double kLargestOffset = 0.35;
// Changes below this (g_loc) are not significant: the least change of an output along an axis of the platter
// is 0.13, and one of 0.05 is left where the item is tilted as far as it may be.
constexpr double kLeastChange = 0.03;
// Standard uncertainty of a mean (g_loc) with which the direction of the smallest change is still known to 10
// degrees.
constexpr double kLargestNoise = 0.02;

/// Everything that the search for a mounting works with.
struct TurnReadings {
  const std::vector<PoseReading>& poses;
  const MountingSearch& search;
  Changes seen;      ///< R
  Changes expected;  ///< g_loc, in the platter's frame, with both signs +1.

  /// R for one g_loc by the turn of X (0) or Z (1) alone.
  double response_by(int axis) const { return seen.col(axis).norm() / expected.col(axis).norm(); }
  std::string value(double reading) const {
    return fmt::format("{:.3g}{}{}", reading, search.response_unit.empty() ? "" : " ", search.response_unit);
  }
};

TurnReadings turn_readings(const std::vector<PoseReading>& poses, const MountingSearch& search) {
  if (poses.size() != 3)
    throw std::invalid_argument(
        fmt::format("mounting: readings at {} poses of the stage; required: three", poses.size()));
  TurnReadings turn{poses, search, {}, {}};
  for (int k = 0; k < 2; ++k) {
    const PoseReading &before = poses[static_cast<std::size_t>(k)],
                      &after = poses[static_cast<std::size_t>(k) + 1];
    turn.seen.col(k) = after.mean - before.mean;
    turn.expected.col(k) = gravity_at(after.x, after.z) - gravity_at(before.x, before.z);
  }
  return turn;
}

void require_numbers(const TurnReadings& turn) {
  for (const PoseReading& pose : turn.poses) {
    if (!pose.mean.allFinite())
      throw MountingUnclear(
          fmt::format("mounting: the readings at X = {:g} deg, Z = {:g} deg are no numbers; required: "
                      "numbers. Check the accelerometer and its driver",
                      pose.x.deg(), pose.z.deg()));
  }
}

/// R for one g_loc: by the unit, or by the axis that turns gravity more.
double rough_response(const TurnReadings& turn) {
  if (turn.search.nominal_response) return *turn.search.nominal_response;
  return std::max(turn.response_by(0), turn.response_by(1));
}

void require_little_noise(const TurnReadings& turn) {
  const double response = rough_response(turn);
  for (const PoseReading& pose : turn.poses) {
    const double u = pose.u_mean.maxCoeff();
    if (!(u > kLargestNoise * response)) continue;
    throw MountingUnclear(
        fmt::format("mounting: the mean of the readings at X = {:g} deg, Z = {:g} deg has a standard "
                    "uncertainty of {}; required: at most {}. Noise or vibration hides how gravity changes: "
                    "check the cable and its shield, the supply, and what shakes the bench",
                    pose.x.deg(), pose.z.deg(), turn.value(u), turn.value(kLargestNoise * response)));
  }
}

/// Whether the turn of X (0) or Z (1) changes the readings by at least this part of what it should.
bool turns(const TurnReadings& turn, int axis, double part) {
  return turn.response_by(axis) >= part * rough_response(turn);
}

void require_any_turn(const TurnReadings& turn) {
  const double response = rough_response(turn);
  const double largest = turn.seen.colwise().norm().maxCoeff();
  const bool is_little =
      turn.search.nominal_response
          ? !turns(turn, 0, kLeastTurn) && !turns(turn, 1, kLeastTurn)
          : largest < kLeastPartOfReadings * turn.poses.front().mean.norm() || largest == 0.0;
  if (!is_little) return;
  const std::string required =
      turn.search.nominal_response
          ? fmt::format("about {} and {}", turn.value(turn.expected.col(0).norm() * response),
                        turn.value(turn.expected.col(1).norm() * response))
          : "half and a quarter of what g_loc makes";
  throw MountingUnclear(fmt::format(
      "mounting: turning X and Z by {:g} degrees changes the readings by {} and {}; required: {}. The "
      "accelerometer is not fixed to this stage, its outputs are dead, or its unit or range is another one: "
      "check the mount, both ports and response_unit",
      kSmallTurnDeg, turn.value(turn.seen.col(0).norm()), turn.value(turn.seen.col(1).norm()), required));
}

void require_living_outputs(const TurnReadings& turn) {
  // Where the whole item does not follow, an axis is named instead. One dead output leaves a quarter of each
  // turn.
  if (!turns(turn, 0, kLeastOfDead) || !turns(turn, 1, kLeastOfDead)) return;
  const double response = rough_response(turn);
  for (int j = 0; j < 3; ++j) {
    const bool is_constant =
        turn.seen.row(j).isZero(0.0) &&
        std::ranges::all_of(turn.poses, [&](const PoseReading& pose) { return pose.spread[j] == 0.0; });
    const bool is_deaf = turn.seen.row(j).cwiseAbs().maxCoeff() < kLeastChange * response &&
                         std::abs(turn.poses.front().mean[j]) < 0.5 * response;
    if (!is_constant && !is_deaf) continue;
    throw MountingUnclear(fmt::format(
        "mounting: output {} does not follow gravity: it reads {} at all three poses{}; required: an output "
        "that changes with the turn of at least one axis. Check its wire, its channel and its column",
        kOutputNames[j], turn.value(turn.poses.front().mean[j]), is_constant ? ", without any noise" : ""));
  }
}

/// Both turns must turn gravity.
void require_both_turns(const TurnReadings& turn) {
  for (const int axis : {0, 1}) {
    if (turns(turn, axis, kLeastTurn)) continue;
    throw MountingUnclear(fmt::format(
        "mounting: turning {} by {:g} degrees changes the readings by {}; required: about {}. {}",
        axis == 0 ? "X" : "Z", kSmallTurnDeg, turn.value(turn.seen.col(axis).norm()),
        turn.value(turn.expected.col(axis).norm() * rough_response(turn)),
        axis == 0 ? "That axis is vertical, so it may be the inner one: give the controller's names of the "
                    "outer and the inner axis, in this order (--axes), and state again how far each may turn"
                  : "The item does not turn with that axis, or that axis is vertical although X was turned: "
                    "check the mount, and the controller's names of the axes (--axes)"));
  }
}

/// A rotation or a reflection, and how well it explains the changes.
struct Fit {
  Matrix3d axes;  ///< Directions of u, v, w in the platter's frame, as rows; both signs +1.
  double response = 0.0;
  double residual = 0.0;  ///< Relative.
};

/// The nearest orthogonal matrix of the wanted determinant (orthogonal Procrustes problem).
Fit fit_changes(const TurnReadings& turn, double determinant) {
  const Matrix3d moment =
      turn.seen * turn.expected.transpose();  // It has rank 2: its third direction is free.
  const SingularValues svd = singular_value_decomposition(moment);
  const Matrix3d u = svd.u, v = svd.v;
  Vector3d sense = Vector3d::Ones();
  sense[2] = determinant * (u * v.transpose()).determinant();
  Fit fit;
  fit.axes = u * sense.asDiagonal() * v.transpose();
  const Changes explained = fit.axes * turn.expected;
  fit.response = (turn.seen.array() * explained.array()).sum() / explained.squaredNorm();
  fit.residual = (turn.seen - fit.response * explained).norm() / (fit.response * explained).norm();
  return fit;
}

/// Words for a factor between found and nominal sensitivity that a unit explains.
std::string unit_guess(double ratio) {
  constexpr double kG = 9.80665;
  const auto near = [ratio](double factor) { return std::abs(ratio / factor - 1.0) < kResponseTolerance; };
  if (near(kG)) return "The output is in m/s2, or a full scale is another one: ";
  if (near(1.0 / kG)) return "The output is in g, or a full scale is another one: ";
  if (near(1000.0) || near(1000.0 * kG) || near(1000.0 / kG)) return "The output is in thousandths: ";
  return "Unit or full scale is another one: ";
}

void require_response(const TurnReadings& turn, const Fit& fit) {
  if (!turn.search.nominal_response) return;
  const double nominal = *turn.search.nominal_response, ratio = fit.response / nominal;
  if (std::abs(ratio - 1.0) <= kResponseTolerance) return;
  throw MountingUnclear(fmt::format(
      "mounting: the readings change by {} for g_loc; required: {} within {:.0f} %. {}check response_unit "
      "and the range of the instrument",
      turn.value(fit.response), turn.value(nominal), 100.0 * kResponseTolerance, unit_guess(ratio)));
}

struct NearestMounting {
  Matrix3d axes = Matrix3d::Identity();
  std::string words;
  Angle tilt = Angle::degrees(180.0);
};

Angle turn_between(const Matrix3d& a, const Matrix3d& b) {
  const double cosine = ((a.transpose() * b).trace() - 1.0) / 2.0;
  return Angle::radians(std::acos(std::clamp(cosine, -1.0, 1.0)));
}

NearestMounting nearest_mounting(const Matrix3d& axes) {
  NearestMounting nearest;
  for (const Matrix3d& candidate : turns_of_cube())
    if (const Angle tilt = turn_between(candidate, axes); tilt < nearest.tilt)
      nearest = {candidate, mounting_words(candidate).value(), tilt};
  return nearest;
}

/// The item turned by half a turn about z, with X in the other sense, gives the same readings.
Matrix3d with_other_sign_of_x(const Matrix3d& axes) {
  return axes * Vector3d(-1.0, -1.0, 1.0).asDiagonal();
}

void apply_known_mounting(const Matrix3d& axes, const MountingSearch& search, LearnedMounting& learned) {
  const auto known = mounting_matrix(search.known);
  if (!known || known->determinant() < 0.0)
    throw std::invalid_argument(fmt::format(
        "mounting \"{}\": required: directions of u, v and w that are right-handed, as \"-y x z\"",
        search.known));
  const std::string other = nearest_mounting(with_other_sign_of_x(axes)).words;
  for (const int sign : {+1, -1}) {
    const Angle tilt = turn_between(*known, sign > 0 ? axes : with_other_sign_of_x(axes));
    if (tilt > Angle::degrees(kLargestLearnedTiltDeg)) continue;
    learned.sign_x = sign;
    learned.is_sign_x_known = true;
    learned.mounting = search.known;
    learned.tilt = tilt;
    return;
  }
  throw MountingUnclear(
      fmt::format("mounting: stated is \"{}\"; gravity shows \"{}\" (or \"{}\" if X counts the other way). "
                  "Turn the item as it is to be mounted, or state how it is",
                  search.known, learned.mounting, other));
}

}  // namespace

LearnedMounting learn_mounting(const std::vector<PoseReading>& poses, const MountingSearch& search) {
  const TurnReadings turn = turn_readings(poses, search);
  require_numbers(turn);
  require_any_turn(turn);
  require_little_noise(turn);
  require_living_outputs(turn);
  require_both_turns(turn);
  // Rotations and reflections explain changes due to two turns alike. The readings at zero distinguish them:
  // with the wrong ones gravity is on the other side, and the offset is nearly twice g_loc.
  const Vector3d at_zero = gravity_at(poses.front().x, poses.front().z);
  const auto offset_with = [&](const Fit& fit) {
    return (poses.front().mean / fit.response - fit.axes * at_zero).norm();
  };
  const Fit rotation = fit_changes(turn, +1.0), reflection = fit_changes(turn, -1.0);
  const bool is_rotation = offset_with(rotation) <= offset_with(reflection);
  const Fit& fit = is_rotation ? rotation : reflection;
  require_response(turn, fit);
  LearnedMounting learned;
  learned.response = fit.response;
  learned.offset = offset_with(fit);
  learned.sign_z = is_rotation ? +1 : -1;
  if (fit.residual > kLargestResidual)
    throw MountingUnclear(fmt::format(
        "mounting: no position of the item explains how the readings change: {:.0f} % are left; required: at "
        "most {:.0f} %. One output is dead or has another sensitivity, the stage's zeros are far from the "
        "horizontal, or the bench was shaken: look at the outputs one by one",
        100.0 * fit.residual, 100.0 * kLargestResidual));
  // With the reflection of x undone the outputs are right-handed, and Z turns the other way.
  const Matrix3d axes = is_rotation ? fit.axes : Matrix3d(fit.axes * Vector3d(-1.0, 1.0, 1.0).asDiagonal());
  const NearestMounting nearest = nearest_mounting(axes);
  learned.mounting = nearest.words;
  learned.tilt = nearest.tilt;
  if (nearest.tilt > Angle::degrees(kLargestLearnedTiltDeg))
    throw MountingUnclear(
        fmt::format("mounting: the item is turned by {:.0f} degrees from the nearest position along the "
                    "platter's axes, \"{}\"; required: at most {:g} degrees. Mount it along the platter's "
                    "axes, check that zero of both axes is where the platter is level, or write the bench "
                    "file by hand with its directions as nine numbers (docs/bench_file.md)",
                    nearest.tilt.deg(), nearest.words, kLargestLearnedTiltDeg));
  if (learned.offset > kLargestOffset)
    throw MountingUnclear(
        fmt::format("mounting: at zero the readings are {:.2f} g_loc away from where the turns say that "
                    "gravity is; required: at most {:.2f} g_loc. An output has a large offset or is dead, or "
                    "the platter is not level at zero of X",
                    learned.offset, kLargestOffset));
  if (!search.known.empty()) apply_known_mounting(axes, search, learned);
  return learned;
}

}  // namespace abcal
