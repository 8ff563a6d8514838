#include "app/measure/session/temperature_series.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "app/bench_file/chamber_consistency.h"
#include "app/measure/session/temperature_soak.h"
#include "app/system/progress.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_label.h"
#include "protocol/run/stoppable_clock.h"

namespace abcal {
namespace {

/// Interval of the temperature readings during a soak, and the least number of them in soak_span_s, which may
/// shorten the interval.
constexpr double kIntervalS = 20.0;
constexpr double kReadingsInSpan = 15.0;
/// Instruments that send their temperature with some readings only send it once per second.
constexpr double kTemperaturePatienceS = 2.0;
constexpr double kTellEveryS = 600.0;
/// A chamber is switched off only if its air is this near to 23 degC.
constexpr double kWarmEnoughK = 5.0;
constexpr double kWaitForAmbientS = 7200.0;

/// The present temperature (degC) of the item's own sensor; nullopt if its readings do not include it.
std::optional<double> item_temperature(Bench& bench) {
  Accelerometer& accelerometer = *bench.first().accelerometer;
  accelerometer.start();
  accelerometer.discard_pending();
  const Clock::Instant deadline = bench.clock->now() + from_seconds(kTemperaturePatienceS);
  std::optional<Reading> reading;
  do {
    reading = accelerometer.next(deadline);
  } while (reading && !reading->temperature_degc && bench.clock->now() < deadline);
  // Stopped, it stays powered. A running simulated one would have to make the readings of hours.
  accelerometer.stop();
  return reading ? reading->temperature_degc : std::nullopt;
}

}  // namespace

std::vector<SeriesPoint> series_points(const TemperatureConfig& config) {
  std::vector<SeriesPoint> points{{SeriesLeg::kReference, config.reference_degc}};
  const std::vector<double>& all = config.set_points_degc;
  for (const double degc : all) points.push_back({SeriesLeg::kUp, degc});
  if (config.down)
    for (std::size_t n = all.size() - 1; n-- > 0;) points.push_back({SeriesLeg::kDown, all[n]});
  points.push_back({SeriesLeg::kReturn, config.reference_degc});
  return points;
}

std::vector<std::filesystem::path> series_paths(const std::filesystem::path& stem, std::size_t points) {
  std::vector<std::filesystem::path> paths;
  for (std::size_t n = 1; n <= points; ++n) paths.emplace_back(fmt::format("{}-{:02}.run", stem.string(), n));
  return paths;
}

struct TemperatureSeries::Progress {
  Request request;
  std::vector<SeriesPoint> points;
  std::vector<std::filesystem::path> paths;
  std::vector<std::size_t> missing;
  double run_s = 0.0;  ///< Duration of the run at one point.

