#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stdexcept>
#include <thread>

#include "app/faces/commands/commands.h"
#include "app/ground/bench_file/bench_config.h"
#include "app/ground/bench_file/bench_consistency.h"
#include "app/ground/bench_file/bench_records.h"
#include "app/ground/system/exit_code.h"
#include "app/ground/system/interrupt.h"
#include "app/ground/system/output.h"
#include "app/ground/system/real_clock.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/operate/bench/fault_schedule.h"
#include "app/operate/bench/make_bench.h"
#include "app/operate/bench/make_firmware.h"
#include "app/operate/emulate/compare_firmware.h"
#include "app/operate/emulate/control_server.h"
#include "app/operate/emulate/listening_port.h"
#include "drivers/wire/port_list.h"
#include "drivers/wire/readable_bytes.h"
#include "sim/emulator.h"
#include "sim/firmware/faulty_port.h"
#include "sim/followed_stage.h"
#include "sim/sim_clock.h"

namespace abcal {
namespace {

/// Real time, passing `speed` times as fast.
class ScaledClock final : public Clock {
 public:
  explicit ScaledClock(double speed) : speed_(speed), start_(real_.now()), utc_start_(real_.utc_now()) {}
  Instant now() const override { return start_ + scaled(); }
  UtcTime utc_now() const override { return utc_start_ + scaled(); }
  void sleep_until(Instant instant) override {
    real_.sleep_until(start_ + from_seconds(to_seconds(instant - start_) / speed_));
  }

 private:
  Duration scaled() const { return from_seconds(to_seconds(real_.now() - start_) * speed_); }
  RealClock real_;
  double speed_;
  Instant start_;
  UtcTime utc_start_;
};

/// A simulated instrument and the name of its link.
struct Served {
  std::string name;  ///< "stage", "stage-x", "stage-z", "accelerometer".
  std::string driver;
  std::string port;
  std::shared_ptr<sim::FaultyPort> firmware;
};

/// Where an instrument is served: on the TCP port that the bench file names, else on a pseudo-terminal.
sim::Endpoint endpoint(const Served& served, const std::filesystem::path& links, sim::LineModel line) {
  if (served.port.starts_with("tcp:")) return {served.firmware, listening_port(served.port)};
  return {served.firmware, sim::PtyLink{links / served.name, line}};
}

/// Reports each command that an instrument does not carry out when it arrives for the first time.
EmulatorControl::Unserved watch_unserved(const std::vector<Served>& all) {
  EmulatorControl::Unserved unserved;
  for (const Served& served : all) {
    served.firmware->unserved().on_first([name = served.name](const sim::UnservedCommand& each) {
      print_log("{}: host asked \"{}\": {}\n", name, each.command, each.reaction);
    });
    unserved[served.name] = &served.firmware->unserved();
  }
  return unserved;
}

/// Turns the world by the read-back of a real stage until it is destroyed.
class StageFollower {
 public:
  /// @param end Asked to stop when the stage cannot be read any more.
  StageFollower(const BenchConfig& config, std::shared_ptr<sim::SimBench> world, std::stop_source end)
      : end_(std::move(end)), stage_(make_stage(config, clock_), std::move(world), clock_) {
    stage_.identify();
    thread_ = std::jthread([this](const std::stop_token& stop) { follow(stop); });
  }

