#include "sim/sim_bench.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

#include "sim/counter_noise.h"
#include "sim/refusal.h"

namespace abcal::sim {
namespace {

constexpr std::size_t kKeptEpochs = 4096;
// exp(-40) is below the resolution of a double: the ring-down is over.
constexpr double kRingDownTimeConstants = 40.0;
constexpr double kMicro = 1e-6;
/// Half-widths of the gaps of the plays, as parts of half the width within which all turn round.
constexpr std::array<double, 4> kPlayGaps{0.2, 0.4, 0.7, 1.0};
constexpr double kFieldNorthGauss = 0.25;
constexpr double kFieldDownGauss = 0.45;

Angle angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b)));
}

void check_slow_effects(const OutputTruth& truth) {
  const auto finite = [](const Eigen::Vector3d& value, const char* what) {
    if (!value.allFinite()) refuse(what, "not finite", "finite");
  };
  finite(truth.k4, "k4");
  finite(truth.k5, "k5");
  finite(truth.asymmetry, "asymmetry");
  for (const Eigen::Vector3d* cross :
       {&truth.cross_ab, &truth.cross_ac, &truth.cross_bc, &truth.cross_bb, &truth.cross_cc})
    finite(*cross, "cross terms");
  finite(truth.hysteresis, "hysteresis");
  finite(truth.drift_1, "drift_1");
  finite(truth.drift_2, "drift_2");
  finite(truth.drift_3, "drift_3");
  finite(truth.exponential_drift, "exponential_drift");
  finite(truth.sinusoidal_drift, "sinusoidal_drift");
  finite(truth.sensitivity_drift, "sensitivity_drift");
  finite(truth.gain_step, "gain_step");
  finite(truth.mount_creep_urad, "mount_creep_urad");
  require(std::isfinite(truth.sinusoidal_drift_phase.deg()), "sinusoidal_drift_phase",
          truth.sinusoidal_drift_phase.deg(), "finite");
  require(std::isfinite(truth.gain_step_at_s), "gain_step_at_s", truth.gain_step_at_s, "finite");
  const auto size = [](double value, const char* what) {
    require(value >= 0.0 && std::isfinite(value), what, value, ">= 0");
  };
  size(truth.hysteresis_width, "hysteresis_width");
  size(truth.random_walk, "random_walk");
  size(truth.flicker_noise, "flicker_noise");
  size(truth.correlated_noise, "correlated_noise");
  const auto time = [](double value, const char* what) {
    require(value > 0.0 && std::isfinite(value), what, value, "> 0");
  };
  time(truth.exponential_drift_s, "exponential_drift_s");
  time(truth.sinusoidal_drift_period_s, "sinusoidal_drift_period_s");
  time(truth.correlated_noise_s, "correlated_noise_s");
  time(truth.mount_creep_s, "mount_creep_s");
}

void check(const OutputTruth& truth) {
  check_slow_effects(truth);
  const auto finite = [](const auto& matrix, const char* what) {
    if (!matrix.allFinite()) refuse(what, "not finite", "finite");
  };
  finite(truth.sensitivity_matrix, "sensitivity_matrix");
  finite(truth.offset, "offset");
  finite(truth.k2, "k2");
  finite(truth.k3, "k3");
  finite(truth.drift_per_hour, "drift_per_hour");
  finite(truth.offset_per_degc, "offset_per_degc");
  finite(truth.offset_per_degc2, "offset_per_degc2");
  finite(truth.offset_per_degc3, "offset_per_degc3");
  finite(truth.sensitivity_per_degc, "sensitivity_per_degc");
  finite(truth.sensitivity_per_degc2, "sensitivity_per_degc2");
  finite(truth.sensitivity_per_degc3, "sensitivity_per_degc3");
  finite(truth.offset_thermal_hysteresis, "offset_thermal_hysteresis");
  finite(truth.sensitivity_thermal_hysteresis, "sensitivity_thermal_hysteresis");
  const auto not_negative = [](double value, const char* what) {
    require(value >= 0.0 && std::isfinite(value), what, value, ">= 0");
  };
  not_negative(truth.noise, "noise");
  not_negative(truth.quantisation, "quantisation");
  not_negative(truth.ring_down_frequency_hz, "ring_down_frequency_hz");
  not_negative(truth.low_pass_hz, "low_pass_hz");
  not_negative(truth.group_delay_s, "group_delay_s");
  not_negative(truth.time_stamp_jitter_s, "time_stamp_jitter_s");
  finite(truth.rate_offset, "rate_offset");
  finite(truth.position_u_mm, "position_u_mm");
  finite(truth.position_v_mm, "position_v_mm");
  finite(truth.position_w_mm, "position_w_mm");
  require(truth.full_scale > 0.0, "full_scale", truth.full_scale, "> 0");
  require(truth.ring_down_decay_s > 0.0 && std::isfinite(truth.ring_down_decay_s), "ring_down_decay_s",
          truth.ring_down_decay_s, "> 0");
  require(std::isfinite(truth.ring_down_amplitude), "ring_down_amplitude", truth.ring_down_amplitude,
          "finite");
  require(std::isfinite(truth.temperature_degc), "temperature_degc", truth.temperature_degc, "finite");
  require(std::isfinite(truth.temperature_per_hour), "temperature_per_hour", truth.temperature_per_hour,
          "finite");
}

/// Returns the truth, with the seed of its noise in this run, if all of its numbers are possible; nothing is
/// constructed before this check.
ItemTruth checked(ItemTruth truth, std::uint64_t run) {
  check(truth);
  truth.seed = seed_of_run(truth.seed, run);
  return truth;
}

/// Time constant of the item's low-pass; 0: it has none.
double time_constant_s(const OutputTruth& truth) {
  return truth.low_pass_hz > 0.0 ? 1.0 / (2.0 * std::numbers::pi * truth.low_pass_hz) : 0.0;
}

}  // namespace

SimBench::SimBench(const BenchTruth& truth, Clock::Instant start)
    : SimBench(ItemTruth{truth, truth.seed}, truth, start) {}

