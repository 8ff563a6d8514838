#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stdexcept>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_records.h"
#include "app/commands/commands.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/bench/make_firmware.h"
#include "app/measure/emulator/compare_firmware.h"
#include "app/measure/emulator/served_bench.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "drivers/wire/readable_bytes.h"
#include "sim/sim_clock.h"

namespace abcal {
namespace {

struct EmulateCommand {
  std::string bench_file;
  std::string link_dir = ".";
  double speed = 1.0;
  std::optional<std::uint16_t> control;
  bool follow_stage = false;
  bool watch = false;
  std::string compare;     ///< Log to compare with; nothing is served then.
  std::string instrument;  ///< Port of the bench that the log is of; may be empty if the bench has one port.
  bool json = false;
};

/// Serves until interrupted.
void serve_instruments(const EmulateCommand& command) {
  const BenchConfig config = read_bench(command.bench_file, register_records());
  if (!std::isfinite(command.speed)) throw CLI::ValidationError("--speed", "must be a finite number");
  const std::stop_token stop = interrupt_token();
  ServedBench::Options options{command.link_dir, command.speed, command.follow_stage, command.control};
  if (command.watch) options.watch = [](const std::string& line) { print_result("{}\n", line); };
  ServedBench served(command.bench_file, config, options);
  for (const ServedBench::Place& place : served.places())
    print_result("{}: {} on {}\n", place.name, place.driver, place.address);
  if (command.follow_stage) print_result("The accelerometer follows the encoders of the stage.\n");
  if (const auto port = served.control_port()) print_result("control: tcp:127.0.0.1:{}\n", *port);
  print_result("Serving until interrupted (Ctrl-C).\n");
  served.serve(stop);
  if (served.dropped_bytes() > 0) {
    print_log("{} bytes of output were dropped: more than their line carries, or not read in time\n",
              served.dropped_bytes());
  }
}

/// The port of the bench that a log is of.
/// @throws std::invalid_argument
InstrumentPort port_of_log(const BenchConfig& config, const std::string& instrument) {
  const std::vector<InstrumentPort> ports = ports_to_serve(config, true);
  std::vector<std::string> names;
  for (const InstrumentPort& port : ports) {
    if (port.name == instrument || (instrument.empty() && ports.size() == 1)) return port;
    names.push_back(port.name);
  }
  throw std::invalid_argument(fmt::format("--instrument {}: required: one of {}",
                                          instrument.empty() ? "is missing" : instrument,
                                          fmt::join(names, ", ")));
}

nlohmann::ordered_json comparison_json(const std::vector<ComparedExchange>& exchanges) {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const ComparedExchange& each : exchanges) {
    rows.push_back({{"t_s", each.t_s},
                    {"asked", wire::bytes_as_text(each.asked)},
                    {"real", wire::bytes_as_text(each.real)},
                    {"simulated", wire::bytes_as_text(each.simulated)},
                    {"likeness", to_string(each.likeness)}});
  }
  return {{"schema", "abcal.firmware_comparison/1"}, {"exchanges", rows}};
}

bool agrees(Likeness likeness) {
  return likeness == Likeness::kEqual || likeness == Likeness::kNumbersDiffer ||
         likeness == Likeness::kSameLength;
}

/// Prints the number of exchanges for each kind of agreement and, once, each request whose answers differ.
void print_comparison(const std::vector<ComparedExchange>& exchanges) {
  std::map<Likeness, std::size_t> counts;
  std::set<std::string> told;
  for (const ComparedExchange& each : exchanges) {
    ++counts[each.likeness];
    if (agrees(each.likeness) || !told.insert(each.asked).second) continue;
    print_result("{:.3f} s: \"{}\": {}\n  real:      \"{}\"\n  simulated: \"{}\"\n", each.t_s,
                 wire::printable(each.asked), to_string(each.likeness), wire::printable(each.real),
                 wire::printable(each.simulated));
  }
  print_result("{} exchanges", exchanges.size());
  for (const auto& [likeness, count] : counts) print_result("; {}: {}", to_string(likeness), count);
  print_result("\n");
}

/// @return whether all answers agree.
bool compare_with_log(const EmulateCommand& command) {
  const BenchConfig config = read_bench(command.bench_file, register_records());
  const WireLog log = read_wire_log(command.compare);
  sim::SimClock clock;
  const InstrumentPort port = port_of_log(config, command.instrument);
  const auto firmware = make_firmware(config, port, world_of(make_worlds(config, clock.now()), port.item));
  const std::vector<ComparedExchange> exchanges = compare_firmware(log, *firmware, clock.now());
  if (exchanges.empty())
    throw std::invalid_argument(command.compare +
                                ": no bytes of a host or an instrument; nothing to compare");
  if (command.json) {
    print_result("{}\n", comparison_json(exchanges).dump(2));
  } else {
    print_comparison(exchanges);
  }
  return std::ranges::all_of(exchanges, agrees, &ComparedExchange::likeness);
}

}  // namespace

CLI::App* add_emulate(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<EmulateCommand>();
  CLI::App* command = parent.add_subcommand(
      "emulate", "Serve simulated instruments on pseudo-terminals or TCP ports until interrupted");
  command
      ->add_option("BENCH", options->bench_file,
                   "bench file (TOML); its [simulation] describes the simulated bench")
      ->required();
  command->add_option("--link-dir", options->link_dir,
                      "folder for the links `stage`, and `accelerometer` or `item-1`, `item-2` ...");
  CLI::Option* speed = command->add_option("--speed", options->speed, "factor by which time passes faster")
                           ->check(CLI::PositiveNumber);
  command->add_option("--control", options->control,
                      "loopback port for faults and changes during the run, one line of JSON each; 0: any");
  command
      ->add_flag("--follow-stage", options->follow_stage,
                 "the stage is real: serve only the accelerometer, which follows the encoders of the stage")
      ->excludes(speed);
  CLI::Option* watch = command->add_flag(
      "--watch", options->watch,
      "print each command that an instrument does not carry out, with its bytes, as it comes");
  CLI::Option* compare = command->add_option("--compare", options->compare,
                                             "serve nothing: give the simulated instrument the host's bytes "
                                             "of this file (`abcal record`) and show where "
                                             "its answers differ from the real one's");
  command->add_option("--instrument", options->instrument, "the port of the bench that the file is of")
      ->needs(compare);
  command->add_flag("--json", options->json, "print the comparison as one JSON object")->needs(compare);
  watch->excludes(compare);
  command->callback([options, &exit_code] {
    if (!options->compare.empty()) {
      exit_code = compare_with_log(*options) ? kExitDone : kExitFailed;
      return;
    }
    serve_instruments(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
