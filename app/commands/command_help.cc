#include "app/commands/command_help.h"

#include <array>
#include <stdexcept>
#include <string>
#include <string_view>

namespace abcal {
namespace {

struct CommandHelp {
  std::string_view name;
  std::string_view group;
  std::string_view examples;  ///< One a line.
};

constexpr std::string_view kMeasure = "Measure", kEvaluate = "Evaluate", kCertify = "Certify",
                           kPrepare = "Prepare a bench", kWithoutBench = "Without a bench";

constexpr std::array<CommandHelp, 31> kHelp{{
    {"init", kPrepare, "abcal init\nabcal init --stage emulated"},
    {"instruments", kPrepare, "abcal instruments --probe"},
    {"plan", kPrepare, "abcal plan bench.toml\nabcal plan bench.toml --reach 'phi=1e-3 deg, s=2e-5'"},
    {"check", kPrepare, "abcal check bench.toml\nabcal check bench.toml --no-motion"},
    {"level", kPrepare, "abcal level bench.toml -o bench.level.json"},
    {"stage", kPrepare,
     "abcal stage learn m1.run m2.run m3.run -o bench.stage\nabcal stage show bench.stage --figures stage"},
    {"gravity", kPrepare, "abcal gravity --latitude 52.3 --height 80"},
    {"self-test", kPrepare, "abcal self-test"},
    {"run", kMeasure, "abcal run bench.toml -o sn1234.run\nabcal run bench.toml -o sn1234.run --record"},
    {"mountings", kMeasure, "abcal mountings bench.toml --mountings 3"},
    {"resume", kMeasure, "abcal resume sn1234.run"},
    {"temperature", kMeasure, "abcal temperature bench.toml -o series"},
    {"serve", kMeasure, "abcal serve bench.toml"},
    {"bench", kMeasure, "abcal bench bench.toml"},
    {"analyse", kEvaluate, "abcal analyse sn1234.run\nabcal analyse averages.csv --estimator abc --json"},
    {"combine", kEvaluate, "abcal combine sn1234-a.run sn1234-b.run -o sn1234.measurement"},
    {"uncertainty", kEvaluate, "abcal uncertainty sn1234.run --trials 100000"},
    {"report", kEvaluate, "abcal report sn1234.run --pdf sn1234.pdf"},
    {"compare", kEvaluate, "abcal compare before.run after.run"},
    {"pilot", kEvaluate,
     "abcal pilot init comparison.toml\nabcal pilot add comparison.toml lab2.xml --participant LAB2"},
    {"export", kEvaluate, "abcal export sn1234.run --as px4"},
    {"apply", kEvaluate, "abcal apply sn1234.run --to bench.toml"},
    {"verify", kCertify, "abcal verify sn1234.run"},
    {"issue", kCertify,
     "abcal issue sn1234.run --laboratory laboratory.toml --dcc sn1234.xml --pdf sn1234.pdf"},
    {"lab", kCertify,
     "abcal lab init --laboratory \"Example laboratory\" --administrator \"N. N.\"\nabcal help lab"},
    {"demo", kWithoutBench, "abcal demo\nabcal demo --no-wait --json"},
    {"docs", kWithoutBench, "abcal docs\nabcal docs effects"},
    {"simulate", kWithoutBench, "abcal simulate abc1 --trials 1000000"},
    {"emulate", kWithoutBench,
     "abcal emulate bench.toml --link-dir links\nabcal emulate bench.toml --link-dir links --watch"},
    {"replay", kWithoutBench, "abcal replay sn1234.run"},
    {"record", kWithoutBench, "abcal record --port /dev/ttyUSB0 --serve links/stage -o stage.wire"},
}};

}  // namespace

void add_help(CLI::App& app) {
  for (CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; })) {
    const auto* help = kHelp.begin();
    while (help != kHelp.end() && help->name != command->get_name()) ++help;
    if (help == kHelp.end()) throw std::logic_error("the command " + command->get_name() + " has no example");
    command->group(std::string(help->group));
    std::string examples = "Examples:\n  ";
    for (const char c : help->examples) examples += c == '\n' ? std::string("\n  ") : std::string(1, c);
    command->footer(examples);
  }
  app.footer(
      "`abcal help COMMAND` shows the options of a command, with an example. A new bench begins\n"
      "with `abcal init`, which writes its file. Without one, begin with `abcal demo`.");
}

}  // namespace abcal
