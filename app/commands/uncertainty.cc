#include "app/commands/uncertainty.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>
#include <vector>

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

/// The items that are fitted together with item k (all from 0), itself among them.
std::vector<std::size_t> fitted_with(const TrayResult& joint, std::size_t k) {
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < joint.items.size(); ++i)
    if (i == k || (joint.items[k].in_common_fit && joint.items[i].in_common_fit)) out.push_back(i);
  return out;
}

/// The study of an item by its fit: with other items, in several runs, with a record of its stage, or alone.
RunUncertainty study_of_joint_result(const AnalysedRun& run, int item, const UncertaintyOptions& options) {
  const std::size_t k = static_cast<std::size_t>(item) - 1;
  const AnalysedItem& wanted = run.item(item);
  const std::vector<std::size_t> together = fitted_with(run.joint, k);
  const std::size_t runs = std::max<std::size_t>(1, run.runs.size());
  if (together.size() == 1 && runs == 1 && !wanted.stored.record.stage_record.record)
    return joint_uncertainty(wanted.stored.record, options);
  std::vector<RunRecord> records;
  std::vector<ItemInRun> places;
  for (std::size_t r = 0; r < runs; ++r)
    for (std::size_t i = 0; i < together.size(); ++i) {
      const std::size_t of_run = together[i];
      // Only the items of the first run have the record of the stage with which they were evaluated.
      records.push_back(r == 0 ? run.items[of_run].stored.record : run.runs[r].items[of_run].record);
      places.push_back({static_cast<int>(i), static_cast<int>(r)});
    }
  const auto number = static_cast<int>(std::ranges::find(together, k) - together.begin());
  return common_fit_uncertainty({records, places, number}, wanted.results.front(), options);
}

/// The analysis of which the study of a joint result is.
AnalysedRun analysed(const StudyOptions& options, std::vector<StoredRun> items) {
  for (StoredRun& item : items) override_sizes(options, item.record.tolerances);
  return analyse_run(std::move(items), "joint");
}

/// The analysis of a measurement of several runs.
AnalysedRun analysed_measurement(const StudyOptions& options) {
  const bool overrides = options.alignment || options.step || options.initial_turn || options.zero ||
                         !options.stage_record.empty();
  if (overrides)
    throw std::invalid_argument(
        fmt::format("{}: the sizes of a measurement are those of its runs; required: none of --alignment, "
                    "--step, --initial-turn, --zero, --stage-record",
                    options.file));
  return analyse_file(options.file, options.estimator);
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

/// @param trials  unless others are asked for
UncertaintyOptions uncertainty_options(const StudyOptions& options, std::uint64_t trials,
                                       MonteCarloTeam* team) {
  UncertaintyOptions out;
  out.trials = trials;
  if (options.trials) out.trials = not_negative("--trials", *options.trials);
  if (options.digits) {
    out.trials.reset();
    out.digits = *options.digits;
  }
  out.seed = not_negative("--seed", options.seed);
  out.threads = static_cast<unsigned>(not_negative("--threads", options.threads));
  out.resolution = options.resolution;
  out.paper_preset = options.preset == "paper";
  out.stop = interrupt_token();
  out.team = team;
  return out;
}

RunUncertainty study_of(const StudyOptions& options, MonteCarloTeam* team) {
  RealClock clock;
  ProgressBar bar("uncertainty", clock);
  const Clock::Instant start = clock.now();
  const auto with_bar = [&](std::uint64_t trials) {
    UncertaintyOptions out = uncertainty_options(options, trials, team);
    out.progress = [&](std::uint64_t done, std::uint64_t planned) {
      if (planned > 0 && to_seconds(clock.now() - start) > 2.0)
        bar.show(static_cast<double>(done), static_cast<double>(planned));
    };
    return out;
  };
  const auto done = [&](RunUncertainty study) {
    bar.clear();
    return study;
  };
  if (looks_like_measurement(options.file))
    return done(study_of_joint_result(analysed_measurement(options), chosen_item(options.file, options.item),
                                      with_bar(kCommonFitTrials)));
  std::vector<StoredRun> items = items_of(options);
  const int item = chosen(options);
  RunRecord record = items.at(static_cast<std::size_t>(item) - 1).record;
  const Estimator& estimator = estimator_of(options, record);
  require_angles(record, estimator);
  override_sizes(options, record.tolerances);
  if (estimator.rests_on_stated_sizes) return done(run_uncertainty(record, with_bar(kAbcTrials)));
  if (estimator.fit != nullptr) return done(norm_uncertainty(record, with_bar(kJointTrials)));
  check_tolerances(record.tolerances);
  const bool alone = items.size() == 1 && !record.stage_record.record;
  if (alone) return done(joint_uncertainty(record, with_bar(kJointTrials)));
  return done(study_of_joint_result(analysed(options, std::move(items)), item, with_bar(kCommonFitTrials)));
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
      "Monte Carlo trials (default: 10000 of the joint and norm results, 200000 of the ABC result, 1000 of "
      "several items or runs or with a record of the stage)");
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
