#include "app/measure/bench/make_bench.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "app/bench_file/not_real.h"
#include "app/bench_file/stage_description_file.h"
#include "app/measure/bench/fault_schedule.h"
#include "app/measure/bench/instrument_leases.h"
#include "app/measure/bench/kept_turns.h"
#include "app/measure/bench/make_firmware.h"
#include "app/measure/bench/stage_trial.h"
#include "app/measure/bench/stage_watchdog.h"
#include "app/measure/guard/beating.h"
#include "app/measure/guard/guarded_chamber.h"
#include "app/measure/guard/guarded_stage.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/typed_line.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/mounted_stage.h"
#include "drivers/instrument/replaceable.h"
#include "drivers/instrument/split_stage.h"
#include "drivers/registry.h"
#include "drivers/wire/halt_recipe.h"
#include "drivers/wire/open_stream.h"
#include "drivers/wire/port_held.h"
#include "drivers/wire/reopenable_stream.h"
#include "sim/faults.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/followed_stage.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"

namespace abcal {
namespace {

/// Opens a port by `open`. The guard of a run that was killed holds the stage's port until it has halted the
/// axes, which takes about a second; a run that starts sooner waits for it.
template <class Open>
std::unique_ptr<wire::ByteStream> open_after_guard(const std::string& port, const Open& open, Clock& clock) {
  using namespace std::chrono_literals;
  const Clock::Instant latest = clock.now() + 10s;
  bool is_waiting = false;
  for (bool is_first = true;; is_first = false) {
    try {
      return open();
    } catch (const wire::PortHeld& error) {
      // The guard may have ended between the attempt and the search for the holder, which then finds others,
      // e.g. the emulator: a second attempt shows that the port is free.
      const bool is_held_by_guard = error.is_held_by("abcal-guard");
      if (clock.now() >= latest || (!is_held_by_guard && !is_first && !is_waiting)) throw;
      if (is_held_by_guard && !std::exchange(is_waiting, true))
        print_log("{}: waiting until the guard of a run that was killed has halted the stage\n", port);
    }
    clock.sleep_until(clock.now() + 50ms);
  }
}

AxisMounting mounting(const StageAxisConfig& axis) {
  const auto angle = [](const std::optional<double>& degrees) {
    return degrees ? std::optional(Angle::degrees(*degrees)) : std::nullopt;
  };
  return {axis.zero, axis.sign, angle(axis.travel_min_deg), angle(axis.travel_max_deg),
          axis.wraps_deg.has_value()};
}

/// @return null: no driver of the list has this name
template <class Driver>
const Driver* driver_called(const std::vector<Driver>& drivers, const std::string& name) {
  const auto found =
      std::find_if(drivers.begin(), drivers.end(), [&](const Driver& d) { return d.name == name; });
  return found == drivers.end() ? nullptr : &*found;
}

template <class Driver>
const Driver& find_driver(const std::vector<Driver>& drivers, const std::string& name) {
  const Driver* found = driver_called(drivers, name);
  if (found == nullptr) throw std::invalid_argument("no driver is called \"" + name + "\"");
  return *found;
}

/// A driver of stages that has a port.
const StageDriver& find_stage_driver(const std::string& name) {
  const StageDriver* described = driver_called(described_stage_drivers(), name);
  return described != nullptr ? *described : find_driver(stage_drivers(), name);
}

StageSettings stage_settings(const BenchConfig& config, const InstrumentPort& port) {
  StageSettings settings;
  if (port.driver == kDescribed)
    settings.description = std::make_shared<const StageDescription>(stage_description_of(config.stage));
  settings.axis_names = port.axis_names(config.stage);
  settings.speed_deg_per_s = {config.stage.x.speed_deg_per_s, config.stage.z.speed_deg_per_s};
  settings.units_per_degree = {config.stage.x.units_per_degree, config.stage.z.units_per_degree};
  settings.address = port.address;
  settings.unit = config.stage.unit;
  return settings;
}

AccelerometerSettings accelerometer_settings(const AccelerometerConfig& config) {
  AccelerometerSettings settings = config.settings;
  // A baud rate in the bench file means a line that has one; USB and TCP are as fast as they are. 10 bits a
  // byte.
  if (config.baud) settings.link_bytes_per_s = *config.baud / 10.0;
  return settings;
}

ChamberSettings chamber_settings(const ChamberConfig& config) {
  ChamberSettings settings = config.settings;
  settings.tcp_framing = has_tcp_frames(config.port);
  return settings;
}

std::unique_ptr<ThermalChamber> chamber_at_terminal(const ManualChamberDriver& driver,
                                                    const ChamberConfig& config) {
  if (::isatty(STDIN_FILENO) != 1)
    throw InstrumentError("manual chamber", Fault::kCannotOpen,
                          "a chamber that a person sets needs one at a terminal, but standard input is none");
  return driver.make([](std::string_view text) { print_log("{}", text); }, typed_line,
                     chamber_settings(config));
}

/// One driver's handle on a stream; the next driver on the same port gets another handle.
class SharedStream final : public wire::ByteStream {
 public:
  explicit SharedStream(std::shared_ptr<wire::ByteStream> stream) : stream_(std::move(stream)) {}

