#include "protocol/run/dwell_measurement.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "protocol/record/planned_dwell.h"
#include "protocol/run/dwell.h"

namespace abcal {
namespace {

/// Disturbances that may be over the next time: the angle is measured again.
constexpr std::uint32_t kTransientFlags = kFlagNotQuiet | kFlagStuck | kFlagOutsideWindow;
/// Between two looks at the temperature while the run waits for it.
constexpr Clock::Duration kTemperatureInterval = std::chrono::seconds(5);

}  // namespace

MeasuredDwell DwellMeasurement::measure(std::size_t position, const PlannedAngle& angle) {
  const LimitsConfig& limits = context_.settings.limits;
  std::uint32_t marks = kFlagNone;
  std::optional<Clock::Instant> temperature_deadline;
  for (int repeats_left = limits.repeats;;) {
    MeasuredDwell measured = measure_once(position, angle);
    DwellRecord& dwell = measured.dwell;
    dwell.flags |= marks;
    if ((dwell.flags & kFlagTemperature) != 0U && limits.temperature_wait_s > 0.0) {
      if (!temperature_deadline) {
        temperature_deadline = context_.clock.now() + from_seconds(limits.temperature_wait_s);
      }
      wait_for_temperature(position, dwell.temperature_degc, *temperature_deadline);
      marks |= kFlagHeld;
      continue;
    }
    const std::uint32_t transient = dwell.flags & kTransientFlags;
    if (transient == 0U) return measured;
    const bool left_window = (transient & kFlagOutsideWindow) != 0U;
    if (repeats_left-- == 0) {
      if (left_window) fail_left_window(angle, dwell);
      return measured;
    }
    context_.journal.notify(
        "repeated", fmt::format("{}: {}; it is measured again", describe(angle), describe_flags(transient)));
    if (left_window) parts_.motion.forget_positions();
    marks |= kFlagRepeated;
  }
}

MeasuredDwell DwellMeasurement::measure_once(std::size_t position, const PlannedAngle& angle) {
  RunJournal& journal = context_.journal;
  journal.set_activity(describe(angle));
  journal.phase(position, RunPhase::kMoving);
  const Clock::Instant begin = context_.clock.now();
  const auto stopped_x = parts_.motion.move_to(StageAxis::kX, angle.x);
  const auto stopped_z = parts_.motion.move_to(StageAxis::kZ, angle.z);
  Window window;
  window.stopped = std::max(stopped_x.value_or(begin), stopped_z.value_or(begin));

  journal.phase(position, RunPhase::kSettling);
  window.quiet = parts_.settling.settle(window.stopped);

  journal.phase(position, RunPhase::kDwelling);
  parts_.readings.discard_pending();
  window.inside_before = parts_.motion.is_inside_window(angle);
  window.begin = context_.clock.now();
  const std::uint64_t lost_before = parts_.readings.lost();
  std::vector<Reading> readings = parts_.readings.read(static_cast<std::size_t>(
      readings_per_dwell(context_.settings.protocol, context_.accelerometer_info.rate_hz)));
  const std::uint64_t first = readings.front().sequence;
  if (!parts_.settling.read_until_at_rest(readings)) window.quiet = false;
  if (readings.front().sequence != first) window.begin = readings.front().arrival;
  window.end = context_.clock.now();
  context_.stopwatch.add_moving(window.stopped - begin);
  context_.stopwatch.add_settling(window.begin - window.stopped);
  context_.stopwatch.add_dwelling(window.end - window.begin);

  DwellStatistics statistics = dwell_statistics(readings, context_.accelerometer_info);
  const auto lost_unseen = static_cast<std::int64_t>(parts_.readings.lost() - lost_before);
  statistics.lost = std::max(statistics.lost, lost_unseen);
  parts_.plausibility.require_possible(angle, statistics, readings.size());
  parts_.settling.learn(readings, statistics);

  MeasuredDwell measured{dwell_record(angle, statistics, window), {}};
  measured.readings.reserve(readings.size());
  for (const Reading& reading : readings) {
    measured.readings.push_back(
        {reading.sequence, context_.time_s(reading.arrival), reading.output, reading.temperature_degc});
  }
  return measured;
}

DwellRecord DwellMeasurement::dwell_record(const PlannedAngle& angle, const DwellStatistics& statistics,
                                           const Window& window) {
  DwellRecord dwell = planned_dwell(angle);
  dwell.encoder_x = parts_.motion.encoder_angle(StageAxis::kX);
  dwell.encoder_z = parts_.motion.encoder_angle(StageAxis::kZ);
  dwell.time_s = context_.time_s(window.begin + (window.end - window.begin) / 2);
  dwell.settle_time_s = to_seconds(window.begin - window.stopped);
  dwell.count = statistics.count;
  dwell.lost = statistics.lost;
  dwell.mean = statistics.mean;
  dwell.spread = statistics.spread;
  dwell.u_mean = statistics.u_mean;
  dwell.temperature_degc = statistics.temperature_degc;
  dwell.flags = statistics.flags | parts_.plausibility.flags(statistics, parts_.settling.spreads().median());
  if (statistics.lost > 0) dwell.flags |= kFlagLostReadings;
  if (!window.quiet) dwell.flags |= kFlagNotQuiet;
  if (!window.inside_before || !parts_.motion.is_inside_window(angle, *dwell.encoder_x, *dwell.encoder_z)) {
    dwell.flags |= kFlagOutsideWindow;
  }
  return dwell;
}

void DwellMeasurement::wait_for_temperature(std::size_t position, std::optional<double> temperature_degc,
                                            Clock::Instant deadline) {
  RunJournal& journal = context_.journal;
  const StoppableClock& clock = context_.clock;
  const Clock::Instant begin = clock.now();
  const auto excess = [&] { return parts_.plausibility.temperature_excess(temperature_degc); };
  journal.notify("temperature", fmt::format("{}: {}; waiting for the temperature to come back",
                                            journal.activity(), excess().value_or("")));
  journal.phase(position, RunPhase::kTemperature);
  while (const auto why = excess()) {
    if (clock.now() >= deadline) {
      throw InstrumentError(context_.accelerometer_name(), Fault::kImplausible,
                            fmt::format("{}; it did not come back within {} s (temperature_wait_s)", *why,
                                        context_.settings.limits.temperature_wait_s));
    }
    clock.wait_until(std::min(deadline, clock.now() + kTemperatureInterval));
    parts_.readings.discard_pending();
    const std::vector<Reading> window = parts_.readings.read(parts_.settling.window_size());
    temperature_degc = dwell_statistics(window, context_.accelerometer_info).temperature_degc;
  }
  journal.notify("temperature",
                 fmt::format("the temperature came back after {:.0f} s", to_seconds(clock.now() - begin)));
  context_.stopwatch.add_settling(clock.now() - begin);
}

void DwellMeasurement::fail_left_window(const PlannedAngle& angle, const DwellRecord& dwell) const {
  throw InstrumentError(
      context_.stage_name(), Fault::kStalled,
      fmt::format("it does not stay at {}: X at {:.5f} deg, commanded {:.5f} deg; Z at {:.5f} deg, "
                  "commanded {:.5f} deg; required: within {} deg (position_window_deg). Check for missed "
                  "steps, a motor that is switched off or a cable that pulls",
                  describe(angle), dwell.encoder_x->deg(), dwell.commanded_x.deg(), dwell.encoder_z->deg(),
                  dwell.commanded_z.deg(), context_.settings.protocol.position_window.deg()));
}

}  // namespace abcal
