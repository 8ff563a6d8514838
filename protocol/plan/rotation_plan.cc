#include "protocol/plan/rotation_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <string>
#include <utility>

#include "protocol/plan/faces.h"
#include "protocol/plan/sweep_margins.h"

namespace abcal {
namespace {

constexpr Angle kTurn = Angle::degrees(360.0);
constexpr std::size_t kX = 0;
constexpr std::size_t kZ = 1;

std::string number(double value) {
  return fmt::format("{:.8g}", value);
}

/// Words for a problem that the published protocol does not have.
std::string in_face(int face) {
  return face == 2 ? ", for face 2 (or [protocol] faces = 1)" : "";
}

std::string describe(const AxisTravel& travel) {
  return number(travel.min.deg()) + " to " + number(travel.max.deg()) + " deg";
}

/// `angle` moved by whole turns to the least value not below `lowest`; nullopt if that is above `highest`.
std::optional<Angle> representation(Angle angle, Angle lowest, Angle highest) {
  const double turns = std::ceil((lowest.deg() - angle.deg()) / kTurn.deg());
  const Angle moved = angle + kTurn * turns;
  if (moved > highest) return std::nullopt;
  return moved;
}

/// Possible positions of an axis at an angle: the angle itself and a turn to either side, within the travel.
std::vector<Angle> representations(Angle angle, const AxisTravel& travel, Angle approach) {
  const Angle lowest = travel.min + approach;
  std::vector<Angle> possible;
  for (const double turns : {0.0, -1.0, 1.0}) {
    const Angle moved = angle + kTurn * turns;
    if (moved >= lowest && moved <= travel.max) possible.push_back(moved);
  }
  if (possible.empty()) {
    if (const auto moved = representation(angle, lowest, travel.max)) possible.push_back(*moved);
  }
  return possible;
}

struct SweepAngle {
  int n;
  Angle alpha;
  Angle commanded;
};

/// The axis that turns, with its travel.
struct TurningAxis {
  std::string name;
  AxisTravel travel;
};

/// The way from rest to a rate, or from it to rest, with a time at the rate.
Angle way_to_rate(const ProtocolConfig& config, double rate_deg_per_s, double margin_s) {
  const double rate = std::abs(rate_deg_per_s);
  return Angle::degrees(rate * rate / (2.0 * config.acceleration_deg_per_s2) + margin_s * rate);
}

/// The way from rest to the first step of a sweep.
Angle run_up(const ProtocolConfig& config, double rate_deg_per_s) {
  return way_to_rate(config, rate_deg_per_s, kMarginBeforeS);
}

/// The angles of one circle that is swept at a constant rate: all in one turn of the axis, with room to reach
/// the rate.
std::vector<SweepAngle> turn_at_rate(const ProtocolConfig& config, const TurningAxis& axis,
                                     std::vector<Problem>& problems) {
  double fastest = 0.0;
  for (const double rate : config.rate_deg_per_s) fastest = std::max(fastest, rate);
  const Angle beyond = config.step * 0.5 + run_up(config, fastest);
  const Angle last = config.step * (config.steps - 1);
  const bool whole_turn = std::abs((config.step * config.steps - kTurn).deg()) < 1e-9;
  // A whole turn may begin at any of its angles; the nearest to 0 that the travel allows.
  const int turn = whole_turn ? 1 : static_cast<int>(std::ceil(kTurn.deg() / config.step.deg()));
  for (int k = 0; k <= 2 * config.steps; ++k) {
    const int begin = turn * (k % 2 == 0 ? k / 2 : -(k + 1) / 2);
    const Angle first = whole_turn ? config.step * begin : kTurn * (begin / turn);
    if (first - beyond - config.approach < axis.travel.min || first + last + beyond > axis.travel.max)
      continue;
    std::vector<SweepAngle> angles;
    for (int i = 0; i < config.steps; ++i) {
      const int n = whole_turn ? ((begin + i) % config.steps + config.steps) % config.steps : i;
      angles.push_back({n + 1, config.step * n, first + config.step * i});
    }
    return angles;
  }
  problems.push_back(
      {"axis " + axis.name, "travel " + describe(axis.travel),
       fmt::format("a travel of {} deg: the circle, and {} deg at either end for half a step and the way to "
                   "{} deg/s at {} deg/s2 ([protocol] rate_deg_per_s, acceleration_deg_per_s2)",
                   number((last + beyond * 2.0 + config.approach).deg()), number(beyond.deg()),
                   number(fastest), number(config.acceleration_deg_per_s2))});
  return {};
}

/// The angles of one circle by rising commanded angle, as near to alpha itself as the travel allows.
std::vector<SweepAngle> sweep(const ProtocolConfig& config, int face, const TurningAxis& axis,
                              std::vector<Problem>& problems) {
  if (config.is_constant_rate()) return turn_at_rate(config, axis, problems);
  const AxisTravel& travel = axis.travel;
  const Angle lowest_possible = travel.min + config.approach;
  const Angle last = config.step * (config.steps - 1);
  const bool fits_as_is = Angle{} >= lowest_possible && last <= travel.max && last < kTurn;
  const Angle lowest = fits_as_is ? Angle{} : lowest_possible;
  std::vector<SweepAngle> angles;
  std::string unreachable;
  for (int n = 1; n <= config.steps; ++n) {
    if (face_of(n, config.faces) != face) continue;
    const Angle alpha = config.step * (n - 1);
    if (const auto commanded = representation(alpha, lowest, travel.max)) {
      angles.push_back({n, alpha, *commanded});
    } else {
      unreachable += (unreachable.empty() ? "" : ", ") + number(alpha.deg());
    }
  }
  if (!unreachable.empty()) {
    problems.push_back({"axis " + axis.name, "travel " + describe(travel),
                        "a travel that reaches alpha = " + unreachable + " deg, coming from " +
                            number(config.approach.deg()) + " deg below (approach_deg)" + in_face(face)});
  }
  std::stable_sort(angles.begin(), angles.end(),
                   [](const SweepAngle& a, const SweepAngle& b) { return a.commanded < b.commanded; });
  return angles;
}

/// One way to measure a part of the plan: an experiment, or a visit of the check poses.
using Part = std::vector<PlannedAngle>;

double distance_deg(const PlannedAngle& from, const PlannedAngle& to) {
  return std::abs(to.x.deg() - from.x.deg()) + std::abs(to.z.deg() - from.z.deg());
}

/// How far both axes turn inside a part.
double travel_deg(const Part& part) {
  double sum = 0.0;
  for (std::size_t k = 1; k < part.size(); ++k) sum += distance_deg(part[k - 1], part[k]);
  return sum;
}

/// One way of each part, so that the axes turn least from the zero through all parts and back to the zero; of
/// ways that are equal, the first. (Shortest path through layers.)
std::vector<Part> least_travel(const std::vector<std::vector<Part>>& ways_of_parts) {
  struct Path {
    double travelled_deg = 0.0;
    std::vector<Part> parts;
    PlannedAngle at;
  };
  std::vector<Path> paths(1);
  const auto shortest_to = [&](const PlannedAngle& next) {
    return std::ranges::min_element(
        paths, {}, [&](const Path& path) { return path.travelled_deg + distance_deg(path.at, next); });
  };
  for (const std::vector<Part>& ways : ways_of_parts) {
    std::vector<Path> longer;
    for (const Part& part : ways) {
      Path path = *shortest_to(part.front());
      path.travelled_deg += distance_deg(path.at, part.front()) + travel_deg(part);
      path.at = part.back();
      path.parts.push_back(part);
      longer.push_back(std::move(path));
    }
    paths = std::move(longer);
  }
  return shortest_to(PlannedAngle{})->parts;
}

/// One circle: an experiment, or one face of it.
struct Circle {
  int experiment;
  int face;
  std::vector<SweepAngle> sweep;
  std::vector<Angle> held_at;  ///< Positions of the axis that does not turn.

