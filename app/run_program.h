#pragma once

#include <functional>
#include <string>

namespace CLI {
class App;
}

namespace abcal {

/// A program with subcommands.
struct ProgramDescription {
  std::string name;         ///< "abcal"
  std::string description;  ///< For --help.
  /// Adds the subcommands; each sets the exit code (app/system/exit_code.h) when it was run.
  std::function<void(CLI::App&, int& exit_code)> add_commands;
};

/// All of main(): signals, standard descriptors, the command line, exceptions as messages and exit codes (a
/// contract, docs/architecture.md), and at the end whether every result was written.
/// @returns the exit code for the shell
int run_program(int argc, char** argv, const ProgramDescription& program) noexcept;

}  // namespace abcal