SimBench::SimBench(const ItemTruth& item, const StageTruth& stage, Clock::Instant start)
    : SimBench(item,
               {std::make_shared<const DrawnStage>(stage), item.temperature_degc, item.temperature_per_hour},
               start) {}

SimBench::SimBench(ItemTruth item, Platter platter, Clock::Instant start)
    : item_(checked(std::move(item), platter.stage->truth().run)),
      platter_(std::move(platter)),
      stage_(*platter_.stage),
      start_(start),
      thermal_(stage().chamber, item_.temperature_degc, start_),
      platter_thermal_(stage().chamber, platter_.temperature_degc, start_),
      random_walk_(item_.seed, NoiseStream::kRandomWalk, stage().span_s, std::nullopt),
      correlated_(item_.seed, NoiseStream::kCorrelated, stage().span_s,
                  item_.correlated_noise_s / stage().span_s),
      flicker_(item_.seed, stage().span_s) {
  for (const StageAxis axis : kStageAxes) {
    const AxisTruth& a = stage().axis(axis);
    limits_[index(axis)] = {a.speed_deg_per_s, a.acceleration_deg_per_s2, a.acceleration_deg_per_s2};
  }
  Epoch rest{.start = start, .settled = start, .motion = {AxisMotion({}, start), AxisMotion({}, start)}};
  epochs_.push_back(std::move(rest));
}

const SimBench::Epoch& SimBench::epoch_at(Clock::Instant t) const {
  // Nearly always the last one: search from the end.
  for (auto epoch = epochs_.rbegin(); epoch != epochs_.rend(); ++epoch)
    if (epoch->start <= t) return *epoch;
  return epochs_.front();
}

std::shared_ptr<SimBench> SimBench::add_item(ItemTruth item) {
  const std::shared_ptr<SimBench> world(new SimBench(std::move(item), platter_, start_));
  const std::lock_guard lock(mutex_);
  followers_.push_back(world);
  return world;
}

std::vector<std::shared_ptr<SimBench>> SimBench::followers() const {
  const std::lock_guard lock(mutex_);
  return followers_;
}

void SimBench::move(StageAxis axis, Angle target, Clock::Instant t) {
  for (const auto& follower : followers()) follower->move(axis, target, t);
  const std::lock_guard lock(mutex_);
  const Epoch& now = epochs_.back();
  if (t < now.start) refuse("the time of a move", "before the move commanded last", "in order of time");
  const WorldFault* short_stop = find_fault(FaultKind::kStopsShort, t, axis);
  const AxisMotion& before = now.motion[index(axis)];
  const Angle from = before.position(t);
  if (short_stop != nullptr && std::isfinite(target.deg())) {
    const Angle missing = Angle::degrees(target < from ? -short_stop->value : short_stop->value);
    target = target - missing;
  }
  command(axis, AxisMotion::move(t, from, before.velocity_deg_per_s(t), target, limits_[index(axis)]), t);
}

void SimBench::place(StageAxis axis, Angle angle, Clock::Instant t) {
  for (const auto& follower : followers()) follower->place(axis, angle, t);
  if (!std::isfinite(angle.deg())) refuse("the angle of an axis", "not finite", "finite");
  const std::lock_guard lock(mutex_);
  const Epoch& now = epochs_.back();
  if (t < now.start) refuse("the time of a position", "before the move commanded last", "in order of time");
  if (now.motion[index(axis)].position(t) == angle && !now.motion[index(axis)].moving(t)) return;
  command(axis, AxisMotion(angle, t), t);
}

void SimBench::halt(StageAxis axis, Clock::Instant t) {
  for (const auto& follower : followers()) follower->halt(axis, t);
  const std::lock_guard lock(mutex_);
  const Epoch& now = epochs_.back();
  if (t < now.start) refuse("the time of a halt", "before the move commanded last", "in order of time");
  const AxisMotion& before = now.motion[index(axis)];
  if (!before.moving(t)) return;
  command(axis, AxisMotion::halt(t, before.position(t), before.velocity_deg_per_s(t), limits_[index(axis)]),
          t);
}

void SimBench::command(StageAxis axis, AxisMotion motion, Clock::Instant t) {
  for (const WorldFault& fault : faults_)
    if (fault.kind == FaultKind::kStalledAxis && fault.axis == axis && t < fault.until)
      motion.stall_at(fault.at);
  const Epoch& before = epochs_.back();
  Epoch next = before;
  next.start = t;
  // For the hysteresis the change of the outputs counts from the last rest at another pose; commands at one
  // instant are one motion.
  const bool was_at_rest = t >= before.settled && !before.motion[0].moving(t) && !before.motion[1].moving(t);
  const bool changes = motion.target() != before.motion[index(axis)].position(t);
  if (was_at_rest && changes && before.start < t) next.force_before = force(before, t);
  next.force_at_rest.reset();
  if (const OutputTruth& truth = truth_at(t); truth.hysteresis_width > 0.0)
    next.plays = plays_at(truth, before, t);
  next.plays_at_rest.reset();
  next.motion[index(axis)] = motion;
  if (motion.direction() != 0) next.backlash[index(axis)] = motion.direction() < 0;
  next.settled = t;
  for (std::size_t k = 0; k < 2; ++k) {
    next.settled = std::max(next.settled, next.motion[k].planned_end());
    next.pose[k] = canonical_pose(next.motion[k].target());
    next.error_from_deg[k] = error_deg(before, k, t);
  }
  for (const StageAxis each : kStageAxes) {
    const std::size_t k = index(each);
    next.error_to_deg[k] =
        stage_error(each, next.motion[k].target(), next.motion[1 - k].target()).deg() +
        (next.backlash[k] ? stage().axis(each).backlash.deg() : 0.0);  // lags behind a falling angle
  }
  epochs_.push_back(std::move(next));
  if (epochs_.size() > kKeptEpochs) epochs_.pop_front();
}