  void write(std::string_view bytes) override { stream_->write(bytes); }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override { return stream_->read_until(deadline); }
  void discard_input() override { stream_->discard_input(); }
  std::size_t dropped_bytes() const override { return stream_->dropped_bytes(); }
  std::string name() const override { return stream_->name(); }

 private:
  std::shared_ptr<wire::ByteStream> stream_;
};

/// Opens the instruments of one bench file, more than once if needed. The streams outlive the drivers, so
/// that a recording, scripted faults and simulated firmware continue after a port was gone.
class Opener {
 public:
  /// @param guard  opens the real ports of stage and chamber
  Opener(const BenchConfig& config, BenchStreams streams, SimWorlds worlds, Clock& clock,
         std::shared_ptr<HaltGuard> guard)
      : config_(config),
        streams_(std::move(streams)),
        worlds_(std::move(worlds)),
        clock_(clock),
        guard_(std::move(guard)) {}

  std::unique_ptr<RotationStage> stage() {
    const std::array<AxisMounting, 2> mountings{mounting(config_.stage.x), mounting(config_.stage.z)};
    if (config_.stage.driver == kSimulated) {
      // In-process and without a controller: protocol angles all the way.
      std::array<AxisMounting, 2> limits;
      for (std::size_t k = 0; k < 2; ++k)
        limits[k] = {Angle{}, +1, mountings[k].travel_min, mountings[k].travel_max};
      return std::make_unique<MountedStage>(std::make_unique<sim::SimStage>(world_of(worlds_, 1), clock_),
                                            limits);
    }
    if (const auto* by_hand = driver_called(manual_stage_drivers(), config_.stage.driver)) {
      end_orderly_at_signals();  // A message reports that the stage did not halt.
      if (streams_.replay)
        throw std::invalid_argument("a stage turned by hand has no bytes: typed angles are not recorded");
      return std::make_unique<MountedStage>(
          by_hand->make(stage_settings(config_, InstrumentPort{}),
                        [](std::string_view text) { print_log("{}", text); }),
          mountings);
    }
    std::vector<std::unique_ptr<RotationStage>> parts;
    for (const InstrumentPort& port : stage_ports(config_.stage)) {
      const StageDriver& driver = find_stage_driver(port.driver);
      StageSettings settings = stage_settings(config_, port);
      SerialDefaults serial = driver.serial;
      if (settings.description) serial = {settings.description->baud, settings.description->rts_cts};
      // Before the stage can move: signals then end the program only after the halt of a real stage.
      if (driver.connections == 0 || port.port != kSimulated) end_orderly_at_signals();
      if (settings.description && port.port != kSimulated) require_trial(settings);
      std::vector<std::unique_ptr<wire::ByteStream>> streams;
      if (driver.connections > 0) {
        for (const InstrumentPort& connection : connections_of(port, driver.connections))
          streams.push_back(open(connection, serial, Opens::kGuard));
      }
      parts.push_back(driver.make(std::move(streams), clock_, settings));
      if (driver.connections == 0) continue;  // abcal has no stream to halt it by.
      const std::lock_guard lock(halt_mutex_);
      if (opened_.at(port.name).port != nullptr) {
        parts.back() =
            std::make_unique<GuardedStage>(std::move(parts.back()), guard_, port.name, port.driver);
        has_guarded_ports_ = true;
      } else {
        halt_ports_[port.name] = {opened_.at(port.name).stream, parts.back()->halt_recipes()};
      }
    }
    std::unique_ptr<RotationStage> stage =
        parts.size() == 1 ? std::move(parts[0])
                          : std::make_unique<SplitStage>(std::move(parts[0]), std::move(parts[1]));
    if (!turns_) {
      const auto ports = stage_ports(config_.stage);
      const bool is_real = !streams_.replay && std::ranges::any_of(ports, [](const InstrumentPort& port) {
        return port.port != kSimulated;
      });
      turns_ = is_real ? make_kept_turns() : std::make_shared<CountedTurns>();
    }
    return std::make_unique<MountedStage>(std::move(stage), mountings, turns_);
  }

