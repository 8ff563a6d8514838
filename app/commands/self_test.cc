#include "app/commands/validation/self_test.h"

#include <fmt/format.h>
#include <unistd.h>

#include <array>
#include <nlohmann/json.hpp>

#include "app/commands/commands.h"
#include "app/commands/validation/validation_file.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/terminal.h"
#include "app/system/version.h"
#include "drivers/text/names.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

struct SelfTestOptions {
  bool json = false, file = false, page = false;
  std::string results;
};

constexpr auto kGrades = names<SelfCheck::Grade>(
    {{SelfCheck::Grade::kGood, "good"}, {SelfCheck::Grade::kNote, "note"}, {SelfCheck::Grade::kBad, "bad"}});

void print_check(const SelfCheck& check) {
  const Emphasis emphasis = check.grade == SelfCheck::Grade::kGood   ? Emphasis::kGood
                            : check.grade == SelfCheck::Grade::kNote ? Emphasis::kWarning
                                                                     : Emphasis::kBad;
  print_result("{}  {}: {}: {}\n",
               emphasised(stdout, emphasis, fmt::format("{:>4}", kGrades.of(check.grade, "bad"))),
               check.group, check.what, check.found);
}

std::string host_name() {
  std::array<char, 256> name{};
  return ::gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "an unnamed computer";
}

int self_test(const SelfTestOptions& options) {
  if (options.page) {
    print_result("{}", validation_page());
    return kExitDone;
  }
  std::optional<TestResults> results;
  if (!options.results.empty()) results = read_test_results(options.results);
  const Clock::UtcTime now = RealClock().utc_now();
  const bool for_people = !options.json && !options.file;
  const std::vector<SelfCheck> checks =
      run_self_test(now, for_people ? print_check : std::function<void(const SelfCheck&)>());
  const bool good = all_good(checks);
  if (options.file) {
    print_result("{}", validation_file({program_version(), format_utc(now), host_name()}, checks,
                                       results ? &*results : nullptr));
  } else if (options.json) {
    nlohmann::ordered_json json{{"schema", "abcal.self_test/1"},
                                {"version", program_version()},
                                {"utc", format_utc(now)},
                                {"good", good}};
    for (const SelfCheck& check : checks)
      json["checks"].push_back({{"group", check.group},
                                {"what", check.what},
                                {"result", kGrades.of(check.grade, "bad")},
                                {"found", check.found}});
    print_result("{}\n", json.dump(2));
  } else {
    print_result("{}\n",
                 good ? "The self-test is good." : "The self-test is NOT good: do not measure with it.");
  }
  return good ? kExitDone : kExitFailed;
}

}  // namespace

CLI::App* add_self_test(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<SelfTestOptions>();
  CLI::App* command = parent.add_subcommand(
      "self-test",
      "Check this installation: what it needs, the paper's tables, a simulated run; under a minute");
  CLI::Option* json = command->add_flag("--json", options->json, "print one JSON object");
  CLI::Option* file =
      command->add_flag("--file", options->file, "print the software validation file (ISO/IEC 17025, 7.11)");
  command
      ->add_option("--results", options->results,
                   "with --file: folder with what the tests wrote with GTEST_OUTPUT=xml:FOLDER/")
      ->needs(file);
  command->add_flag("--page", options->page, "print the page of requirements, risks and tests only")
      ->excludes(file)
      ->excludes(json);
  file->excludes(json);
  command->callback([options, &exit_code] { exit_code = self_test(*options); });
  return command;
}

}  // namespace abcal
