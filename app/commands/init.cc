#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/not_real.h"
#include "app/commands/check.h"
#include "app/commands/commands.h"
#include "app/commands/demo_bench.h"
#include "app/commands/init_answers.h"
#include "app/commands/init_bench_file.h"
#include "app/commands/init_instruments.h"
#include "app/commands/init_question.h"
#include "app/commands/shell_word.h"
#include "app/commands/terminal_listener.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/session/learned_mounting.h"
#include "app/measure/session/small_turn.h"
#include "app/results/analysis/size_costs.h"
#include "app/results/planner/known_bench.h"
#include "app/results/planner/plan_prediction.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/real_clock.h"
#include "app/system/terminal.h"
#include "app/system/text_layout.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/limits.h"
#include "protocol/record/run_interrupted.h"

namespace abcal {
namespace {

struct InitCommand {
  std::filesystem::path output = "bench.toml";
  std::string stage, item, travel, place, operator_name;  ///< Answers; empty: ask.
  std::string axes, mounting, response_unit;              ///< Where the usual does not hold.
  bool yes = false;
};

/// Whether a run with the usual protocol fits into a travel, in protocol angles.
bool is_enough_for_a_run(const std::array<AxisTravel, 2>& travel) {
  try {
    (void)make_rotation_plan(ProtocolConfig{}, travel);
    return true;
  } catch (const PlanError&) {  // Its message lists every angle, which is too long here.
    return false;
  }
}

/// A travel that suffices for either sign of each axis, so that one that is too small is reported before the
/// turn.
std::array<AxisTravel, 2> read_travel(const std::string& answer) {
  const auto stated = parse_travel(answer);
  if (is_enough_for_a_run(stated) &&
      is_enough_for_a_run({in_protocol_angles(stated[0], -1), in_protocol_angles(stated[1], -1)}))
    return stated;
  const double approach_deg = ProtocolConfig{}.approach.deg();
  throw std::invalid_argument(fmt::format(
      "travel: found X {:g} to {:g}, Z {:g} to {:g} degrees; required: every angle of a full turn, coming "
      "from {:g} degree on the other side, whichever way the axis counts. {:g} degrees from end to end "
      "always suffice, as -5 400. Give the cable more slack, or lead it through a slip ring",
      stated[0].min.deg(), stated[0].max.deg(), stated[1].min.deg(), stated[1].max.deg(), approach_deg,
      360.0 + approach_deg));
}

/// Refuses options that make no sense and, without a terminal, answers that are missing: all at once, before
/// a port is opened.
void require_answers(const InitCommand& command) {
  std::vector<std::string> problems;
  const auto read = [&](const char* option, const std::string& given, const auto& reads) {
    if (given.empty()) return;
    try {
      (void)reads(given);
    } catch (const std::invalid_argument& error) {
      problems.push_back(fmt::format("{} \"{}\": {}", option, given, error.what()));
    }
  };
  read("--travel", command.travel, read_travel);
  read("--place", command.place, parse_place);
  read("--operator", command.operator_name, parse_operator);
  read("--axes", command.axes, parse_axes);
  if (!command.mounting.empty() && !mounting_matrix(command.mounting))
    problems.push_back(fmt::format(
        "--mounting \"{}\": required: the axes of the platter along which u, v and w point, as \"-y x z\"",
        command.mounting));
  if (!command.stage.empty() && command.stage == command.item)
    problems.push_back(
        fmt::format("--stage and --item name one port, {}; required: a port for each", command.stage));
  const auto require = [&](bool is_answered, const char* option, const char* words) {
    if (!is_answered) problems.push_back(fmt::format("{}: {}", option, words));
  };
  const bool is_emulated = command.stage == kEmulated;
  if (is_emulated && !command.item.empty())
    problems.push_back(fmt::format(
        "--item {}: the emulated bench has an item of its own; required: no --item, or another --stage",
        command.item));
  if (::isatty(STDIN_FILENO) != 1) {
    const std::size_t wrong = problems.size();
    require(!command.stage.empty(), "--stage PORT",
            "which stage? `abcal instruments --probe` lists them; --stage emulated needs no hardware");
    require(is_emulated || !command.item.empty(), "--item PORT", "which accelerometer?");
    require(!command.travel.empty(), "--travel \"MIN MAX\"",
            "how far may each axis turn with this cable, in degrees?");
    require(!command.place.empty(), "--place \"LATITUDE HEIGHT\"", "where is the laboratory?");
    require(!command.operator_name.empty(), "--operator NAME", "who measures?");
    require(is_emulated || command.yes, "--yes", "may the stage turn, with somebody at its switch?");
    if (problems.size() > wrong)
      problems.insert(problems.begin() + static_cast<std::ptrdiff_t>(wrong),
                      "standard input is no terminal, so that nobody can be asked; required:");
  }
  if (!problems.empty()) throw std::invalid_argument(fmt::format("init: {}", fmt::join(problems, "\n  ")));
}

/// Reads a draft as a bench file is read: its text is the only way to a configuration.
BenchConfig config_of(const BenchDraft& draft) {
  return parse_bench(bench_draft_text(draft), "the new bench file");
}

/// Asks for what the instruments do not report.
void ask_person(InitCommand& command, BenchDraft& draft) {
  const Question travel{"How far may each axis turn with this cable?",
                        "  Degrees from where it is homed, as its controller counts: -100 365 for both\n"
                        "  axes, or -100 365, -5 400 for the outer (X) and the inner axis (Z).\n",
                        "--travel"};
  draft.travel = ask(travel, command.travel, read_travel);
  const Question place{"Where is the laboratory?",
                       "  Latitude in degrees (south negative) and height above sea level in metres, as\n"
                       "  52.3 80. Or a survey's local gravity and its expanded uncertainty in m/s2, as\n"
                       "  g 9.81234 0.00002.\n",
                       "--place"};
  draft.place = ask(place, command.place, parse_place);
  if (draft.place.latitude_deg)
    print_log("{}", indented(fmt::format("At latitude {:g} degrees, {:g} m above sea level: {}.",
                                         *draft.place.latitude_deg, *draft.place.height_m,
                                         gravity_by_formula(draft.place))));
  draft.operator_name = ask(Question{"Who measures?", "  The name goes into reports.\n", "--operator"},
                            command.operator_name, parse_operator);
}

/// Position and travel of an axis.
/// @throws InstrumentError if it is outside its stated travel
std::string axis_text(Bench& bench, const BenchConfig& config, const Identities& identities, StageAxis axis) {
  const StageAxisInfo& info = identities.stage.axes[index(axis)];
  const std::string allowed =
      fmt::format("{:g} to {:g} degrees", info.travel_min.deg(), info.travel_max.deg());
  std::string now = "not homed: first it seeks its reference, as far as its controller goes";
  if (info.referenced) {
    const Angle at = bench.stage->encoder_angle(axis);
    const Angle window = config.protocol.position_window;
    if (at < info.travel_min - window || at > info.travel_max + window)
      throw InstrumentError(
          fmt::format("stage axis {}", to_string(axis)), Fault::kOutOfTravel,
          fmt::format("stands at {:.3f} degrees; required: {}, as stated. Nothing has moved. State how far "
                      "the cable allows, or turn the axis back with the controller's own program",
                      at.deg(), allowed));
    now = fmt::format("now at {:.3f} degrees", at.deg());
  }
  return wrapped(fmt::format("{}: {}. Allowed: {} (cable and controller), {:g} deg/s.", to_string(axis), now,
                             allowed, info.speed_deg_per_s),
                 "  ", "     ", kTerminalColumns);
}

/// Prints what will move and how far, then asks for confirmation by a person at the emergency stop.
void confirm_motion(const InitCommand& command, const std::string& axes) {
  print_log(
      "\nBefore anything moves:\n{}"
      "The stage turns twice: to learn the mounting, and for `abcal check` with the new\n"
      "bench file. Each time both axes go to zero, X turns by {:g} degrees, Z turns by\n"
      "{:g} degrees, and both return to zero. The second time either may turn to the\n"
      "other side, within the limits above.\n"
      "Clear the way of platter and cable. Keep a hand on the stage's emergency stop:\n"
      "a software halt is none. Ctrl-C halts the stage.\n",
      axes, kSmallTurnDeg, kSmallTurnDeg);
  std::string answer = command.yes ? "yes" : "";
  if (!ask(Question{"Turn now? (yes or no)", "", "--yes"}, answer, parse_yes_or_no))
    throw RunInterrupted(Message("the turn was not confirmed: nothing has moved"));
}

/// The readings of the small turn, and what else the instruments reported.
struct Turned {
  LearnedMounting learned;
  std::string stage_name, accelerometer_name;
  std::string response_unit;
  ItemNames item;      ///< As the instrument reports it.
  double noise = 0.0;  ///< Standard deviation of one reading, in g_loc.
};

Turned turn_and_learn(const InitCommand& command, const BenchConfig& config, bool is_emulated) {
  BenchStreams streams;
  streams.owner = "a first turn";
  Bench bench = make_bench(config, std::move(streams));
  const Identities identities = identify(bench, config);
  if (!is_emulated) {
    std::string axes;
    for (const StageAxis axis : kStageAxes) axes += axis_text(bench, config, identities, axis);
    confirm_motion(command, axes);
  }
  TerminalListener terminal(small_turn_at_terminal());
  const std::vector<TurnedItem> items =
      measure_small_turn(bench, config, identities, terminal.listener(), interrupt_token());
  terminal.finish();
  if (!items.front().missing.empty())
    throw InstrumentError("accelerometer", Fault::kNoReply, items.front().missing);
  const AccelerometerInfo& info = identities.items.front().accelerometer;
  const ItemNames names{info.maker, info.model, info.serial_number};
  const std::string& unit = info.output_unit;
  const MountingSearch search{unit, nominal_response({}, unit, config.g_loc.value_mps2), command.mounting};
  const StageInfo& stage = identities.stage;
  Turned turned{learn_mounting(items.front().poses, search),
                in_words(ItemNames{stage.maker, stage.model, stage.serial_number}),
                in_words(names),
                unit,
                reported_by_item(config.items.front().accelerometer.driver, unit, names),
                0.0};
  turned.noise = items.front().poses.front().spread.maxCoeff() / turned.learned.response;
  return turned;
}

void print_learned(const Turned& turned) {
  const LearnedMounting& learned = turned.learned;
  print_result("Mounting: u, v, w point along \"{}\", within {:.1f} degrees; {:.4g} {} for g_loc\n",
               learned.mounting, learned.tilt.deg(), learned.response, turned.response_unit);
  print_result("Signs: X {:+d} ({}), Z {:+d} (from gravity)\nZeros: where the axes are homed\n",
               learned.sign_x, learned.is_sign_x_known ? "from gravity and --mounting" : "by definition",
               learned.sign_z);
}

/// Prints how much each unstated size costs.
void print_costs(const BenchConfig& config, const Turned& turned) {
  constexpr double kLeastNoise = 1e-7;  // Readings without any noise determine no uncertainty.
  KnownItem item{.noise = std::max(turned.noise, kLeastNoise)};
  if (const auto axes = mounting_matrix(turned.learned.mounting)) item.sensitivity_matrix *= *axes;
  const Budget budget = predict_budget(planning_bench(config, item), config.protocol);
  const std::string costs = default_costs_text(default_costs(config.items.front().tolerances, budget));
  if (costs.empty()) return;
  print_result("\n{}{}{}",
               emphasised(stdout, Emphasis::kHeading,
                          wrapped("Sizes that are still defaults: U of a run would be smaller by at least "
                                  "this part if the size were zero",
                                  "", "  ", kTerminalColumns)),
               costs,
               wrapped("docs/effects.md: how to find each size, and how to state it under "
                       "[stage_uncertainty] and [item_uncertainty]",
                       "  -> ", "     ", kTerminalColumns));
}

/// The command that gives the same answers, except the confirmation of the motion.
std::string same_answers(const InitCommand& command) {
  std::string words = "abcal init";
  const std::vector<std::pair<std::string, std::string>> options{
      {"--stage", command.stage},
      {"--item", command.item},
      {"--travel", command.travel},
      {"--place", command.place},
      {"--operator", command.operator_name},
      {"--axes", command.axes},
      {"--mounting", command.mounting},
      {"--response-unit", command.response_unit},
      {"--output", command.output == InitCommand().output ? "" : command.output.string()}};
  for (const auto& [option, answer] : options)
    if (!answer.empty()) words += fmt::format(" {} {}", option, typed_word(answer));
  return words;
}

/// @param is_fit  for a run, as the check has found
void print_next(const InitCommand& command, const Instruments& instruments, bool is_fit) {
  const std::string file = typed_word(command.output.string()),
                    run = typed_word(command.output.stem().string() + ".run");
  print_result("\n{}\n", emphasised(stdout, Emphasis::kHeading, "Next"));
  if (instruments.are_emulated())
    print_result("  abcal emulate {} --link-dir {}\n      the emulated instruments, in another terminal\n",
                 file, typed_word(instruments.folder().string()));
  if (!is_fit) {
    print_result("  abcal check {}\n      again, once the problems above are solved\n", file);
    return;
  }
  print_result("  abcal plan {}\n      the angles of a run, and how long it takes\n", file);
  print_result("  abcal run {} -o {}\n      the calibration\n", file, run);
}

std::string now_in_words() {
  const auto seconds = std::chrono::time_point_cast<std::chrono::seconds>(RealClock().utc_now());
  return fmt::format("{:%Y-%m-%d %H:%M} UTC", fmt::gmtime(std::chrono::system_clock::to_time_t(seconds)));
}

BenchDraft describe_bench(InitCommand& command, Instruments& instruments) {
  BenchDraft draft;
  const ProbeAnswer stage = instruments.stage();
  std::optional<std::array<std::string, 2>> axes;
  if (!command.axes.empty()) axes = parse_axes(command.axes);
  draft.axes = axes_of(stage, axes);
  const ProbeAnswer item = instruments.item();
  draft.stage_driver = stage.driver;
  draft.stage_port = instruments.stage_port();
  draft.accelerometer_driver = item.driver;
  draft.accelerometer_port = instruments.item_port();
  draft.response_unit = command.response_unit;
  draft.made = fmt::format("Made by `abcal init`, {}.", now_in_words());
  if (instruments.are_emulated()) draft.emulated = emulated_sections();
  ask_person(command, draft);
  return draft;
}

/// Makes the small turn and learns the mounting. After any failure it prints that nothing is written, and how
/// to continue.
Turned turn_or_tell(const InitCommand& command, const BenchDraft& draft, bool is_emulated) {
  try {
    return turn_and_learn(command, config_of(draft), is_emulated);
  } catch (const std::exception&) {  // The caller reports the reason.
    print_log("\nNo bench file is written. The same answers again:\n  {}\n", same_answers(command));
    throw;
  }
}

void print_welcome(const InitCommand& command) {
  const bool is_emulated = command.stage == kEmulated;
  if (!command.stage.empty() && (is_emulated || !command.item.empty()) && !command.travel.empty() &&
      !command.place.empty() && !command.operator_name.empty())
    return;
  print_log("{}\n", wrapped(fmt::format("abcal init asks at most five questions and writes {}. Nothing moves "
                                        "before you say yes. Ctrl-C ends it.",
                                        command.output.string()),
                            "", "", kTerminalColumns));
}

int init(InitCommand& command) {
  if (std::filesystem::exists(std::filesystem::symlink_status(command.output)))
    throw std::invalid_argument(fmt::format(
        "--output {}: exists already, and init overwrites no file; required: another name (--output)",
        command.output.string()));
  require_writable({{"--output", command.output}}, {}, false);
  require_answers(command);
  print_welcome(command);
  std::filesystem::path folder = std::filesystem::absolute(command.output);
  folder.replace_filename(command.output.stem().string() + "-emulated");
  Instruments instruments(command.stage, command.item, folder.lexically_normal());
  const std::stop_token stop = interrupt_token();  // From now on there are things to end.
  BenchDraft draft = describe_bench(command, instruments);
  if (stop.stop_requested()) end_without_an_answer();
  const Turned turned = turn_or_tell(command, draft, instruments.are_emulated());
  draft.learned = turned.learned;
  draft.item = turned.item;
  draft.stage_name = turned.stage_name;
  draft.accelerometer_name = turned.accelerometer_name;
  const BenchConfig config = config_of(draft);
  OutputFile(command.output).write_new(bench_draft_text(draft));
  print_result("Bench file: {}\n", command.output.string());
  print_learned(turned);
  print_result("\n{}\n", emphasised(stdout, Emphasis::kHeading,
                                    fmt::format("abcal check {}", command.output.string())));
  int exit_code = kExitFailed;
  try {
    exit_code = print_findings(check_at_terminal(config, false));
  } catch (const RunInterrupted& interrupted) {
    throw RunInterrupted(
        Message("{why}; {file} is written, but not checked", interrupted.message(), command.output.string()));
  }
  print_costs(config, turned);
  print_next(command, instruments, exit_code == kExitDone);
  return exit_code;
}

}  // namespace

CLI::App* add_init(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<InitCommand>();
  CLI::App* command = parent.add_subcommand(
      "init",
      "Find the instruments, ask five questions, turn both axes by 30 degrees, and write a bench file");
  command
      ->add_option("-o,--output", options->output,
                   "bench file to write; one that exists is never overwritten")
      ->capture_default_str();
  command->add_option("--stage", options->stage, "port of the stage; `emulated`: a bench without hardware")
      ->option_text("PORT");
  command->add_option("--item", options->item, "port of the accelerometer")->option_text("PORT");
  command
      ->add_option("--travel", options->travel,
                   "how far the axes may turn with this cable, in degrees: \"-100 365\", or \"-100 365, -5 "
                   "400\" for X and Z")
      ->option_text("TEXT");
  command
      ->add_option("--place", options->place,
                   "latitude in degrees and height in metres, \"52.3 80\"; or local gravity and its U, \"g "
                   "9.81234 0.00002\"")
      ->option_text("TEXT");
  command->add_option("--operator", options->operator_name, "who measures")->option_text("NAME");
  command->add_flag("--yes", options->yes, "turn the stage without asking; somebody must be at its switch");
  command
      ->add_option("--axes", options->axes,
                   "the controller's names of the outer and the inner axis, \"1 2\" (default: as found)")
      ->option_text("TEXT");
  command
      ->add_option("--mounting", options->mounting,
                   "how the item stands, \"-y x z\" for u, v, w, where marks on the platter say what x is: "
                   "the sign of X is learned too")
      ->option_text("TEXT");
  command
      ->add_option("--response-unit", options->response_unit,
                   "unit of the output, for an instrument that does not report it")
      ->option_text("UNIT");
  command->callback([options, &exit_code] { exit_code = init(*options); });
  return command;
}

}  // namespace abcal
