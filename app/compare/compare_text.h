#pragma once

#include <cstdio>
#include <string>

#include "app/compare/compare_results.h"

namespace abcal {

/// A comparison as people read it: verdict, the nine properties, the mounting, what several results tell, and
/// what a reader must know. Colours as `stream` allows.
std::string compare_text(const ResultsComparison& comparison, std::FILE* stream);

}  // namespace abcal
