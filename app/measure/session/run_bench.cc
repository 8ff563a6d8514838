#include "app/measure/session/run_bench.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <ctime>
#include <functional>
#include <map>
#include <optional>
#include <stop_token>
#include <utility>

#include "app/bench_file/instrument_ports.h"
#include "app/bench_file/item_identity.h"
#include "app/bench_file/level_file.h"
#include "app/bench_file/not_real.h"
#include "app/bench_file/stage_record_file.h"
#include "app/measure/session/host_clock.h"
#include "app/system/read_file.h"
#include "app/system/version.h"
#include "drivers/instrument/driver_catalogue.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/sha256.h"

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

/// @param role  accelerometer_name() of its item
InstrumentIdentity identity(const AccelerometerInfo& info, std::string role) {
  std::string details = fmt::format("output in {}, {:g} readings/s", info.output_unit, info.rate_hz);
  if (info.full_scale) details += fmt::format(", full scale {:g} {}", *info.full_scale, info.output_unit);
  return {std::move(role), info.maker, info.model, info.serial_number, info.firmware, details};
}

InstrumentIdentity identity(const ChamberInfo& info) {
  return {
      "chamber",     info.maker,
      info.model,    info.serial_number,
      info.firmware, fmt::format("set points {:g} to {:g} degC", info.least_set_degc, info.most_set_degc)};
}

/// Whether an instrument measures voltages; its own calibration is then part of the traceability.
bool reads_volts(const AccelerometerConfig& config, const AccelerometerInfo& info) {
  return info.output_unit.ends_with("V") ||
         find_in(driver_catalogue().accelerometers, config.driver).traits.reads_volts;
}

/// An item on the stage, as the bench file and its accelerometer name it.
RunItem item_of(const BenchItemConfig& stated, const ItemIdentity& identified,
                const AccelerometerInfo& info) {
  const auto [maker, model, serial_number] = identity_parts_of(stated, info);
  // A simulated accelerometer names itself where the bench file names no item; a voltmeter is not the item.
  const auto either = [](const std::string& known, const std::string& found, bool is_item) {
    return known.empty() && is_item ? found : known;
  };
  const bool is_simulated = stated.accelerometer.driver == kSimulated;
  RunItem item;
  item.k = identified.k;
  item.maker = either(maker.text(), info.maker, is_simulated);
  item.model = either(model.text(), info.model, is_simulated);
  item.serial_number = either(serial_number.text(), info.serial_number, is_simulated);
  item.firmware = either(stated.item.firmware, info.firmware, !reads_volts(stated.accelerometer, info));
  item.driver = stated.accelerometer.driver;
  item.port = stated.accelerometer.port;
  item.mounting = stated.expected.mounting;
  item.response_unit = info.output_unit;
  item.rate_hz = info.rate_hz;
  item.full_scale = info.full_scale;
  item.resolution = info.resolution;
  item.registers = identified.corrections;
  return item;
}

/// The names that are stated of an item, and those that its instrument reports where nothing is stated.
std::map<std::string, std::string> item_labels(const BenchItemConfig& stated, const AccelerometerInfo& info) {
  const ItemConfig& item = stated.item;
  const auto [maker, model, serial_number] = identity_parts_of(stated, info);
  std::map<std::string, std::string> labels{{"item.maker", maker.text()},
                                            {"item.model", model.text()},
                                            {"item.serial_number", serial_number.text()},
                                            {"item.customer_number", item.customer_number},
                                            {"item.range", item.range},
                                            {"item.filter", item.filter},
                                            {"item.firmware", item.firmware},
                                            {"item.supply", item.supply},
                                            {"item.reference_surface", item.reference_surface},
                                            {"item.direction_marks", item.direction_marks},
                                            {"item.fasteners", item.fasteners},
                                            {"item.cable", item.cable}};
  if (item.torque_newton_metre) labels["item.torque"] = fmt::format("{:g} N m", *item.torque_newton_metre);
  std::erase_if(labels, [](const auto& each) { return each.second.empty(); });
  return labels;
}

/// Records the serial number that the bench file states for an instrument that reports none, as stated.
void note_stated_serial_number(const std::string& stated, InstrumentIdentity& instrument, RunHeader& header) {
  if (stated.empty() || is_serial_number_reported(instrument.serial_number)) return;
  header.labels[stated_serial_number_label(instrument.role)] = stated;
  instrument.details += stated_serial_number_words(stated);
}

/// Adds the items, their accelerometers and the facts of each to the header.
void add_items(const BenchConfig& config, const Identities& identities, RunHeader& header) {
  for (const ItemIdentity& identified : identities.items) {
    const BenchItemConfig& stated = config.item(identified.k);
    AccelerometerInfo info = identified.accelerometer;
    if (info.output_unit.empty()) info.output_unit = stated.accelerometer.settings.unit;  // Missing item.
    header.items.push_back(item_of(stated, identified, info));
    if (identified.is_present()) {
      header.instruments.push_back(identity(info, accelerometer_name(config, identified.k)));
      if (reads_volts(stated.accelerometer, info))
        note_stated_serial_number(stated.accelerometer.serial_number, header.instruments.back(), header);
    }
    ItemFacts facts{item_labels(stated, info), info.output_unit, stated.tolerances, stated.limits,
                    stated.expected};
    if (identified.k > 1) {
      header.further_items.push_back(std::move(facts));
      continue;
    }
    header.labels.merge(facts.labels);
    header.response_unit = facts.response_unit;
    header.tolerances = facts.tolerances;
    header.limits = facts.limits;
    header.expected = facts.expected;
  }
}

