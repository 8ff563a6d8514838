#include "app/studies/calibration/second_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "protocol/plan/rotation_plan.h"

namespace abcal {
namespace {

using Eigen::Array3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;

Matrix3d turn(const Vector3d& axis, double angle) {
  return Eigen::AngleAxisd(angle, axis).toRotationMatrix();
}

/// The stage: where gravity is in the frame of the platter.
class TheoryStage {
 public:
  TheoryStage(const sim::StageTruth& truth, std::uint64_t seed) : truth_(truth), engine_(seed) {
    z_ = {truth.zx, truth.zy, std::sqrt(1.0 - truth.zx * truth.zx - truth.zy * truth.zy)};
    x_ = {std::sqrt(1.0 - truth.xz * truth.xz), 0.0, truth.xz};
    // The platter is perpendicular to Z.
    base_ = Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), z_).toRotationMatrix();
  }

  Vector3d up_at(double x, double z) const { return platter(x, z).transpose() * Vector3d::UnitZ(); }
  /// The platter in the LGCS with both axes at zero.
  Matrix3d at_zero() const { return platter(0.0, 0.0); }

  /// Actual angles of X and Z (radian) at an angle of the plan: the axis that turns has its map, the other
  /// one the error of its initial turn. At check poses, which only return, there are none.
  std::pair<double, double> actual(const PlannedAngle& at) {
    double x = at.x.rad(), z = at.z.rad();
    if (at.experiment == 1 || at.experiment == 2) x += mapped(truth_.x, at);
    if (at.experiment == 2) z += truth_.z.initial_turn_error.rad();
    if (at.experiment == 3) z += mapped(truth_.z, at);
    if (at.experiment == 3) x += truth_.x.initial_turn_error.rad();
    return {x, z};
  }

 private:
  double mapped(const sim::AxisTruth& axis, const PlannedAngle& at) {
    double error = axis.mean_step_error.rad() + step(axis, at);
    for (const sim::ErrorHarmonic& one : axis.harmonics)
      error += one.sin_coefficient.rad() * std::sin(one.order * at.alpha.rad()) +
               one.cos_coefficient.rad() * (std::cos(one.order * at.alpha.rad()) - 1.0);
    return error;
  }
  /// The closing angle is at the position of the first one of its experiment.
  double step(const sim::AxisTruth& axis, const PlannedAngle& at) {
    const auto [found, is_new] = steps_.try_emplace({at.experiment, at.n}, 0.0);
    if (is_new) found->second = axis.step_error_sd.rad() * normal_(engine_);
    return found->second;
  }
  static Matrix3d wobble(const sim::AxisTruth& axis, double angle, const Vector3d& first,
                         const Vector3d& second) {
    double about_first = 0.0, about_second = 0.0;
    for (const sim::WobbleHarmonic& one : axis.wobble) {
      const double c = std::cos(one.order * angle), s = std::sin(one.order * angle);
      about_first += one.cos_1_urad * c + one.sin_1_urad * s;
      about_second += one.cos_2_urad * c + one.sin_2_urad * s;
    }
    const Vector3d tilt = 1e-6 * (about_first * first + about_second * second);
    return tilt.norm() > 0.0 ? turn(tilt.normalized(), tilt.norm()) : Matrix3d::Identity();
  }
  Matrix3d platter(double x, double z) const {
    const Vector3d across_x = Vector3d::UnitZ().cross(x_).normalized();
    const Vector3d across_z = (Vector3d::UnitX() - z_.x() * z_).normalized();
    return wobble(truth_.x, x, across_x, x_.cross(across_x)) * turn(x_, x) *
           wobble(truth_.z, z, across_z, z_.cross(across_z)) * turn(z_, z) * base_;
  }

  const sim::StageTruth& truth_;
  std::mt19937_64 engine_;
  std::normal_distribution<double> normal_;
  Vector3d x_, z_;
  Matrix3d base_;
  std::map<std::pair<int, int>, double> steps_;
};

/// Relays of Preisach's kind: each reverses once its output has returned from its last extremum by a width of
/// its own, uniform up to that of the item.
class Relays {
 public:
  Relays(double width, std::mt19937_64& engine) {
    std::uniform_real_distribution<double> uniform(0.0, width);
    for (Relay& one : relays_) one.width = uniform(engine);
  }
  /// @return the mean of their signs
  double follow(double y) {
    double sum = 0.0;
    for (Relay& one : relays_) {
      if (!one.extremum) one.extremum = y;
      // Before the first turn either direction is possible.
      const bool up = one.sign > 0.0 || (one.sign == 0.0 && y >= *one.extremum);
      if (one.sign != 0.0) one.extremum = up ? std::max(*one.extremum, y) : std::min(*one.extremum, y);
      if (std::abs(y - *one.extremum) >= one.width) {
        one.sign = y > *one.extremum ? 1.0 : -1.0;
        one.extremum = y;
      }
      sum += one.sign;
    }
    return sum / static_cast<double>(relays_.size());
  }

