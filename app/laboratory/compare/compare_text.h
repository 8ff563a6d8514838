#pragma once

#include <cstdio>
#include <string>

#include "app/laboratory/compare/compare_results.h"

namespace abcal {

/// A comparison as text: verdict, the nine properties, the mounting, statistics of several results, and notes
/// for the reader. Colours as `stream` allows.
std::string compare_text(const ResultsComparison& comparison, std::FILE* stream);

}  // namespace abcal
