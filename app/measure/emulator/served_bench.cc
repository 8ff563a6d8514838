#include "app/measure/emulator/served_bench.h"

#include <fmt/format.h>

#include <exception>
#include <functional>
#include <map>
#include <stdexcept>
#include <thread>
#include <utility>

#include "app/bench_file/bench_consistency.h"
#include "app/measure/bench/fault_schedule.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/bench/make_firmware.h"
#include "app/measure/emulator/control_server.h"
#include "app/measure/emulator/listening_port.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "drivers/wire/port_list.h"
#include "drivers/wire/readable_bytes.h"
#include "sim/emulator.h"
#include "sim/firmware/faulty_port.h"
#include "sim/followed_stage.h"

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

/// Reports commands that an instrument does not carry out: each time to `watch`, else the first time.
EmulatorControl::Unserved watch_unserved(const std::vector<Served>& all, const Clock& clock,
                                         const std::function<void(const std::string&)>& watch) {
  const Clock::Instant start = clock.now();
  EmulatorControl::Unserved unserved;
  for (const Served& served : all) {
    served.firmware->unserved().on_note(
        [name = served.name, start, &clock, watch](const sim::UnservedCommand& each) {
          if (watch) {
            watch(fmt::format("{:.3f} s {}: \"{}\": {}; bytes {}", to_seconds(clock.now() - start), name,
                              each.command, each.reaction, wire::bytes_in_hex(each.bytes)));
          } else if (each.count == 1) {
            print_log("{}: host asked \"{}\": {}\n", name, each.command, each.reaction);
          }
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

}  // namespace

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

struct ServedBench::Impl {
  Impl(BenchConfig the_config, const Options& options)
      : config(std::move(the_config)), clock(options.speed), worlds(make_worlds(config, clock.now())) {
    std::error_code error;
    std::filesystem::create_directories(options.link_dir, error);
    if (error)
      throw std::runtime_error(options.link_dir.string() + ": cannot be created: " + error.message());
    const std::shared_ptr<sim::SimBench>& world = worlds.front();
    if (options.follow_stage) follower.emplace(config, world, end);
    for (const InstrumentPort& port : ports_to_serve(config, !options.follow_stage)) {
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
      endpoints.push_back(endpoint(served, options.link_dir, line));
      links[served.name] = &served.firmware->link();
    }
    emulator.emplace(std::move(endpoints), clock, options.speed);
    control.emplace(worlds, clock, std::move(links), watch_unserved(all, clock, options.watch));
    if (options.control) control_server.emplace(*control, *options.control);
  }

  BenchConfig config;
  ScaledClock clock;
  SimWorlds worlds;
  std::stop_source end;
  std::optional<StageFollower> follower;
  std::vector<Served> all;
  std::optional<sim::Emulator> emulator;
  std::optional<EmulatorControl> control;
  std::optional<ControlServer> control_server;
};

ServedBench::ServedBench(const std::string& bench_file, const BenchConfig& config, const Options& options) {
  require_possible_truth(bench_file, config);
  impl_ = std::make_unique<Impl>(config, options);
}

ServedBench::~ServedBench() = default;

std::vector<ServedBench::Place> ServedBench::places() const {
  const std::vector<std::string> addresses = impl_->emulator->addresses();
  std::vector<Place> places;
  for (std::size_t i = 0; i < impl_->all.size(); ++i)
    places.push_back({impl_->all[i].name, impl_->all[i].driver, addresses[i]});
  return places;
}

std::optional<std::uint16_t> ServedBench::control_port() const {
  if (!impl_->control_server) return std::nullopt;
  return impl_->control_server->port();
}

void ServedBench::serve(const std::stop_token& stop) {
  const std::stop_callback on_stop(stop, [this] { impl_->end.request_stop(); });
  impl_->emulator->run(impl_->end.get_token());
  if (impl_->follower) impl_->follower->finish();
}

std::uint64_t ServedBench::dropped_bytes() const {
  return impl_->emulator->dropped_bytes();
}

}  // namespace abcal
