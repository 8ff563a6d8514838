#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_record.h"
#include "protocol/run/dwell.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// Compares the readings at each angle with possible values: with the angle before, the usual spread, the
/// first temperature and local gravity (protocol/run/reading_plausibility.h). Keeps the data that it needs
/// from earlier angles.
class PlausibilityCheck {
 public:
  /// `context` must outlive this; its accelerometer must be identified.
  PlausibilityCheck(const RunContext& context, std::optional<double> first_temperature_degc);

  /// Readings that cannot be true end the run; they are not averaged into a plausible number.
  /// @param read  Number of readings, those that are not finite included.
  /// @throws InstrumentError kImplausible: not finite, too many lost, the same three numbers at two angles;
  /// with several items also a direction that is not that of gravity: the item may be loose.
  void require_possible(const PlannedAngle& angle, const DwellStatistics& statistics, std::size_t read) const;

  /// Flags for a stuck output, spread above the usual, temperature, norm of the readings.
  std::uint32_t flags(const DwellStatistics& statistics,
                      const std::optional<Eigen::Vector3d>& usual_spread) const;

  /// Description of a temperature outside its limits.
  std::optional<Message> temperature_excess(std::optional<double> temperature_degc) const;

  /// Description of a wrong unit or full scale that the circle of an experiment shows; else absent.
  /// @param dwell  One more angle of the experiment. @param last  It is the last one.
  std::optional<Message> full_scale_excess(const DwellRecord& dwell, bool last);

  /// Keeps a measured angle: the next one is compared with it.
  void remember(const DwellRecord& dwell);

 private:
  void require_direction_of_gravity(const PlannedAngle& angle, const Eigen::Vector3d& mean) const;

  const RunContext& context_;
  std::optional<double> nominal_;  ///< R for one g_loc.
  std::optional<double> first_temperature_degc_;
  std::optional<Eigen::Vector3d> previous_mean_;
  std::vector<DwellRecord> circle_;  ///< Dwells of the experiment under way.
};

}  // namespace abcal