/// Refuses an accelerometer whose serial number or output unit is not that of the bench file.
void require_as_stated(const std::string& role, const AccelerometerConfig& config,
                       const AccelerometerInfo& info) {
  require_serial_number_of_accelerometer(role, config, info);
  const std::string& unit = config.settings.unit;
  if (unit.empty() || config.driver == "simulated" || unit == info.output_unit) return;
  throw InstrumentError(role + " " + info.model, Fault::kWrongIdentity,
                        fmt::format("its output is in {}; required: {} ([accelerometer] response_unit)",
                                    info.output_unit, unit));
}

/// Starts an accelerometer and requires one reading: an item without any is missing.
void require_reading(Accelerometer& accelerometer, const Clock& clock, double timeout_s) {
  accelerometer.start();
  const bool reads = accelerometer.next(clock.now() + from_seconds(timeout_s)).has_value();
  accelerometer.stop();
  if (!reads)
    throw InstrumentError(
        "accelerometer", Fault::kNoReply,
        fmt::format("it answers, but gives no reading for {} s (reading_timeout_s)", timeout_s));
}

void identify_items(Bench& bench, const BenchConfig& config, bool ask_corrections, Identities& identities) {
  identities.items.clear();
  for (BenchItem& item : bench.items) {
    ItemIdentity& identity = identities.items.emplace_back();
    identity.k = item.k;
    if (item.missing.empty()) {
      try {
        identity.accelerometer = item.accelerometer->identify();
        if (ask_corrections) identity.corrections = item.accelerometer->correction_registers();
        // A silent item delays the others. A single item needs no test: its first dwell finds it silent.
        if (config.has_several_items())
          require_reading(*item.accelerometer, *bench.clock, config.protocol.reading_timeout_s);
      } catch (const InstrumentError& error) {
        if (!config.has_several_items()) throw;
        item.missing = error.message();
      }
    }
    identity.missing = item.missing;
    if (identity.is_present())
      require_as_stated(item_words(config, item.k) + "accelerometer", config.item(item.k).accelerometer,
                        identity.accelerometer);
  }
}

/// Output rate of the slowest item that is present, in Hz.
double slowest_rate_hz(const Identities& identities) {
  double slowest = identities.first().accelerometer.rate_hz;
  for (const ItemIdentity& item : identities.items)
    if (item.is_present()) slowest = std::min(slowest, item.accelerometer.rate_hz);
  return slowest;
}

}  // namespace

SessionStart session_start(const Bench& bench) {
  const bool real_time = !bench.simulated_time && !bench.replayed;
  return {bench.clock->utc_now(), bench.clock->now(), real_time ? read_host_clock() : HostClock{},
          program_version(), bench.repeatable};
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
      Message("serial number {found}; required: {required} (serial_number in the bench file). Connect the "
              "right one, or name its port by usb:VID:PID:SERIAL",
              found.empty() ? Message("not reported") : Message("{found}", found), required));
}

void require_or_state_serial_number(const std::string& role, const std::string& model,
                                    const std::string& found, const std::string& stated) {
  if (is_serial_number_reported(found)) {
    require_serial_number(role, model, found, stated);
    return;
  }
  // One of two controllers may report its serial number, which must then be among the stated ones.
  const std::vector<std::string> all = single_serial_numbers(stated);
  for (const std::string& reported : single_serial_numbers(found))
    if (reported != "0" && std::find(all.begin(), all.end(), reported) == all.end())
      require_serial_number(role, model, found, stated);
}

void require_serial_number_of_accelerometer(const std::string& role, const AccelerometerConfig& config,
                                            const AccelerometerInfo& info) {
  const auto require = reads_volts(config, info) ? require_or_state_serial_number : require_serial_number;
  require(role, info.model, info.serial_number, config.serial_number);
}

ItemIdentityParts identity_parts_of(const BenchItemConfig& stated, const AccelerometerInfo& info) {
  return identity_parts({stated.item.maker, stated.item.model, stated.item.serial_number},
                        reported_by_item(stated.accelerometer.driver, info.output_unit,
                                         {info.maker, info.model, info.serial_number}));
}

void require_item_as_stated(const std::string& role, const BenchItemConfig& stated,
                            const AccelerometerInfo& info) {
  std::string differences;
  for (const IdentityPart& part : identity_parts_of(stated, info))
    if (const std::string one = difference(part); !one.empty())
      differences += (differences.empty() ? "" : "; ") + one;
  if (!differences.empty())
    throw InstrumentError(role + " " + info.model, Fault::kWrongIdentity, differences);
}