void SimBench::set_motion_limits(StageAxis axis, const MotionLimits& limits) {
  for (const auto& follower : followers()) follower->set_motion_limits(axis, limits);
  const auto positive = [](double value, const char* what) {
    require(value > 0.0 && std::isfinite(value), what, value, "> 0");
  };
  positive(limits.speed_deg_per_s, "speed_deg_per_s");
  positive(limits.acceleration_deg_per_s2, "acceleration_deg_per_s2");
  positive(limits.deceleration_deg_per_s2, "deceleration_deg_per_s2");
  const std::lock_guard lock(mutex_);
  limits_[index(axis)] = limits;
}

MotionLimits SimBench::motion_limits(StageAxis axis) const {
  const std::lock_guard lock(mutex_);
  return limits_[index(axis)];
}

bool SimBench::moving(StageAxis axis, Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return epoch_at(t).motion[index(axis)].moving(t);
}

Clock::Instant SimBench::motion_end(StageAxis axis, Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return epoch_at(t).motion[index(axis)].end();
}

Angle SimBench::target(StageAxis axis, Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return epoch_at(t).motion[index(axis)].target();
}

Angle SimBench::commanded_angle(StageAxis axis, Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return epoch_at(t).motion[index(axis)].position(t);
}

double SimBench::shift_deg(FaultKind kind, std::size_t axis, Clock::Instant t) const {
  const WorldFault* fault = find_fault(kind, t, axis == 0 ? StageAxis::kX : StageAxis::kZ);
  return fault == nullptr ? 0.0 : fault->value;
}

/// The commanded angle with the ripple of the rate, which is absent at rest.
double SimBench::position_deg(const Epoch& epoch, std::size_t axis, Clock::Instant t) const {
  const AxisMotion& motion = epoch.motion[axis];
  const double commanded_deg = motion.position(t).deg();
  const StageAxis which = kStageAxes[axis];
  if (stage().axis(which).rate_ripple == 0.0 || !motion.moving(t)) return commanded_deg;
  const double velocity = motion.velocity_deg_per_s(t);
  const double share = std::abs(velocity) / std::max(motion.peak_speed_deg_per_s(), 1e-9);
  return commanded_deg + share * stage_.ripple_deg(which, commanded_deg, velocity < 0.0 ? -1 : 1);
}

Angle SimBench::encoder_angle(StageAxis axis, Clock::Instant t) const {
  Angle exact;
  {
    const std::lock_guard lock(mutex_);
    if (epoch_at(t).motion[index(axis)].moving(t)) {
      double late_s = stage().encoder_latency_s;
      if (stage().encoder_jitter_s > 0.0) {
        const auto when = static_cast<std::uint64_t>(t.time_since_epoch().count());
        late_s += stage().encoder_jitter_s *
                  std::abs(normal_numbers(seed_of_run(stage().seed, stage().run), NoiseStream::kEncoder,
                                          {when, index(axis), 0, 0})[0]);
      }
      t -= from_seconds(late_s);
    }
    exact = Angle::degrees(position_deg(epoch_at(t), index(axis), t));
    exact += Angle::degrees(shift_deg(FaultKind::kMovedAxis, index(axis), t));
  }
  const double resolution = stage().axis(axis).encoder_resolution.deg();
  if (resolution == 0.0) return exact;
  return Angle::degrees(std::round(exact.deg() / resolution) * resolution);
}

double SimBench::error_deg(const Epoch& epoch, std::size_t axis, Clock::Instant t) const {
  if (t >= epoch.settled) return epoch.error_to_deg[axis];
  // On a long way the error follows its map; on a short one it changes evenly.
  constexpr double kLongWayDeg = 180.0;
  const AxisMotion& motion = epoch.motion[axis];
  const double way_deg = std::abs((motion.target() - motion.position(motion.start())).deg());
  if (motion.moving(t) && way_deg >= kLongWayDeg) {
    const StageAxis which = kStageAxes[axis];
    return stage_.error_on_the_way_deg(which, motion.position(t).deg(), epoch.motion[1 - axis].target()) +
           (epoch.backlash[axis] ? stage().axis(which).backlash.deg() : 0.0);
  }
  const double done =
      t <= epoch.start ? 0.0 : to_seconds(t - epoch.start) / to_seconds(epoch.settled - epoch.start);
  return epoch.error_from_deg[axis] + done * (epoch.error_to_deg[axis] - epoch.error_from_deg[axis]);
}

Angle SimBench::actual_angle(StageAxis axis, Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  const Epoch& epoch = epoch_at(t);
  const double shift =
      shift_deg(FaultKind::kMissedStep, index(axis), t) + shift_deg(FaultKind::kMovedAxis, index(axis), t);
  return Angle::degrees(position_deg(epoch, index(axis), t) + error_deg(epoch, index(axis), t) + shift);
}

Angle SimBench::stage_error(StageAxis axis, Angle commanded, Angle other_commanded) const {
  return stage_.error(axis, commanded, other_commanded);
}

Eigen::Vector3d SimBench::axis_z(Clock::Instant t) const {
  if (stage().zx_per_degc == 0.0) return stage_.axis_z();
  const double now_degc =
      platter_thermal_.in_use()
          ? platter_thermal_.item(t)
          : platter_.temperature_degc + platter_.temperature_per_hour * (to_seconds(t - start_) / 3600.0);
  const double from_start = now_degc - platter_.temperature_degc;
  return (stage_.axis_z() + from_start * stage().zx_per_degc * Eigen::Vector3d::UnitX()).normalized();
}

double SimBench::span_time(Clock::Instant t) const {
  return to_seconds(t - start_) / stage().span_s - 0.5;
}

/// Rotation from the base of the stage, which may tilt slowly, to the LGCS.
Eigen::Matrix3d SimBench::floor_tilt(Clock::Instant t) const {
  const Eigen::Vector3d tilt(stage().floor_tilt_x_urad, stage().floor_tilt_y_urad, 0.0);
  return turned_by(kMicro * span_time(t) * tilt + stage_.floor_of_run());
}

/// Up, seen from the base of the stage.
Eigen::Vector3d SimBench::up_in_base(Clock::Instant t) const {
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  // specific force at rest: up, not down
  if (stage().floor_tilt_x_urad == 0.0 && stage().floor_tilt_y_urad == 0.0 &&
      stage_.floor_of_run().isZero(0.0))
    return up;
  return floor_tilt(t).transpose() * up;
}

