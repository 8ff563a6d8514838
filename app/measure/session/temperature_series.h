#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/measure/session/measuring_session.h"
#include "protocol/plan/series_leg.h"

namespace abcal {

/// One point to measure.
struct SeriesPoint {
  SeriesLeg leg = SeriesLeg::kUp;
  double set_degc = 0.0;
};

/// The reference, the set points from one end to the other, back if wanted, and the reference again.
std::vector<SeriesPoint> series_points(const TemperatureConfig& config);

/// The run file of each point: STEM-01.run ...
std::vector<std::filesystem::path> series_paths(const std::filesystem::path& stem, std::size_t points);

/// Measures a series: drives the chamber to each point, waits until the item is at rest, and lets
/// MeasuringSession measure a run. Points that are measured are kept, and an interrupted run is resumed, so
/// that a series continues where it ended. After any end the chamber is left as its policy states.
class TemperatureSeries {
 public:
  struct Options {
    MeasuringSession::Options session;             ///< The listener receives the events of every run.
    std::function<void(const std::string&)> tell;  ///< Sentences for a person, with the remaining time.
  };
  struct Request {
    BenchConfig bench;
    std::string bench_file;      ///< Its name, for messages.
    std::filesystem::path stem;  ///< Common part of the run files' paths: "STEM-01.run".
    std::string plan_words{};    ///< Request that the plan was found for; empty: the bench file's plan.
  };

  explicit TemperatureSeries(Options options) : options_(std::move(options)) {}

  /// @throws BenchError (every demand that the chamber cannot meet), InstrumentError, RunFileError,
  /// RunInterrupted, std::invalid_argument: the output file is from another bench
  std::vector<std::filesystem::path> measure(const Request& request);

 private:
  struct Progress;
  void measure_points(MeasuringSession& session, Progress& progress);
  void measure_point(MeasuringSession& session, Progress& progress, std::size_t n);
  std::string soak(MeasuringSession& session, const Progress& progress, std::size_t n);
  void end(MeasuringSession& session, const BenchConfig& config, bool wait);
  void say(const std::string& text) const {
    if (options_.tell) options_.tell(text);
  }

  Options options_;
};

}  // namespace abcal
