#include "app/make_bench.h"

#include <algorithm>
#include <functional>
#include <map>
#include <stdexcept>
#include <utility>

#include "app/real_clock.h"
#include "drivers/instrument/mounted_stage.h"
#include "drivers/registry.h"
#include "drivers/wire/open_stream.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/mip_firmware.h"
#include "sim/firmware/newport_esp_firmware.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/firmware/scpi_voltmeter_firmware.h"
#include "sim/firmware/vectornav_firmware.h"
#include "sim/firmware/witmotion_firmware.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"

namespace abcal {
namespace {

constexpr const char* kSimulated = "simulated";

AxisMounting mounting(const StageAxisConfig& axis) {
  const auto angle = [](const std::optional<double>& degrees) {
    return degrees ? std::optional(Angle::degrees(*degrees)) : std::nullopt;
  };
  return {axis.zero, axis.sign, angle(axis.travel_min_deg), angle(axis.travel_max_deg)};
}

template <class Driver>
const Driver& find_driver(const std::vector<Driver>& drivers, const std::string& name) {
  const auto found =
      std::find_if(drivers.begin(), drivers.end(), [&](const Driver& d) { return d.name == name; });
  if (found == drivers.end()) throw std::invalid_argument("no driver is called \"" + name + "\"");
  return *found;
}

/// The bytes to and from an instrument: a recording, a real port, or simulated firmware in this process.
std::unique_ptr<wire::ByteStream> open_port(
    const BenchStreams& streams, std::string_view role, const std::string& port,
    const std::optional<int>& baud, const SerialDefaults& defaults, Clock& clock,
    const std::function<std::shared_ptr<sim::Firmware>()>& make_firmware) {
  if (streams.replay) return streams.replay(role, clock);
  std::unique_ptr<wire::ByteStream> stream;
  if (port == kSimulated) {
    stream = std::make_unique<sim::FirmwareStream>(make_firmware(), clock);
  } else {
    wire::SerialSettings settings;
    settings.baud = baud ? static_cast<unsigned>(*baud) : defaults.baud;
    settings.rts_cts = defaults.rts_cts;
    stream = wire::open_stream(port, settings, clock);
  }
  return streams.wrap ? streams.wrap(role, std::move(stream), clock) : std::move(stream);
}

/// Settings that every stage's firmware has: axis names, signs and zeros, serial number.
template <class Settings>
Settings stage_firmware_settings(const StageConfig& stage) {
  Settings settings;
  settings.axis_names = {stage.x.axis, stage.z.axis};
  settings.sign = {stage.x.sign, stage.z.sign};
  settings.zero = {stage.x.zero, stage.z.zero};
  if (!stage.serial_number.empty()) settings.serial_number = stage.serial_number;
  return settings;
}

std::shared_ptr<sim::Firmware> pi_gcs_firmware(const BenchConfig& config,
                                               std::shared_ptr<sim::SimBench> world) {
  auto settings = stage_firmware_settings<sim::PiGcsSettings>(config.stage);
  if (!config.stage.address.empty()) settings.address = std::stoi(config.stage.address);
  return std::make_shared<sim::PiGcsFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> mip_firmware(const BenchConfig& config, std::shared_ptr<sim::SimBench> world) {
  sim::MipSettings settings;
  if (!config.accelerometer.serial_number.empty())
    settings.serial_number = config.accelerometer.serial_number;
  if (config.accelerometer.baud) settings.baud = static_cast<unsigned>(*config.accelerometer.baud);
  return std::make_shared<sim::MipFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> newport_esp_firmware(const BenchConfig& config,
                                                    std::shared_ptr<sim::SimBench> world) {
  return std::make_shared<sim::NewportEspFirmware>(
      std::move(world), stage_firmware_settings<sim::NewportEspSettings>(config.stage));
}

std::shared_ptr<sim::Firmware> vectornav_firmware(const BenchConfig& config,
                                                  std::shared_ptr<sim::SimBench> world) {
  sim::VectorNavSettings settings;
  if (!config.accelerometer.serial_number.empty())
    settings.serial_number = config.accelerometer.serial_number;
  if (config.accelerometer.baud) settings.baud = static_cast<unsigned>(*config.accelerometer.baud);
  return std::make_shared<sim::VectorNavFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> witmotion_firmware(const BenchConfig& config,
                                                  std::shared_ptr<sim::SimBench> world) {
  sim::WitMotionSettings settings;
  if (config.accelerometer.baud) settings.baud = static_cast<unsigned>(*config.accelerometer.baud);
  return std::make_shared<sim::WitMotionFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> scpi_voltmeter_firmware(const BenchConfig& config,
                                                       std::shared_ptr<sim::SimBench> world) {
  sim::ScpiVoltmeterSettings settings;
  if (!config.accelerometer.serial_number.empty())
    settings.serial_number = config.accelerometer.serial_number;
  return std::make_shared<sim::ScpiVoltmeterFirmware>(std::move(world), settings);
}

using MakeFirmware = std::shared_ptr<sim::Firmware> (*)(const BenchConfig&, std::shared_ptr<sim::SimBench>);

/// Driver name -> the simulated instrument that it talks to.
const std::map<std::string, MakeFirmware>& stage_firmwares() {
  static const std::map<std::string, MakeFirmware> firmwares{{"newport_esp", newport_esp_firmware},
                                                             {"pi_gcs", pi_gcs_firmware}};
  return firmwares;
}

const std::map<std::string, MakeFirmware>& accelerometer_firmwares() {
  static const std::map<std::string, MakeFirmware> firmwares{{"microstrain_mip", mip_firmware},
                                                             {"scpi_voltmeter", scpi_voltmeter_firmware},
                                                             {"vectornav", vectornav_firmware},
                                                             {"witmotion", witmotion_firmware}};
  return firmwares;
}

std::shared_ptr<sim::Firmware> make_firmware(const std::map<std::string, MakeFirmware>& firmwares,
                                             const std::string& driver, const BenchConfig& config,
                                             std::shared_ptr<sim::SimBench> world) {
  const auto found = firmwares.find(driver);
  if (found == firmwares.end()) {
    throw std::invalid_argument("driver \"" + driver +
                                "\" has no simulated firmware; required: a real port, or another driver");
  }
  return found->second(config, std::move(world));
}

}  // namespace

std::shared_ptr<sim::Firmware> make_stage_firmware(const BenchConfig& config,
                                                   std::shared_ptr<sim::SimBench> world) {
  return make_firmware(stage_firmwares(), config.stage.driver, config, std::move(world));
}

std::shared_ptr<sim::Firmware> make_accelerometer_firmware(const BenchConfig& config,
                                                           std::shared_ptr<sim::SimBench> world) {
  return make_firmware(accelerometer_firmwares(), config.accelerometer.driver, config, std::move(world));
}

Bench make_bench(const BenchConfig& config, BenchStreams streams) {
  Bench bench;
  const bool stage_simulated = config.stage.port == kSimulated;
  const bool accelerometer_simulated = config.accelerometer.port == kSimulated;
  bench.replayed = static_cast<bool>(streams.replay);
  bench.simulated_time = bench.replayed || (stage_simulated && accelerometer_simulated);
  if (bench.replayed) {
    bench.clock = std::move(streams.replay_clock);
  } else if (bench.simulated_time) {
    bench.clock = std::make_unique<sim::SimClock>();
  } else {
    bench.clock = std::make_unique<RealClock>();
  }
  Clock& clock = *bench.clock;
  if (stage_simulated || accelerometer_simulated) {
    bench.world = std::make_shared<sim::SimBench>(config.simulation, clock.now());
  }

  if (config.stage.driver == kSimulated) {
    const std::array<AxisMounting, 2> limits{
        AxisMounting{Angle{}, +1, mounting(config.stage.x).travel_min, mounting(config.stage.x).travel_max},
        AxisMounting{Angle{}, +1, mounting(config.stage.z).travel_min, mounting(config.stage.z).travel_max}};
    bench.stage = std::make_unique<MountedStage>(std::make_unique<sim::SimStage>(bench.world, clock), limits);
  } else {
    const StageDriver& driver = find_driver(stage_drivers(), config.stage.driver);
    StageSettings settings;
    settings.axis_names = {config.stage.x.axis, config.stage.z.axis};
    settings.speed_deg_per_s = {config.stage.x.speed_deg_per_s, config.stage.z.speed_deg_per_s};
    settings.address = config.stage.address;
    auto stream = open_port(streams, "stage", config.stage.port, config.stage.baud, driver.serial, clock,
                            [&] { return make_stage_firmware(config, bench.world); });
    bench.stage = std::make_unique<MountedStage>(
        driver.make(std::move(stream), clock, settings),
        std::array<AxisMounting, 2>{mounting(config.stage.x), mounting(config.stage.z)});
  }

  if (config.accelerometer.driver == kSimulated) {
    bench.accelerometer = std::make_unique<sim::SimAccelerometer>(
        bench.world, clock, config.accelerometer.rate_hz,
        config.accelerometer.response_unit.empty() ? "g" : config.accelerometer.response_unit);
  } else {
    const AccelerometerDriver& driver = find_driver(accelerometer_drivers(), config.accelerometer.driver);
    AccelerometerSettings settings;
    settings.rate_hz = config.accelerometer.rate_hz;
    settings.full_scale = config.accelerometer.full_scale;
    // A baud rate in the bench file means a line that has one; USB and TCP are as fast as they are. 10 bits a
    // byte.
    if (config.accelerometer.baud) settings.link_bytes_per_s = *config.accelerometer.baud / 10.0;
    auto stream =
        open_port(streams, "accelerometer", config.accelerometer.port, config.accelerometer.baud,
                  driver.serial, clock, [&] { return make_accelerometer_firmware(config, bench.world); });
    bench.accelerometer = driver.make(std::move(stream), clock, settings);
  }
  return bench;
}

}  // namespace abcal
