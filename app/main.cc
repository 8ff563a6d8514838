#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdlib>
#include <exception>
#include <sstream>

#include "app/bench/bench_config.h"
#include "app/commands/commands.h"
#include "app/commands/manual.h"
#include "app/commands/simulate.h"
#include "app/commands/uncertainty.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/version.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/run/experiment_run.h"

namespace abcal {
namespace {

int fail(ExitCode code, const char* what) {
  print_error(what);
  return code;
}

/// A command was refused, or help was asked for.
int explain(const CLI::App& app, const CLI::ParseError& error) {
  if (error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success)) {
    std::ostringstream text, ignored;
    const int exit_code = app.exit(error, text, ignored);
    print_result("{}", text.str());
    return exit_code;
  }
  print_log("abcal: {}\nRun `abcal --help` or `abcal COMMAND --help` to see what is possible.\n",
            error.what());
  return kExitUsage;
}

/// @returns what the program shall return to the shell; whatever was thrown is a message by then.
int run_command(int argc, char** argv) {
  int exit_code = kExitDone;
  CLI::App app(
      "abcal calibrates triaxial accelerometers with gravity on a two-axis rotation stage (ABC protocol).\n"
      "A software halt is no emergency stop: keep the stage's own switch within reach.",
      "abcal");
  app.set_version_flag("--version", std::string("abcal ") + program_version());
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::help);
  add_run(app, exit_code);
  add_resume(app, exit_code);
  add_replay(app, exit_code);
  add_plan(app, exit_code);
  add_check(app, exit_code);
  add_analyse(app, exit_code);
  add_uncertainty(app, exit_code);
  add_simulate(app, exit_code);
  add_report(app, exit_code);
  add_issue(app, exit_code);
  add_verify(app, exit_code);
  add_level(app, exit_code);
  add_emulate(app, exit_code);
  add_compare(app, exit_code);
  add_gravity(app, exit_code);
  add_serve(app, exit_code);
  add_instruments(app, exit_code);
  add_manual_option(app, std::string("abcal ") + program_version());
  try {
    app.parse(argc, argv);
    return exit_code;
  } catch (const CLI::ParseError& error) {
    return explain(app, error);
  } catch (const BenchError& error) {
    return fail(kExitUsage, error.what());
  } catch (const PlanError& error) {
    return fail(kExitUsage, error.what());
  } catch (const InstrumentError& error) {
    return fail(kExitInstrument, error.what());
  } catch (const RunInterrupted& error) {
    return fail(kExitInterrupted, error.what());
  } catch (const std::invalid_argument& error) {
    return fail(kExitUsage, error.what());
  }
}

/// An exception that nobody caught, in whichever thread, is a bug; its words are not lost.
[[noreturn]] void end_after_bug() noexcept {
  try {
    if (const std::exception_ptr pending = std::current_exception()) std::rethrow_exception(pending);
    print_error("ended by an error of its own");
  } catch (const std::exception& error) {
    print_log("abcal: ended by an error of its own: {}\n", error.what());
  } catch (...) {
    print_error("ended by an error of its own, of an unknown kind");
  }
  std::abort();
}

}  // namespace
}  // namespace abcal

int main(int argc, char** argv) {
  using namespace abcal;
  reserve_standard_descriptors();
  std::set_terminate(end_after_bug);
  watch_for_signals();
  int exit_code = kExitFailed;
  try {
    exit_code = run_command(argc, argv);
  } catch (const std::exception& error) {
    print_error(error.what());
  } catch (...) {
    print_error("failed for a reason that has no words");
  }
  return finish_output(exit_code);
}
