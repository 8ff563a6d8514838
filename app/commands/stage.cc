#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/stage_record_file.h"
#include "app/commands/commands.h"
#include "app/commands/stage_try.h"
#include "app/document/band_figure.h"
#include "app/document/drawing_svg.h"
#include "app/results/analysis/series_of_runs.h"
#include "app/results/analysis/stage_record_use.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/terminal.h"
#include "protocol/estimators/checks/result_checks.h"
#include "protocol/estimators/measurement/measurement_result.h"
#include "protocol/estimators/measurement/stage_curves.h"
#include "protocol/statistics/distributions.h"
#include "protocol/statistics/median.h"

namespace abcal {
namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;

/// "serial number 17 of maker model".
std::string stage_words(const StageIdentity& stage) {
  return fmt::format("{} {}, serial number {}", stage.maker, stage.model,
                     stage.serial_number.empty() ? "not reported" : stage.serial_number);
}

/// A size of what does not repeat, with its bounds: degrees, or urad of an alignment.
std::string size_words(RepeatPart part, const SizeFound& size) {
  const bool tilt = part == RepeatPart::kFloor;
  const double unit = tilt ? 1e6 : kDegrees;
  return fmt::format("{:.2g} {} ({:.2g} to {:.2g})", unit * size.rms, tilt ? "urad" : "degrees",
                     unit * size.lower, unit * size.upper);
}

/// The largest error and the median uncertainty of a curve.
std::string curve_words(const std::vector<StageCurvePoint>& curve, double unit, std::string_view name) {
  if (curve.empty()) return "not measured";
  double most = 0.0;
  std::vector<double> u;
  for (const StageCurvePoint& point : curve) {
    most = std::max(most, std::abs(point.value));
    u.push_back(point.standard_uncertainty);
  }
  return fmt::format("up to {:.2g} {} at {} angles, u {:.1g}", unit * most, name, curve.size(),
                     unit * median(std::move(u)));
}

std::string record_text(const StageRecord& record, const std::string& file) {
  std::string text = fmt::format(
      "{}\n{}\n", emphasised(stdout, Emphasis::kHeading, "Stage: " + stage_words(record.identity)),
      "  " + record.identity.axes);
  text +=
      fmt::format("Learned: {} runs in {} {}, the last on {}{}\n", record.runs(), record.learnings.size(),
                  record.learnings.size() == 1 ? "learning" : "learnings", record.learned_utc().substr(0, 10),
                  record.learnings.back().by.empty() ? "" : ", by " + record.learnings.back().by);
  text += fmt::format("Good for: {:.1f} months, then learn again\n\n", validity_months(record));
  text += emphasised(stdout, Emphasis::kHeading, "What repeats") + "\n";
  const auto row = [&](const std::string& name, const std::string& value) {
    text += fmt::format("  {:<34} {}\n", name, value);
  };
  for (const char axis : {'X', 'Z'})
    row(fmt::format("angle of {}", axis), curve_words(angle_error(record.state, axis), kDegrees, "degrees"));
  for (const char axis : {'X', 'Z'})
    for (const int direction : {1, 2})
      row(fmt::format("wobble of {}, direction {}", axis, direction),
          curve_words(wobble(record.state, axis, direction), 1e6, "urad"));
  for (const char* name : {"Zx", "Zy", "Xz"})
    if (const Eigen::Index at = record.state.place_of(name); at >= 0)
      row(name, fmt::format("{:+.1f} urad, u {:.1f}", 1e6 * record.state.mean(at),
                            1e6 * std::sqrt(record.state.covariance(at, at))));
  text += "\n" + emphasised(stdout, Emphasis::kHeading, "What does not repeat (95 %)") + "\n";
  for (const RepeatPart part : kAllRepeatParts)
    row(std::string(in_words(part)),
        size_words(part, record.repeatabilities[static_cast<std::size_t>(part)]));
  row("growth in a month", fmt::format("{:.2g} of the stated sizes ({:.2g} to {:.2g})", record.growth.rms,
                                       record.growth.lower, record.growth.upper));
  text += fmt::format("\nFile: {}\nSHA-256: {}\n", file, record.sha256);
  return text;
}

/// Writes the maps of a stage as figures.
void write_figures(const StageRecord& record, const std::filesystem::path& folder) {
  const auto panel = [](std::string title, const std::vector<StageCurvePoint>& curve, double unit) {
    BandPanel out;
    out.title = std::move(title);
    for (const StageCurvePoint& point : curve) {
      out.x.push_back(point.angle_deg);
      out.y.push_back(unit * point.value);
      out.half_width.push_back(2.0 * unit * point.standard_uncertainty);
    }
    return out;
  };
  std::filesystem::create_directories(folder);
  const auto write = [&](const std::string& name, const char* caption, const std::vector<BandPanel>& panels) {
    OutputFile(folder / name)
        .write(svg_file(band_figure(caption, "angle, degrees", panels).drawing, caption));
    print_log("wrote {}\n", (folder / name).string());
  };
  std::vector<BandPanel> angles;
  for (const char axis : {'X', 'Z'}) {
    angles.push_back(
        panel(fmt::format("{}, 0.001 degrees", axis), angle_error(record.state, axis), 1e3 * kDegrees));
    std::vector<BandPanel> tilts;
    for (const int direction : {1, 2})
      tilts.push_back(panel(fmt::format("{}, direction {}, urad", axis, direction),
                            wobble(record.state, axis, direction), 1e6));
    write(fmt::format("wobble-{}.svg", axis), "Wobble of an axis, less its mean, with U (k = 2)", tilts);
  }
  write("angle-error.svg", "Error of the angle of each axis, less its mean, with U (k = 2)", angles);
}

struct LearnOptions {
  std::vector<std::string> runs;
  std::string output, before, by;
};

/// Runs that are not usable alone would teach wrong numbers.
void require_usable(const RunsOfStage& loaded, const SeriesRuns& each) {
  std::string words;
  for (std::size_t k = 0; k < loaded.runs.size(); ++k) {
    std::string why;
    if (each.alone[k].verdict != Verdict::kUsable) why = each.alone[k].why;
    for (const Check& check : check_record(loaded.runs[k].record))
      if (!check.passed) why += (why.empty() ? "" : "; ") + check.words;
    if (is_at_constant_rate(loaded.runs[k].record))
      why += "the stage turned at constant rates: the mean over a step is not the error at an angle";
    if (!why.empty()) words += fmt::format("\n  {}: {}", loaded.files[k], why);
  }
  if (!words.empty())
    throw std::invalid_argument(
        "these runs are not usable, and a record would keep what is wrong with them; required: usable runs:" +
        words);
}

void require_new_runs(const RunsOfStage& loaded, const StageRecord& before, const std::string& file) {
  if (const auto differ = differences(before.identity, stage_identity(loaded.runs.front())); !differ.empty())
    throw std::invalid_argument(
        fmt::format("{}: is the record of another stage: {}", file, fmt::join(differ, "; ")));
  for (std::size_t k = 0; k < loaded.runs.size(); ++k) {
    if (before.was_taught_by(loaded.sha256[k]))
      throw std::invalid_argument(
          fmt::format("{}: taught {} already; required: further runs", loaded.files[k], file));
    if (loaded.runs[k].header.created_utc < before.learned_utc())
      throw std::invalid_argument(
          fmt::format("{}: began before the last learning of {} ({}); required: later runs", loaded.files[k],
                      file, before.learned_utc()));
  }
}

int learn(const LearnOptions& options) {
  constexpr double kMonthsOfOneLearning = 2.0 / 30.44;
  std::error_code ignored;
  if (std::filesystem::exists(options.output, ignored))
    throw std::invalid_argument(fmt::format("-o {}: exists; required: a new file", options.output));
  const RunsOfStage loaded = load_runs_of_stage(options.runs);
  const std::string& first_utc = loaded.runs.front().header.created_utc;
  const std::string& last_utc = loaded.runs.back().header.created_utc;
  if (months_between(first_utc, last_utc) > kMonthsOfOneLearning)
    throw std::invalid_argument(
        fmt::format("the runs began between {} and {}; required: runs of two days, as the stage changes from "
                    "day to day; learn the later ones with --record",
                    first_utc.substr(0, 10), last_utc.substr(0, 10)));
  std::optional<StageRecord> before;
  double months = 0.0;
  if (!options.before.empty()) {
    before = read_stage_record(options.before);
    require_new_runs(loaded, *before, options.before);
    months = months_between(before->learned_utc(), last_utc);
  }
  const std::vector<RunRecord> records = loaded.records();
  const SeriesRuns each = fit_each_run(records, loaded.places, {});
  require_usable(loaded, each);
  StageLearned learned = learn_stage(each.runs, before, months);
  if (!learned.fit.converged)
    throw std::runtime_error(
        "the common fit of these runs did not converge: they do not agree about the stage");
  const double probability = chi2_tail(learned.fit.chi2, learned.fit.degrees_of_freedom);
  StageRecord& record = learned.record;
  record.identity = stage_identity(loaded.runs.front());
  if (before) record.learnings = before->learnings;
  Learning& learning = record.learnings.emplace_back(Learning{last_utc, options.by, {}});
  for (std::size_t k = 0; k < loaded.runs.size(); ++k)
    learning.runs.push_back({std::filesystem::path(loaded.files[k]).filename().string(), loaded.sha256[k],
                             item_of(loaded.runs[k]), learned.fit.in_runs[k].mounting()});
  constexpr double kContradiction = 1e-5;
  if (probability < kContradiction)
    throw std::runtime_error(fmt::format(
        "the runs contradict each other: chi2 {:.4g} for {} degrees of freedom (probability {:.1g}); no "
        "record is written. Learn from runs of one item that nobody touched but to turn it",
        learned.fit.chi2, learned.fit.degrees_of_freedom, probability));
  write_stage_record(options.output, record);
  for (const EffectTest& change : learned.changes)
    print_log(
        "warning: since the record before the stage has changed: {} ({:.1f} times what it expects, "
        "probability {:.1g})\n",
        change.name, change.times_stated, change.probability);
  print_result("{}", record_text(read_stage_record(options.output), options.output));
  print_log("next: record = \"{}\" under [stage] of the bench file, or abcal analyse RUN --stage-record {}\n",
            options.output, options.output);
  return kExitDone;
}

nlohmann::ordered_json tests_json(const std::vector<EffectTest>& tests) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const EffectTest& test : tests)
    list.push_back({{"part", test.name},
                    {"times_expected", test.times_stated},
                    {"probability", test.probability},
                    {"passed", test.passed}});
  return list;
}

