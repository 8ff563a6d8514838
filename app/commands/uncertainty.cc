#include "app/commands/uncertainty.h"

#include <fmt/format.h>

#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "app/bench_file/stage_record_file.h"
#include "app/commands/simulate.h"
#include "app/commands/table_options.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/stage_record_use.h"
#include "app/studies/trials/study_json.h"
#include "app/studies/trials/study_text.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/progress.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"
#include "protocol/uncertainty/run_uncertainty.h"

namespace abcal {
namespace {

struct StudyOptions {
  std::string file, estimator, preset, stage_record;
  TableOptions table;
  std::optional<std::int64_t> trials;
  std::optional<int> digits;
  std::int64_t seed = 1;
  int threads = 0, item = 0;
  std::optional<double> alignment, step, initial_turn, zero, resolution;
  bool json = false;
};

/// The estimator that the study is of: the one asked for, or the one that the run declared.
const Estimator& estimator_of(const StudyOptions& options, const RunRecord& record) {
  const Estimator& estimator =
      options.estimator.empty() ? declared_estimator(record) : find_estimator(options.estimator);
  const auto only_of = [&](bool given, const char* option, const char* of) {
    if (given)
      throw std::invalid_argument(fmt::format(
          "{}: it belongs to the {} result, and the study is of the {} result{}; required: "
          "--estimator {} with it",
          option, of, estimator.name, options.estimator.empty() ? ", which the run declared" : "", of));
  };
  if (!estimator.rests_on_stated_sizes) {
    only_of(options.resolution.has_value(), "--resolution", "abc");
    only_of(!options.preset.empty(), "--preset", "abc");
    only_of(!options.stage_record.empty(), "--stage-record", "abc");
  }
  if (!estimator.needs_angles)
    for (const auto& [option, given] : {std::pair{"--alignment", options.alignment},
                                        {"--step", options.step},
                                        {"--initial-turn", options.initial_turn},
                                        {"--zero", options.zero}})
      only_of(given.has_value(), option, "joint");
  return estimator;
}

/// Sizes from the command line take the place of the run's own.
void override_sizes(const StudyOptions& options, EffectSizes& sizes) {
  const auto override_with = [&](std::optional<double> degrees, const char* key, Angle& size) {
    if (!degrees) return;
    size = Angle::degrees(*degrees);
    sizes.shapes.erase(key);
    sizes.sources.insert_or_assign(key, "command line");
  };
  override_with(options.alignment, "alignment_deg", sizes.alignment);
  override_with(options.step, "step_deg", sizes.step);
  override_with(options.initial_turn, "initial_turn_deg", sizes.initial_turn);
  override_with(options.zero, "zero_deg", sizes.zero);
}

/// The item of a run that is asked for.
int chosen(const StudyOptions& options) {
  const NamedItem named = named_item(options.file);
  return chosen_item(named.file, options.item != 0 ? options.item : named.item);
}

/// The study of a measurement of several runs.
RunUncertainty study_of_measurement(const StudyOptions& options) {
  const bool overrides = options.alignment || options.step || options.initial_turn || options.zero ||
                         !options.stage_record.empty();
  if (overrides)
    throw std::invalid_argument(
        fmt::format("{}: the sizes of a measurement are those of its runs; required: none of --alignment, "
                    "--step, --initial-turn, --zero, --stage-record",
                    options.file));
  const AnalysedRun run = analyse_file(options.file, options.estimator);
  const AnalysedItem& item = run.item(chosen_item(options.file, options.item));
  return common_fit_uncertainty(item.stored.record, item.results.front(), "several runs");
}

/// The study of an item that was measured together with others, or with a record of the stage: the joint
/// result is that of their common fit.
RunUncertainty study_of_common_fit(std::vector<StoredRun> items, const StudyOptions& options) {
  for (StoredRun& item : items) override_sizes(options, item.record.tolerances);
  const char* const of =
      items.front().record.stage_record.record ? "the run with the record of its stage" : "several items";
  const AnalysedRun run = analyse_run(std::move(items), "joint");
  const int item = chosen(options);
  for (const AnalysedItem& one : run.items) {
    if (one.stored.item == item) return common_fit_uncertainty(one.stored.record, one.results.front(), of);
  }
  throw std::invalid_argument(fmt::format("{} has no item {}", options.file, item));
}

/// The record of the stage that an option names.
StageRecord stage_record_of(const std::string& file) {
  const std::string text = read_file(file);
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, false);
  if (json.is_object() && json.contains("step_error"))
    throw std::invalid_argument(
        fmt::format("{}: is the JSON of a joint analysis. Its step errors are of one run and without their "
                    "covariances, and an uncertainty from them is three times too small; required: the "
                    "record of a stage (`abcal stage learn`)",
                    file));
  return parse_stage_record(text, file);
}

/// The items, with the record of their stage: the one that is asked for, else the run's own.
std::vector<StoredRun> items_of(const StudyOptions& options) {
  const std::string file = named_item(options.file).file;
  std::vector<StoredRun> items = load_items(file, options.table);
  say_how_read(file, items.front().record);
  if (!options.stage_record.empty())
    use_stage_record(items, std::make_shared<const StageRecord>(stage_record_of(options.stage_record)), file);
  return items;
}

RunUncertainty study_of(const StudyOptions& options, MonteCarloTeam* team) {
  if (looks_like_measurement(options.file)) return study_of_measurement(options);
  std::vector<StoredRun> items = items_of(options);
  RunRecord record = items.at(static_cast<std::size_t>(chosen(options)) - 1).record;
  const Estimator& estimator = estimator_of(options, record);
  require_angles(record, estimator);
  const bool joint = estimator.fit == nullptr;
  UncertaintyOptions uncertainty;
  if (!estimator.rests_on_stated_sizes) uncertainty.trials = kJointTrials;
  if (options.trials) uncertainty.trials = not_negative("--trials", *options.trials);
  if (options.digits) {
    uncertainty.trials.reset();
    uncertainty.digits = *options.digits;
  }
  uncertainty.seed = not_negative("--seed", options.seed);
  uncertainty.threads = static_cast<unsigned>(not_negative("--threads", options.threads));
  uncertainty.resolution = options.resolution;
  uncertainty.paper_preset = options.preset == "paper";
  override_sizes(options, record.tolerances);
  if (joint) {
    check_tolerances(record.tolerances);
    if (items.size() > 1 || record.stage_record.record) return study_of_common_fit(std::move(items), options);
  }
  uncertainty.stop = interrupt_token();
  RealClock clock;
  ProgressBar bar("uncertainty", clock);
  const Clock::Instant start = clock.now();
  uncertainty.progress = [&](std::uint64_t done, std::uint64_t planned) {
    if (planned > 0 && to_seconds(clock.now() - start) > 2.0) {
      bar.show(static_cast<double>(done), static_cast<double>(planned));
    }
  };
  uncertainty.team = team;
  RunUncertainty study = joint                    ? joint_uncertainty(record, uncertainty)
                         : estimator.needs_angles ? run_uncertainty(record, uncertainty)
                                                  : norm_uncertainty(record, uncertainty);
  bar.clear();
  return study;
}

void print(const RunUncertainty& study, bool json) {
  if (json) {
    print_result("{}\n", study_json(study).dump(2));
    for (const std::string& warning : study.warnings) print_warning(warning);
  } else {
    print_result("{}", study_text(study));
  }
}

}  // namespace

