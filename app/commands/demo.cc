#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>

#include <cstdlib>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/commands/analyse.h"
#include "app/commands/commands.h"
#include "app/commands/demo_bench.h"
#include "app/commands/emulation.h"
#include "app/commands/terminal_listener.h"
#include "app/console/server.h"
#include "app/console/steered_run.h"
#include "app/document/document_html.h"
#include "app/laboratory/register/database.h"
#include "app/laboratory/register/login.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/report_data.h"
#include "app/results/analysis/result_json.h"
#include "app/results/analysis/result_summary.h"
#include "app/results/report/calibration_document.h"
#include "app/system/browser.h"
#include "app/system/descriptor.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/real_clock.h"
#include "app/system/terminal.h"
#include "protocol/record/run_interrupted.h"

namespace abcal {
namespace {

struct DemoCommand {
  std::filesystem::path folder = "abcal-demo";
  int steps = 30;  ///< 3 x 30 angles take about 50 s.
  bool no_browser = false, no_wait = false, json = false;
};

/// The folder of the demo, for one demo at a time.
class DemoFolder {
 public:
  explicit DemoFolder(const std::filesystem::path& named) : path_(std::filesystem::absolute(named)) {
    std::error_code error;
    std::filesystem::create_directories(path_, error);
    if (error) throw std::invalid_argument(named.string() + ": cannot be created: " + error.message());
    path_ = std::filesystem::canonical(path_);
    lock_ = Descriptor(::open((path_ / ".demo.lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    if (lock_.number() < 0 || ::flock(lock_.number(), LOCK_EX | LOCK_NB) != 0)
      throw std::invalid_argument(fmt::format(
          "{}: another demo uses this folder, or it cannot be written to; required: the end of that demo, or "
          "another folder (--dir)",
          named.string()));
  }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  Descriptor lock_;
};

PlannedAngle planned_angle(const nlohmann::json& json) {
  PlannedAngle angle;
  angle.experiment = json.value("experiment", 0);
  angle.n = json.value("n", 0);
  angle.alpha = Angle::degrees(json.value("alpha_deg", 0.0));
  angle.x = Angle::degrees(json.value("x_deg", 0.0));
  angle.z = Angle::degrees(json.value("z_deg", 0.0));
  angle.check = json.value("check", false);
  return angle;
}

/// Shows the messages of a bench at the terminal, as a run is shown whose events are at hand.
class MessagesAtTerminal {
 public:
  explicit MessagesAtTerminal(std::filesystem::path folder) : folder_(std::move(folder)) {}

  void see(const nlohmann::json& message) {
    const std::string event = message.value("event", "");
    const auto position = message.value("position", std::size_t{0});
    const std::string type = message.value("type", "");
    if (type == "snapshot") {
      begin(message.at("run"));
    } else if (type == "activity" && message.value("activity", "") == "idle") {
      terminal_.finish();
    } else if (event == PhaseEvent::kName) {
      show_phase(position, message.value("phase", ""));
    } else if (event == DwellDoneEvent::kName) {
      terminal_.on(DwellDoneEvent{position, {}});
    } else if (event == FinishedEvent::kName) {
      FinishedEvent end;
      end.file = (folder_ / message.value("file", "")).string();
      end.complete = message.value("complete", false);
      end.measured = message.value("measured", std::size_t{0});
      end.planned = message.value("planned", std::size_t{0});
      terminal_.on(end);
      return;
    }
    const auto line = message.find("line");
    if (line != message.end() && line->value("grade", "info") != "info")
      terminal_.on(NoticeEvent{"", Message::bare(line->value("text", ""))});
  }

 private:
  void begin(const nlohmann::json& run) {
    if (run.is_null() || !run.at("ended").is_null()) return;
    RunBeganEvent began;
    for (const nlohmann::json& angle : run.at("plan")) began.plan.push_back(planned_angle(angle));
    terminal_.on(began);
  }
  void show_phase(std::size_t position, const std::string& words) {
    for (int number = 0; number <= static_cast<int>(RunPhase::kParking); ++number) {
      const auto phase = static_cast<RunPhase>(number);
      if (to_string(phase) == words) terminal_.on(PhaseEvent{position, phase});
    }
  }

  std::filesystem::path folder_;
  TerminalListener terminal_{{.title = "Calibrating", .introduce = false}};
};

/// The files that a demo has made.
struct DemoFiles {
  std::filesystem::path folder, bench_file, run, report;
  std::string console;

  std::vector<std::pair<std::string, std::string>> next_commands() const {
    return {{fmt::format("abcal analyse {} --full", run.string()), "everything that is known of the result"},
            {fmt::format("abcal emulate {} --link-dir {}", bench_file.string(), folder.string()),
             fmt::format("the same bench again, for `abcal run {}`", bench_file.string())},
            {"abcal instruments --probe", "which instruments are on the ports of this computer"}};
  }
};

void write_report(DemoFiles& files) {
  files.report = first_free_path(std::filesystem::path(files.run).replace_extension(".html"));
  const ReportData data = gather_report(files.run, RealClock().utc_now(), 1);
  OutputFile(files.report).write(document_html(calibration_document(data)));
}

nlohmann::ordered_json demo_json(const DemoFiles& files, const CalibrationResult& result,
                                 const TruthComparison& comparison) {
  nlohmann::ordered_json next = nlohmann::ordered_json::array();
  for (const auto& [command, words] : files.next_commands()) next.push_back(command);
  return {{"schema", "abcal.demo/1"},
          {"folder", files.folder.string()},
          {"bench_file", files.bench_file.string()},
          {"run", files.run.string()},
          {"report", files.report.string()},
          {"console", files.console},
          {"agrees_with_true_values", comparison.agrees()},
          {"largest_difference", comparison.largest},
          {"next", next},
          {"result", result_json(result)}};
}

/// Shows the result of the run and its comparison with the emulator's true values. @return the exit code
int show_results(DemoFiles& files, bool json) {
  const AnalysedRun run = analyse_file_by(files.run, {});
  const AnalysedItem& item = run.item(1);
  if (!json) print_result("{}", summary_text(item, files.run.string(), stdout));
  const TruthComparison comparison =
      show_truth(files.bench_file.string(), item.stored, item.result(), json ? stderr : stdout);
  write_report(files);
  if (json) {
    print_result("{}\n", demo_json(files, item.result(), comparison).dump(2));
  } else {
    print_result("\nReport: {}\n{}\n", files.report.string(), emphasised(stdout, Emphasis::kHeading, "Next"));
    for (const auto& [command, words] : files.next_commands())
      print_result("  {}\n      {}\n", command, words);
  }
  return item.result().verdict != Verdict::kNotUsable && comparison.agrees() ? kExitDone : kExitFailed;
}

void require_no_register() {
  if (const std::string location = lab::register_location({}); !location.empty())
    throw std::invalid_argument(
        fmt::format("the demo measures without a person of the register that ABCAL_REGISTER names ({}); "
                    "required: env -u ABCAL_REGISTER abcal demo",
                    lab::without_password(location)));
}

/// Measures the run of the demo. @throws as SteeredRun::measure()
console::RunEnd measure(console::SteeredRun& steered, const std::stop_token& stop) {
  try {
    return steered.measure("abcal demo", stop);
  } catch (const RunInterrupted&) {
    steered.close();  // Its last messages report what is kept.
    throw RunInterrupted(
        Message("the demo was interrupted; its stage is halted and its processes have ended"));
  }
}

int demo(const DemoCommand& command) {
  const std::stop_token stop = interrupt_token();
  require_no_register();
  const DemoFolder folder(command.folder);
  const std::filesystem::path bench_file = write_demo_bench(folder.path(), command.steps);
  const bool waits = !command.no_wait && !command.json && is_terminal(stdout);
  DemoFiles files{command.folder, command.folder / bench_file.filename(), {}, {}, {}};
  print_log("A calibration on emulated instruments, in about {:.0f} s. Nothing real moves.\nBench file: {}\n",
            8.0 + 0.52 * (3.0 * command.steps + 11.0), files.bench_file.string());
  const Emulation emulation(bench_file.string(), read_bench(bench_file.string()), folder.path());
  for (const ServedBench::Place& place : emulation.places())
    print_log("Emulated {}: {} on {}\n", place.name, place.driver, place.address);
  const console::Session::Options bench{bench_file, folder.path(), 1.0};
  MessagesAtTerminal shown(command.folder);
  console::SteeredRun steered(
      bench, [&shown](const nlohmann::json& message) { shown.see(message); }, stop);
  console::ServerOptions options;
  options.port = 0;
  console::Server server(options, bench);
  files.console = fmt::format("http://127.0.0.1:{}/", server.port());
  print_log("Console: {} shows the run in a browser\n", files.console);
  if (!command.no_browser && !command.json)
    (void)open_in_browser(files.console, "the demo opens its page with");
  const console::RunEnd end = measure(steered, stop);
  if (!end.complete) {
    print_error("the run of the demo ended early: " + end.why);
    return end.instrument_failed ? kExitInstrument : kExitFailed;
  }
  files.run = command.folder / end.file;
  const int exit_code = show_results(files, command.json);
  if (!waits) return exit_code;
  print_result("\nThe console stays at {} until Ctrl-C; a further run can be started there.\n",
               files.console);
  return server.serve(stop) ? kExitInterrupted : exit_code;
}

}  // namespace

CLI::App* add_demo(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<DemoCommand>();
  CLI::App* command = parent.add_subcommand(
      "demo", "Calibrate emulated instruments in about a minute, in the console and here; needs no files");
  command->add_option("--dir", options->folder, "folder for its files, made if absent")
      ->capture_default_str();
  command->add_option("--steps", options->steps, "angles of each of the three experiments, a divisor of 360")
      ->check(CLI::Range(5, 360))
      ->capture_default_str();
  command->add_flag("--no-browser", options->no_browser, "do not open a browser");
  command->add_flag("--no-wait", options->no_wait,
                    "end with the result (default on a terminal: keep the console open until Ctrl-C)");
  command->add_flag("--json", options->json,
                    "print one JSON object, schema abcal.demo/1, and end; no browser is opened");
  command->callback([options, &exit_code] { exit_code = demo(*options); });
  return command;
}

}  // namespace abcal