  std::size_t turning() const { return experiment == 3 ? kZ : kX; }
  std::size_t standing() const { return experiment == 3 ? kX : kZ; }
};

constexpr std::array kAxisNames{"X", "Z"};

/// Positions in which an axis may be held at an angle, or a problem.
struct Holding {
  const std::array<AxisTravel, 2>& travel;
  Angle approach;
  std::vector<Problem>& problems;

  std::vector<Angle> at(Angle angle, std::size_t axis, int face = 1) const {
    std::vector<Angle> possible = representations(angle, travel.at(axis), approach);
    if (possible.empty()) {
      problems.push_back(
          {std::string("axis ") + kAxisNames.at(axis), "travel " + describe(travel.at(axis)),
           "a travel that includes the axis angle " + number(angle.deg()) + " deg" + in_face(face)});
    }
    return possible;
  }
};

/// The circles in their order.
std::vector<Circle> circles_of(const ProtocolConfig& config, const Holding& holding) {
  std::vector<Problem>& problems = holding.problems;
  if (config.faces == kFaces && config.steps % kFaces != 0) {
    problems.push_back({"[protocol] steps", std::to_string(config.steps) + " with faces = 2",
                        "an even number: half of the angles belong to each face"});
  }
  std::array<std::array<std::vector<SweepAngle>, 2>, kFaces> sweeps;  // Experiments 1 and 2 share that of X.
  for (int face = 1; face <= config.faces; ++face) {
    for (const std::size_t axis : {kX, kZ})
      sweeps.at(static_cast<std::size_t>(face - 1)).at(axis) =
          sweep(config, face, {kAxisNames.at(axis), holding.travel.at(axis)}, problems);
  }
  std::vector<Circle> circles;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int face = 1; face <= config.faces; ++face) {
      Circle& circle = circles.emplace_back(Circle{experiment, face, {}, {}});
      circle.sweep = sweeps.at(static_cast<std::size_t>(face - 1)).at(circle.turning());
      circle.held_at = holding.at(held_angle(experiment, face), circle.standing(), face);
    }
  }
  return circles;
}