void require_items_as_stated(const BenchConfig& config, const Identities& identities) {
  for (const ItemIdentity& item : identities.items)
    if (item.is_present())
      require_item_as_stated(item_words(config, item.k) + "accelerometer", config.item(item.k),
                             item.accelerometer);
}

const ItemIdentity& Identities::first() const {
  const auto present = std::ranges::find_if(items, &ItemIdentity::is_present);
  return present == items.end() ? items.front() : *present;
}

Identities identify(Bench& bench, const BenchConfig& config, bool ask_corrections) {
  Identities identities{.stage = bench.stage->identify()};
  require_or_state_serial_number("stage", identities.stage.model, identities.stage.serial_number,
                                 config.stage.serial_number);
  identify_items(bench, config, ask_corrections, identities);
  if (bench.chamber) {
    identities.chamber = bench.chamber->identify();
    require_serial_number("chamber", identities.chamber->model, identities.chamber->serial_number,
                          config.chamber.settings.serial_number);
  }
  return identities;
}

void require_all_items(const Identities& identities) {
  std::string missing;
  std::size_t count = 0;
  for (const ItemIdentity& item : identities.items) {
    if (item.missing.empty()) continue;
    missing += fmt::format("{}item {} ({})", count++ == 0 ? "" : "; ", item.k, item.missing);
  }
  if (count == 0) return;
  const bool all = count == identities.items.size();
  throw InstrumentError("items", Fault::kNotReady,
                        fmt::format("{} of {} are not there: {}. Connect {}{}", count,
                                    identities.items.size(), missing, count == 1 ? "it" : "them",
                                    all ? "" : ", or measure the others without: --without-missing-items"));
}

/// The record of the stage as its file has it, once it is found to be of this stage.
std::string stage_record_text(const BenchConfig& config, const InstrumentIdentity& stage) {
  const std::string text = read_file(config.stage.record);
  const StageRecord record = parse_stage_record(text, config.stage.record);
  if (const std::vector<std::string> differ =
          differences(record.identity, stage_identity(stage, config.stage));
      !differ.empty())
    throw InstrumentError("stage", Fault::kWrongIdentity,
                          fmt::format("{} is the record of another stage: {}. Learn this stage (`abcal stage "
                                      "learn`), or leave `[stage] record` out",
                                      config.stage.record, fmt::join(differ, "; ")));
  return text;
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
  label(std::string(kEstimatorLabel), config.protocol.estimator);
  header.instruments = {identity(identities.stage)};
  if (config.stage.is_described())
    header.instruments.front().details += fmt::format(
        "; description {}, SHA-256 {}", config.stage.description, sha256_of(config.stage.description_text));
  note_stated_serial_number(config.stage.serial_number, header.instruments.front(), header);
  header.g_loc = config.g_loc;
  add_items(config, identities, header);
  if (identities.chamber) header.instruments.push_back(identity(*identities.chamber));
  if (!config.stage.level_file.empty()) {
    const LevelFile level = read_level_file(config.stage.level_file);
    require_serial_number("stage", identities.stage.model, identities.stage.serial_number,
                          level.stage_serial_number);
    header.measured_alignment = level.alignment;
  }
  if (!config.stage.record.empty())
    header.stage_record = stage_record_text(config, header.instruments.front());
  header.step = config.protocol.step;
  header.approach = config.protocol.approach;
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
                           slowest_rate_hz(identities));
}

std::optional<Message> note_environment(Bench& bench, const BenchConfig& config, RunFile& file,
                                        std::string_view moment) {
  constexpr Clock::Duration kPatience = std::chrono::seconds(30);  // some sensors report every ten seconds
  std::optional<Message> warning;
  EnvironmentReading now;
  if (bench.environment) {
    try {
      now = bench.environment->read(bench.clock->now() + kPatience);
    } catch (const InstrumentError& error) {
      if (moment == "start") throw;
      file.append_event(format_utc(file.utc_now(*bench.clock)), "environment not read", error.message());
      warning = Message("the environment could not be read: {why}", error.message());
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
  // In simulated time only one thread may use the bench.
  std::optional<std::stop_callback<std::function<void()>>> halt_at_once;
  if (!bench.simulated_time) halt_at_once.emplace(stop, [&] { bench.stage->halt(); });
  const BenchItemConfig& first = config.items.front();
  const RunSettings settings{config.protocol, first.limits, first.tolerances, first.expected,
                             config.g_loc.value_mps2};
  RunInstruments instruments{
      *bench.stage, *bench.clock, {}, config.has_several_items(), bench.reconnector.get()};
  for (const BenchItem& item : bench.items) {
    if (!item.missing.empty()) continue;
    const BenchItemConfig& stated = config.item(item.k);
    instruments.items.push_back(
        {item.k, *item.accelerometer, stated.limits, stated.tolerances, stated.expected});
  }
  if (instruments.items.empty())
    throw InstrumentError("items", Fault::kNotReady,
                          Message("none of them is there: {why}", bench.items.front().missing));
  return run_experiments(instruments, {measurement.plan, settings, measurement.so_far}, measurement.file,
                         observer, stop);
}

}  // namespace abcal
