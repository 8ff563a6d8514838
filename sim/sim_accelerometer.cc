#include "sim/sim_accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "sim/counter_noise.h"

namespace abcal::sim {
namespace {

// Unread readings that are kept, as in a driver's bounded queue; older readings are lost.
constexpr std::uint64_t kQueue = 65536;

}  // namespace

SimAccelerometer::SimAccelerometer(std::shared_ptr<SimBench> bench, Clock& clock, double rate_hz,
                                   std::string output_unit, std::string serial_number)
    : bench_(std::move(bench)),
      clock_(clock),
      rate_hz_(rate_hz),
      output_unit_(std::move(output_unit)),
      serial_number_(std::move(serial_number)) {
  if (!(rate_hz > 0.0 && rate_hz <= 1e6))
    throw std::invalid_argument(
        fmt::format("simulated accelerometer: rate_hz is {}, required: above 0, at most 1e6", rate_hz));
}

Clock::Instant SimAccelerometer::sample_time(std::uint64_t index) const {
  return bench_->start() + from_seconds(static_cast<double>(index) / rate_hz_);
}

std::uint64_t SimAccelerometer::first_after(Clock::Instant t) const {
  const double since = std::max(0.0, to_seconds(t - bench_->start()));
  auto n = static_cast<std::uint64_t>(since * rate_hz_);
  while (sample_time(n) <= t) ++n;
  while (n > 0 && sample_time(n - 1) > t) --n;
  return n;
}

AccelerometerInfo SimAccelerometer::identify() {
  stop();
  AccelerometerInfo info{.maker = "abcal",
                         .model = "simulated accelerometer",
                         .serial_number = serial_number_,
                         .firmware = "1",
                         .output_unit = output_unit_,
                         .full_scale = std::nullopt,
                         .resolution = std::nullopt,
                         .rate_hz = rate_hz_};
  if (std::isfinite(bench_->item().full_scale)) info.full_scale = bench_->item().full_scale;
  if (bench_->item().quantisation > 0.0) info.resolution = bench_->item().quantisation;
  return info;
}

void SimAccelerometer::start() {
  started_ = true;
  health_ = {};
  next_index_ = first_after(clock_.now());
}

std::optional<Reading> SimAccelerometer::next(Clock::Instant deadline) {
  if (!started_)
    throw InstrumentError("simulated accelerometer", Fault::kNotReady,
                          "asked for a reading before it was started");
  const std::uint64_t made = first_after(clock_.now());
  if (made > next_index_ + kQueue) {
    health_.lost_readings += made - kQueue - next_index_;
    next_index_ = made - kQueue;
  }
  for (;;) {
    const Clock::Instant t = sample_time(next_index_);
    if (t > deadline && t > clock_.now()) {
      clock_.sleep_until(deadline);
      return std::nullopt;
    }
    clock_.sleep_until(t);
    const std::uint64_t sequence = next_index_++;
    if (bench_->fault_at(FaultKind::kNoOutput, t)) continue;
    const SimOutput output = bench_->output(t, sequence, from_seconds(1.0 / rate_hz_));
    ++health_.readings;
    return Reading{.output = output.value,
                   .sequence = sequence,
                   .arrival = t + lateness(sequence),
                   .temperature_degc = output.temperature_degc,
                   .over_range = output.clipped[0] || output.clipped[1] || output.clipped[2]};
  }
}

Clock::Duration SimAccelerometer::lateness(std::uint64_t sequence) const {
  const double jitter_s = bench_->item().time_stamp_jitter_s;
  if (jitter_s == 0.0) return {};
  const auto normal = normal_numbers(bench_->item().seed, NoiseStream::kTimeStamp, {sequence, 0, 0, 0});
  return from_seconds(jitter_s * std::abs(normal[0]));
}

void SimAccelerometer::discard_pending() {
  next_index_ = std::max(next_index_, first_after(clock_.now()));
}

void SimAccelerometer::stop() noexcept {
  started_ = false;
}

}  // namespace abcal::sim
