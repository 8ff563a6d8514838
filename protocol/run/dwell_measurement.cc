#include "protocol/run/dwell_measurement.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "protocol/record/planned_dwell.h"
#include "protocol/run/dwell.h"
#include "protocol/run/sampling_times.h"

namespace abcal {
namespace {

/// Disturbances that may have ended at the next attempt: the angle is measured again.
constexpr std::uint32_t kTransientFlags = kFlagNotQuiet | kFlagStuck | kFlagOutsideWindow;
/// Interval between two readings of the temperature while the run waits for it.
constexpr Clock::Duration kTemperatureInterval = std::chrono::seconds(5);

}  // namespace

std::vector<ItemDwell> DwellMeasurement::measure(std::size_t position, const PlannedAngle& angle) {
  std::map<int, Attempts> attempts;
  std::map<int, ItemDwell> kept;
  ItemChannels::Channels pending = items_.active();
  for (const ItemChannel* channel : pending)
    attempts[channel->k].repeats_left = channel->context.settings.limits.repeats;
  while (!pending.empty()) {
    std::map<int, ItemDwell> measured = measure_once(position, angle, pending);
    ItemChannels::Channels again;
    for (ItemChannel* channel : pending) {
      const auto found = measured.find(channel->k);
      if (found == measured.end()) continue;  // It has failed.
      Attempts& its_attempts = attempts[channel->k];
      found->second.dwell.flags |= its_attempts.marks;
      const bool repeat = must_be_repeated(position, angle, *channel, found->second.dwell, its_attempts);
      if (!repeat) {
        kept[channel->k] = std::move(found->second);
      } else if (!channel->failure) {
        again.push_back(channel);
      }
    }
    pending = std::move(again);
  }
  std::vector<ItemDwell> dwells;
  for (auto& [k, dwell] : kept) dwells.push_back(std::move(dwell));
  return dwells;
}

bool DwellMeasurement::must_be_repeated(std::size_t position, const PlannedAngle& angle, ItemChannel& channel,
                                        const DwellRecord& dwell, Attempts& attempts) {
  const LimitsConfig& limits = channel.context.settings.limits;
  if ((dwell.flags & kFlagTemperature) != 0U && limits.temperature_wait_s > 0.0) {
    if (!attempts.temperature_deadline)
      attempts.temperature_deadline = context_.clock.now() + from_seconds(limits.temperature_wait_s);
    items_.each({&channel}, [&](ItemChannel& its_channel) {
      wait_for_temperature(position, its_channel, dwell.temperature_degc, *attempts.temperature_deadline);
    });
    attempts.marks |= kFlagHeld;
    return true;
  }
  const std::uint32_t transient = dwell.flags & kTransientFlags;
  if (transient == 0U) return false;
  const bool left_window = (transient & kFlagOutsideWindow) != 0U;
  if (attempts.repeats_left-- == 0) {
    if (left_window) fail_left_window(angle, dwell);
    return false;
  }
  channel.context.notify("repeated", Message("{angle}: {flags}; it is measured again", describe(angle),
                                             describe_flags(transient)));
  if (left_window) motion_.forget_positions();
  attempts.marks |= kFlagRepeated;
  return true;
}

std::map<int, ItemDwell> DwellMeasurement::measure_once(std::size_t position, const PlannedAngle& angle,
                                                        const ItemChannels::Channels& pending) {
  RunJournal& journal = context_.journal;
  journal.set_activity(describe(angle));
  journal.phase(position, RunPhase::kMoving);
  const Clock::Instant begin = context_.clock.now();
  const auto stopped_x = motion_.move_to(StageAxis::kX, angle.x);
  const auto stopped_z = motion_.move_to(StageAxis::kZ, angle.z);
  const Clock::Instant stopped = std::max(stopped_x.value_or(begin), stopped_z.value_or(begin));

  journal.phase(position, RunPhase::kSettling);
  Windows windows = settle(pending, stopped);

  journal.phase(position, RunPhase::kDwelling);
  items_.each(pending, [](ItemChannel& channel) { channel.readings.discard_pending(); });
  Encoders encoders;
  encoders.inside = motion_.is_inside_window(angle);
  read(pending, windows);
  const Clock::Instant end = context_.clock.now();
  Clock::Instant dwell_begin = stopped;
  for (const auto& [k, window] : windows) dwell_begin = std::max(dwell_begin, window.begin);
  context_.stopwatch.add_moving(stopped - begin);
  context_.stopwatch.add_settling(dwell_begin - stopped);
  context_.stopwatch.add_dwelling(end - dwell_begin);

  items_.each(pending, [&](ItemChannel& channel) {
    Window& window = windows[channel.k];
    window.statistics = dwell_statistics(window.readings, channel.context.accelerometer_info);
    window.statistics.lost = std::max(window.statistics.lost, static_cast<std::int64_t>(window.lost));
    channel.plausibility.require_possible(angle, window.statistics, window.readings.size());
    channel.settling.learn(window.statistics);
  });
  encoders.x = motion_.encoder_angle(StageAxis::kX);
  encoders.z = motion_.encoder_angle(StageAxis::kZ);
  encoders.inside = encoders.inside && motion_.is_inside_window(angle, encoders.x, encoders.z);
  std::map<int, ItemDwell> measured;
  items_.each(pending, [&](ItemChannel& channel) {
    measured[channel.k] = item_dwell(angle, channel, windows[channel.k], encoders);
  });
  return measured;
}

DwellMeasurement::Windows DwellMeasurement::settle(const ItemChannels::Channels& pending,
                                                   Clock::Instant stopped) const {
  Windows windows;
  for (const ItemChannel* channel : pending) windows[channel->k].stopped = stopped;
  for (const ItemChannel* restless : items_.settle(pending, stopped)) windows[restless->k].quiet = false;
  return windows;
}

void DwellMeasurement::read(const ItemChannels::Channels& pending, Windows& windows) const {
  const Clock::Instant begin = context_.clock.now();
  items_.each(pending, [&](ItemChannel& channel) {
    windows[channel.k].begin = begin;
    windows[channel.k].lost = channel.readings.lost();  // Before.
  });
  items_.each(pending, [&](ItemChannel& channel) {
    Window& window = windows[channel.k];
    window.readings = channel.readings.read(static_cast<std::size_t>(
        readings_per_dwell(context_.settings.protocol, channel.context.accelerometer_info.rate_hz)));
    const std::uint64_t first = window.readings.front().sequence;
    if (!channel.settling.read_until_at_rest(window.readings)) window.quiet = false;
    place_at_sampling_times(window.readings, channel.context.accelerometer_info);
    if (window.readings.front().sequence != first) window.begin = window.readings.front().arrival;
    window.lost = channel.readings.lost() - window.lost;
    // With other items it may have waited for its turn.
    window.end = items_.several() ? window.readings.back().arrival : context_.clock.now();
  });
}

ItemDwell DwellMeasurement::item_dwell(const PlannedAngle& angle, const ItemChannel& channel,
                                       const Window& window, const Encoders& encoders) const {
  const DwellStatistics& statistics = window.statistics;
  ItemDwell measured{channel.k, planned_dwell(angle), {}};
  DwellRecord& dwell = measured.dwell;
  dwell.encoder_x = encoders.x;
  dwell.encoder_z = encoders.z;
  dwell.time_s = context_.time_s(window.begin + (window.end - window.begin) / 2);
  dwell.settle_time_s = to_seconds(window.begin - window.stopped);
  dwell.count = statistics.count;
  dwell.lost = statistics.lost;
  dwell.mean = statistics.mean;
  dwell.spread = statistics.spread;
  dwell.u_mean = statistics.u_mean;
  dwell.temperature_degc = statistics.temperature_degc;
  dwell.flags =
      statistics.flags | channel.plausibility.flags(statistics, channel.settling.spreads().median());
  if (statistics.lost > 0) dwell.flags |= kFlagLostReadings;
  if (!window.quiet) dwell.flags |= kFlagNotQuiet;
  if (!encoders.inside) dwell.flags |= kFlagOutsideWindow;
  measured.readings.reserve(window.readings.size());
  for (const Reading& reading : window.readings) {
    measured.readings.push_back(
        {reading.sequence, context_.time_s(reading.arrival), reading.output, reading.temperature_degc});
  }
  return measured;
}

void DwellMeasurement::wait_for_temperature(std::size_t position, ItemChannel& channel,
                                            std::optional<double> temperature_degc, Clock::Instant deadline) {
  RunJournal& journal = context_.journal;
  const StoppableClock& clock = context_.clock;
  const Clock::Instant begin = clock.now();
  const auto excess = [&] { return channel.plausibility.temperature_excess(temperature_degc); };
  channel.context.notify("temperature",
                         Message("{activity}: {excess}; waiting for the temperature to come back",
                                 journal.activity(), excess().value_or(Message())));
  journal.phase(position, RunPhase::kTemperature);
  while (const auto why = excess()) {
    if (clock.now() >= deadline) {
      throw InstrumentError(channel.context.accelerometer_name(), Fault::kImplausible,
                            Message("{excess}; it did not come back within {seconds} s (temperature_wait_s)",
                                    *why, channel.context.settings.limits.temperature_wait_s));
    }
    clock.wait_until(std::min(deadline, clock.now() + kTemperatureInterval));
    channel.readings.discard_pending();
    const std::vector<Reading> window = channel.readings.read(channel.settling.window_size());
    temperature_degc = dwell_statistics(window, channel.context.accelerometer_info).temperature_degc;
  }
  channel.context.notify("temperature", Message("the temperature came back after {seconds:.0f} s",
                                                to_seconds(clock.now() - begin)));
  context_.stopwatch.add_settling(clock.now() - begin);
}

void DwellMeasurement::fail_left_window(const PlannedAngle& angle, const DwellRecord& dwell) const {
  throw InstrumentError(
      context_.stage_name(), Fault::kStalled,
      Message("it does not stay at {angle}: X at {x:.5f} deg, commanded {commanded_x:.5f} deg; Z at {z:.5f} "
              "deg, commanded {commanded_z:.5f} deg; required: within {window} deg (position_window_deg). "
              "Check for missed steps, a motor that is switched off or a cable that pulls",
              describe(angle), dwell.encoder_x->deg(), dwell.commanded_x.deg(), dwell.encoder_z->deg(),
              dwell.commanded_z.deg(), context_.settings.protocol.position_window.deg()));
}

}  // namespace abcal
