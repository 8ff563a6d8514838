#pragma once

#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/clock.h"
#include "sim/bench_truth.h"
#include "sim/faults.h"
#include "sim/sim_bench.h"

namespace abcal {

/// One `[[fault]]` of a bench file.
struct FaultConfig {
  std::string kind;             ///< A name of sim::fault_descriptions(), e.g. "silence".
  std::string instrument;       ///< Faults of the wire: "stage", "stage-z" (its own port) or "accelerometer".
  std::string axis = "x";       ///< Faults of an axis: "x" or "z".
  double at_s = 0.0;            ///< From the start of the world on.
  std::optional<double> for_s;  ///< Absent: it lasts.
  std::optional<int> at_write, for_writes;  ///< Faults of the wire: from this command on, that many.
  double value = 0.0;                       ///< clipped-output: full scale in R; of an axis: degrees.
  std::string output;                       ///< stuck-output: "u", "v" or "w"; empty: all three.
  std::string text;                         ///< replaced-reply
  double delay_s = 1.0;                     ///< late-reply
};

/// One `[[change]]`: from `at_s` on the accelerometer and the room are like this.
struct ChangeConfig {
  double at_s = 0.0;
  sim::OutputTruth truth;
  int item = 1;  ///< Of several.
};

/// The names that FaultConfig::instrument may have on a bench with one item.
const std::vector<std::string>& fault_instruments();

/// The number of the item behind "item-3" or "item-3-u"; nothing for another name.
std::optional<int> item_of_instrument(std::string_view instrument);

/// The names that FaultConfig::kind may have.
std::vector<std::string> fault_names();

/// What is wrong with a fault in itself (no instrument for one of the wire, an unknown axis), or nothing.
std::optional<std::string> problem_of(const FaultConfig& fault);

/// The fault of the wire that this is, with times counted from `start`; nothing for one of the world.
std::optional<sim::WireFault> wire_fault(const FaultConfig& fault, Clock::Instant start);
std::optional<sim::WorldFault> world_fault(const FaultConfig& fault, Clock::Instant start);

/// The faults of the wire of one instrument.
std::vector<sim::WireFault> wire_faults(const std::vector<FaultConfig>& faults, const std::string& instrument,
                                        Clock::Instant start);

/// Tells the world of its faults and changes.
/// @param item  Of several: whose world it is; it has the faults of its accelerometer, and all of the stage.
void schedule(const std::vector<FaultConfig>& faults, const std::vector<ChangeConfig>& changes,
              sim::SimBench& world, std::optional<int> item = std::nullopt);

}  // namespace abcal