SimBench::Turn SimBench::turn_at(const Epoch& epoch, Clock::Instant t) const {
  Turn turn;
  for (std::size_t k = 0; k < 2; ++k) {
    const double shift_deg_k =
        shift_deg(FaultKind::kMissedStep, k, t) + shift_deg(FaultKind::kMovedAxis, k, t);
    const double at_deg = position_deg(epoch, k, t);
    turn.actual[k] = reduced_rad(at_deg + error_deg(epoch, k, t) + shift_deg_k);
    turn.commanded[k] = reduced_rad(at_deg);
  }
  return turn;
}

BodyMotion SimBench::body_motion(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  const Epoch& epoch = epoch_at(t);
  const Turn turn = turn_at(epoch, t);
  const Eigen::Matrix3d R_LP = floor_tilt(t) * stage_.orientation(turn.actual, turn.commanded, axis_z(t));
  // The rotation closest to the directions of the outputs (polar decomposition), right-handed in any case.
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(mounted_matrix(truth_at(t), t).rowwise().normalized(),
                                              Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double handed = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  const Eigen::Matrix3d R_BP =
      svd.matrixU() * Eigen::Vector3d(1.0, 1.0, handed).asDiagonal() * svd.matrixV().transpose();

  std::array<double, 2> rate_radps{};
  for (std::size_t k = 0; k < 2; ++k) {
    double rate_degps = epoch.motion[k].velocity_deg_per_s(t);
    if (t < epoch.settled && t >= epoch.start)
      rate_degps +=
          (epoch.error_to_deg[k] - epoch.error_from_deg[k]) / to_seconds(epoch.settled - epoch.start);
    rate_radps[k] = Angle::degrees(rate_degps).rad();
  }
  const Eigen::Vector3d rate_L =
      rate_radps[0] * stage_.axis_x() +
      rate_radps[1] * (Eigen::AngleAxisd(turn.actual[0], stage_.axis_x()) * axis_z(t));
  const Eigen::Matrix3d R_LB = R_LP * R_BP.transpose();
  const Eigen::Vector3d field_L(kFieldNorthGauss, 0.0, -kFieldDownGauss);
  return {R_LB, R_LB.transpose() * rate_L, R_LB.transpose() * field_L};
}

Eigen::Vector3d SimBench::force(const Epoch& epoch, Clock::Instant t) const {
  std::array<double, 2> shift{};
  for (std::size_t k = 0; k < 2; ++k)
    shift[k] = shift_deg(FaultKind::kMissedStep, k, t) + shift_deg(FaultKind::kMovedAxis, k, t);
  const bool level = stage().floor_tilt_x_urad == 0.0 && stage().floor_tilt_y_urad == 0.0;
  const bool rigid = stage().zx_per_degc == 0.0;
  const bool at_rest = level && rigid && shift[0] == 0.0 && shift[1] == 0.0 && t >= epoch.settled &&
                       !epoch.motion[0].moving(t) && !epoch.motion[1].moving(t);
  if (at_rest && epoch.force_at_rest) return *epoch.force_at_rest;
  const Turn turn = turn_at(epoch, t);
  const Eigen::Vector3d f_L = up_in_base(t);
  const Eigen::Vector3d f_P = stage_.orientation(turn.actual, turn.commanded, axis_z(t)).transpose() * f_L;
  if (at_rest) epoch.force_at_rest = f_P;
  return f_P;
}

Eigen::Vector3d SimBench::specific_force(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return force(epoch_at(t), t);
}

const OutputTruth& SimBench::truth_at(Clock::Instant t) const {
  for (auto change = changes_.rbegin(); change != changes_.rend(); ++change)
    if (change->at <= t) return change->truth;
  return item_;
}

void SimBench::change(const OutputTruth& truth, Clock::Instant at) {
  check(truth);
  const std::lock_guard lock(mutex_);
  if (!changes_.empty() && at < changes_.back().at)
    refuse("a change of the truth", "before the last one", "in order of time");
  changes_.push_back({at, truth});
}

OutputTruth SimBench::output_truth(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return truth_at(t);
}

double SimBench::item_temperature(const OutputTruth& truth, Clock::Instant t) const {
  if (thermal_.in_use()) return thermal_.item(t);
  return truth.temperature_degc + truth.temperature_per_hour * (to_seconds(t - start_) / 3600.0);
}

double SimBench::temperature_degc(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return item_temperature(truth_at(t), t);
}

void SimBench::command_chamber(const ChamberCommand& command, Clock::Instant t) {
  for (const auto& follower : followers()) follower->command_chamber(command, t);
  const std::lock_guard lock(mutex_);
  thermal_.command(command, t);
  platter_thermal_.command(command, t);
}

bool SimBench::chamber_in_use() const {
  const std::lock_guard lock(mutex_);
  return thermal_.in_use();
}

ChamberCommand SimBench::commanded_chamber() const {
  const std::lock_guard lock(mutex_);
  return thermal_.commanded();
}

double SimBench::chamber_set_point(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return thermal_.set_point(t);
}

double SimBench::chamber_air(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return thermal_.in_use() ? thermal_.air(t) : item_temperature(truth_at(t), t);
}

double SimBench::chamber_humidity_percent(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  return thermal_.humidity_percent(t);
}

/// Relative change of the sensitivity with the item's temperature.
Eigen::Array3d SimBench::thermal_gain(const OutputTruth& truth, Clock::Instant t) const {
  Eigen::Array3d gain = Eigen::Array3d::Zero();
  const bool curved = !truth.sensitivity_per_degc2.isZero(0.0) || !truth.sensitivity_per_degc3.isZero(0.0);
  if (curved || !truth.sensitivity_per_degc.isZero(0.0)) {
    const double d = item_temperature(truth, t) - item_.temperature_degc;
    gain += d * (truth.sensitivity_per_degc.array() +
                 d * (truth.sensitivity_per_degc2.array() + d * truth.sensitivity_per_degc3.array()));
  }
  if (thermal_.in_use() && !truth.sensitivity_thermal_hysteresis.isZero(0.0))
    gain += thermal_.hysteresis(t) * truth.sensitivity_thermal_hysteresis.array();
  return gain;
}

/// Change of the offset (R) with the item's temperature.
Eigen::Array3d SimBench::thermal_offset(const OutputTruth& truth, Clock::Instant t) const {
  const double d = item_temperature(truth, t) - item_.temperature_degc;
  Eigen::Array3d offset = d * (truth.offset_per_degc.array() +
                               d * (truth.offset_per_degc2.array() + d * truth.offset_per_degc3.array()));
  if (thermal_.in_use() && !truth.offset_thermal_hysteresis.isZero(0.0))
    offset += thermal_.hysteresis(t) * truth.offset_thermal_hysteresis.array();
  return offset;
}

SimOutput SimBench::output(Clock::Instant t, std::uint64_t sample_index,
                           Clock::Duration sample_period) const {
  if (stage().noise_seeded_by_angle && sample_period <= Clock::Duration::zero())
    refuse("the sample period", "not positive", "positive, as the noise restarts at each pose");
  const std::lock_guard lock(mutex_);
  SimOutput output = output_without_faults(epoch_at(t), t, sample_index, sample_period);
  for (const WorldFault& stuck : faults_) {
    if (stuck.kind != FaultKind::kStuckOutput || t < stuck.at || t >= stuck.until) continue;
    const Clock::Instant since = std::max(stuck.at, start_);
    // The sample index of that instant is not known; any fixed one gives a plausible reading.
    const SimOutput then = output_without_faults(epoch_at(since), since, 0, sample_period);
    if (stuck.output < 0) return then;
    output.value[stuck.output] = then.value[stuck.output];
    output.clipped[static_cast<std::size_t>(stuck.output)] =
        then.clipped[static_cast<std::size_t>(stuck.output)];
  }
  if (const WorldFault* clip = find_fault(FaultKind::kClippedOutput, t, StageAxis::kX)) {
    for (int j = 0; j < 3; ++j) {
      if (std::abs(output.value[j]) < clip->value) continue;
      output.value[j] = std::copysign(clip->value, output.value[j]);
      output.clipped[static_cast<std::size_t>(j)] = true;
    }
  }
  if (find_fault(FaultKind::kNotFinite, t, StageAxis::kX) != nullptr)
    output.value.setConstant(std::numeric_limits<double>::quiet_NaN());
  return output;
}

Eigen::Array3d SimBench::gain(const OutputTruth& truth, Clock::Instant t) const {
  Eigen::Array3d gain = Eigen::Array3d::Ones();
  if (!truth.sensitivity_drift.isZero(0.0)) gain += truth.sensitivity_drift.array() * span_time(t);
  if (!truth.gain_step.isZero(0.0) && to_seconds(t - start_) >= truth.gain_step_at_s)
    gain += truth.gain_step.array();
  gain += thermal_gain(truth, t);
  return gain;
}

/// Slow changes of the offset (R) other than its linear drift and its temperature coefficient.
Eigen::Array3d SimBench::slow_offset(const OutputTruth& truth, Clock::Instant t) const {
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  const double since_s = std::max(0.0, to_seconds(t - start_));
  const double x = 2.0 * span_time(t);  // -1 to 1 in the span
  if (!truth.drift_1.isZero(0.0)) sum += 0.5 * x * truth.drift_1.array();
  if (!truth.drift_2.isZero(0.0)) sum += 0.25 * (3.0 * x * x - 1.0) * truth.drift_2.array();
  if (!truth.drift_3.isZero(0.0)) sum += 0.25 * (5.0 * x * x - 3.0) * x * truth.drift_3.array();
  if (!truth.exponential_drift.isZero(0.0))
    sum += std::exp(-since_s / truth.exponential_drift_s) * truth.exponential_drift.array();
  if (!truth.sinusoidal_drift.isZero(0.0)) {
    const double cycles = since_s / truth.sinusoidal_drift_period_s;
    sum += std::sin(2.0 * std::numbers::pi * cycles + truth.sinusoidal_drift_phase.rad()) *
           truth.sinusoidal_drift.array();
  }
  if (truth.random_walk > 0.0) sum += truth.random_walk * random_walk_.at(since_s).array();
  if (truth.flicker_noise > 0.0) sum += truth.flicker_noise * flicker_.at(since_s).array();
  if (truth.correlated_noise > 0.0) sum += truth.correlated_noise * correlated_.at(since_s).array();
  return sum;
}

/// The sensitivity matrix along the platter's axes, including the creep of the mount.
Eigen::Matrix3d SimBench::mounted_matrix(const OutputTruth& truth, Clock::Instant t) const {
  if (truth.mount_creep_urad.isZero(0.0)) return truth.sensitivity_matrix;
  const double since_s = std::max(0.0, to_seconds(t - start_));
  const double done = -std::expm1(-since_s / truth.mount_creep_s);
  return truth.sensitivity_matrix * turned_by(kMicro * done * truth.mount_creep_urad).transpose();
}

/// The deviations from a straight line beyond k2 and k3.
Eigen::Array3d SimBench::bend(const OutputTruth& truth, const Eigen::Array3d& linear) const {
  const Eigen::Array3d square = linear.square();
  Eigen::Array3d sum = square * square * (truth.k4.array() + linear * truth.k5.array()) +
                       linear.abs() * truth.asymmetry.array();
  const Eigen::Array3d norm = truth.sensitivity_matrix.rowwise().norm().array();
  const Eigen::Array3d a = (norm > 0.0).select(linear / norm, 0.0);  // 0 for an output without response
  const Eigen::Array3d b(a[1], a[2], a[0]);
  const Eigen::Array3d c(a[2], a[0], a[1]);
  sum += norm *
         (truth.cross_ab.array() * a * b + truth.cross_ac.array() * a * c + truth.cross_bc.array() * b * c +
          truth.cross_bb.array() * b * b + truth.cross_cc.array() * c * c);
  return sum;
}

/// Specific forces on the elements of u, v, w (rows) by the turning of the axes, along x, y, z of the
/// platter, in g_loc: the acceleration of each element.
Eigen::Matrix3d SimBench::forces_by_turning(const OutputTruth& truth, Clock::Instant t) const {
  constexpr double kStandardGravity = 9.80665;
  constexpr Clock::Duration kShort = std::chrono::milliseconds(2);
  Eigen::Matrix3d forces = Eigen::Matrix3d::Zero();
  const Epoch& epoch = epoch_at(t);
  std::array<double, 2> rate{}, acceleration{};
  for (std::size_t k = 0; k < 2; ++k) {
    if (!epoch.motion[k].moving(t)) continue;
    const double before = position_deg(epoch, k, t - kShort);
    const double now = position_deg(epoch, k, t);
    const double after = position_deg(epoch, k, t + kShort);
    const double interval = to_seconds(kShort);
    rate[k] = Angle::degrees((after - before) / (2.0 * interval)).rad();
    acceleration[k] = Angle::degrees((after - 2.0 * now + before) / (interval * interval)).rad();
  }
  if (rate[0] == 0.0 && rate[1] == 0.0) return forces;
  const double turned_z = reduced_rad(position_deg(epoch, 1, t));
  const Eigen::AngleAxisd back(-turned_z, Eigen::Vector3d::UnitZ());
  const std::array<Eigen::Vector3d, 2> axes{back * Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ()};
  const Eigen::Vector3d from_x = back * Eigen::Vector3d(0.0, 1e-3 * stage().axes_distance_mm, 0.0);
  const std::array<Eigen::Vector3d, 3> places{truth.position_u_mm, truth.position_v_mm, truth.position_w_mm};
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 2; ++k) {
      const Eigen::Vector3d r = 1e-3 * places[j] + (k == 0 ? from_x : Eigen::Vector3d::Zero());
      const Eigen::Vector3d turning = rate[k] * axes[k];
      const Eigen::Vector3d a = turning.cross(turning.cross(r)) + acceleration[k] * axes[k].cross(r);
      forces.row(static_cast<Eigen::Index>(j)) += a.transpose() / kStandardGravity;
    }
  }
  return forces;
}

