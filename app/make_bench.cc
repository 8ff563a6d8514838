#include "app/make_bench.h"

#include <algorithm>
#include <functional>
#include <map>
#include <stdexcept>
#include <utility>

#include "app/real_clock.h"
#include "drivers/instrument/mounted_stage.h"
#include "drivers/instrument/split_stage.h"
#include "drivers/manual_stage/manual_stage.h"
#include "drivers/registry.h"
#include "drivers/wire/open_stream.h"
#include "sim/faults.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/mip_firmware.h"
#include "sim/firmware/newport_esp_firmware.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/firmware/scpi_voltmeter_firmware.h"
#include "sim/firmware/text_line_firmware.h"
#include "sim/firmware/vectornav_firmware.h"
#include "sim/firmware/witmotion_firmware.h"
#include "sim/firmware/xsens_mti_firmware.h"
#include "sim/firmware/zaber_ascii_firmware.h"
#include "sim/followed_stage.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"

namespace abcal {
namespace {

constexpr const char* kSimulated = "simulated";
constexpr const char* kManual = "manual";

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

/// The bytes to and from an instrument: a real port, or simulated firmware in this process; with the faults
/// and the delays that the bench file asks for.
std::unique_ptr<wire::ByteStream> open_port(
    const BenchConfig& config, const std::string& instrument, const std::string& port,
    const std::optional<int>& baud, const SerialDefaults& defaults, Clock& clock,
    const std::function<std::shared_ptr<sim::Firmware>()>& make_firmware) {
  const bool simulated = port == kSimulated;
  std::unique_ptr<wire::ByteStream> stream;
  if (simulated) {
    stream = std::make_unique<sim::FirmwareStream>(make_firmware(), clock);
  } else {
    wire::SerialSettings settings;
    settings.baud = baud ? static_cast<unsigned>(*baud) : defaults.baud;
    settings.rts_cts = defaults.rts_cts;
    stream = wire::open_stream(port, settings, clock);
  }
  auto faults = wire_faults(config.faults, instrument, clock.now());
  const sim::LinkTiming timing = simulated ? config.link : sim::LinkTiming{};
  if (faults.empty() && timing.latency + timing.jitter == Clock::Duration::zero()) return stream;
  return std::make_unique<sim::FaultyStream>(std::move(stream), clock, std::move(faults),
                                             config.simulation.seed, timing);
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

std::shared_ptr<sim::Firmware> pi_gcs_firmware(const BenchConfig& config, const StagePort& port,
                                               std::shared_ptr<sim::SimBench> world) {
  auto settings = stage_firmware_settings<sim::PiGcsSettings>(config.stage);
  if (!port.address.empty()) settings.address = std::stoi(port.address);
  return std::make_shared<sim::PiGcsFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> mip_firmware(const BenchConfig& config, std::shared_ptr<sim::SimBench> world) {
  sim::MipSettings settings;
  if (!config.accelerometer.serial_number.empty())
    settings.serial_number = config.accelerometer.serial_number;
  if (config.accelerometer.baud) settings.baud = static_cast<unsigned>(*config.accelerometer.baud);
  return std::make_shared<sim::MipFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> newport_esp_firmware(const BenchConfig& config, const StagePort&,
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

std::shared_ptr<sim::Firmware> text_line_firmware(const BenchConfig& config,
                                                  std::shared_ptr<sim::SimBench> world) {
  sim::TextLineSettings settings;
  settings.rate_hz = config.accelerometer.rate_hz;
  return std::make_shared<sim::TextLineFirmware>(std::move(world), settings);
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

std::shared_ptr<sim::Firmware> xsens_mti_firmware(const BenchConfig& config,
                                                  std::shared_ptr<sim::SimBench> world) {
  sim::XsensMtiSettings settings;
  if (!config.accelerometer.serial_number.empty()) settings.device_id = config.accelerometer.serial_number;
  if (config.accelerometer.baud) settings.baud = static_cast<unsigned>(*config.accelerometer.baud);
  return std::make_shared<sim::XsensMtiFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> zaber_ascii_firmware(const BenchConfig& config, const StagePort& port,
                                                    std::shared_ptr<sim::SimBench> world) {
  auto settings = stage_firmware_settings<sim::ZaberAsciiSettings>(config.stage);
  if (!port.address.empty()) settings.address = std::stoi(port.address);
  // Of two devices: "12345/67890", as the driver gives it.
  if (const auto slash = settings.serial_number.find('/'); slash != std::string::npos) {
    settings.z_serial_number = settings.serial_number.substr(slash + 1);
    settings.serial_number.resize(slash);
  }
  return std::make_shared<sim::ZaberAsciiFirmware>(std::move(world), settings);
}

using MakeStageFirmware = std::shared_ptr<sim::Firmware> (*)(const BenchConfig&, const StagePort&,
                                                             std::shared_ptr<sim::SimBench>);
using MakeFirmware = std::shared_ptr<sim::Firmware> (*)(const BenchConfig&, std::shared_ptr<sim::SimBench>);

/// Driver name -> the simulated instrument that it talks to.
const std::map<std::string, MakeStageFirmware>& stage_firmwares() {
  static const std::map<std::string, MakeStageFirmware> firmwares{{"newport_esp", newport_esp_firmware},
                                                                  {"pi_gcs", pi_gcs_firmware},
                                                                  {"zaber_ascii", zaber_ascii_firmware}};
  return firmwares;
}

const std::map<std::string, MakeFirmware>& accelerometer_firmwares() {
  static const std::map<std::string, MakeFirmware> firmwares{
      {"microstrain_mip", mip_firmware}, {"scpi_voltmeter", scpi_voltmeter_firmware},
      {"text_line", text_line_firmware}, {"vectornav", vectornav_firmware},
      {"witmotion", witmotion_firmware}, {"xsens_mti", xsens_mti_firmware}};
  return firmwares;
}

template <class Make>
Make find_firmware(const std::map<std::string, Make>& firmwares, const std::string& driver) {
  const auto found = firmwares.find(driver);
  if (found == firmwares.end()) {
    throw std::invalid_argument("driver \"" + driver +
                                "\" has no simulated firmware; required: a real port, or another driver");
  }
  return found->second;
}

std::unique_ptr<RotationStage> make_part(const BenchConfig& config, const StagePort& port,
                                         const std::shared_ptr<sim::SimBench>& world, Clock& clock) {
  StageSettings settings;
  settings.axis_names = {config.stage.x.axis, config.stage.z.axis};
  settings.speed_deg_per_s = {config.stage.x.speed_deg_per_s, config.stage.z.speed_deg_per_s};
  settings.address = port.address;
  if (port.driver == kManual) return manual_stage::at_terminal(settings);
  const StageDriver& driver = find_driver(stage_drivers(), port.driver);
  return driver.make(open_port(config, port.name, port.port, port.baud, driver.serial, clock,
                               [&] { return make_stage_firmware(config, port, world); }),
                     clock, settings);
}

AccelerometerSettings accelerometer_settings(const AccelerometerConfig& config) {
  AccelerometerSettings settings;
  settings.rate_hz = config.rate_hz;
  settings.full_scale = config.full_scale;
  // A baud rate in the bench file means a line that has one; USB and TCP are as fast as they are. 10 bits a
  // byte.
  if (config.baud) settings.link_bytes_per_s = *config.baud / 10.0;
  for (std::size_t j = 0; j < 3; ++j) {
    settings.scale[j] = config.scale[static_cast<Eigen::Index>(j)];
    settings.bias[j] = config.bias[static_cast<Eigen::Index>(j)];
  }
  settings.unit = config.response_unit;
  settings.channels = config.channels;
  settings.range_v = config.range_v;
  settings.integration_plc = config.integration_plc;
  settings.columns = config.columns;
  settings.separator = config.separator;
  settings.comment = config.comment;
  return settings;
}

bool any_stage_part_is(const BenchConfig& config, bool simulated) {
  const std::vector<StagePort> ports = stage_ports(config.stage);
  return std::any_of(ports.begin(), ports.end(),
                     [&](const StagePort& port) { return (port.port == kSimulated) == simulated; });
}

}  // namespace

std::vector<StagePort> stage_ports(const StageConfig& stage) {
  if (!stage.split()) return {{"stage", stage.driver, stage.port, stage.baud, stage.address}};
  return {{"stage-x", stage.x.driver, stage.x.port, stage.x.baud, stage.x.address},
          {"stage-z", stage.z.driver, stage.z.port, stage.z.baud, stage.z.address}};
}

std::shared_ptr<sim::Firmware> make_stage_firmware(const BenchConfig& config, const StagePort& port,
                                                   std::shared_ptr<sim::SimBench> world) {
  return find_firmware(stage_firmwares(), port.driver)(config, port, std::move(world));
}

std::shared_ptr<sim::Firmware> make_accelerometer_firmware(const BenchConfig& config,
                                                           std::shared_ptr<sim::SimBench> world) {
  return find_firmware(accelerometer_firmwares(), config.accelerometer.driver)(config, std::move(world));
}

std::unique_ptr<RotationStage> make_stage(const BenchConfig& config,
                                          const std::shared_ptr<sim::SimBench>& world, Clock& clock) {
  const std::array<AxisMounting, 2> mountings{mounting(config.stage.x), mounting(config.stage.z)};
  if (config.stage.driver == kSimulated) {
    // In-process and without a controller: protocol angles all the way.
    std::array<AxisMounting, 2> limits;
    for (std::size_t k = 0; k < 2; ++k)
      limits[k] = {Angle{}, +1, mountings[k].travel_min, mountings[k].travel_max};
    return std::make_unique<MountedStage>(std::make_unique<sim::SimStage>(world, clock), limits);
  }
  std::vector<std::unique_ptr<RotationStage>> parts;
  for (const StagePort& port : stage_ports(config.stage))
    parts.push_back(make_part(config, port, world, clock));
  std::unique_ptr<RotationStage> stage =
      parts.size() == 1 ? std::move(parts[0])
                        : std::make_unique<SplitStage>(std::move(parts[0]), std::move(parts[1]));
  return std::make_unique<MountedStage>(std::move(stage), mountings);
}

Bench make_bench(const BenchConfig& config) {
  Bench bench;
  const bool accelerometer_simulated = config.accelerometer.port == kSimulated;
  bench.simulated_time = accelerometer_simulated && !any_stage_part_is(config, false);
  if (bench.simulated_time) {
    bench.clock = std::make_unique<sim::SimClock>();
  } else {
    bench.clock = std::make_unique<RealClock>();
  }
  Clock& clock = *bench.clock;
  if (any_stage_part_is(config, true) || accelerometer_simulated) {
    bench.world = std::make_shared<sim::SimBench>(config.simulation, clock.now());
    schedule(config.faults, config.changes, *bench.world);
  } else if (!config.changes.empty()) {
    throw std::invalid_argument(
        "[[change]]: nothing on this bench is simulated, so that nothing would change");
  }

  bench.stage = make_stage(config, bench.world, clock);
  // A real stage turns the simulated world by what its encoder says.
  if (accelerometer_simulated && any_stage_part_is(config, false))
    bench.stage = std::make_unique<sim::FollowedStage>(std::move(bench.stage), bench.world, clock);

  if (config.accelerometer.driver == kSimulated) {
    bench.accelerometer = std::make_unique<sim::SimAccelerometer>(
        bench.world, clock, config.accelerometer.rate_hz,
        config.accelerometer.response_unit.empty() ? "g" : config.accelerometer.response_unit);
  } else {
    const AccelerometerDriver& driver = find_driver(accelerometer_drivers(), config.accelerometer.driver);
    bench.accelerometer = driver.make(
        open_port(config, "accelerometer", config.accelerometer.port, config.accelerometer.baud,
                  driver.serial, clock, [&] { return make_accelerometer_firmware(config, bench.world); }),
        clock, accelerometer_settings(config.accelerometer));
  }
  return bench;
}

}  // namespace abcal
