#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <map>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/item_identity.h"
#include "app/measure/bench/make_bench.h"
#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"

namespace abcal {

/// An item and its accelerometer.
struct ItemIdentity {
  int k = 1;
  AccelerometerInfo accelerometer;
  /// Corrections that the accelerometer itself applies (Accelerometer::correction_registers()).
  std::map<std::string, std::string> corrections;
  Message missing;  ///< Why it takes no part; empty: it takes part.

  bool is_present() const { return missing.empty(); }
};

/// The identities that the instruments reported before the first move.
struct Identities {
  StageInfo stage;
  std::optional<ChamberInfo> chamber{};
  std::vector<ItemIdentity> items = std::vector<ItemIdentity>(1);  ///< As Bench::items.

  /// The first item that is present; the first of all where none is.
  const ItemIdentity& first() const;
  std::array<AxisTravel, 2> travel() const;
};

/// Identifies the instruments and compares them with the bench file. With several items, one that does not
/// answer is marked as missing in Bench::items and in the result.
/// @param ask_corrections  false: for the replay of a recording in which nobody asked
/// @throws InstrumentError kWrongIdentity
Identities identify(Bench& bench, const BenchConfig& config, bool ask_corrections = true);

/// @throws InstrumentError that names every missing item and the required action
void require_all_items(const Identities& identities);

/// Refuses an instrument whose serial number is not `required` (empty: any will do).
/// @throws InstrumentError kWrongIdentity
void require_serial_number(const std::string& role, const std::string& model, const std::string& found,
                           const std::string& required);

/// As require_serial_number(), but the bench file may state the serial number of an instrument that reports
/// none. A number that is reported must equal the stated one.
/// @throws InstrumentError kWrongIdentity
void require_or_state_serial_number(const std::string& role, const std::string& model,
                                    const std::string& found, const std::string& stated);

/// Compares the serial number of an accelerometer, or of the voltmeter that reads it, with the bench file. As
/// for a stage, that of a voltmeter may be stated only; any other accelerometer must report it.
/// @throws InstrumentError kWrongIdentity
void require_serial_number_of_accelerometer(const std::string& role, const AccelerometerConfig& config,
                                            const AccelerometerInfo& info);

/// Maker, model and serial number of an item, by the bench file and by the instrument that answers.
ItemIdentityParts identity_parts_of(const BenchItemConfig& stated, const AccelerometerInfo& info);

/// Refuses an item whose maker, model or serial number, as its instrument reports it, is not that of [item].
/// @param role  for messages: "item 2, accelerometer"
/// @throws InstrumentError kWrongIdentity, with every difference
void require_item_as_stated(const std::string& role, const BenchItemConfig& stated,
                            const AccelerometerInfo& info);

/// require_item_as_stated() for every item that is present.
void require_items_as_stated(const BenchConfig& config, const Identities& identities);

/// How long a plan takes on these instruments, in the time of the bench.
PlanDuration estimate_duration(const std::vector<PlannedAngle>& plan, const BenchConfig& config,
                               const Identities& identities);

/// When and by which clocks measuring begins on a bench.
SessionStart session_start(const Bench& bench);

/// The header of a run file, as it is stored before the first angle.
RunHeader make_header(const BenchConfig& config, const Identities& identities, std::vector<PlannedAngle> plan,
                      const Clock& clock);

/// "a.run" given, or "BENCH-20260301T120000Z<extension>" here.
std::filesystem::path output_path(const std::string& given, const std::string& bench_file,
                                  const std::string& extension);

/// Stores temperature, humidity and pressure as measured by the sensor, or as typed into the bench file. A
/// sensor that fails at the start throws InstrumentError; at the end of a run the failure is only recorded,
/// because the run is complete without it.
/// @return a warning: why the sensor could not be read at the end.
std::optional<Message> note_environment(Bench& bench, const BenchConfig& config, RunFile& file,
                                        std::string_view moment);

/// A plan to measure on a bench, and the file for it.
struct PlanMeasurement {
  Bench& bench;
  const BenchConfig& config;
  RunFile& file;
  const std::vector<PlannedAngle>& plan;
  RunProgress so_far;
};

/// Measures the missing angles of the plan. In real time `stop` halts the stage at once, even while the
/// measuring thread waits: the halt is sent by the thread that requests the stop.
RunTiming measure_plan(const PlanMeasurement& measurement, RunObserver& observer,
                       const std::stop_token& stop);

}  // namespace abcal