  /// Halts all axes on the ports of the stage without a driver. May be called from any thread.
  HaltReport halt_ports() {
    std::map<std::string, HaltPort, std::less<>> ports;
    bool has_guarded_ports = false;
    {
      const std::lock_guard lock(halt_mutex_);
      ports = halt_ports_;
      has_guarded_ports = has_guarded_ports_;
    }
    // All are halted before any is queried: a lost port must not delay the halt of the other axis.
    for (const auto& [name, port] : ports) {
      for (const HaltRecipe& recipe : port.recipes) {
        try {
          wire::stop_at_once(recipe, *port.stream, clock_);
        } catch (const InstrumentError&) {  // A lost port: carry_out() reports it.
        }
      }
    }
    HaltReport report;
    if (has_guarded_ports) report = guard_->halt("the stage has no driver while its port is opened again");
    for (const auto& [name, port] : ports) {
      for (const HaltRecipe& recipe : port.recipes) {
        const Clock::Instant deadline = clock_.now() + wire::longest_halt(recipe);
        if (!wire::carry_out(recipe, *port.stream, clock_, deadline)) continue;
        for (const StageAxis axis : kStageAxes)
          if (recipe.axes[index(axis)]) report.axes[index(axis)] = AxisHalt::kHalted;
      }
    }
    return report;
  }

  std::unique_ptr<Accelerometer> accelerometer(int item) {
    const AccelerometerConfig& config = config_.item(item).accelerometer;
    if (config.driver == kSimulated) {
      return std::make_unique<sim::SimAccelerometer>(
          world_of(worlds_, item), clock_, config.settings.rate_hz,
          config.settings.unit.empty() ? "g" : config.settings.unit, "SIM-" + std::to_string(item + 1));
    }
    const AccelerometerDriver& driver = find_driver(accelerometer_drivers(), config.driver);
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    bool is_real = false;
    if (driver.ports > 0) {
      for (const InstrumentPort& port : accelerometer_ports(config_, item)) {
        streams.push_back(open(port, driver.serial));
        is_real = is_real || opened_.at(port.name).port != nullptr;
      }
    }
    auto made = driver.make(std::move(streams), clock_, accelerometer_settings(config));
    return is_real ? leased_accelerometer(std::move(made), driver.name, guard_->owner()) : std::move(made);
  }

  std::unique_ptr<ThermalChamber> chamber() {
    end_orderly_at_signals();  // A real chamber must be left as its policy states.
    if (const auto* by_hand = driver_called(manual_chamber_drivers(), config_.chamber.driver))
      return chamber_at_terminal(*by_hand, config_.chamber);
    const ChamberDriver& driver = find_driver(chamber_drivers(), config_.chamber.driver);
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    for (const InstrumentPort& port : chamber_ports(config_.chamber))
      streams.push_back(open(port, driver.serial, Opens::kGuard));
    auto chamber = driver.make(std::move(streams), clock_, chamber_settings(config_.chamber));
    for (const InstrumentPort& port : chamber_ports(config_.chamber))
      if (opened_.at(port.name).port != nullptr)
        chamber = std::make_unique<GuardedChamber>(std::move(chamber), guard_, port.name, port.driver,
                                                   config_.temperature.policy());
    return chamber;
  }

