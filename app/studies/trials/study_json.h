#pragma once

#include <nlohmann/json_fwd.hpp>

#include "protocol/uncertainty/run_uncertainty.h"
#include "protocol/uncertainty/simulation_sets.h"

namespace abcal {

/// A simulation set as one JSON object, schema abcal.study/1 (docs/architecture.md). Every group of outputs
/// has sensitivity_matrix (3x3, rows u v w), offset, intrinsic_sensitivity and intrinsic_angle (degrees) as
/// plain numbers; values that are not determined or not printed are null.
nlohmann::ordered_json study_json(const StudyResult& study);

/// The uncertainty of a run, same schema; cases: type B, type A, combined.
nlohmann::ordered_json study_json(const RunUncertainty& study);

}  // namespace abcal
