#include "protocol/run/settling.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/dwell.h"
#include "protocol/run/reading_plausibility.h"
#include "protocol/statistics/distributions.h"
#include "protocol/statistics/median.h"

namespace abcal {
namespace {

/// Number of windows in the time for which outputs and temperature must be stable.
constexpr double kStabilityWindows = 10.0;
constexpr std::size_t kStoredSpreads = 15;
/// An output without change is frozen if another one spreads by more than this number of resolution steps.
constexpr double kFrozenBeside = 2.0;
/// Share of spread_factor for a window: it is shorter than a whole swing of a slow ring-down, but the dwell
/// after it must stay within spread_factor. Noise of the usual spread, and of twice that, still passes.
constexpr double kQuietPart = 0.75;
/// With settle_s = "auto" a window advances by its length over this number.
constexpr std::size_t kBlocksOfWindow = 5;
/// Windows whose spreads are added before they are compared with those of as many windows before.
constexpr std::size_t kNoiseWindows = 5;
/// The spread has stopped falling if it is at least this share of the spread before.
constexpr double kNoLongerFalling = 0.8;
/// Limit of the creep in standard uncertainties: beyond it a dwell has begun too early (noise alone exceeds
/// it in one of a hundred dwells, which then takes a quarter longer).
constexpr double kCreepLimit = 3.0;
/// Probability that noise alone exceeds the limit where this invalidates the dwell (settle_s is a number),
/// and the least number of readings in a quarter for which the test is made.
constexpr double kCreepFalseAlarm = 1e-7;
constexpr std::size_t kLeastQuarter = 10;
/// Creep below this fraction of the mean's norm is ignored. It exceeds round-off of outputs without noise.
constexpr double kNoCreep = 1e-7;
/// Limit of the accumulated creep, in standard uncertainties, tested after each dwell.
constexpr double kLessonLimit = 4.0;
/// Least number of differences in the sum.
constexpr int kLeastLessons = 12;
/// In spreads of one reading: an output that changed less since the angle before has no direction.
constexpr double kChangeWithDirection = 10.0;

/// Sum of the spreads of kNoiseWindows windows, ending `skip` windows before the last.
Eigen::Vector3d sum_of_spreads(const std::vector<Eigen::Vector3d>& spreads, std::size_t skip) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < kNoiseWindows; ++k) sum += spreads[spreads.size() - 1 - skip - k];
  return sum;
}

}  // namespace

void SpreadHistory::add(const Eigen::Vector3d& spread, double resolution) {
  empty_ = false;
  const bool others_move = spread.maxCoeff() > kFrozenBeside * resolution;
  for (std::size_t j = 0; j < 3; ++j) {
    const double of_output = spread[static_cast<Eigen::Index>(j)];
    if (of_output == 0.0 && others_move) continue;
    std::vector<double>& known = spreads_[j];
    if (known.size() == kStoredSpreads) known.erase(known.begin());
    known.push_back(of_output);
  }
}

std::optional<Eigen::Vector3d> SpreadHistory::median() const {
  if (empty_) return std::nullopt;
  Eigen::Vector3d median = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  for (std::size_t j = 0; j < 3; ++j) {
    if (!spreads_[j].empty()) median[static_cast<Eigen::Index>(j)] = abcal::median(spreads_[j]);
  }
  return median;
}

Eigen::Vector3d creep_of(std::span<const Reading> readings, const AccelerometerInfo& info,
                         double drift_per_s) {
  const std::size_t quarter = readings.size() / 4;
  Eigen::Vector3d creep = Eigen::Vector3d::Zero();
  if (quarter == 0) return creep;
  const DwellStatistics first = dwell_statistics(readings.first(quarter), info);
  const DwellStatistics later = dwell_statistics(readings.subspan(readings.size() / 2), info);
  if (first.count == 0 || later.count < 2) return creep;
  const Eigen::Vector3d difference = first.mean - dwell_statistics(readings.subspan(quarter), info).mean;
  const double of_no_account = kNoCreep * later.mean.norm();
  // Variance of a mean of n of N readings: u^2(later half) (N/2) / n; n is N/4 and 3N/4.
  const double scale = std::sqrt(8.0 / 3.0);
  // The middles of both parts are half of the dwell apart.
  const double apart_s = 0.5 * to_seconds(readings.back().arrival - readings.front().arrival);
  const double drift = drift_per_s * apart_s * later.mean.norm();
  for (int j = 0; j < 3; ++j) {
    if (std::abs(difference[j]) > of_no_account)
      creep[j] = difference[j] / std::hypot(scale * later.u_mean[j], drift);
  }
  return creep;
}