std::string tests_table(const std::vector<EffectTest>& tests) {
  std::string text = fmt::format("{:<28} {:>14} {:>12}\n", "part", "times expected", "probability");
  for (const EffectTest& test : tests)
    text += fmt::format("{:<28} {:>14.2f} {:>12.2g}{}\n", test.name, test.times_stated, test.probability,
                        test.passed ? "" : "  !");
  return text;
}

int check_against(const std::string& file, const std::string& run, bool json) {
  const auto record = std::make_shared<const StageRecord>(read_stage_record(file));
  RunsOfStage loaded = load_runs_of_stage({run});
  use_stage_record(loaded.runs, record, run);
  const RunAnalysis analysis = analyse_items(loaded.records(), {&find_estimator("joint")});
  const CalibrationResult& result = analysis.joint.items.front().result;
  if (!result.stage_record) throw std::runtime_error(fmt::format("{}: {}", run, result.why));
  const StageRecordUse& use = *result.stage_record;
  if (json) {
    print_result("{}\n", nlohmann::ordered_json{{"schema", "abcal.stage-check/1"},
                                                {"run", run},
                                                {"record", file},
                                                {"agrees", use.agrees},
                                                {"age_months", use.age_months},
                                                {"validity_months", use.validity_months},
                                                {"tests", tests_json(use.tests)}}
                             .dump(2));
    return use.agrees ? kExitDone : kExitFailed;
  }
  std::string text =
      emphasised(stdout, use.agrees ? Emphasis::kGood : Emphasis::kBad,
                 use.agrees ? "The run agrees with the record." : "The run contradicts the record.") +
      "\n";
  text += fmt::format("Age of the record: {:.1f} months; good for {:.1f}\n\n", use.age_months,
                      use.validity_months);
  print_result("{}{}", text, tests_table(use.tests));
  return use.agrees ? kExitDone : kExitFailed;
}

