#pragma once

#include <filesystem>
#include <string>

#include "app/system/child_process.h"

namespace abcal {

/// gnuplot, for is_installed().
extern const Tool kGnuplot;

/// Text that gnuplot reads literally: in single quotes it follows neither escapes nor backquotes.
std::string gnuplot_quoted(const std::string& text);

/// Draws a script, which names its terminal and output.
/// @throws ProgramMissing if gnuplot is not installed
/// @throws std::runtime_error if gnuplot fails; the script is kept, and named
void run_gnuplot(const std::filesystem::path& script);

/// Draws the text of a script that writes one file; nothing else is left.
/// @throws as run_gnuplot(); std::runtime_error if the script cannot be written, or made no such file
void draw_file(const std::string& script, const std::filesystem::path& output);

/// The picture of a script without terminal and output as SVG, 800 wide.
/// @throws ProgramMissing, std::runtime_error
std::string draw_svg(const std::string& script, int height);

}  // namespace abcal