bool SettlingLesson::add(const Eigen::Vector3d& creep, const Eigen::Vector3d& mean,
                         const Eigen::Vector3d& spread) {
  const std::optional<Eigen::Vector3d> before = std::exchange(previous_mean_, mean);
  if (!before) return false;
  for (int j = 0; j < 3; ++j) {
    const double change = mean[j] - (*before)[j];
    if (!(std::abs(change) > kChangeWithDirection * spread[j]) || !std::isfinite(creep[j])) continue;
    sum_ += std::copysign(creep[j], creep[j] * change);
    ++count_;
  }
  if (count_ < kLeastLessons || std::abs(sum_) <= kLessonLimit * std::sqrt(static_cast<double>(count_)))
    return false;
  patience_ *= 2.0;
  sum_ = 0.0;
  count_ = 0;
  return true;
}

std::size_t Settling::window_size() const {
  return quiet_window_size(context_.settings.protocol, context_.accelerometer_info.rate_hz);
}

void Settling::warm_up() {
  const double warm_up_s = context_.settings.protocol.warm_up_s;
  if (!(warm_up_s > 0.0)) return;
  context_.journal.set_activity(Message("warming up"));
  context_.journal.phase(0, RunPhase::kWarmingUp);
  const Clock::Instant begin = context_.clock.now();
  context_.clock.wait_until(begin + from_seconds(warm_up_s));
  context_.stopwatch.add_settling(context_.clock.now() - begin);
}

bool Settling::is_stable_since(Clock::Instant begin) {
  const ProtocolConfig& protocol = context_.settings.protocol;
  const LimitsConfig& limits = context_.settings.limits;
  const Tolerances& tolerances = context_.settings.tolerances;
  if (!(protocol.stability_s > 0.0)) return true;
  const auto elapsed_s = [&] { return to_seconds(context_.clock.now() - begin); };
  if (elapsed_s() > protocol.stability_s + protocol.stability_timeout_s) {
    throw InstrumentError(
        context_.accelerometer_name(), Fault::kImplausible,
        Message("not stable for {stability} s within {timeout} s (stability_s, stability_timeout_s); "
                "required: outputs within {outputs:.2g} of their norm, temperature within {temperature:.2g} "
                "degC ([limits] stability, stability_degc). Let the bench warm up, and avoid draughts",
                protocol.stability_s, protocol.stability_timeout_s, stability_limit(limits, tolerances),
                stability_limit_degc(limits, tolerances)));
  }
  const double wanted = context_.accelerometer_info.rate_hz * protocol.stability_s / kStabilityWindows;
  const auto readings_per_window = static_cast<std::size_t>(std::ceil(std::max(wanted, 10.0)));
  const std::vector<Reading> readings = readings_.read(readings_per_window);
  const DwellStatistics window = dwell_statistics(readings, context_.accelerometer_info);
  stability_.push_back({elapsed_s(), window.mean, window.u_mean, window.temperature_degc});
  return is_stable(stability_, protocol.stability_s, limits, tolerances);
}

void Settling::learn_noise() {
  const ProtocolConfig& protocol = context_.settings.protocol;
  context_.journal.set_activity(Message("waiting for quiet outputs before the first angle"));
  const Clock::Instant begin = context_.clock.now();
  const Clock::Instant last = begin + from_seconds(protocol.settle_s + protocol.quiet_timeout_s);
  std::vector<Eigen::Vector3d> spreads;
  while (true) {
    spreads.push_back(spread_of(readings_.read(window_size())));
    if (spreads.size() < 2 * kNoiseWindows) continue;
    const Eigen::Vector3d later = sum_of_spreads(spreads, 0);
    const Eigen::Vector3d earlier = sum_of_spreads(spreads, kNoiseWindows);
    if ((later.array() >= kNoLongerFalling * earlier.array()).all() || context_.clock.now() >= last) {
      spreads_.add(later / static_cast<double>(kNoiseWindows),
                   context_.accelerometer_info.resolution.value_or(0.0));
      break;
    }
  }
  context_.stopwatch.add_settling(context_.clock.now() - begin);
}

bool Settling::is_quiet_window(std::span<const Reading> window) const {
  const double rate_hz = context_.accelerometer_info.rate_hz;
  const double drift = rate_hz > 0.0 ? context_.drift_per_s / rate_hz : 0.0;
  return is_quiet(window, spreads_.median(), kQuietPart * context_.settings.limits.spread_factor,
                  resolution(), drift);
}

