#include "protocol/model/effects.h"

#include <cmath>
#include <numbers>

#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr int kWobbleHarmonics = 3;
constexpr int kSmoothHarmonics = kHarmonics;

/// The name of the unknown of an effect that has only one.
std::string no_name(int /*i*/) {
  return {};
}

/// An unknown that is one input at every pose at which `acts`.
template <int input, bool (*acts)(const StagePose&)>
StageShare whole_input(const StagePose& pose, int /*i*/) {
  return {input, acts(pose) ? 1.0 : 0.0, 0, 0.0};
}
bool always(const StagePose& /*pose*/) {
  return true;
}
template <int experiment, int face>
bool in_circle(const StagePose& pose) {
  return pose.experiment == experiment && pose.face == face;
}
/// Whether an axis has the errors of its map: while it moves, and at rest in face 2. At 0 degrees it has its
/// zero, and the initial turns of -90 degrees have errors of their own, as in the published protocol.
template <bool of_x>
bool has_its_map(const StagePose& pose) {
  return pose.about_x() == of_x || pose.face == 2;
}

double alignment_prior(const EffectSizes& sizes) {
  return sincos(sizes.alignment).sin;
}
double turn_prior(const EffectSizes& sizes) {
  return sizes.initial_turn.rad();
}
double zero_prior(const EffectSizes& sizes) {
  return sizes.zero.rad();
}
double smooth_prior(const EffectSizes& sizes) {
  return sizes.step_smooth.rad();
}
double eccentric_prior(const EffectSizes& sizes) {
  return sizes.step_eccentric.rad();
}
double wobble_prior(const EffectSizes& sizes) {
  return sizes.wobble_urad * 1e-6;
}

/// D_m sin(m a), E_m (cos(m a) - 1), m = 1 .. 6, of an axis that has the errors of its map.
template <bool of_x>
StageShare smooth_share(const StagePose& pose, int i) {
  const auto m = static_cast<std::size_t>(i / 2 + 1);
  if (!has_its_map<of_x>(pose)) return {};
  const AngleHarmonics& a = of_x ? pose.x : pose.z;
  return {of_x ? kInputAngleX : kInputAngleZ, i % 2 == 0 ? a.sin[m] : a.cos[m] - 1.0, 0, 0.0};
}
std::string smooth_name(int i) {
  return std::string(i % 2 == 0 ? "sin " : "cos ") + std::to_string(i / 2 + 1) + "/rev";
}

/// c cos(m a) + d sin(m a), m = 1 .. 3, along the two directions across the axis; it also acts on an axis at
/// rest, and at the pose (0, 0), where s is defined.
template <bool of_x>
StageShare wobble_share(const StagePose& pose, int i) {
  const auto m = static_cast<std::size_t>(i / 4 + 1);
  const int direction = (i / 2) % 2;
  const AngleHarmonics& a = of_x ? pose.x : pose.z;
  const int input = (of_x ? kInputTiltXy : kInputTiltZx) + direction;
  const int zero = (of_x ? kInputTiltXyAtZero : kInputTiltZxAtZero) + direction;
  if (i % 2 == 0) return {input, a.cos[m], zero, 1.0};
  return {input, a.sin[m], zero, 0.0};
}
std::string wobble_name(int i) {
  return std::string(i % 2 == 0 ? "cos " : "sin ") + std::to_string(i / 4 + 1) + "/rev, direction " +
         std::to_string((i / 2) % 2 + 1);
}

template <bool of_x>
StageShare delay_share(const StagePose& pose, int /*i*/) {
  if (pose.about_x() != of_x) return {};
  return {of_x ? kInputAngleX : kInputAngleZ, -pose.rate_radps, 0, 0.0};
}
/// The axis X passes at this distance from Z, along y where Z is at 0: centripetal and tangential
/// acceleration of all that turns about it.
StageShare distance_share(const StagePose& pose, int /*i*/) {
  if (!pose.about_x()) return {};
  const Eigen::Vector3d axis = pose.axis_in_platter();
  const Eigen::Vector3d side(pose.z.sin[1], pose.z.cos[1], 0.0);
  const int along = std::abs(side.x()) > std::abs(side.y()) ? kInputForceX : kInputForceY;
  const double sign = side(along - kInputForceX);
  const double turned = axis.cross(side).z();
  return {along, -pose.rate_radps * pose.rate_radps * sign / kStandardGravity, kInputForceZ,
          pose.acceleration_radps2 * turned / kStandardGravity};
}
/// The phase of the item beyond a delay: as if the angle were ahead by it.
StageShare phase_share(const StagePose& pose, int /*i*/) {
  return {moving_angle_input(pose.experiment), std::pow(pose.mean_rate_radps / kReferenceRate, 3), 0, 0.0};
}
double phase_prior(const EffectSizes& sizes) {
  return sizes.phase_rad;
}
double delay_prior(const EffectSizes& sizes) {
  return sizes.delay_s;
}
double distance_prior(const EffectSizes& sizes) {
  return sizes.axes_distance_mm * 1e-3;
}