  std::unique_ptr<EnvironmentSensor> environment() {
    for (const InstrumentPort& port : environment_ports(config_.environment)) {
      const EnvironmentDriver& driver = find_driver(environment_drivers(), port.driver);
      return driver.make(open(port, driver.serial), clock_, config_.environment.settings);
    }
    return nullptr;
  }

 private:
  /// A described stage on a real port: its text has passed a trial, with this stage.
  void require_trial(StageSettings& settings) const {
    if (streams_.is_trial || streams_.replay) return;
    const StageDescription& description = *settings.description;
    const std::vector<StageTrial> trials = find_stage_trials(description.sha256);
    if (trials.empty())
      throw std::invalid_argument(
          "the description " + description.source +
          " has not been tried on a stage in its present form; required: abcal stage try " +
          description.source + " --port PORT, with a person at the stage");
    auto tried = std::make_shared<StageDescription>(description);
    for (const StageTrial& trial : trials)
      if (has_same_scale(trial, settings)) tried->tried_with.push_back(trial.stage());
    if (tried->tried_with.empty())
      throw std::invalid_argument(
          "the description " + description.source +
          " has been tried with other units_per_degree; required: those of the trial, or abcal stage try " +
          description.source + " --port PORT --units-per-degree \"X,Z\", with a person at the stage");
    settings.description = std::move(tried);
  }

  /// Whether a trial turned the axes with the scale of the bench file, where the description has none.
  static bool has_same_scale(const StageTrial& trial, const StageSettings& settings) {
    for (const StageAxis axis : kStageAxes) {
      const auto& units = settings.units_per_degree[index(axis)];
      const std::string& name = settings.axis_names[index(axis)];
      if (name.empty() || !units) continue;
      const auto tried = trial.units_per_degree.find(name);
      if (tried == trial.units_per_degree.end() || tried->second != *units) return false;
    }
    return true;
  }

  struct Opened {
    std::shared_ptr<wire::ByteStream> stream;
    wire::ReopenableStream* port = nullptr;  ///< Innermost part of `stream`; null: no real port.
  };

  enum class Opens { kThisProgram, kGuard };

  /// The stream to an instrument; a port that was lost is opened again.
  std::unique_ptr<wire::ByteStream> open(const InstrumentPort& port, const SerialDefaults& defaults,
                                         Opens opens = Opens::kThisProgram) {
    auto found = opened_.find(port.name);
    if (found == opened_.end()) {
      found = opened_.emplace(port.name, open_first(port, defaults, opens)).first;
    } else {
      if (found->second.port != nullptr) found->second.port->reopen();
      found->second.stream->discard_input();
    }
    return std::make_unique<SharedStream>(found->second.stream);
  }

  /// Opens a recording, a real port, or simulated firmware in this process, with the faults and the delays of
  /// the bench file.
  Opened open_first(const InstrumentPort& port, const SerialDefaults& defaults, Opens opens) {
    if (streams_.replay) return {streams_.replay(port.name, clock_)};
    const bool simulated = port.port == kSimulated;
    Opened opened;
    std::unique_ptr<wire::ByteStream> stream;
    std::function<void(bool)> power;
    if (simulated) {
      auto firmware = std::make_unique<sim::FirmwareStream>(
          make_firmware(config_, port, world_of(worlds_, port.item)), clock_);
      power = [inside = firmware.get()](bool on) { inside->power(on); };
      stream = std::move(firmware);
    } else {
      wire::SerialSettings settings;
      settings.baud = port.baud ? static_cast<unsigned>(*port.baud) : defaults.baud;
      settings.rts_cts = defaults.rts_cts;
      const auto open_once = [role = port.name, name = port.port, settings, opens, guard = guard_,
                              &clock = clock_]() -> std::unique_ptr<wire::ByteStream> {
        return std::make_unique<BeatingStream>(opens == Opens::kGuard
                                                   ? guard->open(role, name, settings)
                                                   : wire::open_stream(name, settings, clock, guard->owner()),
                                               guard, clock);
      };
      auto reopenable =
          std::make_unique<wire::ReopenableStream>([name = port.port, open_once, &clock = clock_] {
            return open_after_guard(name, open_once, clock);
          });
      opened.port = reopenable.get();
      stream = std::move(reopenable);
    }
    auto faults = wire_faults(config_.faults, port.name, clock_.now());
    const sim::LinkTiming timing = simulated ? config_.link : sim::LinkTiming{};
    if (!faults.empty() || timing.latency + timing.jitter > Clock::Duration::zero()) {
      auto faulty = std::make_unique<sim::FaultyStream>(std::move(stream), clock_, std::move(faults),
                                                        config_.simulation.seed, timing);
      faulty->on_power(power);
      stream = std::move(faulty);
    }
    opened.stream = streams_.wrap ? streams_.wrap(port.name, std::move(stream), clock_) : std::move(stream);
    return opened;
  }

