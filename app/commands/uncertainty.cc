#include "app/commands/uncertainty.h"

#include <fmt/format.h>

#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "app/bench_file/stage_record_file.h"
#include "app/commands/simulate.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/load_record.h"
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

struct Options {
  std::string file, estimator, preset, stage_record;
  std::optional<std::int64_t> trials;
  std::optional<int> digits;
  std::int64_t seed = 1;
  int threads = 0, item = 0;
  std::optional<double> alignment, step, initial_turn, zero, resolution;
  bool json = false;
};

/// The estimator that the study is of: the one asked for, or the one that the run declared.
const Estimator& estimator_of(const Options& options, const RunRecord& record) {
  const Estimator& estimator =
      options.estimator.empty() ? declared_estimator(record) : find_estimator(options.estimator);
  if (!estimator.certifiable)
    throw std::invalid_argument(fmt::format(
        "uncertainty: {} declares estimator \"{}\", which has no Monte Carlo; required: --estimator joint or "
        "--estimator abc",
        options.file, estimator.name));
  if (estimator.fit != nullptr) return estimator;
  const auto only_of_abc = [&](bool given, const char* option) {
    if (given)
      throw std::invalid_argument(
          fmt::format("{}: it belongs to the ABC result, and the study is of the {} result{}; required: "
                      "--estimator abc with it",
                      option, estimator.name, options.estimator.empty() ? ", which the run declared" : ""));
  };
  only_of_abc(options.resolution.has_value(), "--resolution");
  only_of_abc(!options.preset.empty(), "--preset");
  only_of_abc(!options.stage_record.empty(), "--stage-record");
  return estimator;
}

/// Sizes from the command line take the place of the run's own.
void override_sizes(const Options& options, EffectSizes& sizes) {
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

/// The study of an item that was measured together with others: the joint result is that of their common fit.
RunUncertainty study_of_common_fit(std::vector<StoredRun> items, const Options& options) {
  for (StoredRun& item : items) override_sizes(options, item.record.tolerances);
  const AnalysedRun run = analyse_run(std::move(items), "joint");
  const NamedItem named = named_item(options.file);
  const int item = chosen_item(named.file, options.item != 0 ? options.item : named.item);
  for (const AnalysedItem& one : run.items) {
    if (one.stored.item == item) return common_fit_uncertainty(one.stored.record, one.results.front());
  }
  throw std::invalid_argument(fmt::format("{} has no item {}", options.file, item));
}

/// The record of the stage that an option names.
StageRecord stage_record_of(const std::string& file) {
  const std::string text = read_file(file);
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, false);
  if (json.is_object() && json.contains("step_error"))
    throw std::invalid_argument(fmt::format(
        "{}: is the JSON of a joint analysis. Its step errors are of one run and without their covariances, "
        "and "
        "an uncertainty from them is three times too small; required: the record of a stage (`abcal stage "
        "learn`)",
        file));
  return parse_stage_record(text, file);
}

/// The readings of the item, with the record of its stage: the one that is asked for, else the run's own.
RunRecord run_of(const Options& options) {
  if (options.stage_record.empty()) return load_record(options.file, options.item).record;
  const NamedItem named = named_item(options.file);
  std::vector<StoredRun> items = load_items(named.file);
  use_stage_record(items, std::make_shared<const StageRecord>(stage_record_of(options.stage_record)),
                   named.file);
  const int item = chosen_item(named.file, options.item != 0 ? options.item : named.item);
  return items.at(static_cast<std::size_t>(item) - 1).record;
}

RunUncertainty study_of(const Options& options, MonteCarloTeam* team) {
  RunRecord record = run_of(options);
  const bool joint = estimator_of(options, record).fit == nullptr;
  UncertaintyOptions uncertainty;
  if (joint) uncertainty.trials = kJointTrials;
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
    if (record.stage_record.record)
      throw std::invalid_argument(fmt::format(
          "{}: the run uses a record of its stage, which this simulation does not draw from; `abcal analyse` "
          "gives the uncertainty, or analyse it with the published estimator (--estimator {})",
          options.file, kPublishedEstimator));
    check_tolerances(record.tolerances);
    std::vector<StoredRun> items = load_items(named_item(options.file).file);
    if (items.size() > 1) return study_of_common_fit(std::move(items), options);
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
  RunUncertainty study =
      joint ? joint_uncertainty(record, uncertainty) : run_uncertainty(record, uncertainty);
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
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "uncertainty", "Uncertainty of a run's result: budget, Monte Carlo, coverage intervals");
  command->add_option("FILE", options->file, "run file, or CSV of averaged readings")->required();
  command
      ->add_option("--estimator", options->estimator,
                   "whose result: joint or abc (default: the one that the run declared)")
      ->check(CLI::IsMember(estimator_names()));
  command->add_option("--item", options->item, "of a run with several items: which one, from 1");
  CLI::Option* trials = command->add_option(
      "--trials", options->trials,
      "Monte Carlo trials (default: 10000 of the joint result, 200000 of the ABC result)");
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
  command->add_option(
      "--stage-record,--measured-acs", options->stage_record,
      "abc: record of the stage (`abcal stage learn`), for the type A evaluation (default: the "
      "record that the run keeps)");
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
