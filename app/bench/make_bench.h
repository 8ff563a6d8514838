#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench/bench_config.h"
#include "app/bench/chamber_watch.h"
#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/environment_sensor.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/byte_stream.h"
#include "protocol/run/experiment_run.h"
#include "sim/sim_bench.h"

namespace abcal {

/// One of several items on a bench.
struct BenchItem {
  int k = 1;                               ///< As in the bench file, from 1.
  Accelerometer* accelerometer = nullptr;  ///< Null: it is not there.
  std::string missing;                     ///< Why it is not there; empty: it is.
};

/// The instruments of a bench file, and the time they live in. Members are destroyed from the last to the
/// first.
struct Bench {
  std::unique_ptr<Clock> clock;
  std::shared_ptr<sim::SimBench> world;  ///< The simulated world; null where everything is real.
  std::vector<std::shared_ptr<sim::SimBench>>
      item_worlds;  ///< Of several items, by number; the first is `world`.
  std::unique_ptr<ChamberWatch>
      chamber;  ///< Null: there is none. Stage and accelerometer let it be looked at.
  std::unique_ptr<RotationStage> stage;          ///< In protocol angles, inside the bench's travel.
  std::unique_ptr<Accelerometer> accelerometer;  ///< Of several items that of the first that is there.
  std::vector<std::unique_ptr<Accelerometer>> further_accelerometers;
  std::vector<BenchItem> items;              ///< Of several: all that are to be opened. Empty: there is one.
  std::unique_ptr<Reconnector> reconnector;  ///< Opens unplugged ports again.
  std::unique_ptr<EnvironmentSensor> environment;  ///< Null: temperature and so on are typed in.
  bool simulated_time = false;                     ///< Everything is simulated, or replayed.
  bool repeatable = false;                         ///< ... simulated, and the clock jumps.
  bool replayed = false;                           ///< Its bytes come from a recording.
};

/// How the byte streams of a bench are replaced or wrapped. `role`
/// is InstrumentPort::name. All must outlive the bench.
struct BenchStreams {
  using Stream = std::unique_ptr<wire::ByteStream>;

  /// Called with each stream that was opened; the driver uses the stream that it returns.
  std::function<Stream(std::string_view role, Stream opened, const Clock& clock)> wrap;
  /// Gives the streams of a replay: no port is opened, and the bench lives in the time of `replay_clock`,
  /// which jumps.
  std::function<Stream(std::string_view role, Clock& clock)> replay;
  std::unique_ptr<Clock> replay_clock;
};

/// Opens the instruments of a bench file. The only place where real, simulated and replayed differ.
/// `simulated_clock`, if given, is the clock if everything is simulated, instead of one that jumps.
/// One of several items whose port cannot be opened is missing.
/// @throws InstrumentError kCannotOpen; std::invalid_argument for settings a driver refuses.
Bench make_bench(const BenchConfig& config, BenchStreams streams = {},
                 std::unique_ptr<Clock> simulated_clock = nullptr);

/// Which of "stage" and "accelerometer" are simulated in a bench file, in whole or in part. An emulated
/// instrument on a pseudo-terminal looks like a real one and is not among them.
std::vector<std::string> simulated_instruments(const BenchConfig& config);

/// The stage of a bench file alone, in protocol angles. Simulated stages speak through their firmware's
/// bytes.
std::unique_ptr<RotationStage> make_stage(const BenchConfig& config, Clock& clock);

}  // namespace abcal
