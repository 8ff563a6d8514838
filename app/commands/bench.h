#pragma once

#include <CLI/CLI.hpp>

namespace abcal {

/// `abcal bench`: the process that holds a bench for consoles.
CLI::App* add_bench(CLI::App& parent, int& exit_code);

}  // namespace abcal
