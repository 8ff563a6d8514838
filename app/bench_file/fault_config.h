#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sim/bench_truth.h"

namespace abcal {

/// One `[[fault]]` of a bench file.
struct FaultConfig {
  std::string kind;             ///< A name of sim::fault_descriptions(), e.g. "silence".
  std::string instrument;       ///< Faults of the wire: "stage", "stage-z" (its own port) or "accelerometer".
  std::string axis = "x";       ///< Faults of an axis: "x" or "z".
  double at_s = 0.0;            ///< From the start of the world on.
  std::optional<double> for_s;  ///< Absent: it lasts.
  std::optional<int> at_write, for_writes;  ///< Faults of the wire: first command, number of commands.
  double value = 0.0;                       ///< clipped-output: full scale in R; axis faults: degrees.
  std::string output;                       ///< stuck-output: "u", "v" or "w"; empty: all three.
  std::string text;                         ///< replaced-reply
  double delay_s = 1.0;                     ///< late-reply

  bool operator==(const FaultConfig&) const = default;
};

/// One `[[change]]`: the truth of accelerometer and room from `at_s` on.
struct ChangeConfig {
  double at_s = 0.0;
  sim::OutputTruth truth;
  int item = 1;  ///< Number of the item, from 1.

  bool operator==(const ChangeConfig&) const = default;
};

/// The names that FaultConfig::instrument may have on a bench with one item.
const std::vector<std::string>& fault_instruments();

/// The number of the item behind "item-3" or "item-3-u"; nothing for another name.
std::optional<int> item_of_instrument(std::string_view instrument);

/// The names that FaultConfig::kind may have.
std::vector<std::string> fault_names();

/// The problem of a fault of the wire that names no instrument; nothing for any other fault.
std::optional<std::string> problem_of(const FaultConfig& fault);

}  // namespace abcal
