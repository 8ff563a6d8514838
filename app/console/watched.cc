#include "app/console/watched.h"

#include <utility>

namespace abcal::console {
namespace {

constexpr Clock::Duration kGroup = std::chrono::milliseconds(50);

}  // namespace

WatchedStage::WatchedStage(std::unique_ptr<RotationStage> stage, std::function<void(const StageSeen&)> see,
                           std::function<void(const HaltSeen&)> see_halt)
    : stage_(std::move(stage)), see_(std::move(see)), see_halt_(std::move(see_halt)) {}

HaltReport WatchedStage::halt_axes() noexcept {
  const RealClock real;
  const Clock::Instant asked = real.now();
  const HaltReport report = stage_->halt_axes();
  try {
    see_halt_({report, to_seconds(real.now() - asked), real.utc_now()});
  } catch (const std::exception&) {  // A failure to notify pages does not affect the halt.
  }
  return report;
}

void WatchedStage::move_to(StageAxis axis, Angle target) {
  stage_->move_to(axis, target);
  see_({axis, std::nullopt, target});
}

Angle WatchedStage::encoder_angle(StageAxis axis) {
  const Angle angle = stage_->encoder_angle(axis);
  see_({axis, angle, std::nullopt});
  return angle;
}

WatchedAccelerometer::WatchedAccelerometer(std::unique_ptr<Accelerometer> accelerometer,
                                           std::function<void(const StripSeen&)> see, ItemOfBench item)
    : accelerometer_(std::move(accelerometer)), see_(std::move(see)), item_(item) {}

AccelerometerInfo WatchedAccelerometer::identify() {
  AccelerometerInfo info = accelerometer_->identify();
  unit_ = info.output_unit;
  return info;
}

void WatchedAccelerometer::start() {
  accelerometer_->start();
  ++streams_;
  first_arrival_.reset();
  group_ = {};
}

std::optional<Reading> WatchedAccelerometer::next(Clock::Instant deadline) {
  std::optional<Reading> reading = accelerometer_->next(deadline);
  if (reading) note(*reading);
  return reading;
}

void WatchedAccelerometer::note(const Reading& reading) {
  if (!reading.output.allFinite()) return;
  if (!first_arrival_) first_arrival_ = reading.arrival;
  if (group_.readings == 0) {
    group_.mean.setZero();
    group_.lowest = group_.highest = reading.output;
  }
  ++group_.readings;
  group_.mean += (reading.output - group_.mean) / static_cast<double>(group_.readings);
  group_.lowest = group_.lowest.cwiseMin(reading.output);
  group_.highest = group_.highest.cwiseMax(reading.output);
  if (reading.temperature_degc) group_.temperature_degc = reading.temperature_degc;
  const Clock::Instant now = real_.now();
  if (now - last_seen_ < kGroup * static_cast<int>(item_.of)) return;
  last_seen_ = now;
  group_.item = item_.k;
  group_.unit = unit_;
  group_.stream = streams_;
  group_.time_s = to_seconds(reading.arrival - *first_arrival_);
  see_(group_);
  group_ = {};
}

}  // namespace abcal::console
