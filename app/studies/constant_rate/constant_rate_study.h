#pragma once

#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <stop_token>
#include <string>
#include <vector>

#include "app/studies/robustness/scenario.h"
#include "app/studies/trials/error_group.h"
#include "protocol/plan/run_config.h"
#include "sim/bench_truth.h"

namespace abcal {

struct ConstantRateOptions {
  int benches = 1000;  ///< For each design.
  int pairs = 0;       ///< Number of items of the first design that are also measured in steps, on other
                       ///< benches.
  std::uint64_t seed = 1;
  int threads = 1;
  std::stop_token stop = {};
  std::function<void(int done, int planned)> progress = {};
};

struct NamedErrorGroup {
  std::string name, unit;
  ErrorGroup group;
};

/// The runs of one design.
struct ConstantRateOutcome {
  std::string words;  ///< "60 up, 20 down (degree/s), 100 Hz".
  int benches = 0;
  int failed = 0;          ///< Runs or fits without a solution.
  int pairs = 0;           ///< Items measured in steps too, with two results.
  int agreeing = 0;        ///< Pairs whose chi2 is below its 95 % point.
  double longest_s = 0.0;  ///< Longest time from the first move to the park position, in simulated time.
  std::vector<NamedErrorGroup> groups;
};

struct ConstantRateStudy {
  int benches = 0;
  std::uint64_t seed = 0;
  bool interrupted = false;
  std::vector<ConstantRateOutcome> outcomes;
};

/// Whole runs at a constant rate on benches drawn from the default sizes (docs/constant_rate.md): low-pass of
/// 5 Hz, delay of 20 ms, time stamps and encoders that jitter by 1 ms, elements 30 mm from the axes, noise of
/// 1e-4 a reading. The same for any number of threads.
/// @throws std::invalid_argument no benches, no threads
ConstantRateStudy run_constant_rate_study(const ConstantRateOptions& options);

/// Lets a bench turn at 60 and 20 degrees/s, read at kReadingHzAt60And20, as in the first design of the
/// study: its truth, the sizes that it states and its plan.
/// @param further  draws the item's effects of motion
void turn_at_60_and_20(sim::BenchTruth& truth, EffectSizes& sizes, ProtocolConfig& protocol,
                       ScenarioDraw& further);
inline constexpr double kReadingHzAt60And20 = 100.0;

/// The study for people.
std::string constant_rate_text(const ConstantRateStudy& study);
/// The study for programs, schema abcal.constant-rate/1.
nlohmann::ordered_json constant_rate_json(const ConstantRateStudy& study);

}  // namespace abcal