constexpr std::array kStageEffects{
    StageEffect{"Zx", "alignment_deg", 1, "1", alignment_prior, whole_input<kInputZx, always>, no_name},
    StageEffect{"Zy", "alignment_deg", 1, "1", alignment_prior, whole_input<kInputZy, always>, no_name},
    StageEffect{"Xz", "alignment_deg", 1, "1", alignment_prior, whole_input<kInputXz, always>, no_name},
    StageEffect{"d2", "initial_turn_deg", 1, "radian", turn_prior, whole_input<kInputAngleZ, in_circle<2, 1>>,
                no_name},
    StageEffect{"d3", "initial_turn_deg", 1, "radian", turn_prior, whole_input<kInputAngleX, in_circle<3, 1>>,
                no_name},
    StageEffect{"d1, face 2", "initial_turn_deg", 1, "radian", turn_prior,
                whole_input<kInputAngleZ, in_circle<1, 2>>, no_name, 2},
    StageEffect{"d2, face 2", "initial_turn_deg", 1, "radian", turn_prior,
                whole_input<kInputAngleZ, in_circle<2, 2>>, no_name, 2},
    StageEffect{"d3, face 2", "initial_turn_deg", 1, "radian", turn_prior,
                whole_input<kInputAngleX, in_circle<3, 2>>, no_name, 2},
    StageEffect{"F_X", "zero_deg", 1, "radian", zero_prior, whole_input<kInputAngleX, has_its_map<true>>,
                no_name},
    StageEffect{"F_Z", "zero_deg", 1, "radian", zero_prior, whole_input<kInputAngleZ, has_its_map<false>>,
                no_name},
    StageEffect{"smooth step errors of X", "step_smooth_deg", 2 * kSmoothHarmonics, "radian", smooth_prior,
                smooth_share<true>, smooth_name},
    StageEffect{"smooth step errors of Z", "step_smooth_deg", 2 * kSmoothHarmonics, "radian", smooth_prior,
                smooth_share<false>, smooth_name},
    StageEffect{"eccentricity of X", "step_eccentric_deg", 2, "radian", eccentric_prior, smooth_share<true>,
                smooth_name},
    StageEffect{"eccentricity of Z", "step_eccentric_deg", 2, "radian", eccentric_prior, smooth_share<false>,
                smooth_name},
    StageEffect{"wobble of X", "wobble_urad", 4 * kWobbleHarmonics, "radian", wobble_prior,
                wobble_share<true>, wobble_name},
    StageEffect{"wobble of Z", "wobble_urad", 4 * kWobbleHarmonics, "radian", wobble_prior,
                wobble_share<false>, wobble_name},
    StageEffect{"delay about X", "delay_s", 1, "s", delay_prior, delay_share<true>, no_name, 1, true},
    StageEffect{"delay about Z", "delay_s", 1, "s", delay_prior, delay_share<false>, no_name, 1, true},
    StageEffect{"phase", "phase_rad", 1, "radian", phase_prior, phase_share, no_name, 1, true},
    StageEffect{"distance of the axes", "axes_distance_mm", 1, "m", distance_prior, distance_share, no_name,
                1, true},
};

template <double EffectSizes::*member>
double size(const EffectSizes& sizes) {
  return sizes.*member;
}

/// Half the Legendre polynomials of 2 t, orders 1, 2, 3.
ItemShare drift_share(const ItemPoint& at, int /*output*/, int i) {
  const double x = 2.0 * at.t;
  if (i == 0) return {0.5 * x, 0.0};
  if (i == 1) return {(3.0 * x * x - 1.0) / 4.0, 0.0};
  return {(5.0 * x * x - 3.0) * x / 4.0, 0.0};
}
std::string drift_name(int i) {
  return "of order " + std::to_string(i + 1);
}

