#pragma once

#include <CLI/CLI.hpp>

namespace abcal {

/// Gives every command its group in `--help` and its examples. @throws std::logic_error if a command has none
void add_help(CLI::App& app);

}  // namespace abcal