 private:
  struct Relay {
    double width = 0.0, sign = 0.0;
    std::optional<double> extremum;
  };
  std::array<Relay, 100> relays_{};
};

/// The item.
class TheoryItem {
 public:
  TheoryItem(const sim::OutputTruth& truth, std::uint64_t seed) : truth_(truth), engine_(seed) {
    if (truth.hysteresis_width > 0.0)
      for (int j = 0; j < 3; ++j) relays_.emplace_back(truth.hysteresis_width, engine_);
  }

  Array3d linear(const Vector3d& up) const { return (truth_.sensitivity_matrix * up).array(); }

  /// The stage moves on, by one step of its way.
  void pass(const Vector3d& up) {
    const Array3d y = linear(up);
    for (int j = 0; j < static_cast<int>(relays_.size()); ++j)
      turned_(j) = relays_[static_cast<std::size_t>(j)].follow(y(j));
  }
  /// @param before  where the last motion began
  void arrive(const Vector3d& before, const Vector3d& up) {
    if (relays_.empty()) turned_ = (linear(up) - linear(before)).sign();
  }

  /// Share of the hysteresis at the present position of the stage, -1 to 1.
  const Array3d& turned() const { return turned_; }

  /// @param t  -1/2 to 1/2 over the run
  Array3d output(const Vector3d& up, const Array3d& turned, double t) const {
    const Array3d l = linear(up);
    const Array3d size = truth_.sensitivity_matrix.rowwise().norm().array();
    const Array3d y = l / size;
    Array3d bent = l + truth_.k2.array() * l.square() + truth_.k3.array() * l.cube() +
                   truth_.k4.array() * l.square().square() + truth_.k5.array() * l.square() * l.cube() +
                   truth_.asymmetry.array() * l.abs();
    for (int j = 0; j < 3; ++j) {
      const double a = y(j), b = y((j + 1) % 3), c = y((j + 2) % 3);
      bent(j) +=
          size(j) * (truth_.cross_ab(j) * a * b + truth_.cross_ac(j) * a * c + truth_.cross_bc(j) * b * c +
                     truth_.cross_bb(j) * b * b + truth_.cross_cc(j) * c * c);
    }
    const double x = 2.0 * t;
    const Array3d drift =
        0.5 * (truth_.drift_1.array() * x + truth_.drift_2.array() * (3.0 * x * x - 1.0) / 2.0 +
               truth_.drift_3.array() * (5.0 * x * x - 3.0) * x / 2.0);
    return (1.0 + t * truth_.sensitivity_drift.array()) * bent + truth_.offset.array() + drift +
           truth_.hysteresis.array() * turned;
  }

  /// The least-squares line over all directions of gravity (docs/theory/effects.md). Drifts have a mean of
  /// zero.
  sim::TrueLineResponse line(const Matrix3d& at_zero) const {
    const Matrix3d s = truth_.sensitivity_matrix * at_zero.transpose();
    const Array3d size = s.rowwise().norm().array();
    const Matrix3d n = size.inverse().matrix().asDiagonal() * s;
    sim::TrueLineResponse out;
    out.sensitivity_matrix = (1.0 + 3.0 / 5.0 * truth_.k3.array() * size.square() +
                              3.0 / 7.0 * truth_.k5.array() * size.square().square())
                                 .matrix()
                                 .asDiagonal() *
                             s;
    Array3d offset = truth_.offset.array() + truth_.k2.array() * size.square() / 3.0 +
                     truth_.k4.array() * size.square().square() / 5.0 + truth_.asymmetry.array() * size / 2.0;
    for (int j = 0; j < 3; ++j) {
      const Vector3d a = n.row(j), b = n.row((j + 1) % 3), c = n.row((j + 2) % 3);
      offset(j) += size(j) / 3.0 *
                   (truth_.cross_ab(j) * a.dot(b) + truth_.cross_ac(j) * a.dot(c) +
                    truth_.cross_bc(j) * b.dot(c) + truth_.cross_bb(j) + truth_.cross_cc(j));
    }
    out.offset = offset.matrix();
    return out;
  }

  /// The mean of readings with white noise, and what they show of it.
  void read(const Array3d& output, int readings, DwellRecord& dwell) {
    std::normal_distribution<double> normal;
    dwell.count = readings;
    dwell.u_mean = Vector3d::Zero();
    for (Eigen::Index j = 0; j < 3; ++j) {
      double sum = 0.0, squares = 0.0;
      for (int k = 0; k < readings; ++k) {
        const double one = truth_.noise * normal(engine_);
        sum += one;
        squares += one * one;
      }
      const double mean = sum / readings;
      dwell.mean(j) = output(j) + mean;
      dwell.spread(j) = std::sqrt(std::max(0.0, squares - sum * mean) / (readings - 1));
      (*dwell.u_mean)(j) = dwell.spread(j) / std::sqrt(static_cast<double>(readings));
    }
  }

 private:
  const sim::OutputTruth& truth_;
  std::mt19937_64 engine_;
  std::vector<Relays> relays_;
  Array3d turned_ = Array3d::Zero();
};

