#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_config.h"
#include "app/commands/terminal_listener.h"

namespace abcal {

/// Prints the warnings of a bench file: accepted, but unusual.
void print_warnings(const BenchConfig& config);

/// A session whose events are shown at the terminal; Ctrl-C stops it. `terminal` must outlive the session.
RunSession::Options session_options(TerminalListener& terminal);

/// How a command prints a result.
enum class ResultForm {
  kSummary,  ///< The first screen of a terminal: verdict, values with U, warnings.
  kFull,     ///< Everything that is known, in tables as wide as they need.
  kJson,     ///< For programs.
};

/// Adds --json and --full. `form` must outlive the command.
/// @return the option --full
CLI::Option* add_form_options(CLI::App& command, ResultForm& form, const std::string& about_json);

/// Prints the result of a complete run on standard output.
/// @return the exit code of the program.
int print_outcome(const RunOutcome& outcome, ResultForm form);

/// As session_options(); prints the result of the run as soon as it is known, and sets `exit_code`.
RunSession::Options printing_session_options(TerminalListener& terminal, ResultForm form, int& exit_code);

}  // namespace abcal