int compare_records(const std::string& first, const std::string& second, bool json) {
  StageRecord earlier = read_stage_record(first), later = read_stage_record(second);
  if (later.learned_utc() < earlier.learned_utc()) std::swap(earlier, later);
  if (const auto differ = differences(earlier.identity, later.identity); !differ.empty())
    throw std::invalid_argument(fmt::format("the records are of two stages: {}", fmt::join(differ, "; ")));
  const bool continued = later.was_taught_by(earlier.learnings.back().runs.front().sha256);
  const double months = months_between(earlier.learned_utc(), later.learned_utc());
  std::vector<EffectTest> tests = compare_states(state_after(earlier, months), later.state, continued);
  judge_record(tests);
  const bool agree = std::ranges::all_of(tests, &EffectTest::passed);
  if (json) {
    print_result("{}\n", nlohmann::ordered_json{{"schema", "abcal.stage-compare/1"},
                                                {"months", months},
                                                {"continued", continued},
                                                {"agree", agree},
                                                {"tests", tests_json(tests)}}
                             .dump(2));
    return agree ? kExitDone : kExitFailed;
  }
  std::string text = fmt::format(
      "{}\n{:.1f} months apart; {}\n\n",
      emphasised(stdout, agree ? Emphasis::kGood : Emphasis::kBad,
                 agree ? "The records agree." : "The stage has changed more than the records expect."),
      months, continued ? "the later one continues the earlier one" : "independent learnings");
  print_result("{}{}", text, tests_table(tests));
  return agree ? kExitDone : kExitFailed;
}