/// A circle with the axis that does not turn at one of its positions.
Part measured_at(const Circle& circle, Angle held, const ProtocolConfig& config, const AxisTravel& turning) {
  Part part;
  const auto add = [&](int n, bool closing, Angle alpha, Angle commanded) {
    const bool turns_x = circle.turning() == kX;
    PlannedAngle& angle = part.emplace_back();
    angle = {circle.experiment, n, closing, alpha, turns_x ? commanded : held, turns_x ? held : commanded};
    angle.face = circle.face;
  };
  if (config.is_constant_rate()) {
    for (int k = 1; k <= config.sweeps; ++k) {
      const double rate =
          config.rate_deg_per_s.at(static_cast<std::size_t>(k - 1) % config.rate_deg_per_s.size());
      for (std::size_t i = 0; i < circle.sweep.size(); ++i) {
        // With an odd number of sweeps experiment 2 begins where experiment 1 ends.
        const bool up = (k % 2 == 1) != (config.sweeps % 2 == 1 && circle.experiment == 2);
        const SweepAngle& angle = circle.sweep[up ? i : circle.sweep.size() - 1 - i];
        add(angle.n, false, angle.alpha, angle.commanded);
        part.back().sweep = k;
        part.back().rate_deg_per_s = up ? rate : -rate;
      }
    }
    for (int k = 0; k < config.stops; ++k) {
      const SweepAngle& angle = circle.sweep[static_cast<std::size_t>(k) * circle.sweep.size() /
                                             static_cast<std::size_t>(config.stops)];
      add(angle.n, false, angle.alpha, angle.commanded);
    }
    return part;
  }
  for (const SweepAngle& angle : circle.sweep) add(angle.n, false, angle.alpha, angle.commanded);
  if (config.closing_angle) {
    const SweepAngle& first = circle.sweep.front();
    const Angle full_turn = first.commanded + kTurn;
    add(first.n, true, first.alpha + kTurn, full_turn <= turning.max ? full_turn : first.commanded);
  }
  return part;
}

/// Both check poses, in either order and with every turn that the travel allows.
std::vector<Part> ways_of_visit(const std::array<std::vector<Angle>, kCheckPoses>& x,
                                const std::array<std::vector<Angle>, kCheckPoses>& z) {
  const auto ways_of_pose = [&](std::size_t pose) {
    std::vector<PlannedAngle> ways;
    for (const Angle at_x : x[pose]) {
      for (const Angle at_z : z[pose])
        ways.push_back({0, static_cast<int>(pose) + 1, false, Angle{}, at_x, at_z, true});
    }
    return ways;
  };
  std::vector<Part> ways;
  for (const PlannedAngle& first : ways_of_pose(0)) {
    for (const PlannedAngle& second : ways_of_pose(1)) {
      ways.push_back({first, second});
      ways.push_back({second, first});
    }
  }
  return ways;
}

}  // namespace