/// sin(2 pi c t), cos(2 pi c t), c = 2 .. 6 cycles over the run. Slower ones are within the polynomials, as
/// far as they matter; faster ones look like noise from angle to angle or like smooth step errors.
constexpr int kLeastCycles = 2;
constexpr int kMostCycles = 6;
ItemShare cyclic_drift_share(const ItemPoint& at, int /*output*/, int i) {
  const double phase = 2.0 * std::numbers::pi * (kLeastCycles + i / 2) * at.t;
  return {i % 2 == 0 ? std::sin(phase) : std::cos(phase), 0.0};
}
std::string cyclic_drift_name(int i) {
  return std::string(i % 2 == 0 ? "sin, " : "cos, ") + std::to_string(kLeastCycles + i / 2) + " cycles a run";
}

ItemShare sensitivity_drift_share(const ItemPoint& at, int output, int /*i*/) {
  return {at.t * at.y(output), at.t};
}

template <int order>
ItemShare power_share(const ItemPoint& at, int output, int /*i*/) {
  const double y = at.y(output);
  double lower = 1.0;
  for (int k = 1; k < order; ++k) lower *= y;
  return {lower * y, order * lower};
}
ItemShare absolute_share(const ItemPoint& at, int output, int /*i*/) {
  const double y = at.y(output);
  return {std::abs(y), std::copysign(1.0, y)};
}

/// a b, a d, b d, b^2, d^2 with a the output's own y, b and d those of the next two in the order u, v, w, u.
ItemShare cross_share(const ItemPoint& at, int output, int i) {
  const double a = at.y(output);
  const double b = at.y((output + 1) % 3);
  const double d = at.y((output + 2) % 3);
  switch (i) {
    case 0:
      return {a * b, b, a, 0.0};
    case 1:
      return {a * d, d, 0.0, a};
    case 2:
      return {b * d, 0.0, d, b};
    case 3:
      return {b * b, 0.0, 2.0 * b, 0.0};
    default:
      return {d * d, 0.0, 0.0, 2.0 * d};
  }
}
std::string cross_name(int i) {
  static constexpr std::array<const char*, 5> kNames{"own and next", "own and last", "next and last",
                                                     "next squared", "last squared"};
  return kNames[static_cast<std::size_t>(i)];
}
/// The mean over all directions of a product of two linear responses is a third of their rows' product.
LineShare cross_line(const Eigen::Matrix3d& rows, int output, int i) {
  const Eigen::Vector3d a = rows.row(output);
  const Eigen::Vector3d b = rows.row((output + 1) % 3);
  const Eigen::Vector3d d = rows.row((output + 2) % 3);
  const std::array<double, 5> means{a.dot(b) / 3.0, a.dot(d) / 3.0, b.dot(d) / 3.0, b.dot(b) / 3.0,
                                    d.dot(d) / 3.0};
  return {0.0, means[static_cast<std::size_t>(i)]};
}

ItemShare hysteresis_share(const ItemPoint& at, int output, int /*i*/) {
  return {at.came_from(output), 0.0};
}

/// Mean rate of the sweep over the reference rate. A filter acts on the sine that gravity becomes, whose
/// frequency is that of the turn; a ripple of the rate is another frequency.
double relative_rate(const ItemPoint& at) {
  return at.mean_rate_radps / kReferenceRate;
}
template <int power>
ItemShare low_pass_share(const ItemPoint& at, int output, int /*i*/) {
  double loss = 1.0;
  for (int k = 0; k < power; ++k) loss *= relative_rate(at);
  return {-loss * at.swing(output), -loss};
}
ItemShare delay_difference_share(const ItemPoint& at, int output, int /*i*/) {
  return {-at.rate_radps * at.by_angle(output), 0.0};
}
ItemShare rate_offset_share(const ItemPoint& at, int /*output*/, int /*i*/) {
  return {relative_rate(at), 0.0};
}
ItemShare position_share(const ItemPoint& at, int output, int i) {
  return {at.by_position(output, i), 0.0};
}
std::string position_name(int i) {
  return std::string("along ") + "xyz"[i];
}
double position_prior(const EffectSizes& sizes) {
  return sizes.position_mm * 1e-3;
}

