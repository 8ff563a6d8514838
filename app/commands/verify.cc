#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "app/commands/commands.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/terminal.h"
#include "protocol/record/verify.h"

namespace abcal {

CLI::App* add_verify(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string run_file;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "verify", "Check that a run and its results are consistent with their hashes and chains");
  command->add_option("RUN", options->run_file, "run file")->required();
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([options, &exit_code] {
    const std::vector<IntegrityCheck> checks = verify_run(options->run_file);
    bool good = true;
    for (const IntegrityCheck& check : checks) good = good && check.good;
    if (options->json) {
      nlohmann::ordered_json json{{"schema", "abcal.verify/1"}, {"good", good}};
      if (good) json["attests"] = attested_by(options->run_file);
      for (const IntegrityCheck& check : checks)
        json["checks"].push_back({{"what", check.what}, {"good", check.good}, {"found", check.found}});
      print_result("{}\n", json.dump(2));
    } else {
      for (const IntegrityCheck& check : checks) {
        print_result(
            "{}  {}: {}\n",
            emphasised(stdout, check.good ? Emphasis::kGood : Emphasis::kBad, check.good ? "good" : " bad"),
            check.what, check.found);
      }
      print_result("{}\n", good ? attested_by(options->run_file)
                                : "The run or its results were changed, or the run is not closed.");
    }
    exit_code = good ? kExitDone : kExitFailed;
  });
  return command;
}

}  // namespace abcal