bool Settling::settle(Clock::Instant stopped) {
  context_.clock.wait_until(listens_from(stopped));
  readings_.discard_pending();
  const Rest rest = find_rest(stopped);
  context_.clock.wait_until(rest.begin);
  return rest.quiet;
}

Clock::Instant Settling::listens_from(Clock::Instant stopped) const {
  if (context_.settings.protocol.settle_auto) return stopped;
  const double rate_hz = context_.accelerometer_info.rate_hz;
  const double window_s = rate_hz > 0.0 ? static_cast<double>(window_size()) / rate_hz : 0.0;
  return stopped + from_seconds(context_.settings.protocol.settle_s) - from_seconds(window_s);
}

Settling::Rest Settling::find_rest(Clock::Instant stopped) {
  const ProtocolConfig& protocol = context_.settings.protocol;
  if (protocol.settle_auto) return find_rest_by_outputs(stopped);
  const Clock::Instant settled = stopped + from_seconds(protocol.settle_s);
  const Clock::Instant last = settled + from_seconds(protocol.quiet_timeout_s);
  while (true) {
    const std::vector<Reading> window = readings_.read(window_size());
    context_.clock.wait_until(settled);
    const Clock::Instant now = context_.clock.now();
    if (is_quiet_window(window)) return {true, now};
    if (now >= last) return {false, now};
  }
}

Settling::Rest Settling::find_rest_by_outputs(Clock::Instant stopped) {
  const Clock::Instant last = stopped + from_seconds(context_.settings.protocol.quiet_timeout_s);
  const std::size_t block = window_size() / kBlocksOfWindow;
  std::vector<Reading> window = readings_.read(window_size());
  while (!is_quiet_window(window)) {
    if (context_.clock.now() >= last) return {false, context_.clock.now()};
    window.erase(window.begin(), window.begin() + static_cast<std::ptrdiff_t>(block));
    const std::vector<Reading> later = readings_.read(block);
    window.insert(window.end(), later.begin(), later.end());
  }
  // Quiet since the window's first reading, but not before half of the time so far (first window). With
  // several items this one may have waited for its turn: its last arrival is taken as the present time.
  const Clock::Instant now = context_.beside_others ? window.back().arrival : context_.clock.now();
  const Clock::Duration quiet_after = std::max(window.front().arrival - stopped, (now - stopped) / 2);
  return {true, stopped + from_seconds(lesson_.patience() * to_seconds(quiet_after))};
}

bool Settling::read_until_at_rest(std::vector<Reading>& readings) {
  const ProtocolConfig& protocol = context_.settings.protocol;
  const auto update_creep = [&] {
    creep_ = creep_of(readings, context_.accelerometer_info, context_.drift_per_s);
  };
  const auto creeps_beyond = [&](double limit) { return creep_.cwiseAbs().maxCoeff() > limit; };
  update_creep();
  if (!protocol.settle_auto) {
    const auto of_noise = static_cast<double>(readings.size() / 2) - 1.0;
    return readings.size() / 4 < kLeastQuarter ||
           !creeps_beyond(student_t_above(kCreepFalseAlarm / 2.0, of_noise));
  }
  const Clock::Instant last = context_.clock.now() + from_seconds(protocol.quiet_timeout_s);
  const std::size_t quarter = std::max<std::size_t>(1, readings.size() / 4);
  for (; creeps_beyond(kCreepLimit); update_creep()) {
    if (context_.clock.now() >= last) return false;
    readings.erase(readings.begin(), readings.begin() + static_cast<std::ptrdiff_t>(quarter));
    const std::vector<Reading> later = readings_.read(quarter);
    readings.insert(readings.end(), later.begin(), later.end());
  }
  return true;
}

void Settling::learn(const DwellStatistics& statistics) {
  const bool by_outputs = context_.settings.protocol.settle_auto;
  if (!lesson_.add(creep_, statistics.mean, statistics.spread) || told_) return;
  told_ = !by_outputs;
  const auto& protocol = context_.settings.protocol;
  context_.notify("settling",
                  by_outputs
                      ? Message("the outputs of many angles together still creep towards their rest in the "
                                "first quarter of the dwell; from now on a dwell begins after {times:g} "
                                "times the time from which on they showed no motion (settle_s = \"auto\")",
                                lesson_.patience())
                      : Message("the outputs of many angles together still creep towards their rest in the "
                                "first quarter of the dwell; settle_s = {seconds:g} is too short for this "
                                "item on this stage. State a longer one, or \"auto\", and measure again",
                                protocol.settle_s));
}

}  // namespace abcal