LineShare no_line(const Eigen::Matrix3d& /*rows*/, int /*output*/, int /*i*/) {
  return {};
}
/// With y = a.g over the sphere the mean of y^n is |a|^n/(n + 1) for even n; the slope of y^n along a is 3/(n
/// + 2) |a|^(n-1) for odd n.
template <int order>
LineShare power_line(const Eigen::Matrix3d& rows, int output, int /*i*/) {
  const double norm = rows.row(output).norm();
  if constexpr (order % 2 == 0) return {0.0, std::pow(norm, order) / (order + 1)};
  return {3.0 / (order + 2) * std::pow(norm, order - 1), 0.0};
}
LineShare absolute_line(const Eigen::Matrix3d& rows, int output, int /*i*/) {
  return {0.0, 0.5 * rows.row(output).norm()};
}

using enum ItemEffectKind;
constexpr std::array kItemEffects{
    ItemEffect{"drift", "drift", kDrift, 3, size<&EffectSizes::drift>, drift_share, no_line, drift_name},
    ItemEffect{"cyclic drift", "cyclic_drift", kDrift, 2 * (kMostCycles - kLeastCycles + 1),
               size<&EffectSizes::cyclic_drift>, cyclic_drift_share, no_line, cyclic_drift_name},
    ItemEffect{"sensitivity drift", "sensitivity_drift", kDrift, 1, size<&EffectSizes::sensitivity_drift>,
               sensitivity_drift_share, no_line, no_name},
    ItemEffect{"k2", "k2", kCurvature, 1, size<&EffectSizes::k2>, power_share<2>, power_line<2>, no_name},
    ItemEffect{"k3", "k3", kCurvature, 1, size<&EffectSizes::k3>, power_share<3>, power_line<3>, no_name},
    ItemEffect{"k4", "nonlinearity", kOther, 1, size<&EffectSizes::nonlinearity>, power_share<4>,
               power_line<4>, no_name},
    ItemEffect{"k5", "nonlinearity", kOther, 1, size<&EffectSizes::nonlinearity>, power_share<5>,
               power_line<5>, no_name},
    ItemEffect{"|a|", "nonlinearity", kOther, 1, size<&EffectSizes::nonlinearity>, absolute_share,
               absolute_line, no_name},
    ItemEffect{"cross terms", "nonlinearity", kOther, 5, size<&EffectSizes::nonlinearity>, cross_share,
               cross_line, cross_name},
    ItemEffect{"hysteresis", "hysteresis", kOther, 1, size<&EffectSizes::hysteresis>, hysteresis_share,
               no_line, no_name},
    ItemEffect{"low-pass", "low_pass", kOther, 1, size<&EffectSizes::low_pass>, low_pass_share<2>, no_line,
               no_name, true},
    ItemEffect{"low-pass, fourth power", "low_pass_fourth", kOther, 1, size<&EffectSizes::low_pass_fourth>,
               low_pass_share<4>, no_line, no_name, true},
    ItemEffect{"delay", "delay_difference_s", kOther, 1, size<&EffectSizes::delay_difference_s>,
               delay_difference_share, no_line, no_name, true},
    ItemEffect{"offset with the rate", "rate_offset", kOther, 1, size<&EffectSizes::rate_offset>,
               rate_offset_share, no_line, no_name, true},
    ItemEffect{"apparent position", "position_mm", kOther, 3, position_prior, position_share, no_line,
               position_name, true},
};

}  // namespace

void ItemPoint::turn(const StagePose& pose, const Eigen::Matrix3d& rows, const GravityAt& gravity) {
  if (pose.rate_radps == 0.0 && pose.acceleration_radps2 == 0.0) return;
  rate_radps = pose.rate_radps;
  mean_rate_radps = pose.mean_rate_radps;
  by_angle = rows * gravity.by_input.col(moving_angle_input(pose.experiment));
  const Eigen::Vector3d axis = pose.axis_in_platter();
  const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - axis * axis.transpose();
  swing = rows * (across * gravity.g);
  Eigen::Matrix3d turning;  // axis x r
  turning << 0.0, -axis.z(), axis.y(), axis.z(), 0.0, -axis.x(), -axis.y(), axis.x(), 0.0;
  by_position = rows * (pose.acceleration_radps2 * turning - pose.rate_radps * pose.rate_radps * across) /
                kStandardGravity;
}

