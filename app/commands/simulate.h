#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>

namespace abcal {

/// `abcal simulate SET`: the paper's simulations. Bad options throw std::invalid_argument.
CLI::App* add_simulate(CLI::App& parent, int& exit_code);

/// A count from the command line. (CLI11 accepts "-3" as an unsigned number and wraps it.)
/// @throws std::invalid_argument naming the option if it is negative
std::uint64_t not_negative(const char* option, std::int64_t value);

}  // namespace abcal
