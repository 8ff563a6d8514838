#pragma once

#include <CLI/CLI.hpp>

namespace abcal {

/// `abcal stage try`.
void add_stage_try(CLI::App& parent, int& exit_code);

}  // namespace abcal