void add_learn(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<LearnOptions>();
  CLI::App* command = parent.add_subcommand(
      "learn", "A record of the stage from runs of one afternoon, best of one item in several mountings");
  command->add_option("RUN", options->runs, "run files of one stage; of usable runs")
      ->required()
      ->expected(1, 1000);
  command->add_option("-o,--output", options->output, "file of the record; a new one")->required();
  command->add_option("--record", options->before,
                      "an earlier record of this stage, which these runs continue");
  command->add_option("--by", options->by, "who has it learned, for the record");
  command->callback([options, &exit_code] { exit_code = learn(*options); });
}

void add_show(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string file, figures;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("show", "What a record says of its stage, and how long it is good for");
  command->add_option("FILE", options->file, "record of a stage")->required();
  command->add_option("--figures", options->figures,
                      "write the errors of the axes as figures (SVG) into this folder");
  command->add_flag("--json", options->json, "print the record, schema abcal.stage-record/1");
  command->callback([options, &exit_code] {
    const StageRecord record = read_stage_record(options->file);
    options->json ? print_result("{}\n", stage_record_json(record).dump(2))
                  : print_result("{}", record_text(record, options->file));
    if (!options->figures.empty()) write_figures(record, options->figures);
    exit_code = kExitDone;
  });
}

/// A subcommand about two files.
struct PairCommand {
  const char *name, *words;
  const char *first, *first_words;
  const char *second, *second_words;
  int (*work)(const std::string& first, const std::string& second, bool json);
};

void add_pair(CLI::App& parent, int& exit_code, const PairCommand& pair) {
  struct Options {
    std::string first, second;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(pair.name, pair.words);
  command->add_option(pair.first, options->first, pair.first_words)->required();
  command->add_option(pair.second, options->second, pair.second_words)->required();
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([options, work = pair.work, &exit_code] {
    exit_code = work(options->first, options->second, options->json);
  });
}

}  // namespace

CLI::App* add_stage(CLI::App& parent, int& exit_code) {
  CLI::App* command = parent.add_subcommand(
      "stage", "The stage as a measured standard: learn, show, check, compare; try: a description of one");
  command->require_subcommand(1);
  add_learn(*command, exit_code);
  add_show(*command, exit_code);
  add_pair(*command, exit_code,
           {"check", "Whether a run agrees with the record of its stage; exit 1 if not", "FILE",
            "record of the stage", "RUN", "run file, other than those that taught it", check_against});
  add_pair(*command, exit_code,
           {"compare", "Whether two records of one stage agree; exit 1 if not", "FIRST", "record of a stage",
            "SECOND", "another record of that stage", compare_records});
  add_stage_try(*command, exit_code);
  return command;
}

}  // namespace abcal
