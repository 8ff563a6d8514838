#include "app/commands/check.h"

#include <fmt/format.h>

#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "app/bench_file/bench_records.h"
#include "app/commands/commands.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

std::ptrdiff_t count(const std::vector<Finding>& findings, Finding::Grade grade) {
  return std::ranges::count(findings, grade, &Finding::grade);
}

int exit_code_of(const std::vector<Finding>& findings) {
  return count(findings, Finding::Grade::kProblem) > 0 ? kExitFailed : kExitDone;
}

nlohmann::ordered_json findings_json(const std::vector<Finding>& findings) {
  nlohmann::ordered_json json{{"schema", "abcal.check/1"},
                              {"problems", count(findings, Finding::Grade::kProblem)},
                              {"warnings", count(findings, Finding::Grade::kWarning)}};
  json["findings"] = nlohmann::ordered_json::array();
  for (const Finding& finding : findings)
    json["findings"].push_back({{"grade", to_string(finding.grade)},
                                {"what", finding.what},
                                {"found", finding.found},
                                {"advice", finding.advice}});
  return json;
}

}  // namespace

TerminalListener::Options small_turn_at_terminal() {
  return {.title = fmt::format("Turning both axes by {:g} degrees", kSmallTurnDeg),
          .introduce = false,
          .tell_what_is_kept = false};
}

std::vector<Finding> check_at_terminal(const BenchConfig& config, bool no_motion) {
  BenchStreams streams;
  streams.owner = "a check";
  Bench bench = make_bench(config, std::move(streams));
  TerminalListener terminal(small_turn_at_terminal());
  std::vector<Finding> findings =
      check_bench(bench, config, {no_motion, terminal.listener(), interrupt_token()});
  terminal.finish();
  return findings;
}

int print_findings(const std::vector<Finding>& findings) {
  for (const Finding& finding : findings) {
    const Emphasis emphasis = finding.grade == Finding::Grade::kProblem   ? Emphasis::kBad
                              : finding.grade == Finding::Grade::kWarning ? Emphasis::kWarning
                                                                          : Emphasis::kNone;
    print_result("{}  {}: {}\n", emphasised(stdout, emphasis, fmt::format("{:>8}", to_string(finding.grade))),
                 finding.what, finding.found);
    if (!finding.advice.empty()) print_result("{:>8}  do: {}\n", "", finding.advice);
  }
  const std::ptrdiff_t problems = count(findings, Finding::Grade::kProblem);
  const std::ptrdiff_t warnings = count(findings, Finding::Grade::kWarning);
  print_result(
      "{}\n",
      problems > 0   ? fmt::format("{} problem{}: not fit for a run", problems, problems == 1 ? "" : "s")
      : warnings > 0 ? fmt::format("fit for a run, with {} warning{}", warnings, warnings == 1 ? "" : "s")
                     : std::string("fit for a run"));
  return exit_code_of(findings);
}

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
    const std::vector<Finding> findings = check_at_terminal(config, options->no_motion);
    if (!options->json) {
      exit_code = print_findings(findings);
      return;
    }
    print_result("{}\n", findings_json(findings).dump(2));
    exit_code = exit_code_of(findings);
  });
  return command;
}

}  // namespace abcal