/// The linear response l - O at `t`, without filter and delay.
Eigen::Array3d SimBench::linear_response(const OutputTruth& truth, Clock::Instant t) const {
  const Eigen::Matrix3d mounted = mounted_matrix(truth, t);
  Eigen::Vector3d response = mounted * force(epoch_at(t), t);
  const bool at_centre = truth.position_u_mm.isZero(0.0) && truth.position_v_mm.isZero(0.0) &&
                         truth.position_w_mm.isZero(0.0) && stage().axes_distance_mm == 0.0;
  if (!at_centre) response += mounted.cwiseProduct(forces_by_turning(truth, t)).rowwise().sum();
  return response.array() * gain(truth, t);
}

/// The response of the elements without offset: linear, with its bends.
Eigen::Array3d SimBench::bent_response(const OutputTruth& truth, Clock::Instant t) const {
  const Eigen::Array3d linear = linear_response(truth, t);
  return linear + linear.square() * truth.k2.array() + linear.cube() * truth.k3.array() + bend(truth, linear);
}

/// bent_response() behind low-pass and delay: the filter of the output. An exponential memory is integrated
/// by Gauss and Laguerre's rule, exact for all that is smooth over a time constant.
Eigen::Array3d SimBench::filtered_response(const OutputTruth& truth, Clock::Instant t) const {
  constexpr std::array<std::array<double, 5>, 2> kTimes{
      std::array{0.26356031971814176, 1.4134030591065183, 3.596425771040722, 7.085810005858834,
                 12.640800844275784},
      {0.6170308532782699, 2.1129659585785228, 4.610833151017531, 8.39906697120484, 14.260103065920832}};
  constexpr std::array<std::array<double, 5>, 2> kWeights{
      std::array{0.5217556105828096, 0.39866681108317487, 0.07594244968170749, 0.003611758679922043,
                 2.3369972385776238e-05},
      {0.3480145400233489, 0.5022806741324928, 0.14091591949447282, 0.00871989302609997,
       6.897332358564013e-05}};
  constexpr double kMemory = 20.0;  // Time constants.
  const double constant_s = time_constant_s(truth);
  const Clock::Instant then = t - from_seconds(truth.group_delay_s);
  const Clock::Instant oldest = then - from_seconds(kMemory * constant_s);
  const Epoch& epoch = epoch_at(t);
  const bool at_rest = epoch.settled < oldest && !epoch.motion[0].moving(t) && !epoch.motion[1].moving(t);
  if (at_rest || oldest == t) return bent_response(truth, t);
  if (constant_s == 0.0) return bent_response(truth, then);
  const std::size_t order = truth.low_pass_order == 2 ? 1 : 0;
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  for (std::size_t i = 0; i < kTimes[order].size(); ++i)
    sum += kWeights[order][i] * bent_response(truth, then - from_seconds(constant_s * kTimes[order][i]));
  return sum;
}