  const BenchConfig config_;
  const BenchStreams streams_;
  SimWorlds worlds_;
  Clock& clock_;
  /// Declared before the ports: it releases them after they are closed here.
  std::shared_ptr<HaltGuard> guard_;
  std::map<std::string, Opened, std::less<>> opened_;  ///< By InstrumentPort::name.
  std::shared_ptr<CountedTurns> turns_;                ///< Outlives each stage that is made.

  struct HaltPort {
    std::shared_ptr<wire::ByteStream> stream;
    std::vector<HaltRecipe> recipes;
  };
  std::mutex halt_mutex_;
  std::map<std::string, HaltPort, std::less<>>
      halt_ports_;  ///< By InstrumentPort::name; without those of the guard.
  bool has_guarded_ports_ = false;
};

/// The instruments of a bench whose drivers can be made again.
class BenchReconnector final : public Reconnector {
 public:
  explicit BenchReconnector(ReplaceableStage& stage) : stage_(stage) {}

  void add(int item, ReplaceableAccelerometer& accelerometer) {
    accelerometers_.emplace(item, accelerometer);
  }

  bool stage_lost() const override { return stage_.lost(); }

  void reconnect() override {
    if (stage_.lost()) stage_.replace();
    for (const auto& [item, accelerometer] : accelerometers_)
      if (accelerometer.lost()) accelerometer.replace();
  }

  bool item_lost(int item) const override {
    const auto found = accelerometers_.find(item);
    return found != accelerometers_.end() && found->second.lost();
  }

  void give_up_item(int item) override { accelerometers_.erase(item); }

