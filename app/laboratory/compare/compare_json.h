#pragma once

#include <nlohmann/json_fwd.hpp>

#include "app/laboratory/compare/compare_results.h"

namespace abcal {

/// A comparison as JSON, schema abcal.compare/1. Numbers that were not determined are null.
nlohmann::ordered_json compare_json(const ResultsComparison& comparison);

}  // namespace abcal
