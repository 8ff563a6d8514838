#include <memory>
#include <string>

#include "app/analysed_run/run_session.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"

namespace abcal {

CLI::App* add_replay(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string run_file;
    std::string output;
    ResultForm form = ResultForm::kSummary;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("replay", "Repeat a recorded run from its recorded bytes, without instruments");
  command->add_option("RUN", options->run_file, "run file made with `abcal run BENCH --record`")->required();
  command->add_option("-o,--output", options->output,
                      "run file to create (default: RUN-replay.run in the folder of RUN)");
  add_form_options(*command, options->form, "print the result as one JSON object");
  command->callback([options, &exit_code] {
    TerminalListener terminal({.title = "Replaying", .introduce = false});
    RunSession session(printing_session_options(terminal, options->form, exit_code));
    session.replay({options->run_file, options->output});
  });
  return command;
}

}  // namespace abcal
