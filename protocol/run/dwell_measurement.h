#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/run/item_channels.h"
#include "protocol/run/motion.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// Measures one angle: moves to it, settles and reads, and repeats this after a transient disturbance.
class DwellMeasurement {
 public:
  /// All must outlive this.
  DwellMeasurement(RunContext& context, Motion& motion, const ItemChannels& items)
      : context_(context), motion_(motion), items_(items) {}

  /// Measures the angle at `position` in the plan, for all items that have not failed. It is measured again
  /// (limits: repeats), for the items concerned, where the readings spread or creep more than usual, an
  /// output does not change at all, or an axis has left the position window. If the temperature is outside
  /// its limits, waits for it (temperature_wait_s).
  /// @return not yet in the run file, in the order of the items' numbers; without those that failed meanwhile
  /// @throws InstrumentError kStalled: an axis does not stay; kImplausible: the temperature does not return,
  /// or readings that cannot be true. RunInterrupted.
  std::vector<ItemDwell> measure(std::size_t position, const PlannedAngle& angle);

 private:
  /// Times and readings of the dwell of one item.
  struct Window {
    Clock::Instant stopped, begin, end;
    bool quiet = true;
    std::uint64_t lost = 0;  ///< Counted by the driver.
    std::vector<Reading> readings;
    DwellStatistics statistics;
  };
  struct Encoders {
    Angle x, z;
    bool inside = false;  ///< Inside the position window before the dwell and after it.
  };
  using Windows = std::map<int, Window>;  ///< By number of the item.
  std::map<int, ItemDwell> measure_once(std::size_t position, const PlannedAngle& angle,
                                        const ItemChannels::Channels& pending);
  Windows settle(const ItemChannels::Channels& pending, Clock::Instant stopped) const;
  void read(const ItemChannels::Channels& pending, Windows& windows) const;
  ItemDwell item_dwell(const PlannedAngle& angle, const ItemChannel& channel, const Window& window,
                       const Encoders& encoders) const;
  /// State of the repetitions for one item at one angle.
  struct Attempts {
    int repeats_left = 0;
    std::uint32_t marks = kFlagNone;  ///< Flags for the dwell: repeated, held.
    std::optional<Clock::Instant> temperature_deadline;
  };
  bool must_be_repeated(std::size_t position, const PlannedAngle& angle, ItemChannel& channel,
                        const DwellRecord& dwell, Attempts& attempts);
  void wait_for_temperature(std::size_t position, ItemChannel& channel,
                            std::optional<double> temperature_degc, Clock::Instant deadline);
  [[noreturn]] void fail_left_window(const PlannedAngle& angle, const DwellRecord& dwell) const;

  RunContext& context_;
  Motion& motion_;
  const ItemChannels& items_;
};

}  // namespace abcal
