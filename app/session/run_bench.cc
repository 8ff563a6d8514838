#include "app/session/run_bench.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <ctime>
#include <functional>
#include <optional>
#include <stop_token>

#include "app/bench/level_file.h"
#include "app/session/host_clock.h"
#include "app/system/version.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

InstrumentIdentity identity(const StageInfo& info) {
  std::string details;
  for (const StageAxis axis : kStageAxes) {
    const StageAxisInfo& a = info.axes[index(axis)];
    details += fmt::format("{}axis {}: {} travel {:g} to {:g} deg, speed {:g} deg/s, resolution {:g} deg",
                           details.empty() ? "" : "; ", to_string(axis), a.stage_name, a.travel_min.deg(),
                           a.travel_max.deg(), a.speed_deg_per_s, a.resolution.deg());
  }
  return {"stage", info.maker, info.model, info.serial_number, info.firmware, details};
}

InstrumentIdentity identity(const AccelerometerInfo& info) {
  std::string details = fmt::format("output in {}, {:g} readings/s", info.output_unit, info.rate_hz);
  if (info.full_scale) details += fmt::format(", full scale {:g} {}", *info.full_scale, info.output_unit);
  return {"accelerometer", info.maker, info.model, info.serial_number, info.firmware, details};
}

InstrumentIdentity identity(const ChamberInfo& info) {
  return {
      "chamber",     info.maker,
      info.model,    info.serial_number,
      info.firmware, fmt::format("set points {:g} to {:g} degC", info.least_set_degc, info.most_set_degc)};
}

/// The accelerometer on the stage, as the bench file and itself name it.
RunItem item_of(const BenchConfig& config, const Identities& identities) {
  const AccelerometerInfo& info = identities.accelerometer;
  const auto either = [](const std::string& stated, const std::string& found) {
    return stated.empty() ? found : stated;
  };
  RunItem item;
  item.maker = either(config.item.maker, info.maker);
  item.model = either(config.item.model, info.model);
  item.serial_number = either(config.item.serial_number, info.serial_number);
  item.firmware = either(config.item.firmware, info.firmware);
  item.driver = config.accelerometer.driver;
  item.port = config.accelerometer.port;
  item.response_unit = info.output_unit;
  item.rate_hz = info.rate_hz;
  item.full_scale = info.full_scale;
  item.resolution = info.resolution;
  item.registers = identities.corrections;
  return item;
}

}  // namespace

SessionStart session_start(const Bench& bench) {
  const bool real_time = !bench.simulated_time && !bench.replayed;
  return {bench.clock->utc_now(), bench.clock->now(), real_time ? read_host_clock() : HostClock{},
          program_version()};
}

std::array<AxisTravel, 2> Identities::travel() const {
  return {AxisTravel{stage.axes[0].travel_min, stage.axes[0].travel_max},
          AxisTravel{stage.axes[1].travel_min, stage.axes[1].travel_max}};
}

void require_serial_number(const std::string& role, const std::string& model, const std::string& found,
                           const std::string& required) {
  if (required.empty() || found == required) return;
  throw InstrumentError(
      role + " " + model, Fault::kWrongIdentity,
      fmt::format("serial number {}; required: {} (serial_number in the bench file). Connect the "
                  "right one, or name its port by usb:VID:PID:SERIAL",
                  found.empty() ? "not reported" : found, required));
}

Identities identify(Bench& bench, const BenchConfig& config, bool ask_corrections) {
  Identities identities{bench.stage->identify(), bench.accelerometer->identify(), {}, {}};
  if (ask_corrections) identities.corrections = bench.accelerometer->correction_registers();
  require_serial_number("stage", identities.stage.model, identities.stage.serial_number,
                        config.stage.serial_number);
  require_serial_number("accelerometer", identities.accelerometer.model,
                        identities.accelerometer.serial_number, config.accelerometer.serial_number);
  if (bench.chamber) {
    identities.chamber = bench.chamber->identify();
    require_serial_number("chamber", identities.chamber->model, identities.chamber->serial_number,
                          config.chamber.serial_number);
  }
  const std::string& unit = config.accelerometer.response_unit;
  if (!unit.empty() && config.accelerometer.driver != "simulated" &&
      unit != identities.accelerometer.output_unit) {
    throw InstrumentError("accelerometer " + identities.accelerometer.model, Fault::kWrongIdentity,
                          fmt::format("its output is in {}; required: {} ([accelerometer] response_unit)",
                                      identities.accelerometer.output_unit, unit));
  }
  return identities;
}