 private:
  ReplaceableStage& stage_;
  std::map<int, ReplaceableAccelerometer&> accelerometers_;
};

/// Opens the accelerometers of a bench.
void add_accelerometers(const BenchConfig& config, const std::shared_ptr<Opener>& opener,
                        const SimWorlds& worlds, BenchReconnector& reconnector, Bench& bench) {
  for (int k = 1; k <= static_cast<int>(config.items.size()); ++k) {
    if (!config.item(k).left_out.empty()) continue;
    BenchItem& item = bench.items.emplace_back();
    item.k = k;
    item.world = world_of(worlds, k);
    try {
      auto made =
          std::make_unique<ReplaceableAccelerometer>([opener, k] { return opener->accelerometer(k); });
      reconnector.add(k, *made);
      item.accelerometer = std::move(made);
    } catch (const InstrumentError& error) {
      if (!config.has_several_items()) throw;
      item.missing = error.message();
    }
  }
  if (std::ranges::none_of(bench.items, &BenchItem::is_open))
    throw InstrumentError(
        "accelerometer", Fault::kCannotOpen,
        Message("none of the items of this bench can be opened: {why}", bench.items.front().missing));
}

}  // namespace

std::string bench_in_words(const BenchConfig& config) {
  if (!config.name.empty()) return fmt::format("on the bench \"{}\"", config.name);
  std::string ports;
  for (const InstrumentPort& port : stage_ports(config.stage)) {
    const bool is_path = port.port.find(':') == std::string::npos && port.port != kSimulated;
    ports += (ports.empty() ? "" : " and ") +
             (is_path ? std::filesystem::absolute(port.port).string() : port.port);
  }
  return fmt::format("on the bench at \"{}\"", ports);
}

std::unique_ptr<RotationStage> make_stage(const BenchConfig& config, Clock& clock) {
  return Opener(config, {}, {}, clock, std::make_shared<HaltGuard>("abcal", bench_in_words(config))).stage();
}

Bench make_bench(const BenchConfig& config, BenchStreams streams, std::unique_ptr<Clock> simulated_clock) {
  std::vector<InstrumentPort> ports = stage_ports(config.stage);
  const bool stage_is_simulated =
      config.stage.driver == kSimulated ||
      (!ports.empty() && std::all_of(ports.begin(), ports.end(),
                                     [](const InstrumentPort& port) { return port.port == kSimulated; }));
  const bool accelerometer_is_simulated = has_simulated_accelerometer(config);
  for (const InstrumentPort& port : all_accelerometer_ports(config)) ports.push_back(port);
  for (const InstrumentPort& port : environment_ports(config.environment)) ports.push_back(port);
  for (const InstrumentPort& port : chamber_ports(config.chamber)) ports.push_back(port);
  const auto real_port = [](const InstrumentPort& port) { return port.port != kSimulated; };

  // Started when the first port is opened behind it.
  const auto guard =
      std::make_shared<HaltGuard>(streams.owner.empty() ? "abcal" : streams.owner, bench_in_words(config));
  Bench bench;
  bench.replayed = static_cast<bool>(streams.replay);
  const bool turned_by_hand = driver_called(manual_stage_drivers(), config.stage.driver) != nullptr;
  const bool set_by_hand = driver_called(manual_chamber_drivers(), config.chamber.driver) != nullptr;
  bench.simulated_time = bench.replayed || (!turned_by_hand && !set_by_hand &&
                                            std::none_of(ports.begin(), ports.end(), real_port));
  bench.repeatable = bench.simulated_time && !bench.replayed && !simulated_clock;
  if (bench.replayed) {
    bench.clock = std::move(streams.replay_clock);
  } else if (bench.simulated_time) {
    bench.clock = simulated_clock ? std::move(simulated_clock) : std::make_unique<sim::SimClock>();
  } else {
    bench.clock = std::make_unique<BeatingClock>(std::make_unique<RealClock>(), guard);
  }
  const bool anything_simulated =
      stage_is_simulated || accelerometer_is_simulated || !std::all_of(ports.begin(), ports.end(), real_port);
  SimWorlds worlds;
  if (anything_simulated) {
    worlds = make_worlds(config, bench.clock->now());
    bench.world = worlds.front();
  } else if (!config.changes.empty()) {
    throw std::invalid_argument("[[change]]: nothing on this bench is simulated, so a change has no effect");
  }

  const auto opener = std::make_shared<Opener>(config, std::move(streams), worlds, *bench.clock, guard);
  // The encoder of a real stage turns the simulated world.
  const bool followed = accelerometer_is_simulated && !stage_is_simulated;
  auto stage = std::make_unique<ReplaceableStage>(
      [opener, followed, world = bench.world, &clock = *bench.clock]() -> std::unique_ptr<RotationStage> {
        auto made = opener->stage();
        if (followed) made = std::make_unique<sim::FollowedStage>(std::move(made), world, clock);
        return made;
      },
      [opener] { return opener->halt_ports(); });
  auto reconnector = std::make_unique<BenchReconnector>(*stage);
  add_accelerometers(config, opener, worlds, *reconnector, bench);
  bench.environment = opener->environment();
  bench.reconnector = std::move(reconnector);
  bench.stage = std::move(stage);
  // No watchdog if a person turns the stage, who cannot be halted, or if time jumps.
  if (!bench.simulated_time && !turned_by_hand)
    bench.stage = std::make_unique<StageWatchdog>(std::move(bench.stage), *bench.clock);
  if (config.chamber.present()) {
    bench.chamber = std::make_unique<ChamberWatch>([opener] { return opener->chamber(); }, *bench.clock,
                                                   config.chamber.poll_s);
    bench.stage = watched_stage(std::move(bench.stage), *bench.chamber);
    std::unique_ptr<Accelerometer>& first = bench.first().accelerometer;
    first = watched_accelerometer(std::move(first), *bench.chamber);
  }
  return bench;
}

BenchItem& Bench::first() {
  return *std::ranges::find_if(items, &BenchItem::is_open);
}

}  // namespace abcal
