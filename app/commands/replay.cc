#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>

#include "app/bench/bench_config.h"
#include "app/bench/transcript.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/session/run_bench.h"
#include "app/system/output.h"
#include "app/system/version.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/replay_stream.h"
#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"

namespace abcal {
namespace {

/// "a-replay.run" beside "a.run", or the first such name with a number that is free.
std::filesystem::path path_beside(const std::filesystem::path& run) {
  for (int number = 1;; ++number) {
    const std::string count = number == 1 ? "" : fmt::format("-{}", number);
    std::filesystem::path path = run;
    path.replace_filename(fmt::format("{}-replay{}{}", run.stem().string(), count, run.extension().string()));
    if (!std::filesystem::exists(path)) return path;
  }
}

/// How the recorded run ended: what its program said, or why it said nothing. A run that was resumed has
/// several ends; the recording goes up to the first.
std::string end_of(const StoredRun& run) {
  for (const RunEvent& event : run.events) {
    for (const RunState state : {RunState::kInterrupted, RunState::kComplete, RunState::kAbandoned}) {
      if (event.kind == to_string(state)) return event.text;
    }
  }
  return "its program ended without a word (killed, or without power)";
}

bool is_same(const DwellRecord& a, const DwellRecord& b) {
  return a.mean == b.mean && a.count == b.count && a.lost == b.lost && a.encoder_x == b.encoder_x &&
         a.encoder_z == b.encoder_z;
}

/// Says whether the replay did what the recorded run did.
void compare(const StoredRun& recorded, const StoredRun& replayed) {
  std::size_t same = 0;
  for (std::size_t k = 0; k < replayed.measured.size(); ++k) {
    const auto found = std::find(recorded.measured.begin(), recorded.measured.end(), replayed.measured[k]);
    if (found == recorded.measured.end()) continue;
    const auto before = static_cast<std::size_t>(found - recorded.measured.begin());
    if (is_same(recorded.record.dwells[before], replayed.record.dwells[k])) ++same;
  }
  const std::string end = end_of(recorded);
  print_log("Replay: {} of {} angles are exactly as recorded; {}\n", same, replayed.measured.size(),
            end == end_of(replayed) ? "it ended as the recorded run did"
                                    : "it did not end as the recorded run did, which says: " + end);
}

/// A replayed run must not be resumed: its bench file names real ports.
void close_ended_replay(const StoredRun& recorded, const std::filesystem::path& path,
                        const std::string& utc) {
  try {
    compare(recorded, RunFile::load(path));
    RunFile::open_for_append(path).set_state(RunState::kAbandoned, utc, "a replay ends where it ends");
  } catch (const RunFileError& error) {
    print_log("{}\n", error.what());
  }
}

/// @return what the program shall return to the shell.
int replay(const std::filesystem::path& run, const std::filesystem::path& output, bool json) {
  const StoredRun recorded = RunFile::load(run);
  RecordedWire wires(run);
  const BenchConfig config = parse_bench(recorded.header.bench_toml, run.string());
  Bench bench = make_bench(config, wires.streams());
  (void)identify(bench, config);
  if (recorded.header.plan.empty()) {
    throw std::runtime_error(
        fmt::format("the recorded run ended before its first angle ({}), but in the replay both instruments "
                    "were identified: this program takes their answers otherwise than the one that recorded",
                    end_of(recorded)));
  }
  RunHeader header = recorded.header;
  header.program_version = program_version();
  header.created_utc = format_utc(bench.clock->utc_now());
  header.labels["replay.of"] = run.filename().string();
  const std::filesystem::path path = output.empty() ? path_beside(run) : output;
  RunFile file = RunFile::create(path, header);
  file.append_event(header.created_utc, "started", "replay of " + run.filename().string());
  note_environment(bench, config, file, "start");
  try {
    const int exit_code = measure_and_report(bench, config, std::move(file), header.plan, {}, json);
    compare(recorded, RunFile::load(path));
    return exit_code;
  } catch (const InstrumentError& error) {
    close_ended_replay(recorded, path, format_utc(bench.clock->utc_now()));
    if (wires.stopped_by_operator() &&
        error.detail().find(wire::ReplayStream::kEndsHere) != std::string::npos) {
      throw RunInterrupted("the recorded run was stopped by its operator here");
    }
    throw;
  } catch (const RunInterrupted&) {
    close_ended_replay(recorded, path, format_utc(bench.clock->utc_now()));
    throw;
  }
}

}  // namespace

CLI::App* add_replay(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string run_file;
    std::string output;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "replay", "Drive a recorded run again from its own bytes; no instrument is touched");
  command->add_option("RUN", options->run_file, "run file made with `abcal run BENCH --record`")->required();
  command->add_option("-o,--output", options->output,
                      "run file to create (default: RUN-replay.run beside RUN)");
  command->add_flag("--json", options->json, "print the result as one JSON object");
  command->callback(
      [options, &exit_code] { exit_code = replay(options->run_file, options->output, options->json); });
  return command;
}

}  // namespace abcal