PlanError::PlanError(std::vector<Problem> problems)
    : std::runtime_error([&] {
        std::string text = "the rotation plan cannot be executed";
        for (const Problem& problem : problems) text += "\n  " + to_string(problem);
        return text;
      }()),
      problems_(std::move(problems)) {}

std::size_t end_of_sweep(const std::vector<PlannedAngle>& plan, std::size_t position) {
  const PlannedAngle& first = plan.at(position);
  std::size_t end = position + 1;
  if (first.sweep == 0) return end;
  while (end < plan.size() && plan[end].sweep == first.sweep && plan[end].experiment == first.experiment &&
         plan[end].face == first.face)
    ++end;
  return end;
}

SweepTravel sweep_travel(const PlannedAngle& first, const PlannedAngle& last, const ProtocolConfig& config) {
  const double sense = first.rate_deg_per_s < 0.0 ? -1.0 : 1.0;
  const Angle half_step = config.step * 0.5;
  Angle after = way_to_rate(config, first.rate_deg_per_s, kMarginAfterS);
  if (first.sweep < config.sweeps) {
    // The next sweep of the circle begins where this one ends.
    const auto next = static_cast<std::size_t>(first.sweep) % config.rate_deg_per_s.size();
    after = std::max(after, run_up(config, config.rate_deg_per_s[next]));
  }
  return {first.turning() - (half_step + run_up(config, first.rate_deg_per_s)) * sense,
          last.turning() + (half_step + after) * sense};
}

bool can_sweep_from(Angle at, const SweepTravel& way, double rate_deg_per_s) {
  constexpr double kLongestDetourS = 1.0;
  const double lead_s = (way.from - at).deg() / rate_deg_per_s;
  return lead_s >= 0.0 && lead_s <= kLongestDetourS;
}

double readings_of_step(const ProtocolConfig& config, double rate_deg_per_s, double rate_hz) {
  return rate_hz * config.step.deg() / std::abs(rate_deg_per_s);
}

bool has_two_faces(const std::vector<PlannedAngle>& plan) {
  return std::ranges::any_of(plan, [](const PlannedAngle& angle) { return angle.face == 2; });
}

bool has_experiments(const std::vector<PlannedAngle>& plan) {
  return std::ranges::any_of(plan, [](const PlannedAngle& angle) { return angle.experiment > 0; });
}

std::array<CheckPose, kCheckPoses> check_poses() {
  const Angle tilt = Angle::degrees(std::atan(std::numbers::sqrt2) * 180.0 / std::numbers::pi);
  const Angle z = Angle::degrees(45.0);
  return {CheckPose{tilt, z}, CheckPose{tilt + kTurn * 0.5, z}};
}

std::vector<PlannedAngle> make_rotation_plan(const ProtocolConfig& config,
                                             const std::array<AxisTravel, 2>& travel) {
  std::vector<Problem> problems;
  const Holding holding{travel, config.approach, problems};
  const std::vector<Circle> circles = circles_of(config, holding);
  std::array<std::vector<Angle>, kCheckPoses> check_x, check_z;
  if (config.check_poses) {
    for (std::size_t pose = 0; pose < kCheckPoses; ++pose) {
      check_x[pose] = holding.at(check_poses()[pose].x, kX);
      check_z[pose] = holding.at(check_poses()[pose].z, kZ);
    }
  }
  if (!problems.empty()) throw PlanError(std::move(problems));

  std::vector<std::vector<Part>> ways_of_parts;
  const auto add_visit = [&] {
    if (config.check_poses) ways_of_parts.push_back(ways_of_visit(check_x, check_z));
  };
  add_visit();
  for (std::size_t k = 0; k < circles.size(); ++k) {
    std::vector<Part>& ways = ways_of_parts.emplace_back();
    for (const Angle at : circles[k].held_at)
      ways.push_back(measured_at(circles[k], at, config, travel[circles[k].turning()]));
    if (k + 1 == circles.size() || circles[k + 1].experiment != circles[k].experiment) add_visit();
  }
  std::vector<PlannedAngle> plan;
  for (const Part& part : least_travel(ways_of_parts)) plan.insert(plan.end(), part.begin(), part.end());
  return plan;
}

int readings_per_dwell(const ProtocolConfig& config, double rate_hz) {
  if (!(config.mains_hz > 0.0) || !(rate_hz > 0.0)) return config.dwell_readings;
  const double periods = std::ceil(config.dwell_readings * config.mains_hz / rate_hz);
  return std::max(config.dwell_readings, static_cast<int>(std::lround(periods * rate_hz / config.mains_hz)));
}

