#include "app/ground/system/run_program.h"

#include <CLI/CLI.hpp>
#include <cstdlib>
#include <exception>
#include <sstream>
#include <string>
#include <string_view>

#include "app/ground/bench_file/bench_config.h"
#include "app/ground/system/exit_code.h"
#include "app/ground/system/interrupt.h"
#include "app/ground/system/output.h"
#include "app/ground/system/version.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_interrupted.h"

namespace abcal {
namespace {

int fail_with(ExitCode code, const char* what) {
  print_error(what);
  return code;
}

/// A command was refused, or help was asked for.
int explain_command_line(const CLI::App& app, const CLI::ParseError& error) {
  if (error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success)) {
    std::ostringstream text, ignored;
    const int exit_code = app.exit(error, text, ignored);
    print_result("{}", text.str());
    return exit_code;
  }
  print_log("{0}: {1}\nRun `{0} --help` or `{0} COMMAND --help` for commands and options.\n", app.get_name(),
            error.what());
  return kExitUsage;
}

/// @return the exit code of the program.
int run_command(int argc, char** argv, const ProgramDescription& program) {
  const std::string version = program.name + " " + program_version();
  if (argc == 2 &&
      argv[1] == std::string_view("--version")) {  // Other programs ask often: without all the commands.
    print_result("{}\n", version);
    return kExitDone;
  }
  int exit_code = kExitDone;
  CLI::App app(program.description, program.name);
  app.set_version_flag("--version", version);
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::help);
  program.add_commands(app, exit_code);
  try {
    app.parse(argc, argv);
    return exit_code;
  } catch (const CLI::ParseError& error) {
    return explain_command_line(app, error);
  } catch (const BenchError& error) {
    return fail_with(kExitUsage, error.what());
  } catch (const PlanError& error) {
    return fail_with(kExitUsage, error.what());
  } catch (const InstrumentError& error) {
    return fail_with(kExitInstrument, error.what());
  } catch (const RunInterrupted& error) {
    return fail_with(kExitInterrupted, error.what());
  } catch (const std::invalid_argument& error) {
    return fail_with(kExitUsage, error.what());
  }
}

/// An exception that is caught nowhere is a bug, in any thread; its message is logged.
[[noreturn]] void end_after_bug() noexcept {
  try {
    if (const std::exception_ptr pending = std::current_exception()) std::rethrow_exception(pending);
    print_error("internal error");
  } catch (const std::exception& error) {
    print_log("abcal: internal error: {}\n", error.what());
  } catch (...) {
    print_error("internal error of an unknown kind");
  }
  std::abort();
}

}  // namespace

int run_program(int argc, char** argv, const ProgramDescription& program) noexcept {
  reserve_standard_descriptors();
  std::set_terminate(end_after_bug);
  int exit_code = kExitFailed;
  try {
    watch_for_signals();
    exit_code = run_command(argc, argv, program);
  } catch (const std::exception& error) {
    print_error(error.what());
  } catch (...) {
    print_error("failed for an unknown reason");
  }
  return finish_output(exit_code);
}

}  // namespace abcal
