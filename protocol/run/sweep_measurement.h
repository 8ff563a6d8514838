#pragma once

#include <cstddef>
#include <map>
#include <span>
#include <vector>

#include "protocol/model/sweep_angle.h"
#include "protocol/record/run_file.h"
#include "protocol/run/item_channels.h"
#include "protocol/run/motion.h"
#include "protocol/run/run_context.h"
#include "protocol/run/sampling_times.h"

namespace abcal {

/// Measures one sweep: turns an axis through the circle at a constant rate while the items stream, and gives
/// each angle of the plan the readings within one step about it (docs/constant_rate.md).
class SweepMeasurement {
 public:
  /// All must outlive this.
  SweepMeasurement(RunContext& context, Motion& motion, const ItemChannels& items)
      : context_(context), motion_(motion), items_(items) {}

  /// Measures the sweep that begins at `position`, for all items that have not failed. It is measured again
  /// (limits: repeats) where readings of more than a step are missing.
  /// @return its angles, not yet in the run file
  /// @throws InstrumentError kStalled: the axis did not turn as commanded; kImplausible: its encoder's
  /// samples scatter, readings are missing again, or an item's clock runs differently than before.
  /// RunInterrupted.
  std::vector<PassedAngle> measure(const std::vector<PlannedAngle>& plan, std::size_t position);

 private:
  struct Stream {
    std::vector<Reading> readings;
    std::uint64_t lost = 0;  ///< Counted by the driver.
    Clock::Instant heard;    ///< Arrival of the last reading.
  };
  using Streams = std::map<int, Stream>;  ///< By number of the item.

  void go_to_start(const PlannedAngle& first, const SweepTravel& way);
  std::vector<AngleSample> turn(const PlannedAngle& first, const SweepTravel& way, Streams& streams);
  void take_readings(Streams& streams);
  SweepAngle angle_of(std::span<const PlannedAngle> angles, std::span<const AngleSample> samples) const;
  bool are_readings_missing(std::span<const PlannedAngle> angles, const Streams& streams) const;
  double place_by_clock(ItemChannel& channel, std::vector<Reading>& readings);
  void require_even_clock(ItemChannel& channel, const std::vector<Reading>& readings);
  void add_item(ItemChannel& channel, Stream& stream, const SweepAngle& turned,
                std::span<const PlannedAngle> angles, std::vector<PassedAngle>& passed);

  RunContext& context_;
  Motion& motion_;
  const ItemChannels& items_;
  Angle standing_;                       ///< Encoder angle of the axis that does not turn.
  std::map<int, SamplingClock> clocks_;  ///< By number of the item.
  std::map<int, double> period_s_;       ///< In each item's first sweep.
};

}  // namespace abcal