std::size_t quiet_window_size(const ProtocolConfig& config, double rate_hz) {
  return static_cast<std::size_t>(std::clamp(readings_per_dwell(config, rate_hz) / 4, 10, 50));
}

double least_settle_s(const ProtocolConfig& config, double rate_hz) {
  if (!config.settle_auto) return config.settle_s;
  return rate_hz > 0.0 ? static_cast<double>(quiet_window_size(config, rate_hz)) / rate_hz : 0.0;
}

std::array<AxisTravel, 2> cable_twist(const std::vector<PlannedAngle>& plan, const ProtocolConfig& config) {
  std::array<AxisTravel, 2> twist{AxisTravel{Angle{}, Angle{}}, AxisTravel{Angle{}, Angle{}}};
  std::array<Angle, 2> at{};
  const auto turn_to = [&](std::size_t axis, Angle to) {
    const Angle lowest = to < at[axis] ? to - config.approach : to;
    twist[axis].min = std::min(twist[axis].min, lowest);
    twist[axis].max = std::max(twist[axis].max, to);
    at[axis] = to;
  };
  for (std::size_t position = 0; position < plan.size(); position = end_of_sweep(plan, position)) {
    const PlannedAngle& angle = plan[position];
    if (angle.sweep > 0) {
      const auto way = sweep_travel(angle, plan[end_of_sweep(plan, position) - 1], config);
      turn_to(1 - angle.turning_axis(), angle.turning_axis() == kX ? angle.z : angle.x);
      turn_to(angle.turning_axis(), way.from);
      turn_to(angle.turning_axis(), way.to);
      continue;
    }
    turn_to(kX, angle.x);
    turn_to(kZ, angle.z);
  }
  turn_to(kX, Angle{});  // Parked.
  turn_to(kZ, Angle{});
  return twist;
}

double AxisSpeed::duration_s(double distance_deg) const {
  if (!(deg_per_s > 0.0)) return 0.0;
  if (!(deg_per_s2 > 0.0)) return distance_deg / deg_per_s;
  if (distance_deg < deg_per_s * deg_per_s / deg_per_s2) return 2.0 * std::sqrt(distance_deg / deg_per_s2);
  return distance_deg / deg_per_s + deg_per_s / deg_per_s2;
}

PlanDuration estimate_duration(const std::vector<PlannedAngle>& plan, const ProtocolConfig& config,
                               const std::array<AxisSpeed, 2>& speed, double rate_hz) {
  PlanDuration duration;
  std::array<Angle, 2> at{};
  const double dwell_s = rate_hz > 0.0 ? readings_per_dwell(config, rate_hz) / rate_hz : 0.0;
  const auto move = [&](std::size_t axis, Angle to) {
    if (to == at[axis]) return;
    const double distance_deg = std::abs(to.deg() - at[axis].deg());
    const double approach_deg = config.approach.deg();
    if (to < at[axis] && approach_deg > 0.0) {  // Past the target, and up to it again.
      duration.moving_s += speed[axis].duration_s(distance_deg + approach_deg);
      duration.moving_s += speed[axis].duration_s(approach_deg);
    } else {
      duration.moving_s += speed[axis].duration_s(distance_deg);
    }
    at[axis] = to;
  };
  for (std::size_t position = 0; position < plan.size(); position = end_of_sweep(plan, position)) {
    const PlannedAngle& angle = plan[position];
    if (angle.sweep > 0) {
      const std::size_t axis = angle.turning_axis();
      const SweepTravel way = sweep_travel(angle, plan[end_of_sweep(plan, position) - 1], config);
      const double rate = std::abs(angle.rate_deg_per_s);
      move(1 - axis, axis == kX ? angle.z : angle.x);
      if (!can_sweep_from(at[axis], way, angle.rate_deg_per_s)) move(axis, way.from);
      duration.dwelling_s +=
          std::abs((way.to - at[axis]).deg()) / rate + rate / config.acceleration_deg_per_s2;
      at[axis] = way.to;
      continue;
    }
    move(kX, angle.x);
    move(kZ, angle.z);
    duration.settling_s += least_settle_s(config, rate_hz);
    duration.dwelling_s += dwell_s;
  }
  return duration;
}

}  // namespace abcal