StudyProcesses one_process() {
  const auto join = []() -> std::unique_ptr<MonteCarloTeam> {
    // Set by Open MPI's mpirun and srun.
    if (std::getenv("OMPI_COMM_WORLD_SIZE") == nullptr && std::getenv("PMIX_RANK") == nullptr) return nullptr;
    throw std::runtime_error(
        "under mpirun each process of abcal would do the whole study; found: mpirun; required: mpirun "
        "abcal-mpi uncertainty (built if libopenmpi-dev is installed), or abcal without mpirun");
  };
  return {join, [](MonteCarloTeam*, const char*, int) {}};
}

CLI::App* add_uncertainty(CLI::App& parent, int& exit_code, StudyProcesses processes) {
  auto options = std::make_shared<StudyOptions>();
  CLI::App* command = parent.add_subcommand(
      "uncertainty", "Uncertainty of a run's result: budget, Monte Carlo, coverage intervals");
  command->add_option("FILE", options->file, "run file, measurement, or table of readings")->required();
  command
      ->add_option("--estimator", options->estimator,
                   "whose result: joint, abc or norm (default: the one that the run declared; of a table "
                   "joint with angles "
                   "and norm without)")
      ->check(CLI::IsMember(estimator_names()));
  command->add_option("--item", options->item, "of a run with several items: which one, from 1");
  add_table_options(*command, options->table);
  CLI::Option* trials = command->add_option(
      "--trials", options->trials,
      "Monte Carlo trials (default: 10000 of the joint and norm results, 200000 of the ABC result)");
  command
      ->add_option("--digits", options->digits,
                   "adaptive: as many trials as 1 or 2 significant digits of u require")
      ->excludes(trials);
  command->add_option("--seed", options->seed, "seed of the random numbers")->capture_default_str();
  command->add_option("--threads", options->threads, "threads; 0: one per processor (same result)");
  command->add_option("--alignment", options->alignment,
                      "standard uncertainty of the alignment of the axes, degrees");
  command->add_option("--step", options->step, "standard uncertainty of each rotation step, degrees");
  command->add_option("--initial-turn", options->initial_turn,
                      "standard uncertainty of the initial -90 degree turns, degrees");
  command->add_option("--zero", options->zero,
                      "standard uncertainty of the mean step errors (axis zeros), degrees");
  command->add_option("--resolution", options->resolution,
                      "abc: smallest step of the output, in the unit of the readings");
  command
      ->add_option("--preset", options->preset,
                   "abc; paper: the bounds of Geist & Gaitan 2021, section 5, as type B")
      ->check(CLI::IsMember({"paper"}));
  command->add_option("--stage-record,--measured-acs", options->stage_record,
                      "abc: record of the stage (`abcal stage learn`), for the type A evaluation (default: "
                      "the record that the run keeps)");
  command->add_flag("--json", options->json, "print one JSON object, schema abcal.study/1");
  command->callback([options, processes = std::move(processes), &exit_code] {
    const std::unique_ptr<MonteCarloTeam> team = processes.join();
    try {
      const RunUncertainty study = study_of(*options, team.get());
      if (team == nullptr || team->leads()) print(study, options->json);
      exit_code = study.interrupted ? kExitInterrupted : kExitDone;
    } catch (const std::exception& error) {
      processes.abandon(team.get(), error.what(), kExitFailed);
      throw;
    }
  });
  return command;
}

}  // namespace abcal