/// The sign of the change of each output's response.
Eigen::Array3d SimBench::direction_at(const OutputTruth& truth, Clock::Instant t) const {
  constexpr Clock::Duration kJustBefore = std::chrono::milliseconds(2);
  const Clock::Instant before = t - kJustBefore;
  return (mounted_matrix(truth, t) * (force(epoch_at(t), t) - force(epoch_at(before), before)))
      .array()
      .sign();
}

/// direction_at() behind low-pass and delay: hysteresis belongs to the element, whose output is filtered. The
/// signs jump, so that the memory is split there.
Eigen::Array3d SimBench::filtered_direction(const OutputTruth& truth, Clock::Instant t) const {
  const Clock::Instant then = t - from_seconds(truth.group_delay_s);
  const double constant_s = time_constant_s(truth);
  if (constant_s == 0.0) return direction_at(truth, then);
  struct Past {
    double age = 0.0;  ///< Time constants.
    Eigen::Array3d sign;
  };
  const auto past = [&](double age) {
    return Past{age, direction_at(truth, then - from_seconds(constant_s * age))};
  };
  /// Share of the memory that is older.
  const auto older = [&](double age) {
    return truth.low_pass_order == 2 ? (1.0 + age) * std::exp(-age) : std::exp(-age);
  };
  constexpr std::array kAges{0.0, 1.0, 2.5, 5.0, 12.0};
  constexpr double kShortest = 0.02;
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  std::vector<Past> ahead;  // The nearest in time is at the back.
  for (auto age = kAges.rbegin(); age != kAges.rend(); ++age) ahead.push_back(past(*age));
  while (ahead.size() > 1) {
    const Past near = ahead.back();
    const Past& far = ahead[ahead.size() - 2];
    if ((near.sign == far.sign).all() || far.age - near.age < kShortest) {
      sum += 0.5 * (near.sign + far.sign) * (older(near.age) - older(far.age));
      ahead.pop_back();
    } else {
      ahead.back() = past(0.5 * (near.age + far.age));
      ahead.push_back(near);
    }
  }
  return sum;
}

