#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "protocol/plan/effect_sizes.h"
#include "sim/bench_truth.h"

namespace abcal {

/// The run for which a truth is drawn.
struct DrawnRun {
  double span_s = 0.0;     ///< Its time: drifts have their stated sizes over it.
  bool at_a_rate = false;  ///< It is at constant rates, and has the effects of motion.
};

/// Draws the truth of a simulated bench from what is stated of it: each effect from the distribution of its
/// size, by the seed of the stage. The step errors without memory and the noise follow in the simulator, from
/// the same seed. effects_not_drawn() are left as they are.
/// @param sizes      those of each item; the stage has those of the first
/// @param is_fixed   whether a key of [simulation] ("zx", "x.wobble_urad", "k2") keeps its value, for an item
///                   counted from 1, or for the stage (0)
/// @param items      one for each of `sizes`, with its sensitivity matrix
void draw_stated_truth(const std::vector<EffectSizes>& sizes, const DrawnRun& run,
                       const std::function<bool(std::size_t item, std::string_view key)>& is_fixed,
                       sim::StageTruth& stage, const std::vector<sim::OutputTruth*>& items);

/// The same for a bench file. Drifts are drawn over the time of its planned run, and only where simulated
/// time begins with that run: without a port that is not simulated and without a series over temperature.
/// @param gives  whether the file gives a value under a path: "simulation.x.wobble_urad",
///               "item[0].simulation.k2"
void draw_stated_truth(BenchConfig& config, const std::function<bool(const std::string& path)>& gives);

/// Keys of sizes whose effects the simulator does not draw, each with the reason.
struct EffectNotDrawn {
  std::string_view key, reason;
};
const std::vector<EffectNotDrawn>& effects_not_drawn();

}  // namespace abcal
