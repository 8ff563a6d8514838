#include <fmt/format.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>

#include "app/bench/bench_config.h"
#include "app/commands/commands.h"
#include "app/commands/manual.h"
#include "app/commands/simulate.h"
#include "app/commands/uncertainty.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/terminal.h"
#include "app/system/version.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/run/experiment_run.h"

namespace {

int fail(abcal::ExitCode code, const char* what) {
  fmt::print(stderr, "{} {}\n", abcal::emphasised(stderr, abcal::Emphasis::kBad, "abcal:"), what);
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace abcal;
  watch_for_signals();
  // Standard output belongs to results; whatever is logged goes to standard error.
  spdlog::set_default_logger(spdlog::stderr_color_mt("abcal"));
  spdlog::set_pattern("%^%l%$: %v");

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
    if (error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success)) return app.exit(error);  // --help
    fmt::print(stderr, "abcal: {}\nRun `abcal --help` or `abcal COMMAND --help` to see what is possible.\n",
               error.what());
    return kExitUsage;
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
  } catch (const std::exception& error) {
    return fail(kExitFailed, error.what());
  }
}