/// The plays follow the response along its whole way: each is pushed where the response leaves its gap.
SimBench::Plays SimBench::plays_at(const OutputTruth& truth, const Epoch& epoch, Clock::Instant t) const {
  constexpr double kStepDeg = 0.1;
  if (t >= epoch.settled && epoch.plays_at_rest) return *epoch.plays_at_rest;
  const Clock::Instant end = std::min(t, epoch.settled);
  const auto response = [&](Clock::Instant at) -> Eigen::Array3d {
    return (mounted_matrix(truth, at) * force(epoch, at)).array();
  };
  Plays plays = epoch.plays ? *epoch.plays : Plays(response(epoch.start).replicate<1, kPlays>());
  double way_deg = 0.0;
  for (const AxisMotion& motion : epoch.motion)
    way_deg += std::abs((motion.position(end) - motion.position(epoch.start)).deg());
  const int steps = static_cast<int>(std::ceil(way_deg / kStepDeg)) + 1;
  for (int i = 1; i <= steps; ++i) {
    const Eigen::Array3d y = response(epoch.start + (end - epoch.start) * i / steps);
    for (int k = 0; k < kPlays; ++k) {
      const double gap = 0.5 * truth.hysteresis_width * kPlayGaps.at(static_cast<std::size_t>(k));
      plays.col(k) = plays.col(k).max(y - gap).min(y + gap);
    }
  }
  if (t >= epoch.settled) epoch.plays_at_rest = plays;
  return plays;
}

/// The part of the hysteresis in the outputs (R).
Eigen::Array3d SimBench::hysteresis_at(const OutputTruth& truth, const Epoch& epoch, Clock::Instant t) const {
  if (truth.hysteresis_width > 0.0) {
    if (t < epoch.settled) return Eigen::Array3d::Zero();
    const Plays plays = plays_at(truth, epoch, t);
    const Eigen::Array3d y = (mounted_matrix(truth, t) * force(epoch, t)).array();
    Eigen::Array3d turned = Eigen::Array3d::Zero();
    for (int k = 0; k < kPlays; ++k)
      turned += (y - plays.col(k)) /
                (0.5 * truth.hysteresis_width * kPlayGaps.at(static_cast<std::size_t>(k)) * kPlays);
    return truth.hysteresis.array() * turned;
  }
  // During motion the direction is that from the output just before.
  if (epoch.motion[0].moving(t) || epoch.motion[1].moving(t))
    return truth.hysteresis.array() * filtered_direction(truth, t);
  if (epoch.force_before.isZero(0.0)) return Eigen::Array3d::Zero();
  return truth.hysteresis.array() *
         (mounted_matrix(truth, t) * (force(epoch, t) - epoch.force_before)).array().sign();
}

double SimBench::rate_over_reference(const Epoch& epoch, Clock::Instant t) const {
  constexpr double kReferenceDegPerS = 60.0;
  return (epoch.motion[0].velocity_deg_per_s(t) + epoch.motion[1].velocity_deg_per_s(t)) / kReferenceDegPerS;
}

SimOutput SimBench::output_without_faults(const Epoch& epoch, Clock::Instant t, std::uint64_t sample_index,
                                          Clock::Duration sample_period) const {
  const OutputTruth& truth = truth_at(t);
  const double hours = to_seconds(t - start_) / 3600.0;
  SimOutput output;
  output.temperature_degc = item_temperature(truth, t);

  Eigen::Array3d r;
  if (truth.low_pass_hz > 0.0 || truth.group_delay_s > 0.0) {
    r = filtered_response(truth, t) + truth.offset.array() + truth.drift_per_hour.array() * hours +
        thermal_offset(truth, t) + slow_offset(truth, t);
  } else {
    const Eigen::Array3d linear = linear_response(truth, t);  // l - O
    r = linear + truth.offset.array() + linear.square() * truth.k2.array() +
        linear.cube() * truth.k3.array() + truth.drift_per_hour.array() * hours + thermal_offset(truth, t);
    r += bend(truth, linear) + slow_offset(truth, t);
  }
  if (!truth.rate_offset.isZero(0.0)) r += truth.rate_offset.array() * rate_over_reference(epoch, t);
  if (!truth.hysteresis.isZero(0.0)) r += hysteresis_at(truth, epoch, t);

  if (truth.ring_down_amplitude != 0.0) {
    for (const AxisMotion& motion : epoch.motion) {
      if (motion.moving(t) || motion.direction() == 0) continue;
      const double since_s = to_seconds(t - motion.end());
      const double decayed = since_s / truth.ring_down_decay_s;
      if (decayed > kRingDownTimeConstants) continue;
      r += truth.ring_down_amplitude * motion.peak_speed_deg_per_s() * std::exp(-decayed) *
           std::sin(2.0 * std::numbers::pi * truth.ring_down_frequency_hz * since_s);
    }
  }

  if (truth.noise > 0.0) {
    std::array<double, 4> normal{};
    if (stage().noise_seeded_by_angle) {
      const bool settled = t >= epoch.settled;
      const Clock::Instant since = settled ? epoch.settled : epoch.start;
      const auto samples_since =
          static_cast<std::uint64_t>(std::max<std::int64_t>(0, (t - since) / sample_period));
      normal = normal_numbers(item_.seed, NoiseStream::kReadingAtPose,
                              {samples_since, epoch.pose[0], epoch.pose[1], settled ? 1U : 0U});
    } else {
      normal = normal_numbers(item_.seed, NoiseStream::kReading, {sample_index, 0, 0, 0});
    }
    r += truth.noise * Eigen::Array3d(normal[0], normal[1], normal[2]);
  }

  for (int j = 0; j < 3; ++j) {
    if (truth.quantisation > 0.0) r[j] = std::round(r[j] / truth.quantisation) * truth.quantisation;
    if (std::abs(r[j]) >= truth.full_scale) {
      r[j] = std::copysign(truth.full_scale, r[j]);
      output.clipped[static_cast<std::size_t>(j)] = true;
    }
  }
  output.value = r.matrix();
  return output;
}

