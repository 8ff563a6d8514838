#include "app/bench/bench_config.h"

namespace abcal {
namespace {

/// The accelerometer as it sits on the platter.
sim::OutputTruth mounted(sim::OutputTruth truth, const ExpectedItem& expected) {
  if (const auto mounting = mounting_matrix(expected.mounting)) truth.sensitivity_matrix *= *mounting;
  return truth;
}

}  // namespace

BenchConfig for_item(const BenchConfig& config, int item) {
  const TrayItem& of_tray = config.tray.at(static_cast<std::size_t>(item) - 1);
  BenchConfig alone = config;
  alone.tray.clear();
  alone.item = of_tray.item;
  alone.expected = of_tray.expected;
  alone.accelerometer = of_tray.accelerometer;
  alone.tolerances = of_tray.tolerances;
  alone.limits = of_tray.limits;
  alone.emulator.accelerometer_model = of_tray.accelerometer_model;
  alone.emulator.at_power_on = of_tray.at_power_on;
  static_cast<sim::OutputTruth&>(alone.simulation) = mounted(of_tray.simulation, of_tray.expected);
  alone.simulation.item = static_cast<std::uint64_t>(item);
  std::erase_if(alone.changes, [&](const ChangeConfig& change) { return change.item != item; });
  for (ChangeConfig& change : alone.changes) change.truth = mounted(change.truth, of_tray.expected);
  return alone;
}

}  // namespace abcal
