#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/measure/bench/chamber_watch.h"
#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/environment_sensor.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/byte_stream.h"
#include "protocol/run/experiment_run.h"
#include "sim/sim_bench.h"

namespace abcal {

/// One item on a bench. Members are destroyed from the last to the first.
struct BenchItem {
  int k = 1;                             ///< As in the bench file, from 1.
  std::shared_ptr<sim::SimBench> world;  ///< The world as this item feels it; null: nothing is simulated.
  std::unique_ptr<Accelerometer> accelerometer;  ///< Null: it could not be opened.
  Message missing;                               ///< Why it takes no part; empty: it takes part.

  bool is_open() const { return accelerometer != nullptr; }
};

/// The instruments of a bench file, and the time they live in. Members are destroyed from the last to the
/// first.
struct Bench {
  std::unique_ptr<Clock> clock;
  std::shared_ptr<sim::SimBench> world;      ///< The simulated world of the stage; null where all is real.
  std::unique_ptr<ChamberWatch> chamber;     ///< Polled by the stage and the first item; null: none.
  std::unique_ptr<RotationStage> stage;      ///< In protocol angles, inside the bench's travel.
  std::vector<BenchItem> items;              ///< One or more: those that the bench file does not leave out.
  std::unique_ptr<Reconnector> reconnector;  ///< Opens unplugged ports again.
  std::unique_ptr<EnvironmentSensor> environment;  ///< Null: temperature and so on are typed in.
  bool simulated_time = false;                     ///< Everything is simulated, or replayed.
  bool repeatable = false;                         ///< ... simulated, and the clock jumps.
  bool replayed = false;                           ///< Its bytes come from a recording.

  /// The first item whose accelerometer is open; make_bench() makes no bench without one.
  BenchItem& first();
};

/// Functions that replace or wrap the byte streams of a bench. `role` is InstrumentPort::name. All must
/// outlive the bench.
struct BenchStreams {
  using Stream = std::unique_ptr<wire::ByteStream>;

  /// Called with each stream that was opened; the driver uses the stream that it returns.
  std::function<Stream(std::string_view role, Stream opened, const Clock& clock)> wrap;
  /// Gives the streams of a replay: no port is opened, and the bench lives in the time of `replay_clock`,
  /// which jumps.
  std::function<Stream(std::string_view role, Clock& clock)> replay;
  std::unique_ptr<Clock> replay_clock;
  /// Who moves the bench, for the log of its guard and for programs that find it in use: "a jog by A. B.".
  /// Empty: "abcal".
  std::string owner{};
  bool is_trial = false;  ///< The first motions of a described stage, which no trial has passed yet.
};

/// Opens the instruments of a bench file. Only here do real, simulated and replayed instruments differ.
/// `simulated_clock`, if given, is the clock if everything is simulated, instead of one that jumps. With
/// several items, one whose port cannot be opened is missing; at least one is open.
/// @throws InstrumentError kCannotOpen; std::invalid_argument for settings a driver refuses.
Bench make_bench(const BenchConfig& config, BenchStreams streams = {},
                 std::unique_ptr<Clock> simulated_clock = nullptr);

/// A bench in words, for its guard and in the log of that: "on the bench \"left\"", without a name "on the
/// bench at \"tcp:stage:5001\"".
std::string bench_in_words(const BenchConfig& config);

/// The stage of a bench file alone, in protocol angles. Simulated stages speak through their firmware's
/// bytes.
std::unique_ptr<RotationStage> make_stage(const BenchConfig& config, Clock& clock);

}  // namespace abcal