Eigen::Matrix3d SimBench::true_sensitivity_matrix() const {
  return item_.sensitivity_matrix * stage_.platter_at_rest().transpose();  // every row turned by the tilt
}

TrueIntrinsicProperties SimBench::true_intrinsic_properties() const {
  const Eigen::Matrix3d s = true_sensitivity_matrix();
  const Eigen::Vector3d u = s.row(0);
  const Eigen::Vector3d v = s.row(1);
  const Eigen::Vector3d w = s.row(2);
  return {.sensitivity = s.rowwise().norm(),
          .angle = {angle_between(u, v), angle_between(v, w), angle_between(w, u)},
          .offset = item_.offset};
}

TrueLineResponse SimBench::true_line_response(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  const OutputTruth& truth = truth_at(t);
  // The accelerometer senses the direction up in the platter's frame; at the pose (0, 0) the true platter's
  // frame defines x, y, z.
  const Eigen::Matrix3d R_LP = floor_tilt(t) * stage_.orientation({0.0, 0.0}, {0.0, 0.0}, axis_z(t));
  const Eigen::Array3d gains = gain(truth, t);
  const Eigen::Matrix3d s = gains.matrix().asDiagonal() * mounted_matrix(truth, t) * R_LP.transpose();

  // Means over the sphere of the powers of y = S n . g: y^2: S^2 / 3, y^4: S^4 / 5, |y|: S / 2; the slope of
  // y^3 is 3/5 S^2, that of y^5 3/7 S^4; of y_j y_k the mean is S_j S_k (n_j . n_k) / 3.
  const Eigen::Array3d size = s.rowwise().norm().array();
  const Eigen::Array3d size2 = size.square();
  const Eigen::Array3d slope =
      1.0 + 0.6 * truth.k3.array() * size2 + 3.0 / 7.0 * truth.k5.array() * size2 * size2;
  Eigen::Array3d offset = truth.offset.array() + truth.k2.array() * size2 / 3.0 +
                          truth.k4.array() * size2 * size2 / 5.0 + truth.asymmetry.array() * size / 2.0;
  const Eigen::Array3d norm = truth.sensitivity_matrix.rowwise().norm().array();
  const Eigen::Matrix3d y = (norm > 0.0).select(norm.inverse(), 0.0).matrix().asDiagonal() * s;
  for (int j = 0; j < 3; ++j) {
    const Eigen::Vector3d a = y.row(j);
    const Eigen::Vector3d b = y.row((j + 1) % 3);
    const Eigen::Vector3d c = y.row((j + 2) % 3);
    offset[j] += norm[j] / 3.0 *
                 (truth.cross_ab[j] * a.dot(b) + truth.cross_ac[j] * a.dot(c) + truth.cross_bc[j] * b.dot(c) +
                  truth.cross_bb[j] * b.dot(b) + truth.cross_cc[j] * c.dot(c));
  }
  const double hours = to_seconds(t - start_) / 3600.0;
  offset += slow_offset(truth, t) + truth.drift_per_hour.array() * hours + thermal_offset(truth, t);
  return {slope.matrix().asDiagonal() * s, offset.matrix()};
}

void SimBench::inject(const WorldFault& fault) {
  for (const FaultDescription& description : fault_descriptions())
    if (description.kind == fault.kind && description.on_the_wire)
      refuse("the fault", fmt::format("\"{}\"", description.name), "a fault of the world, not of the wire");
  const std::lock_guard lock(mutex_);
  faults_.push_back(fault);
  if (fault.kind == FaultKind::kStalledAxis) epochs_.back().motion[index(fault.axis)].stall_at(fault.at);
}

void SimBench::clear_faults(Clock::Instant t) {
  const std::lock_guard lock(mutex_);
  for (WorldFault& fault : faults_) fault.until = std::min(fault.until, std::max(fault.at, t));
}

std::vector<WorldFault> SimBench::faults_at(Clock::Instant t) const {
  const std::lock_guard lock(mutex_);
  std::vector<WorldFault> in_force;
  for (const WorldFault& fault : faults_)
    if (fault.at <= t && t < fault.until) in_force.push_back(fault);
  return in_force;
}

const WorldFault* SimBench::find_fault(FaultKind kind, Clock::Instant t, StageAxis axis) const {
  if (faults_.empty()) return nullptr;  // Called several times for each reading.
  const bool of_an_axis = kind == FaultKind::kStalledAxis || kind == FaultKind::kStopsShort ||
                          kind == FaultKind::kLostReference || kind == FaultKind::kRefusedMove ||
                          kind == FaultKind::kMissedStep || kind == FaultKind::kMovedAxis ||
                          kind == FaultKind::kLostController;
  for (const WorldFault& fault : faults_)
    if (fault.kind == kind && (!of_an_axis || fault.axis == axis) && fault.at <= t && t < fault.until)
      return &fault;
  return nullptr;
}

std::optional<WorldFault> SimBench::fault_at(FaultKind kind, Clock::Instant t, StageAxis axis) const {
  const std::lock_guard lock(mutex_);
  const WorldFault* fault = find_fault(kind, t, axis);
  return fault == nullptr ? std::nullopt : std::optional(*fault);
}

}  // namespace abcal::sim
