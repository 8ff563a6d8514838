#include "protocol/run/plausibility_check.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>

#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/faces.h"
#include "protocol/run/reading_plausibility.h"

namespace abcal {
namespace {

/// Fewest readings from which it is concluded that the outputs do not follow the stage.
constexpr std::int64_t kLeastReadingsForStuck = 8;

}  // namespace

PlausibilityCheck::PlausibilityCheck(const RunContext& context, std::optional<double> first_temperature_degc)
    : context_(context),
      nominal_(nominal_response(context.settings.expected, context.accelerometer_info.output_unit,
                                context.settings.g_loc_mps2)),
      first_temperature_degc_(first_temperature_degc) {}

void PlausibilityCheck::require_possible(const PlannedAngle& angle, const DwellStatistics& statistics,
                                         std::size_t read) const {
  const auto fail = [&](const Message& detail) {
    throw InstrumentError(context_.accelerometer_name(), Fault::kImplausible, detail);
  };
  const auto total = static_cast<double>(read);
  if (static_cast<double>(statistics.not_finite) > 0.5 * total) {
    fail(
        Message("{bad} of {all} readings at {angle} are not finite numbers; check the output settings and "
                "the condition of the instrument",
                statistics.not_finite, read, describe(angle)));
  }
  const double made = total + static_cast<double>(statistics.lost);
  const double max_lost_fraction = context_.settings.limits.max_lost_fraction;
  if (static_cast<double>(statistics.lost) > max_lost_fraction * made) {
    fail(
        Message("{lost} of {all} readings were lost at {angle}; required: at most {allowed:.0f} % ([limits] "
                "max_lost_fraction). Check the cable, the baud rate and the load of this computer",
                statistics.lost, made, describe(angle), 100.0 * max_lost_fraction));
  }
  // Exactly the same three numbers at two poses: the output does not follow the stage.
  if (previous_mean_ && statistics.count >= kLeastReadingsForStuck && statistics.spread.isZero(0.0) &&
      statistics.mean == *previous_mean_) {
    fail(
        Message("all {all} readings at {angle} are ({u}, {v}, {w}), the same as at the angle before: the "
                "output is stuck",
                read, describe(angle), statistics.mean[0], statistics.mean[1], statistics.mean[2]));
  }
  if (context_.beside_others) require_direction_of_gravity(angle, statistics.mean);
}

void PlausibilityCheck::require_direction_of_gravity(const PlannedAngle& angle,
                                                     const Eigen::Vector3d& mean) const {
  const LimitsConfig& limits = context_.settings.limits;
  const auto mounting = mounting_matrix(context_.settings.expected.mounting);
  // Where the outputs do not show the norm of gravity, their offsets may be large: nothing is known then.
  if (!mounting || !nominal_ || norm_is_wrong(mean, *nominal_, limits)) return;
  const Eigen::Vector3d up_in_platter =
      Eigen::AngleAxisd(-angle.z.rad(), Eigen::Vector3d::UnitZ()) *
      (Eigen::AngleAxisd(-angle.x.rad(), Eigen::Vector3d::UnitX()) * Eigen::Vector3d::UnitZ());
  const Eigen::Vector3d expected = *mounting * up_in_platter;
  const Angle off = Angle::radians(std::atan2(expected.cross(mean).norm(), expected.dot(mean)));
  if (off <= limits.mounting) return;
  throw InstrumentError(
      context_.accelerometer_name(), Fault::kImplausible,
      Message("at {angle} it reads ({u:.4g}, {v:.4g}, {w:.4g}), {off:.0f} deg from the direction that "
              "gravity has for its mounting \"{mounting}\"; required: at most {allowed:g} deg ([limits] "
              "mounting_deg). It may have come loose, or its mounting in the bench file is wrong: look at it "
              "before the stage moves again",
              describe(angle), mean[0], mean[1], mean[2], off.deg(), context_.settings.expected.mounting,
              limits.mounting.deg()));
}

std::uint32_t PlausibilityCheck::flags(const DwellStatistics& statistics,
                                       const std::optional<Eigen::Vector3d>& usual_spread) const {
  const double resolution = context_.accelerometer_info.resolution.value_or(0.0);
  const LimitsConfig& limits = context_.settings.limits;
  std::uint32_t flags = kFlagNone;
  if (is_shaken(statistics, usual_spread, resolution, limits)) flags |= kFlagNotQuiet;
  if (is_stuck(statistics, usual_spread, resolution)) flags |= kFlagStuck;
  if (temperature_excess(statistics.temperature_degc)) flags |= kFlagTemperature;
  if (nominal_ && norm_is_wrong(statistics.mean, *nominal_, limits)) flags |= kFlagNorm;
  return flags;
}

std::optional<Message> PlausibilityCheck::temperature_excess(std::optional<double> temperature_degc) const {
  return abcal::temperature_excess(temperature_degc, first_temperature_degc_, context_.settings.limits,
                                   context_.settings.tolerances);
}

std::optional<Message> PlausibilityCheck::full_scale_excess(const DwellRecord& dwell, bool last) {
  if (!circle_.empty() && !is_same_circle(circle_.back(), dwell)) circle_.clear();
  circle_.push_back(dwell);
  if (!last || !nominal_ || dwell.experiment == 0) return std::nullopt;
  return abcal::full_scale_excess(circle_, *nominal_, context_.settings.expected);
}

void PlausibilityCheck::remember(const DwellRecord& dwell) {
  previous_mean_ = dwell.mean;
  if (!first_temperature_degc_) first_temperature_degc_ = dwell.temperature_degc;
}

}  // namespace abcal
