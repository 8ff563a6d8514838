#include "app/commands/bench.h"
#include "app/commands/command_help.h"
#include "app/commands/commands.h"
#include "app/commands/manual.h"
#include "app/commands/simulate.h"
#include "app/commands/uncertainty.h"
#include "app/run_program.h"
#include "app/system/version.h"

namespace {

void add_commands(CLI::App& app, int& exit_code) {
  using namespace abcal;
  add_init(app, exit_code);
  add_instruments(app, exit_code);
  add_plan(app, exit_code);
  add_check(app, exit_code);
  add_level(app, exit_code);
  add_stage(app, exit_code);
  add_mountings(app, exit_code);
  add_gravity(app, exit_code);
  add_self_test(app, exit_code);
  add_run(app, exit_code);
  add_resume(app, exit_code);
  add_temperature(app, exit_code);
  add_serve(app, exit_code);
  add_bench(app, exit_code);
  add_analyse(app, exit_code);
  add_combine(app, exit_code);
  add_uncertainty(app, exit_code, one_process());
  add_report(app, exit_code);
  add_compare(app, exit_code);
  add_pilot(app, exit_code);
  add_export(app, exit_code);
  add_apply(app, exit_code);
  add_verify(app, exit_code);
  add_issue(app, exit_code);
  add_lab(app, exit_code);
  add_demo(app, exit_code);
  add_docs(app, exit_code);
  add_emulate(app, exit_code);
  add_simulate(app, exit_code);
  add_replay(app, exit_code);
  add_record(app, exit_code);
  add_help(app);
  add_manual_option(app, std::string("abcal ") + program_version());
}

}  // namespace

int main(int argc, char** argv) {
  return abcal::run_program(
      argc, argv,
      {"abcal",
       "abcal calibrates triaxial accelerometers with gravity on a two-axis rotation stage (ABC protocol).\n"
       "A software halt is not an emergency stop: keep the stage's own switch within reach.",
       add_commands});
}
