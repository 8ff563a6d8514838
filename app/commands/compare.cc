#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "app/commands/commands.h"
#include "app/commands/table_options.h"
#include "app/laboratory/compare/compare_json.h"
#include "app/laboratory/compare/compare_results.h"
#include "app/laboratory/compare/compare_text.h"
#include "app/results/analysis/analyses.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"

namespace abcal {

CLI::App* add_compare(CLI::App& parent, int& exit_code) {
  struct Options {
    std::vector<std::string> files;
    std::string estimator;
    CompareOptions compare;
    TableOptions table;
    int item = 0;
    bool published = false, refit = false, json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "compare", "Check whether results of one item agree: E_n, mounting, repeatability, control charts");
  command
      ->add_option("FILE", options->files,
                   "two or more: run files, tables of readings, or certificates (DCC XML). Of a run "
                   "with several items FILE#K is item K: it stands with its file, as results are named in "
                   "the output. One such run alone: its items with one another")
      ->required()
      ->expected(1, 10'000);
  command
      ->add_option(
          "--estimator", options->estimator,
          fmt::format(
              "of runs and tables: {} (default: that of each run or table; {} with --shared and --published)",
              estimator_choice(), kPublishedEstimator))
      ->check(CLI::IsMember(estimator_names()));
  command->add_option("--item", options->item,
                      "of each run with several items that is named without #K: which one, from 1");
  add_table_options(*command, options->table);
  command->add_flag("--shared", options->compare.shared_stage,
                    "all were measured on one stage: subtract the effect of its common errors from the "
                    "uncertainty of the differences");
  command->add_flag("--published", options->published,
                    "of runs and tables: the abc result by the published formula (Geist & Gaitan 2021), for "
                    "comparison with another laboratory's ABC result");
  command->add_flag("--refit", options->refit,
                    "compute every result from the readings, also where this version of abcal has stored it "
                    "with its run");
  command->add_flag("--any-item", options->compare.any_item, "compare results of different items");
  command->add_option("--group-by", options->compare.group_by,
                      "analysis of variance between groups: day, stage, or a label such as operator.name");
  command->add_flag("--json", options->json, "print one JSON object, schema abcal.compare/1");
  command->callback([options, &exit_code] {
    const std::string estimator =
        estimator_to_compare(options->estimator, options->compare.shared_stage || options->published);
    std::vector<ComparedResult> results = load_compared(
        options->files, estimator, options->refit ? ResultSource::kReadings : ResultSource::kStored,
        options->item, options->table);
    for (const ComparedResult& result : results)
      if (result.record) say_how_read(result.file, *result.record);
    if (options->published) take_published_formula(results);
    const ResultsComparison comparison = compare_results(std::move(results), options->compare);
    if (options->json) {
      print_result("{}\n", compare_json(comparison).dump(2));
    } else {
      print_result("{}", compare_text(comparison, stdout));
    }
    exit_code = comparison.agree() ? kExitDone : kExitFailed;
  });
  return command;
}

}  // namespace abcal
