#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/measure/session/learned_mounting.h"
#include "app/measure/session/small_turn.h"

namespace abcal {

/// One mounting of a series of runs of one item (docs/theory/series.md).
struct SeriesMounting {
  std::string words;     ///< "as in the first run", "turned by 90 degrees about X": against the first one.
  std::string mounting;  ///< As [item] mounting: "x -z y".
  BenchConfig bench;     ///< The bench of its run.
  bool is_simulated = false;  ///< The item is simulated, and `bench` has it turned.
};

/// The mountings of a series, the first as the bench file states it.
/// @throws std::invalid_argument a count without a series; several items; a mounting that is not along the
/// axes of the platter
std::vector<SeriesMounting> mountings_of_series(const BenchConfig& config, int count);

/// A drawing of the axes of the platter in lines of text, each axis with the output that points along it:
/// "x: u", "y: -w", "z: v".
std::string mounting_drawing(const std::string& mounting);

/// The present mounting of an item, compared with the required one.
struct MountingJudgement {
  bool is_as_required = false;
  std::string words;  ///< The mounting that gravity shows, and the turn that is missing.
};

/// Judges from a small turn whether an item is mounted as required.
/// @param poses  of measure_small_turn(), with the signs that the bench file states
/// @param search  without `known`
/// @throws as learn_mounting()
MountingJudgement judge_series_mounting(const std::vector<PoseReading>& poses, const MountingSearch& search,
                                        const std::string& required);

}  // namespace abcal
