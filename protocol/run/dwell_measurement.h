#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/run/motion.h"
#include "protocol/run/plausibility_check.h"
#include "protocol/run/reading_source.h"
#include "protocol/run/run_context.h"
#include "protocol/run/settling.h"

namespace abcal {

/// One angle as it was measured, not yet in the run file.
struct MeasuredDwell {
  DwellRecord dwell;
  std::vector<StoredReading> readings;
};

/// Measures one angle: moves there, settles, reads, and repeats it where a disturbance may have passed.
class DwellMeasurement {
 public:
  /// What it measures with. All must outlive it.
  struct Parts {
    Motion& motion;
    Settling& settling;
    ReadingSource& readings;
    const PlausibilityCheck& plausibility;
  };
  DwellMeasurement(RunContext& context, const Parts& parts) : context_(context), parts_(parts) {}

  /// Measures the angle at `position` in the plan. It is measured again (limits: repeats) where the readings
  /// spread or creep more than usual, an output does not change at all, or an axis has left the position
  /// window. Outside its limits the temperature is waited for (temperature_wait_s).
  /// @throws InstrumentError kStalled: an axis does not stay; kImplausible: the temperature does not come
  /// back, or readings that cannot be true. RunInterrupted.
  MeasuredDwell measure(std::size_t position, const PlannedAngle& angle);

 private:
  struct Window {
    Clock::Instant stopped, begin, end;
    bool quiet = false;
    bool inside_before = false;
  };
  MeasuredDwell measure_once(std::size_t position, const PlannedAngle& angle);
  DwellRecord dwell_record(const PlannedAngle& angle, const DwellStatistics& statistics,
                           const Window& window);
  void wait_for_temperature(std::size_t position, std::optional<double> temperature_degc,
                            Clock::Instant deadline);
  [[noreturn]] void fail_left_window(const PlannedAngle& angle, const DwellRecord& dwell) const;

  RunContext& context_;
  Parts parts_;
};

}  // namespace abcal