  /// Ends the following. @throws the error that ended it before.
  void finish() {
    thread_ = {};
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  void follow(const std::stop_token& stop) {
    try {
      while (!stop.stop_requested()) {
        for (const StageAxis axis : kStageAxes) stage_.encoder_angle(axis);
        clock_.sleep_until(clock_.now() + from_seconds(0.02));
      }
    } catch (...) {
      // Unknown is never idle: an accelerometer that no longer follows would give wrong readings.
      failure_ = std::current_exception();
      end_.request_stop();
    }
  }

  RealClock clock_;
  std::stop_source end_;
  std::exception_ptr failure_;
  sim::FollowedStage stage_;
  std::jthread thread_;
};

struct EmulateCommand {
  std::string bench_file;
  std::string link_dir = ".";
  double speed = 1.0;
  std::optional<std::uint16_t> control;
  bool follow_stage = false;
  std::string compare;     ///< Log to compare with; nothing is served then.
  std::string instrument;  ///< Port of the bench that the log is of; may be empty if the bench has one port.
  bool json = false;
};

/// The ports of a bench that have bytes to serve.
/// @throws std::invalid_argument  if it has none
std::vector<InstrumentPort> ports_to_serve(const BenchConfig& config, bool with_stage) {
  std::vector<InstrumentPort> ports;
  const auto add = [&](const std::vector<InstrumentPort>& more) {
    ports.insert(ports.end(), more.begin(), more.end());
  };
  if (with_stage) add(stage_ports(config.stage));
  add(all_accelerometer_ports(config));
  add(environment_ports(config.environment));
  add(chamber_ports(config.chamber));
  if (ports.empty())
    throw std::invalid_argument(
        "no instrument of this bench communicates by bytes: choose other drivers than \"simulated\"");
  return ports;
}

/// @throws BenchError if a simulated truth does not fit the unit of its instrument
void require_possible_truth(const std::string& bench_file, const BenchConfig& config) {
  std::vector<Problem> problems;
  for (int item = 1; item <= static_cast<int>(config.items.size()); ++item) {
    auto problem = simulated_unit_problem(config.item(item));
    if (!problem) continue;
    problem->where = item_words(config, item) + problem->where;
    problems.push_back(std::move(*problem));
  }
  if (!problems.empty()) throw BenchError(bench_file, std::move(problems));
}

/// Serves until interrupted.
void serve_instruments(const EmulateCommand& command) {
  const BenchConfig config = read_bench(command.bench_file, register_records());
  require_possible_truth(command.bench_file, config);
  if (!std::isfinite(command.speed)) throw CLI::ValidationError("--speed", "must be a finite number");
  ScaledClock clock(command.speed);
  const SimWorlds worlds = make_worlds(config, clock.now());
  const std::shared_ptr<sim::SimBench>& world = worlds.front();
  std::error_code error;
  std::filesystem::create_directories(command.link_dir, error);
  if (error) throw std::runtime_error(command.link_dir + ": cannot be created: " + error.message());

  std::stop_source end;
  const std::stop_callback on_interrupt(interrupt_token(), [&end] { end.request_stop(); });
  std::optional<StageFollower> follower;
  if (command.follow_stage) follower.emplace(config, world, end);
  std::vector<Served> all;
  for (const InstrumentPort& port : ports_to_serve(config, !command.follow_stage)) {
    all.push_back(
        {port.name, port.driver, port.port,
         std::make_shared<sim::FaultyPort>(make_firmware(config, port, world_of(worlds, port.item)), clock,
                                           wire_faults(config.faults, port.name, world->start()),
                                           config.simulation.seed, config.link)});
  }
  const sim::LineModel line =
      config.emulator.line == "ideal" ? sim::LineModel::kIdeal : sim::LineModel::kReal;
  std::vector<sim::Endpoint> endpoints;
  std::map<std::string, sim::FaultyStream*> links;
  for (const Served& served : all) {
    endpoints.push_back(endpoint(served, command.link_dir, line));
    links[served.name] = &served.firmware->link();
  }
  sim::Emulator emulator(std::move(endpoints), clock, command.speed);
  EmulatorControl control(worlds, clock, std::move(links), watch_unserved(all));
  std::optional<ControlServer> control_server;
  if (command.control) control_server.emplace(control, *command.control);
  const std::vector<std::string> addresses = emulator.addresses();
  for (std::size_t i = 0; i < all.size(); ++i)
    print_result("{}: {} on {}\n", all[i].name, all[i].driver, addresses[i]);
  if (follower) print_result("The accelerometer follows the encoders of the stage.\n");
  if (control_server) print_result("control: tcp:127.0.0.1:{}\n", control_server->port());
  print_result("Serving until interrupted (Ctrl-C).\n");
  emulator.run(end.get_token());
  if (follower) follower->finish();
  if (emulator.dropped_bytes() > 0) {
    print_log("{} bytes of output were dropped: more than their line carries, or not read in time\n",
              emulator.dropped_bytes());
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

/// How many exchanges agree in which way, and each request whose answers do not, once.
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
  CLI::Option* compare = command->add_option("--compare", options->compare,
                                             "serve nothing: give the simulated instrument the host's bytes "
                                             "of this file (`abcal record`) and show where "
                                             "its answers differ from the real one's");
  command->add_option("--instrument", options->instrument, "the port of the bench that the file is of")
      ->needs(compare);
  command->add_flag("--json", options->json, "print the comparison as one JSON object")->needs(compare);
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
