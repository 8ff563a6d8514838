#include "protocol/run/sweep_measurement.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/faces.h"
#include "protocol/plan/sweep_margins.h"
#include "protocol/record/planned_dwell.h"
#include "protocol/run/dwell.h"
#include "protocol/run/sweep_bins.h"

namespace abcal {
namespace {

/// Largest difference of the mean rate from the command.
constexpr double kRateTolerance = 0.01;
/// Largest scatter of the encoder's samples in time.
constexpr double kMostScatterS = 0.02;
/// Largest change of an item's clock between two sweeps.
constexpr double kMostDrift = 200e-6;
/// Fewest readings of a step that give a value: some of those that the plan requires may be lost.
constexpr double kLeastInStep = 0.5 * kLeastReadingsOfStep;

Message words_of(const PlannedAngle& angle) {
  return {"{circle}, sweep {sweep} at {rate:g} deg/s", circle_words(angle.experiment, angle.face),
          angle.sweep, angle.rate_deg_per_s};
}

StageAxis turning_axis(const PlannedAngle& angle) {
  return kStageAxes[angle.turning_axis()];
}

}  // namespace

void SweepMeasurement::go_to_start(const PlannedAngle& first, const SweepTravel& way) {
  const Clock::Instant begin = context_.clock.now();
  const StageAxis turning = turning_axis(first);
  const StageAxis standing = kStageAxes[1 - first.turning_axis()];
  motion_.move_to(standing, standing == StageAxis::kX ? first.x : first.z);
  if (!can_sweep_from(motion_.encoder_angle(turning), way, first.rate_deg_per_s))
    motion_.move_to(turning, way.from);
  standing_ = motion_.encoder_angle(standing);
  context_.stopwatch.add_moving(context_.clock.now() - begin);
}

void SweepMeasurement::take_readings(Streams& streams) {
  items_.each([&](ItemChannel& channel) {
    Stream& stream = streams[channel.k];
    std::vector<Reading> taken = channel.readings.take();
    const Clock::Instant now = context_.clock.now();
    const double timeout_s = context_.settings.protocol.reading_timeout_s;
    if (!taken.empty()) stream.heard = now;
    if (to_seconds(now - stream.heard) > timeout_s)
      throw InstrumentError(channel.context.accelerometer_name(), Fault::kNoReply,
                            fmt::format("no reading for {} s (reading_timeout_s) during a sweep. Check the "
                                        "cable, the supply, and whether another program has stopped it",
                                        timeout_s));
    stream.readings.insert(stream.readings.end(), taken.begin(), taken.end());
  });
}

std::vector<AngleSample> SweepMeasurement::turn(const PlannedAngle& first, const SweepTravel& way,
                                                Streams& streams) {
  const Clock::Instant begin = context_.clock.now();
  items_.each([&](ItemChannel& channel) {
    if (channel.context.accelerometer_info.rate_hz > 0.0)
      clocks_[channel.k].hear(channel.readings.take());
    else
      channel.readings.discard_pending();
    streams[channel.k] = {{}, channel.readings.lost(), begin};
  });
  std::vector<AngleSample> samples = motion_.sweep(
      turning_axis(first), way.to, std::abs(first.rate_deg_per_s), [&] { take_readings(streams); });
  context_.stopwatch.add_dwelling(context_.clock.now() - begin);
  return samples;
}

/// From the samples between half of the margins on either side: there the axis has its rate.
SweepAngle SweepMeasurement::angle_of(std::span<const PlannedAngle> angles,
                                      std::span<const AngleSample> samples) const {
  const PlannedAngle& first = angles.front();
  const double rate = first.rate_deg_per_s;
  const double beyond = 0.5 * context_.settings.protocol.step.deg() + kMarginAfterS * std::abs(rate);
  const double lowest = std::min(first.turning().deg(), angles.back().turning().deg()) - beyond;
  const double highest = std::max(first.turning().deg(), angles.back().turning().deg()) + beyond;
  std::vector<AngleAtTime> inside;
  for (const AngleSample& sample : samples)
    if (sample.angle_deg >= lowest && sample.angle_deg <= highest)
      inside.push_back({to_seconds(sample.at.time_since_epoch()), sample.angle_deg});
  const std::string where = fmt::format("axis {}, {}", to_string(turning_axis(first)), words_of(first));
  const std::optional<SweepAngle> turned = fit_sweep_angle(inside);
  if (!turned)
    throw InstrumentError(
        context_.stage_name(), Fault::kImplausible,
        fmt::format("{}: its encoder answered {} times within the turn; required: at least 24. The "
                    "controller answers too slowly for this rate ([protocol] rate_deg_per_s)",
                    where, inside.size()));
  if (!(std::abs(turned->mean_rate_deg_per_s() / rate - 1.0) < kRateTolerance))
    throw InstrumentError(
        context_.stage_name(), Fault::kStalled,
        fmt::format(
            "{}: its encoder turned at {:.4g} deg/s; required: within {:g} %. The controller limits its "
            "speed, its acceleration is below [protocol] acceleration_deg_per_s2, or the encoder stands",
            where, turned->mean_rate_deg_per_s(), 100.0 * kRateTolerance));
  if (!(turned->rms_deg() < kMostScatterS * std::abs(rate)))
    throw InstrumentError(
        context_.stage_name(), Fault::kImplausible,
        fmt::format("{}: the samples of its encoder scatter by {:.3g} deg about an even turn; required: "
                    "below {:.3g} deg. The axis does not turn evenly, its acceleration is below [protocol] "
                    "acceleration_deg_per_s2, or its answers come late by more than {:g} ms",
                    where, turned->rms_deg(), kMostScatterS * std::abs(rate), 1e3 * kMostScatterS));
  return *turned;
}

bool SweepMeasurement::are_readings_missing(std::span<const PlannedAngle> angles,
                                            const Streams& streams) const {
  const double step_s = context_.settings.protocol.step.deg() / std::abs(angles.front().rate_deg_per_s);
  for (const ItemChannel* channel : items_.active()) {
    const double rate_hz = channel->context.accelerometer_info.rate_hz;
    const auto stream = streams.find(channel->k);
    if (stream == streams.end() || !(rate_hz > 0.0)) continue;
    const std::vector<Reading>& readings = stream->second.readings;
    for (std::size_t i = 1; i < readings.size(); ++i) {
      const double gap_s = static_cast<double>(readings[i].sequence - readings[i - 1].sequence) / rate_hz;
      if (gap_s > step_s) return true;
    }
  }
  return false;
}

/// @return standard uncertainty of their times, s
double SweepMeasurement::place_by_clock(ItemChannel& channel, std::vector<Reading>& readings) {
  if (!(channel.context.accelerometer_info.rate_hz > 0.0) || readings.empty()) return 0.0;
  SamplingClock& clock = clocks_[channel.k];
  clock.hear(readings);
  const auto placed = clock.times_of(readings);
  if (!placed) return 0.0;
  for (Reading& reading : readings) reading.arrival = placed->times.of(reading.sequence);
  return placed->u_s;
}

void SweepMeasurement::require_even_clock(ItemChannel& channel, const std::vector<Reading>& readings) {
  if (readings.size() < 2) return;
  const double period_s = to_seconds(readings.back().arrival - readings.front().arrival) /
                          static_cast<double>(readings.back().sequence - readings.front().sequence);
  const double usual_s = period_s_.try_emplace(channel.k, period_s).first->second;
  const double drift = period_s / usual_s - 1.0;
  if (std::abs(drift) <= kMostDrift) return;
  throw InstrumentError(
      channel.context.accelerometer_name(), Fault::kImplausible,
      fmt::format(
          "its readings come every {:.6f} ms now and came every {:.6f} ms in its first sweep, {:+.0f} parts "
          "in a million; required: within {:.0f}, or the angles at which they were made are not known",
          1e3 * period_s, 1e3 * usual_s, 1e6 * drift, 1e6 * kMostDrift));
}

void SweepMeasurement::add_item(ItemChannel& channel, Stream& stream, const SweepAngle& turned,
                                std::span<const PlannedAngle> angles, std::vector<PassedAngle>& passed) {
  std::vector<Reading>& readings = stream.readings;
  const AccelerometerInfo& info = channel.context.accelerometer_info;
  const double u_time_s = place_by_clock(channel, readings);
  require_even_clock(channel, readings);
  const std::vector<SweepBin> bins = bins_of_sweep(angles, context_.settings.protocol.step, turned, readings);
  for (std::size_t k = 0; k < bins.size(); ++k) {
    const SweepBin& bin = bins[k];
    if (static_cast<double>(bin.readings.size()) < kLeastInStep)
      throw InstrumentError(
          channel.context.accelerometer_name(), Fault::kImplausible,
          fmt::format("{} readings within one step about alpha = {:g} deg at {:g} deg/s; required: at least "
                      "{:g}. Its stream has gaps, or it reads too slowly for this rate",
                      bin.readings.size(), angles[k].alpha.deg(), angles[k].rate_deg_per_s, kLeastInStep));
    DwellStatistics statistics = dwell_statistics(bin.readings, info);
    statistics.mean = bin.value;
    statistics.spread = bin.spread;
    statistics.u_mean = bin.u;
    channel.plausibility.require_possible(angles[k], statistics, bin.readings.size());
    ItemDwell measured{channel.k, planned_dwell(angles[k]), {}};
    DwellRecord& dwell = measured.dwell;
    const double passed_s = to_seconds(bin.middle.time_since_epoch());
    dwell.motion->rate_deg_per_s = turned.rate_deg_per_s(passed_s);
    dwell.motion->acceleration_deg_per_s2 = turned.acceleration_deg_per_s2(passed_s);
    dwell.motion->u_angle_deg = std::hypot(turned.u_deg(), turned.mean_rate_deg_per_s() * u_time_s);
    const bool turns_x = angles[k].turning_axis() == 0;
    dwell.encoder_x = turns_x ? angles[k].turning() : standing_;
    dwell.encoder_z = turns_x ? standing_ : angles[k].turning();
    dwell.time_s = context_.time_s(bin.middle);
    dwell.count = statistics.count;
    dwell.lost = statistics.lost;
    dwell.mean = statistics.mean;
    dwell.spread = statistics.spread;
    dwell.u_mean = statistics.u_mean;
    dwell.temperature_degc = statistics.temperature_degc;
    dwell.flags = statistics.flags | channel.plausibility.flags(statistics, std::nullopt);
    for (const Reading& reading : bin.readings)
      measured.readings.push_back(
          {reading.sequence, context_.time_s(reading.arrival), reading.output, reading.temperature_degc});
    passed[k].dwells.push_back(std::move(measured));
  }
}

std::vector<PassedAngle> SweepMeasurement::measure(const std::vector<PlannedAngle>& plan,
                                                   std::size_t position) {
  const std::span<const PlannedAngle> angles(&plan.at(position), end_of_sweep(plan, position) - position);
  const PlannedAngle& first = angles.front();
  const SweepTravel way = sweep_travel(first, angles.back(), context_.settings.protocol);
  RunJournal& journal = context_.journal;
  journal.set_activity(words_of(first));
  int repeats_left = context_.settings.limits.repeats;
  while (true) {
    journal.phase(position, RunPhase::kMoving);
    go_to_start(first, way);
    journal.phase(position, RunPhase::kDwelling);
    Streams streams;
    const std::vector<AngleSample> samples = turn(first, way, streams);
    const SweepAngle turned = angle_of(angles, samples);
    if (are_readings_missing(angles, streams) && repeats_left-- > 0) {
      journal.notify(
          "repeated",
          Message("{turn}: readings of more than a step are missing; it is measured again", words_of(first)));
      continue;
    }
    std::vector<PassedAngle> passed(angles.size());
    for (std::size_t k = 0; k < passed.size(); ++k) passed[k].position = position + k;
    items_.each([&](ItemChannel& channel) { add_item(channel, streams[channel.k], turned, angles, passed); });
    if (!passed.front().dwells.empty()) {
      for (const AngleSample& sample : samples)
        passed.front().dwells.front().encoder.push_back({context_.time_s(sample.at), sample.angle_deg});
    }
    return passed;
  }
}

}  // namespace abcal