RunHeader make_header(const BenchConfig& config, const Identities& identities, std::vector<PlannedAngle> plan,
                      const Clock& clock) {
  RunHeader header;
  header.program_version = program_version();
  header.created_utc = format_utc(clock.utc_now());
  header.bench_toml = write_bench(config);
  const auto label = [&](const std::string& key, const std::string& value) {
    if (!value.empty()) header.labels[key] = value;
  };
  label("bench.name", config.name);
  label("operator.name", config.operator_name);
  label("item.maker", config.item.maker);
  label("item.model", config.item.model);
  label("item.serial_number", config.item.serial_number);
  label("item.customer_number", config.item.customer_number);
  label("item.range", config.item.range);
  label("item.filter", config.item.filter);
  label("item.firmware", config.item.firmware);
  label("item.supply", config.item.supply);
  label(std::string(kEstimatorLabel), config.protocol.estimator);
  header.instruments = {identity(identities.stage), identity(identities.accelerometer)};
  if (identities.chamber) header.instruments.push_back(identity(*identities.chamber));
  header.items = {item_of(config, identities)};
  header.response_unit = identities.accelerometer.output_unit;
  header.g_loc = config.g_loc;
  header.tolerances = config.tolerances;
  header.limits = config.limits;
  header.expected = config.expected;
  if (!config.stage.level_file.empty()) {
    const LevelFile level = read_level_file(config.stage.level_file);
    require_serial_number("stage", identities.stage.model, identities.stage.serial_number,
                          level.stage_serial_number);
    header.measured_alignment = level.alignment;
  }
  header.step = config.protocol.step;
  header.steps = config.protocol.steps;
  header.plan = std::move(plan);
  return header;
}

std::filesystem::path output_path(const std::string& given, const std::string& bench_file,
                                  const std::string& extension) {
  if (!given.empty()) return given;
  // The name carries real time also when the run's time is simulated: two dry runs are two files.
  const std::time_t now = std::time(nullptr);
  return fmt::format("{}-{:%Y%m%dT%H%M%SZ}{}", std::filesystem::path(bench_file).stem().string(),
                     fmt::gmtime(now), extension);
}

PlanDuration estimate_duration(const std::vector<PlannedAngle>& plan, const BenchConfig& config,
                               const Identities& identities) {
  return estimate_duration(plan, config.protocol,
                           {AxisSpeed{identities.stage.axes[0].speed_deg_per_s},
                            AxisSpeed{identities.stage.axes[1].speed_deg_per_s}},
                           identities.accelerometer.rate_hz);
}

std::optional<std::string> note_environment(Bench& bench, const BenchConfig& config, RunFile& file,
                                            std::string_view moment) {
  constexpr Clock::Duration kPatience = std::chrono::seconds(30);  // some sensors report every ten seconds
  std::optional<std::string> warning;
  EnvironmentReading now;
  if (bench.environment) {
    try {
      now = bench.environment->read(bench.clock->now() + kPatience);
    } catch (const InstrumentError& error) {
      if (moment == "start") throw;
      file.append_event(format_utc(file.utc_now(*bench.clock)), "environment not read", error.what());
      warning = fmt::format("the environment could not be read: {}", error.what());
    }
  }
  const auto either = [](const std::optional<double>& measured, const std::optional<double>& typed) {
    return measured ? measured : typed;
  };
  file.append_environment(format_utc(file.utc_now(*bench.clock)), moment,
                          either(now.temperature_degc, config.environment.temperature_degc),
                          either(now.humidity_percent, config.environment.humidity_percent),
                          either(now.pressure_hpa, config.environment.pressure_hpa));
  return warning;
}

RunTiming measure_plan(const PlanMeasurement& measurement, RunObserver& observer,
                       const std::stop_token& stop) {
  Bench& bench = measurement.bench;
  const BenchConfig& config = measurement.config;
  // Simulated time has one thread only.
  std::optional<std::stop_callback<std::function<void()>>> halt_at_once;
  if (!bench.simulated_time) halt_at_once.emplace(stop, [&] { bench.stage->halt(); });
  const RunSettings settings{config.protocol, config.limits, config.tolerances, config.expected,
                             config.g_loc.value_mps2};
  return run_experiments({*bench.stage, *bench.accelerometer, *bench.clock, bench.reconnector.get()},
                         {measurement.plan, settings, measurement.so_far}, measurement.file, observer, stop);
}

}  // namespace abcal
