#pragma once

#include <cstdio>
#include <string>

#include "app/results/analysis/analyses.h"

namespace abcal {

/// A result in at most 22 lines of a terminal of 80 columns: the verdict first; s, phi and O of u, v, w, each
/// with its expanded uncertainty U = k u (95.45 %); the warnings without which it would mislead, the number
/// of the others with the command that lists them; what to do next; the name of the file. Names of files and
/// commands stay whole, however long, so that they can be copied. The result is the first of the item.
/// Colours as `stream` allows.
/// @param file  name of the run or table, as a command takes it: with the options that a table needs
std::string summary_text(const AnalysedItem& item, const std::string& file, std::FILE* stream);

/// All items of a run: the verdict of all, then a short block for each item. A single item as above.
std::string summary_text(const AnalysedRun& run, const std::string& file, std::FILE* stream);

/// Everything else: every quantity with k, type A and type B, the stage, checks, all estimators side by side,
/// what dominates U, each default with its cost, all warnings. Lines are as wide as their tables.
std::string full_text(const AnalysedItem& item, const std::string& file, std::FILE* stream);
std::string full_text(const AnalysedRun& run, const std::string& file, std::FILE* stream);

}  // namespace abcal
