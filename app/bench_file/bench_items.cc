#include <fmt/format.h>

#include "app/bench_file/bench_config.h"

namespace abcal {

std::string item_words(const BenchConfig& config, int item) {
  return config.has_several_items() ? fmt::format("item {}, ", item) : "";
}

std::string accelerometer_name(const BenchConfig& config, int item) {
  return config.has_several_items() ? fmt::format("item-{}", item) : "accelerometer";
}

sim::OutputTruth truth_on_platter(const BenchConfig& config, int item, sim::OutputTruth stated) {
  if (!config.has_several_items()) return stated;
  if (const auto mounting = mounting_matrix(config.item(item).expected.mounting))
    stated.sensitivity_matrix *= *mounting;
  return stated;
}

sim::ItemTruth item_truth(const BenchConfig& config, int item) {
  const std::uint64_t seed = config.simulation.seed;
  return {truth_on_platter(config, item, config.item(item).simulation),
          config.has_several_items() ? sim::item_seed(seed, item) : seed};
}

}  // namespace abcal