/// The way of the stage: X moves, then Z, each from below.
class TheoryWay {
 public:
  TheoryWay(TheoryStage& stage, std::vector<TheoryItem>& items, Angle approach)
      : stage_(stage), items_(items), approach_(approach.rad()) {}

  /// @return degrees turned
  double go_to(double x, double z) {
    way_ = 0.0;
    before_.reset();
    move(x_, x);
    move(z_, z);
    if (before_)
      for (TheoryItem& item : items_) item.arrive(*before_, stage_.up_at(x_, z_));
    return way_ * 180.0 / std::numbers::pi;
  }

 private:
  void move(double& axis, double to) {
    if (std::abs(to - axis) < kSame) return;
    if (to < axis && approach_ > 0.0) leg(axis, to - approach_);
    leg(axis, to);
  }
  void leg(double& axis, double to) {
    constexpr double kStep = 2e-3;
    before_ = stage_.up_at(x_, z_);
    const double from = axis;
    const int steps = 1 + static_cast<int>(std::abs(to - from) / kStep);
    for (int k = 1; k <= steps; ++k) {
      axis = from + (to - from) * k / steps;
      for (TheoryItem& item : items_) item.pass(stage_.up_at(x_, z_));
    }
    way_ += std::abs(to - from);
  }

  static constexpr double kSame =
      1e-3;  // An axis that is not commanded is at rest; its actual angle may differ slightly.
  TheoryStage& stage_;
  std::vector<TheoryItem>& items_;
  double approach_, x_ = 0.0, z_ = 0.0, way_ = 0.0;
  std::optional<Vector3d> before_;
};

RunRecord empty_record(const StudyBench& bench, const StudyItem& item) {
  RunRecord record;
  record.source = "second model";
  record.tolerances = item.sizes;
  record.limits = item.limits;
  record.expected = item.expected;
  record.estimator = "joint";
  record.step = bench.protocol.step;
  record.steps = bench.protocol.steps;
  record.approach = bench.protocol.approach;
  record.axes_order = AxesOrder::kXThenZ;
  return record;
}

}  // namespace

MeasuredRecords measure_by_theory(const StudyBench& bench, std::uint64_t seed) {
  TheoryStage stage(bench.stage, seed);
  std::vector<TheoryItem> items;
  MeasuredRecords out;
  for (const StudyItem& item : bench.items) {
    items.emplace_back(item.truth, seed + 1 + items.size());
    out.items.push_back(empty_record(bench, item));
    out.truths.push_back(items.back().line(stage.at_zero()));
  }
  const std::vector<PlannedAngle> plan =
      make_rotation_plan(bench.protocol, {AxisTravel{bench.stage.x.travel_min, bench.stage.x.travel_max},
                                          AxisTravel{bench.stage.z.travel_min, bench.stage.z.travel_max}});
  constexpr double kSettleS = 1.0;
  struct Stop {
    Vector3d up;
    double time_s = 0.0;
    std::vector<Array3d> turned;
  };
  std::vector<Stop> stops;
  TheoryWay way(stage, items, bench.protocol.approach);
  // First the way, which gives the times, then the readings: drifts are over the run.
  double time_s = 0.0;
  const double dwell_s = bench.protocol.dwell_readings / bench.items.front().reading_hz;
  for (const PlannedAngle& at : plan) {
    const auto [x, z] = stage.actual(at);
    time_s += way.go_to(x, z) / bench.stage.x.speed_deg_per_s + kSettleS + 0.5 * dwell_s;
    Stop& stop = stops.emplace_back(Stop{stage.up_at(x, z), time_s, {}});
    for (const TheoryItem& item : items) stop.turned.push_back(item.turned());
    time_s += 0.5 * dwell_s;
  }
  out.time_s = time_s;
  std::optional<double> first, last;
  for (std::size_t i = 0; i < plan.size(); ++i) {
    if (plan[i].check) continue;
    if (!first) first = stops[i].time_s;
    last = stops[i].time_s;
  }
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const double t = (stops[i].time_s - *first) / (*last - *first) - 0.5;
    for (std::size_t k = 0; k < items.size(); ++k) {
      DwellRecord dwell;
      dwell.experiment = plan[i].experiment;
      dwell.n = plan[i].n;
      dwell.closing = plan[i].closing;
      dwell.role = plan[i].check ? DwellRole::kCheck : DwellRole::kPlan;
      dwell.alpha = plan[i].alpha;
      dwell.commanded_x = plan[i].x;
      dwell.commanded_z = plan[i].z;
      dwell.time_s = stops[i].time_s;
      items[k].read(items[k].output(stops[i].up, stops[i].turned[k], t), bench.protocol.dwell_readings,
                    dwell);
      RunRecord& record = out.items[k];
      if (plan[i].check) {
        record.check_poses.push_back({dwell, record.dwells.size()});
      } else {
        record.dwells.push_back(dwell);
      }
    }
  }
  return out;
}

}  // namespace abcal
