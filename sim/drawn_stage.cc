#include "sim/drawn_stage.h"

#include <Eigen/Geometry>
#include <cmath>
#include <string>
#include <utility>

#include "sim/counter_noise.h"
#include "sim/refusal.h"

namespace abcal::sim {
namespace {

constexpr std::int64_t kMicroDegreesPerTurn = 360'000'000;
constexpr std::uint64_t kPoseZero = 0;
constexpr std::uint64_t kPose90 = 90'000'000;
constexpr std::uint64_t kPose180 = 180'000'000;
constexpr std::uint64_t kPoseMinus90 = 270'000'000;
constexpr double kRadPerUrad = 1e-6;
constexpr int kDrawnErrorOrders = 6;   // docs/effects.md, smooth step errors
constexpr int kDrawnWobbleOrders = 3;  // docs/effects.md, wobble
constexpr double kSmallestSpanS = 1e-3;

void check_axis(const AxisTruth& axis, const std::string& name) {
  const auto finite = [&](Angle angle, const char* what) {
    require(std::isfinite(angle.deg()), name + "." + what, angle.deg(), "finite");
  };
  finite(axis.mean_step_error, "mean_step_error");
  finite(axis.initial_turn_error, "initial_turn_error");
  finite(axis.backlash, "backlash");
  finite(axis.travel_min, "travel_min");
  finite(axis.travel_max, "travel_max");
  for (const ErrorHarmonic& harmonic : axis.harmonics) {
    finite(harmonic.sin_coefficient, "harmonics.sin_coefficient");
    finite(harmonic.cos_coefficient, "harmonics.cos_coefficient");
  }
  for (const WobbleHarmonic& w : axis.wobble) {
    for (const double each : {w.cos_1_urad, w.sin_1_urad, w.cos_2_urad, w.sin_2_urad})
      require(std::isfinite(each), name + ".wobble", each, "finite");
  }
  require(axis.rate_ripple >= 0.0 && axis.rate_ripple < 0.1, name + ".rate_ripple", axis.rate_ripple,
          "0 to 0.1");
  const auto positive = [](double value) { return value > 0.0 && std::isfinite(value); };
  require(axis.wobble_sd_urad >= 0.0 && std::isfinite(axis.wobble_sd_urad), name + ".wobble_sd_urad",
          axis.wobble_sd_urad, ">= 0");
  require(axis.smooth_error_sd.deg() >= 0.0 && std::isfinite(axis.smooth_error_sd.deg()),
          name + ".smooth_error_sd", axis.smooth_error_sd.deg(), ">= 0");
  require(axis.step_error_sd.deg() >= 0.0 && std::isfinite(axis.step_error_sd.deg()), name + ".step_error_sd",
          axis.step_error_sd.deg(), ">= 0");
  for (const auto& [angle, what] : {std::pair(axis.fine_map_sd, ".fine_map_sd"),
                                    {axis.step_repeatability_sd, ".step_repeatability_sd"},
                                    {axis.homing_repeatability_sd, ".homing_repeatability_sd"},
                                    {axis.growth_sd, ".growth_sd"},
                                    {axis.knock_sd, ".knock_sd"}})
    require(angle.deg() >= 0.0 && std::isfinite(angle.deg()), name + what, angle.deg(), ">= 0");
  require(axis.encoder_resolution.deg() >= 0.0 && std::isfinite(axis.encoder_resolution.deg()),
          name + ".encoder_resolution", axis.encoder_resolution.deg(), ">= 0");
  require(positive(axis.speed_deg_per_s), name + ".speed_deg_per_s", axis.speed_deg_per_s, "> 0");
  require(positive(axis.acceleration_deg_per_s2), name + ".acceleration_deg_per_s2",
          axis.acceleration_deg_per_s2, "> 0");
  require(axis.travel_min < axis.travel_max, name + ".travel_min", axis.travel_min.deg(), "below travel_max");
}

/// The truth, after the check that it is possible.
StageTruth checked(StageTruth truth) {
  require(truth.span_s >= kSmallestSpanS && std::isfinite(truth.span_s), "span_s", truth.span_s, ">= 0.001");
  require(std::isfinite(truth.zx_per_degc), "zx_per_degc", truth.zx_per_degc, "finite");
  require(std::isfinite(truth.floor_tilt_x_urad), "floor_tilt_x_urad", truth.floor_tilt_x_urad, "finite");
  require(std::isfinite(truth.floor_tilt_y_urad), "floor_tilt_y_urad", truth.floor_tilt_y_urad, "finite");
  require(truth.age_months >= 0.0 && std::isfinite(truth.age_months), "age_months", truth.age_months, ">= 0");
  require(truth.floor_repeatability_urad >= 0.0 && std::isfinite(truth.floor_repeatability_urad),
          "floor_repeatability_urad", truth.floor_repeatability_urad, ">= 0");
  if (!truth.sag_urad.allFinite()) refuse("sag_urad", "not finite", "finite");
  require(truth.zx * truth.zx + truth.zy * truth.zy < 1.0, "zx^2 + zy^2",
          truth.zx * truth.zx + truth.zy * truth.zy, "below 1");
  require(std::abs(truth.xz) < 1.0, "xz", truth.xz, "between -1 and 1");
  check_axis(truth.x, "x");
  check_axis(truth.z, "z");
  return truth;
}

}  // namespace

std::uint64_t canonical_pose(Angle angle) {
  const double reduced = std::remainder(angle.deg(), 360.0);  // exact
  const std::int64_t micro = std::llround(reduced * 1e6) % kMicroDegreesPerTurn;
  return static_cast<std::uint64_t>(micro < 0 ? micro + kMicroDegreesPerTurn : micro);
}

double reduced_rad(double deg) {
  return Angle::degrees(std::remainder(deg, 360.0)).rad();
}

Eigen::Matrix3d turned_by(const Eigen::Vector3d& rotation_vector) {
  const double angle = rotation_vector.norm();
  if (angle == 0.0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, rotation_vector / angle).toRotationMatrix();
}

DrawnStage::DrawnStage(StageTruth truth) : truth_(checked(std::move(truth))) {
  axis_x_ = {std::sqrt(1.0 - truth_.xz * truth_.xz), 0.0, truth_.xz};
  axis_z_ = {truth_.zx, truth_.zy, std::sqrt(1.0 - truth_.zx * truth_.zx - truth_.zy * truth_.zy)};
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d E = up.cross(axis_z_);
  const double tilt_rad = std::atan2(E.norm(), up.dot(axis_z_));
  R_LP_rest_ = E.norm() > 0.0 ? Eigen::AngleAxisd(tilt_rad, E.normalized()).toRotationMatrix()
                              : Eigen::Matrix3d::Identity();
  const std::uint64_t of_run = seed_of_run(truth_.seed, truth_.run);
  if (truth_.floor_repeatability_urad > 0.0) {
    const auto normal = normal_numbers(of_run, NoiseStream::kFloor, {});
    floor_of_run_ =
        kRadPerUrad * truth_.floor_repeatability_urad * Eigen::Vector3d(normal[0], normal[1], 0.0);
  }
  for (const StageAxis axis : kStageAxes) {
    const std::size_t k = index(axis);
    const AxisTruth& a = truth_.axis(axis);
    if (a.homing_repeatability_sd.deg() > 0.0)
      homing_[k] = a.homing_repeatability_sd * normal_numbers(of_run, NoiseStream::kHoming, {k, 0, 0, 0})[0];
    harmonics_[k] = a.harmonics;
    for (int order = 1; order <= kDrawnErrorOrders && a.smooth_error_sd.deg() > 0.0; ++order) {
      const auto normal = normal_numbers(truth_.seed, NoiseStream::kSmoothError,
                                         {k, static_cast<std::uint64_t>(order), 0, 0});
      harmonics_[k].push_back({order, a.smooth_error_sd * normal[0], a.smooth_error_sd * normal[1]});
    }
    for (int order = 1; order <= kDrawnErrorOrders && a.rate_ripple > 0.0; ++order) {
      for (std::size_t down = 0; down < 2; ++down) {
        const auto normal = normal_numbers(truth_.seed, NoiseStream::kRipple,
                                           {k, static_cast<std::uint64_t>(order), down, 0});
        const double size_rad = a.rate_ripple / order;
        ripple_[k][down].push_back(
            {order, Angle::radians(size_rad * normal[0]), Angle::radians(size_rad * normal[1])});
      }
    }
    wobble_[k] = a.wobble;
    for (int order = 1; order <= kDrawnWobbleOrders && a.wobble_sd_urad > 0.0; ++order) {
      const auto normal =
          normal_numbers(truth_.seed, NoiseStream::kWobble, {k, static_cast<std::uint64_t>(order), 0, 0});
      wobble_[k].push_back({order, a.wobble_sd_urad * normal[0], a.wobble_sd_urad * normal[1],
                            a.wobble_sd_urad * normal[2], a.wobble_sd_urad * normal[3]});
    }
  }
}

double DrawnStage::fine_map_deg(std::size_t axis, std::uint64_t pose) const {
  const AxisTruth& a = axis == 0 ? truth_.x : truth_.z;
  const auto drawn = [&](NoiseStream stream) {
    return normal_numbers(truth_.seed, stream, {pose, axis, 0, 0})[0];
  };
  double out = 0.0;
  if (a.fine_map_sd.deg() > 0.0) out += a.fine_map_sd.deg() * drawn(NoiseStream::kFineMap);
  if (const double grown = a.growth_sd.deg() * std::sqrt(truth_.age_months); grown > 0.0)
    out += grown * drawn(NoiseStream::kGrowth);
  if (a.knock_sd.deg() > 0.0 && truth_.knock_from_run > 0 && truth_.run >= truth_.knock_from_run)
    out += a.knock_sd.deg() * drawn(NoiseStream::kKnock);
  return out;
}

Angle DrawnStage::error(StageAxis axis, Angle commanded, Angle other_commanded) const {
  const AxisTruth& a = truth_.axis(axis);
  const std::uint64_t pose = canonical_pose(commanded);
  const Angle homing = homing_[index(axis)];
  if (pose == kPoseZero) return homing;
  // An axis at rest has one error while the other one moves.
  const bool may_stand =
      pose == kPoseMinus90 || (truth_.stands_in_second_face && (pose == kPose90 || pose == kPose180));
  const std::uint64_t other = may_stand ? kPoseZero : canonical_pose(other_commanded);
  double error = homing.deg();
  if (a.step_repeatability_sd.deg() > 0.0)
    error +=
        a.step_repeatability_sd.deg() * normal_numbers(seed_of_run(truth_.seed, truth_.run),
                                                       NoiseStream::kVisit, {pose, other, index(axis), 0})[0];
  if (pose == kPoseMinus90) return Angle::degrees(error + a.initial_turn_error.deg());
  error += a.mean_step_error.deg() + fine_map_deg(index(axis), pose);
  for (const ErrorHarmonic& harmonic : harmonics_[index(axis)]) {
    const double phase = reduced_rad(harmonic.order * std::remainder(commanded.deg(), 360.0));
    error += harmonic.sin_coefficient.deg() * std::sin(phase) +
             harmonic.cos_coefficient.deg() * (std::cos(phase) - 1.0);
  }
  if (a.step_error_sd.deg() > 0.0)
    error += a.step_error_sd.deg() *
             normal_numbers(truth_.seed, NoiseStream::kStepError, {pose, other, index(axis), 0})[0];
  return Angle::degrees(error);
}

double DrawnStage::error_on_the_way_deg(StageAxis axis, double position_deg, Angle other_commanded) const {
  const double below = std::floor(position_deg);
  const double share = position_deg - below;
  return (1.0 - share) * error(axis, Angle::degrees(below), other_commanded).deg() +
         share * error(axis, Angle::degrees(below + 1.0), other_commanded).deg();
}

double DrawnStage::ripple_deg(StageAxis axis, double position_deg, int direction) const {
  double sum = 0.0;
  for (const ErrorHarmonic& harmonic : ripple_[index(axis)][direction < 0 ? 1 : 0]) {
    const double phase = reduced_rad(harmonic.order * std::remainder(position_deg, 360.0));
    sum +=
        harmonic.sin_coefficient.deg() * std::sin(phase) + harmonic.cos_coefficient.deg() * std::cos(phase);
  }
  return sum;
}

Eigen::Matrix3d DrawnStage::wobble(std::size_t axis, double turn_rad) const {
  const Eigen::Vector3d& e = axis == 0 ? axis_x_ : axis_z_;
  // Neither axis is near the vector from which its first direction is derived: zx, zy, xz are small.
  const Eigen::Vector3d first =
      (axis == 0 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitY()).cross(e).normalized();
  const Eigen::Vector3d second = e.cross(first);
  Eigen::Vector3d by = Eigen::Vector3d::Zero();
  for (const WobbleHarmonic& w : wobble_[axis]) {
    const double c = std::cos(w.order * turn_rad);
    const double s = std::sin(w.order * turn_rad);
    by += (w.cos_1_urad * c + w.sin_1_urad * s) * first + (w.cos_2_urad * c + w.sin_2_urad * s) * second;
  }
  return turned_by(kRadPerUrad * by);
}

Eigen::Matrix3d DrawnStage::orientation(const std::array<double, 2>& actual_rad,
                                        const std::array<double, 2>& commanded_rad,
                                        const Eigen::Vector3d& axis_z) const {
  // L: LGCS. P: platter, which carries the accelerometer. X carries Z, Z carries the platter.
  Eigen::Matrix3d R_LP;
  if (wobble_[0].empty() && wobble_[1].empty()) {
    R_LP = (Eigen::AngleAxisd(actual_rad[0], axis_x_) * Eigen::AngleAxisd(actual_rad[1], axis_z))
               .toRotationMatrix() *
           R_LP_rest_;
  } else {
    R_LP = wobble(0, commanded_rad[0]) * Eigen::AngleAxisd(actual_rad[0], axis_x_).toRotationMatrix() *
           wobble(1, commanded_rad[1]) * Eigen::AngleAxisd(actual_rad[1], axis_z).toRotationMatrix() *
           R_LP_rest_;
  }
  if (truth_.sag_urad.isZero(0.0)) return R_LP;
  const Eigen::Vector3d up_P = R_LP.transpose() * Eigen::Vector3d::UnitZ();
  return R_LP * turned_by(kRadPerUrad * up_P.cross(truth_.sag_urad));
}

}  // namespace abcal::sim
