#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <utility>

#include "app/faces/commands/commands.h"
#include "app/faces/commands/terminal_listener.h"
#include "app/ground/bench_file/bench_records.h"
#include "app/ground/system/exit_code.h"
#include "app/ground/system/interrupt.h"
#include "app/ground/system/output.h"
#include "app/ground/system/terminal.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/operate/session/bench_check.h"

namespace abcal {
CLI::App* add_check(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    bool no_motion = false, json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "check", "Identify both instruments, turn both axes by 30 degrees, and report problems");
  command->add_option("BENCH", options->bench_file, "bench file (TOML)")->required();
  command->add_flag("--no-motion", options->no_motion, "move nothing");
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([options, &exit_code] {
    const BenchConfig config = read_bench(options->bench_file, register_records());
    BenchStreams streams;
    streams.owner = "a check";
    Bench bench = make_bench(config, std::move(streams));
    TerminalListener terminal(
        {.title = "Turning both axes by 30 degrees", .introduce = false, .tell_what_is_kept = false});
    const std::vector<Finding> findings =
        check_bench(bench, config, {options->no_motion, terminal.listener(), interrupt_token()});
    terminal.finish();
    int problems = 0, warnings = 0;
    for (const Finding& finding : findings) {
      problems += finding.grade == Finding::Grade::kProblem ? 1 : 0;
      warnings += finding.grade == Finding::Grade::kWarning ? 1 : 0;
    }
    if (options->json) {
      nlohmann::ordered_json json{
          {"schema", "abcal.check/1"}, {"problems", problems}, {"warnings", warnings}};
      json["findings"] = nlohmann::ordered_json::array();
      for (const Finding& finding : findings)
        json["findings"].push_back({{"grade", to_string(finding.grade)},
                                    {"what", finding.what},
                                    {"found", finding.found},
                                    {"advice", finding.advice}});
      print_result("{}\n", json.dump(2));
    } else {
      for (const Finding& finding : findings) {
        const Emphasis emphasis = finding.grade == Finding::Grade::kProblem   ? Emphasis::kBad
                                  : finding.grade == Finding::Grade::kWarning ? Emphasis::kWarning
                                                                              : Emphasis::kNone;
        print_result("{}  {}: {}\n",
                     emphasised(stdout, emphasis, fmt::format("{:>8}", to_string(finding.grade))),
                     finding.what, finding.found);
        if (!finding.advice.empty()) print_result("{:>8}  do: {}\n", "", finding.advice);
      }
      print_result(
          "{}\n",
          problems > 0   ? fmt::format("{} problem{}: not fit for a run", problems, problems == 1 ? "" : "s")
          : warnings > 0 ? fmt::format("fit for a run, with {} warning{}", warnings, warnings == 1 ? "" : "s")
                         : std::string("fit for a run"));
    }
    exit_code = problems > 0 ? kExitFailed : kExitDone;
  });
  return command;
}

}  // namespace abcal
