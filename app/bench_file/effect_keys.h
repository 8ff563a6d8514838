#pragma once

#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/formats/key_visitor.h"

namespace abcal {

/// Visits [stage_uncertainty] and [item_uncertainty]. [tolerances] of abcal.bench/1 is read as well, with a
/// warning, but not written.
/// @param with_item  whether [item_uncertainty] is visited
void visit_effect_sizes(KeyVisitor& keys, EffectSizes& sizes, bool with_item,
                        std::vector<std::string>& warnings);

/// The keys of [item_uncertainty], in the section being visited.
void visit_item_effect_sizes(KeyVisitor& keys, EffectSizes& sizes);

/// The effects of the simulated world (docs/effects.md), in the section being visited: those of one axis, of
/// the accelerometer and its mount, and of the whole bench.
void visit_axis_effects(KeyVisitor& keys, sim::AxisTruth& axis);
/// The list of tables [[simulation.x.wobble]]: after all plain keys of the section, as TOML requires.
void visit_axis_wobble(KeyVisitor& keys, sim::AxisTruth& axis);
void visit_output_effects(KeyVisitor& keys, sim::OutputTruth& truth);
void visit_world_effects(KeyVisitor& keys, sim::StageTruth& truth);

}  // namespace abcal