SweepShares sweep_shares(double turned_rad) {
  constexpr double kPi = std::numbers::pi;
  // A slope of mean square 1 over the turn is the sum of +-2 sqrt 3 sin(m x)/(m pi), + for odd m.
  double line = turned_rad / kPi * std::numbers::sqrt3;
  double line_slope = std::numbers::sqrt3 / kPi, line_curvature = 0.0;
  double left = 1.0;  // Share of its mean square.
  SweepShares out;
  out.value[0] = 1.0;
  for (std::size_t m = 1; m <= kHarmonics; ++m) {
    const auto order = static_cast<double>(m);
    const double sine = std::sin(order * turned_rad), cosine = std::cos(order * turned_rad);
    const std::size_t of_sine = 2 * m - 1, of_cosine = 2 * m;
    out.value[of_sine] = std::numbers::sqrt2 * sine;
    out.slope[of_sine] = std::numbers::sqrt2 * order * cosine;
    out.curvature[of_sine] = -std::numbers::sqrt2 * order * order * sine;
    out.value[of_cosine] = std::numbers::sqrt2 * cosine;
    out.slope[of_cosine] = -std::numbers::sqrt2 * order * sine;
    out.curvature[of_cosine] = -std::numbers::sqrt2 * order * order * cosine;
    const double amplitude = (m % 2 == 1 ? 2.0 : -2.0) * std::numbers::sqrt3 / (order * kPi);
    line -= amplitude * sine;
    line_slope -= amplitude * order * cosine;
    line_curvature += amplitude * order * order * sine;
    left -= 0.5 * amplitude * amplitude;
  }
  const double scale = 1.0 / std::sqrt(left);
  out.value.back() = scale * line;
  out.slope.back() = scale * line_slope;
  out.curvature.back() = scale * line_curvature;
  return out;
}

bool is_fitted(const ItemEffect& effect, const EffectSizes& sizes, bool drift, bool nonlinearity) {
  if (effect.kind == kDrift && !drift) return false;
  if (effect.kind == kCurvature && !nonlinearity) return false;
  return effect.prior(sizes) > 0.0;
}

Message effect_words(std::string_view effect) {
  for (const StageEffect& one : kStageEffects)
    if (one.name == effect) return one.name;
  for (const ItemEffect& one : kItemEffects)
    if (one.name == effect) return one.name;
  static constexpr std::array<Term, 10> kOthers{
      "effects of the other items",
      // Effects in a fit of several runs, or with a record of the stage.
      "stage record", "fine map", "mounting", "step errors", "step errors, from visit to visit",
      "change from run to run", "zeros, from homing to homing", "alignment, from run to run",
      "initial turns, from run to run"};
  return word_of(kOthers, effect);
}

std::string unknown_name(const StageEffect& effect, int index) {
  const std::string which = effect.unknown_name(index);
  return std::string(effect.name) + (which.empty() ? "" : ", ") + which;
}

std::span<const StageEffect> stage_effects() {
  return kStageEffects;
}

std::span<const ItemEffect> item_effects() {
  return kItemEffects;
}

double largest_drift_rate(const EffectSizes& sizes) {
  constexpr int kTimes = 100;
  constexpr double kApart = 1.0 / kTimes;
  double largest = 0.0;
  for (int n = 0; n < kTimes; ++n) {
    double variance = 0.0;
    for (const ItemEffect& effect : kItemEffects) {
      if (effect.kind != kDrift) continue;
      for (int i = 0; i < effect.count; ++i) {
        ItemPoint point;
        point.y = Eigen::Vector3d::Ones();
        point.t = n * kApart - 0.5;
        const double before = effect.share(point, 0, i).value;
        point.t += kApart;
        variance += std::pow(effect.prior(sizes) * (effect.share(point, 0, i).value - before) / kApart, 2);
      }
    }
    largest = std::max(largest, variance);
  }
  return std::sqrt(largest);
}

Eigen::Vector3d EffectColumn::at(const StagePose& pose, const ItemPoint& point,
                                 const Eigen::Matrix<double, 3, kStageInputs>& by_input,
                                 const Eigen::Vector3d& unit) const {
  if (item != nullptr)
    return Eigen::Vector3d::Unit(output) * (unit(output) * item->share(point, output, index).value);
  const StageShare share = stage->share(pose, index);
  return by_input.col(share.input) * share.value + by_input.col(share.second_input) * share.second_value;
}

Eigen::Vector3d signs_of_change(const Eigen::Vector3d& before, const Eigen::Vector3d& now) {
  constexpr double kSameResponse = 1e-6;
  return (now - before).unaryExpr([](double change) {
    return std::abs(change) > kSameResponse ? std::copysign(1.0, change) : 0.0;
  });
}

double step_prior(const EffectSizes& sizes) {
  return sizes.step.rad();
}

int moving_angle_input(int experiment) {
  return experiment == 3 ? kInputAngleZ : kInputAngleX;
}

}  // namespace abcal