  double remaining_s(std::size_t from) const {
    const TemperatureConfig& t = request.bench.temperature;
    double seconds = 0.0;
    for (const std::size_t n : missing) {
      if (n < from) continue;
      const double before = n == 0 ? points[n].set_degc : points[n - 1].set_degc;
      const double ramp =
          t.ramp_k_per_min > 0.0 ? std::abs(points[n].set_degc - before) / t.ramp_k_per_min * 60.0 : 0.0;
      seconds += ramp + t.soak_min_s + run_s;
    }
    return seconds;
  }
};

std::vector<std::filesystem::path> TemperatureSeries::measure(const Request& request) {
  Progress progress;
  progress.request = request;
  progress.points = series_points(progress.request.bench.temperature);
  progress.paths = series_paths(request.stem, progress.points.size());
  for (std::size_t n = 0; n < progress.points.size(); ++n) {
    const std::filesystem::path& path = progress.paths[n];
    if (!std::filesystem::exists(path)) {
      progress.missing.push_back(n);
      continue;
    }
    const StoredRun stored = RunFile::load(path);
    if (stored.header.bench_toml != write_bench(progress.request.bench))
      throw std::invalid_argument(path.string() +
                                  ": was measured with another bench file; required: the same for all points "
                                  "of a series, or another name with -o");
    if (stored.state != RunState::kComplete) {
      progress.missing.push_back(n);
    } else {
      // The program may have ended before it was closed and analysed.
      (void)finish_measured_run(path, options_.session.analyst.get(), find_witness(options_.session).get());
    }
  }
  if (progress.missing.empty()) return progress.paths;

  MeasuringSession::Options session_options = options_.session;
  MeasuringSession* running = nullptr;
  const TemperatureConfig& t = progress.request.bench.temperature;
  session_options.listener = [this, &running, &t](const SessionEvent& event) {
    const auto* phase = std::get_if<PhaseEvent>(&event);
    Bench* bench = running == nullptr ? nullptr : running->bench();
    if (phase != nullptr && bench != nullptr && bench->chamber && t.pause && bench->chamber->info().can_pause)
      bench->chamber->want_pause(phase->phase == RunPhase::kSettling || phase->phase == RunPhase::kDwelling);
    if (options_.session.listener) options_.session.listener(event);
  };
  MeasuringSession session(std::move(session_options));
  running = &session;
  const Identities identities =
      session.identify_instruments({request.bench, progress.paths[progress.missing.front()].string()});
  if (!identities.chamber)
    throw std::invalid_argument(request.bench_file + ": no chamber; required: [chamber] driver and port");
  if (auto problems = chamber_problems(progress.request.bench, *identities.chamber); !problems.empty())
    throw BenchError(request.bench_file, std::move(problems));
  progress.run_s = estimate_duration(make_rotation_plan(progress.request.bench.protocol, identities.travel()),
                                     progress.request.bench, identities)
                       .total_s();
  const ChamberInfo& chamber = *identities.chamber;
  say(fmt::format(
      "Chamber {} {}: set points {:g} to {:g} degC by its own hardware{}{}", chamber.maker, chamber.model,
      chamber.least_set_degc, chamber.most_set_degc,
      chamber.can_ramp || t.ramp_k_per_min <= 0.0 ? "" : ", no ramp of its own: it goes as fast as it can",
      t.pause && !chamber.can_pause ? ", it cannot pause in dwells" : ""));
  say(fmt::format("{} points, {} of them measured already; about {}", progress.points.size(),
                  progress.points.size() - progress.missing.size(),
                  describe_duration(progress.remaining_s(0))));
  try {
    measure_points(session, progress);
  } catch (...) {
    end(session, progress.request.bench, false);
    throw;
  }
  end(session, progress.request.bench, true);
  return progress.paths;
}

void TemperatureSeries::measure_points(MeasuringSession& session, Progress& progress) {
  for (const std::size_t n : progress.missing) {
    const SeriesPoint& point = progress.points[n];
    say(fmt::format("Point {} of {}: {:g} degC ({}); about {} remain", n + 1, progress.points.size(),
                    point.set_degc, to_string(point.leg), describe_duration(progress.remaining_s(n))));
    measure_point(session, progress, n);
  }
}

void TemperatureSeries::measure_point(MeasuringSession& session, Progress& progress, std::size_t n) {
  const SeriesPoint& point = progress.points[n];
  const std::string path = progress.paths[n].string();
  const std::string soaked = soak(session, progress, n);
  say(soaked);
  if (std::filesystem::exists(path)) {
    session.resume({path});
    return;
  }
  StartRequest request{progress.request.bench, path};
  request.labels = {{kPointLabel, fmt::format("{} of {}", n + 1, progress.points.size())},
                    {kLegLabel, std::string(to_string(point.leg))},
                    {kSetLabel, fmt::format("{:g}", point.set_degc)},
                    {kSoakLabel, soaked}};
  if (!progress.request.plan_words.empty()) request.labels[kPlanLabel] = progress.request.plan_words;
  session.start(request);
}

std::string TemperatureSeries::soak(MeasuringSession& session, const Progress& progress, std::size_t n) {
  Bench& bench = *session.bench();
  ChamberWatch& chamber = *bench.chamber;
  const TemperatureConfig& t = progress.request.bench.temperature;
  const double set_degc = progress.points[n].set_degc;
  const StoppableClock clock(*bench.clock, options_.session.stop);
  clock.throw_if_stopped();
  const auto guard = [&](double coldest, const ChamberReading& now) {
    if (progress.request.bench.chamber.dry_gas || !now.humidity_percent) return;
    const double dew = dew_point_degc(now.air_degc, *now.humidity_percent);
    if (coldest >= dew + t.dew_point_margin_k) return;
    throw InstrumentError(
        "chamber " + chamber.info().model, Fault::kNotReady,
        fmt::format("{:.1f} degC is below the dew point of its air, {:.1f} degC with a margin of {:g} K; "
                    "required: dry air or nitrogen on before the series goes on",
                    coldest, dew, t.dew_point_margin_k));
  };
  guard(set_degc, chamber.read());
  chamber.set_temperature(set_degc, t.ramp_k_per_min > 0.0 ? std::optional(t.ramp_k_per_min) : std::nullopt);
  SoakRule rule(t, set_degc);
  const Clock::Duration interval = from_seconds(std::min(kIntervalS, t.soak_span_s / kReadingsInSpan));
  const Clock::Instant begin = clock.now();
  double told_s = 0.0;
  for (;;) {
    chamber.poll();
    const ChamberReading now = chamber.read();
    const auto item = item_temperature(bench);
    const double since_s = to_seconds(clock.now() - begin);
    rule.add(since_s, now.air_degc, item);
    guard(item ? std::min(*item, now.air_degc) : now.air_degc, now);
    if (rule.reached()) return rule.words();
    if (since_s > t.soak_max_s)
      throw InstrumentError("chamber " + chamber.info().model, Fault::kStalled,
                            fmt::format("{:g} degC is not reached after {}: {}; required: [temperature] "
                                        "soak_max_s long enough, or a limit that item and chamber can keep",
                                        set_degc, describe_duration(since_s), rule.words()));
    if (since_s - told_s >= kTellEveryS && !bench.simulated_time) {
      told_s = since_s;
      say(rule.words());
    }
    clock.wait_until(clock.now() + interval);
  }
}

void TemperatureSeries::end(MeasuringSession& session, const BenchConfig& config, bool wait) {
  Bench* bench = session.bench();
  if (bench == nullptr || !bench->chamber) return;
  ChamberWatch& chamber = *bench->chamber;
  const ChamberPolicy policy = config.temperature.policy();
  const bool was_unreachable = chamber.unreachable();
  try {
    if (was_unreachable) {
      const Clock::Instant until = bench->clock->now() + from_seconds(config.protocol.replug_timeout_s);
      for (;;) {
        try {
          chamber.reconnect();
          break;
        } catch (const InstrumentError&) {
          if (bench->clock->now() >= until) throw;
          bench->clock->sleep_until(bench->clock->now() + from_seconds(1.0));
        }
      }
      say("The chamber answers again");
    }
    const auto is_warm = [&] { return std::abs(chamber.read().air_degc - kAmbientDegc) < kWarmEnoughK; };
    bool warm = is_warm();
    chamber.apply(policy, warm);
    if (policy == ChamberPolicy::kOff && !warm && wait) {
      const StoppableClock clock(*bench->clock, options_.session.stop);
      const Clock::Instant until = clock.now() + from_seconds(kWaitForAmbientS);
      for (; !warm && clock.now() < until; warm = is_warm())
        clock.wait_until(clock.now() + from_seconds(kIntervalS));
      chamber.apply(policy, warm);
    }
    const char* left = policy == ChamberPolicy::kHold          ? "holds its last set point"
                       : policy == ChamberPolicy::kOff && warm ? "is switched off"
                                                               : "is driven to 23 degC";
    say(fmt::format("The chamber {}{}", left,
                    policy == ChamberPolicy::kOff && !warm ? " and must be switched off there" : ""));
  } catch (const std::exception& error) {
    say(fmt::format("The chamber was not left as [temperature] end = \"{}\" says: {}", config.temperature.end,
                    error.what()));
  }
}

}  // namespace abcal
