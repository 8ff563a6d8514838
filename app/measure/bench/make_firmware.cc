#include "app/measure/bench/make_firmware.h"

#include <array>
#include <map>
#include <mutex>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "app/bench_file/stage_description_file.h"
#include "app/measure/bench/fault_schedule.h"
#include "drivers/registry.h"
#include "sim/firmware/described_firmware.h"
#include "sim/firmware/iio_firmware.h"
#include "sim/firmware/mavlink_firmware.h"
#include "sim/firmware/mip_firmware.h"
#include "sim/firmware/newport_esp_firmware.h"
#include "sim/firmware/newport_xps_firmware.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/firmware/scpi_voltmeter_firmware.h"
#include "sim/firmware/text_line_firmware.h"
#include "sim/firmware/thorlabs_apt_firmware.h"
#include "sim/firmware/vectornav_firmware.h"
#include "sim/firmware/watlow_f4_firmware.h"
#include "sim/firmware/weiss_firmware.h"
#include "sim/firmware/witmotion_firmware.h"
#include "sim/firmware/xsens_mti_firmware.h"
#include "sim/firmware/zaber_ascii_firmware.h"

namespace abcal {
namespace {

/// The speed of the line as the bench file has it, else as the driver sets it.
std::optional<unsigned> line_baud(const InstrumentPort& port) {
  if (port.baud) return static_cast<unsigned>(*port.baud);
  const auto of = [&](const auto& drivers) -> std::optional<unsigned> {
    for (const auto& driver : drivers)
      if (driver.name == port.driver) return driver.serial.baud;
    return std::nullopt;
  };
  auto found = of(stage_drivers());
  if (!found) found = of(described_stage_drivers());
  if (!found) found = of(accelerometer_drivers());
  return found ? found : of(chamber_drivers());
}

/// Settings that every stage's firmware has: axis names, signs and zeros, serial number.
template <class Settings>
Settings stage_firmware_settings(const StageConfig& stage, const InstrumentPort& port) {
  Settings settings;
  settings.axis_names = port.axis_names(stage);
  settings.sign = {stage.x.sign, stage.z.sign};
  settings.zero = {stage.x.zero, stage.z.zero};
  if (!stage.serial_number.empty()) settings.serial_number = stage.serial_number;
  // The driver gives the serial numbers of two devices on one line as "12345/67890".
  if constexpr (requires { settings.z_serial_number; }) {
    if (const auto slash = settings.serial_number.find('/'); slash != std::string::npos) {
      settings.z_serial_number = settings.serial_number.substr(slash + 1);
      settings.serial_number.resize(slash);
    }
  }
  if constexpr (requires { settings.baud; }) {  // A network or native USB link has none.
    if (const auto baud = line_baud(port)) settings.baud = *baud;
  }
  return settings;
}

/// A model that a driver's firmware can represent, and its changes to the settings.
template <class Settings>
struct ModelProfile {
  std::string_view name;
  void (*apply)(Settings&);
};

/// Applies the changes of `model` to the settings; empty: none.
/// @throws std::invalid_argument for an unknown model
template <class Settings, std::size_t kCount>
void apply_model(Settings& settings, const std::string& model, std::string_view key,
                 const std::array<ModelProfile<Settings>, kCount>& profiles) {
  if (model.empty()) return;
  std::string known;
  for (const ModelProfile<Settings>& profile : profiles) {
    if (profile.name == model) return profile.apply(settings);
    known += (known.empty() ? "" : ", ") + std::string(profile.name);
  }
  throw std::invalid_argument("[emulator] " + std::string(key) + " is \"" + model + "\"; required: one of " +
                              known + ", or nothing");
}

std::shared_ptr<sim::Firmware> pi_gcs_firmware(const BenchConfig& config, const InstrumentPort& port,
                                               std::shared_ptr<sim::SimBench> world) {
  auto settings = stage_firmware_settings<sim::PiGcsSettings>(config.stage, port);
  if (!port.address.empty()) settings.address = std::stoi(port.address);
  using Profile = ModelProfile<sim::PiGcsSettings>;
  // Further differences between the commands of these models are [unverified against a device].
  static const std::array kModels{Profile{"C-884", [](sim::PiGcsSettings&) {}},
                                  Profile{"C-863",
                                          [](sim::PiGcsSettings& s) {
                                            s.model = "C-863.12";
                                            s.has_enable = false;
                                          }},
                                  Profile{"E-861", [](sim::PiGcsSettings& s) {
                                            s.model = "E-861";
                                            s.firmware_version = "7.2.0";
                                            s.has_enable = s.has_unit_query = false;
                                            s.short_identity = true;
                                          }}};
  apply_model(settings, config.emulator.stage_model, "stage_model", kModels);
  return std::make_shared<sim::PiGcsFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> mip_firmware(const BenchConfig& config, const InstrumentPort& port,
                                            std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::MipSettings settings;
  if (!item.accelerometer.serial_number.empty()) settings.serial_number = item.accelerometer.serial_number;
  if (item.accelerometer.baud) settings.baud = static_cast<unsigned>(*item.accelerometer.baud);
  using Profile = ModelProfile<sim::MipSettings>;
  static const std::array kModels{Profile{"3DM-GX5-AHRS",
                                          [](sim::MipSettings& s) {
                                            s.model_name = "3DM-GX5-AHRS";
                                            s.modern_commands = false;
                                          }},
                                  Profile{"3DM-CV7-AHRS",
                                          [](sim::MipSettings& s) {
                                            s.model_name = "3DM-CV7-AHRS";
                                            s.legacy_commands = false;
                                          }},
                                  Profile{"3DM-GV7-AR", [](sim::MipSettings& s) {
                                            s.model_name = "3DM-GV7-AR";
                                            s.magnetometer = false;
                                            s.legacy_commands = false;
                                          }}};
  apply_model(settings, item.accelerometer_model, "accelerometer_model", kModels);
  settings.streaming_at_power_on = item.at_power_on == "streaming";
  return std::make_shared<sim::MipFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> mavlink_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::MavlinkSettings settings;
  const std::string& serial_number = item.accelerometer.serial_number;
  if (!serial_number.empty()) settings.serial_number = serial_number;
  using Profile = ModelProfile<sim::MavlinkSettings>;
  static const std::array kModels{Profile{"PX4", [](sim::MavlinkSettings&) {}},
                                  Profile{"ArduPilot", [](sim::MavlinkSettings& s) { s.autopilot = 3; }},
                                  Profile{"SCALED_IMU", [](sim::MavlinkSettings& s) {
                                            s.version = 1;
                                            s.has_highres = false;
                                          }}};
  apply_model(settings, item.accelerometer_model, "accelerometer_model", kModels);
  return std::make_shared<sim::MavlinkFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> newport_esp_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                    std::shared_ptr<sim::SimBench> world) {
  auto settings = stage_firmware_settings<sim::NewportEspSettings>(config.stage, port);
  using Profile = ModelProfile<sim::NewportEspSettings>;
  static const std::array kModels{
      Profile{"ESP301", [](sim::NewportEspSettings&) {}},
      Profile{"ESP300", [](sim::NewportEspSettings& s) { s.version = "ESP300 Version 3.04 07/27/01"; }}};
  apply_model(settings, config.emulator.stage_model, "stage_model", kModels);
  return std::make_shared<sim::NewportEspFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> vectornav_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                  std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::VectorNavSettings settings;
  if (!item.accelerometer.serial_number.empty()) settings.serial_number = item.accelerometer.serial_number;
  if (item.accelerometer.baud) settings.baud = static_cast<unsigned>(*item.accelerometer.baud);
  using Profile = ModelProfile<sim::VectorNavSettings>;
  static const std::array kModels{
      Profile{"VN-100", [](sim::VectorNavSettings&) {}},
      Profile{"VN-200", [](sim::VectorNavSettings& s) { s.model = "VN-200T-CR"; }}};
  apply_model(settings, item.accelerometer_model, "accelerometer_model", kModels);
  if (item.at_power_on == "silent") settings.async_type = 0;
  settings.serial_port = static_cast<unsigned>(item.serial_port);
  return std::make_shared<sim::VectorNavFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> text_line_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                  std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  const AccelerometerSettings& stated = item.accelerometer.settings;
  sim::TextLineSettings settings;
  settings.rate_hz = stated.rate_hz;
  settings.separator = stated.separator;
  settings.names = stated.names;
  settings.number_unit = stated.number_unit;
  settings.decimal_mark = stated.decimal_mark;
  if (port.baud) settings.baud = static_cast<unsigned>(*port.baud);
  settings.scale = stated.scale;
  settings.bias = stated.bias;
  return std::make_shared<sim::TextLineFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> witmotion_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                  std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::WitMotionSettings settings;
  settings.baud = line_baud(port).value_or(settings.baud);
  constexpr unsigned kNoOutput = 0x0D;
  if (item.at_power_on == "silent") settings.rate_code = kNoOutput;
  return std::make_shared<sim::WitMotionFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> scpi_voltmeter_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                       std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::ScpiVoltmeterSettings settings;
  if (!item.accelerometer_model.empty()) settings = sim::scpi_model(item.accelerometer_model);
  if (!item.accelerometer.serial_number.empty()) settings.serial_number = item.accelerometer.serial_number;
  settings.baud = line_baud(port).value_or(settings.baud);
  return std::make_shared<sim::ScpiVoltmeterFirmware>(std::move(world), settings);
}

/// Three voltmeters of one channel each.
std::shared_ptr<sim::Firmware> scpi_single_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                    std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::ScpiVoltmeterSettings settings;
  settings.family = sim::ScpiFamily::kKeysight34401a;
  if (!item.accelerometer_model.empty()) settings = sim::scpi_model(item.accelerometer_model);
  settings.single_channel = port.part;
  settings.baud = line_baud(port).value_or(settings.baud);
  settings.serial_number += "uvw"[port.part];
  return std::make_shared<sim::ScpiVoltmeterFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> environment_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                    std::shared_ptr<sim::SimBench> world) {
  sim::TextLineSettings settings;
  settings.content = sim::TextLineSettings::Content::kEnvironment;
  settings.rate_hz = 1.0;
  settings.separator = config.environment.settings.separator;
  if (port.baud) settings.baud = static_cast<unsigned>(*port.baud);
  return std::make_shared<sim::TextLineFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> xsens_mti_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                  std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::XsensMtiSettings settings;
  if (!item.accelerometer.serial_number.empty()) settings.device_id = item.accelerometer.serial_number;
  if (item.accelerometer.baud) settings.baud = static_cast<unsigned>(*item.accelerometer.baud);
  using Profile = ModelProfile<sim::XsensMtiSettings>;
  static const std::array kModels{
      Profile{"MTi-3", [](sim::XsensMtiSettings& s) { s.product_code = "MTi-3-8A7G6"; }},
      Profile{"MTi-30", [](sim::XsensMtiSettings&) {}},
      Profile{"MTi-300", [](sim::XsensMtiSettings& s) { s.product_code = "MTi-300-2A8G4"; }},
      Profile{"MTi-680", [](sim::XsensMtiSettings& s) { s.product_code = "MTi-680-8A1G6"; }}};
  apply_model(settings, item.accelerometer_model, "accelerometer_model", kModels);
  return std::make_shared<sim::XsensMtiFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> zaber_ascii_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                    std::shared_ptr<sim::SimBench> world) {
  auto settings = stage_firmware_settings<sim::ZaberAsciiSettings>(config.stage, port);
  if (!port.address.empty()) settings.address = std::stoi(port.address);
  using Profile = ModelProfile<sim::ZaberAsciiSettings>;
  static const std::array kModels{Profile{"X-MCC2", [](sim::ZaberAsciiSettings&) {}},
                                  Profile{"A-MCB2", [](sim::ZaberAsciiSettings& s) { s.version = "6.28"; }}};
  apply_model(settings, config.emulator.stage_model, "stage_model", kModels);
  return std::make_shared<sim::ZaberAsciiFirmware>(std::move(world), settings);
}

/// A connection to a controller: the first one creates the controller, further ones belong to the controller
/// created last in this world.
std::shared_ptr<sim::Firmware> newport_xps_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                    std::shared_ptr<sim::SimBench> world) {
  static std::mutex mutex;
  static std::map<std::weak_ptr<sim::SimBench>, std::weak_ptr<sim::Firmware>, std::owner_less<>> first_ones;
  const std::lock_guard lock(mutex);
  std::erase_if(first_ones,
                [](const auto& entry) { return entry.first.expired() || entry.second.expired(); });
  if (port.connection > 0) {
    const auto found = first_ones.find(world);
    const auto first = found == first_ones.end() ? nullptr : found->second.lock();
    if (!first) throw std::invalid_argument("newport_xps: the first connection to its controller is gone");
    return first->another_session();
  }
  auto settings = stage_firmware_settings<sim::NewportXpsSettings>(config.stage, port);
  using Profile = ModelProfile<sim::NewportXpsSettings>;
  static const std::array kModels{
      Profile{"XPS-C8", [](sim::NewportXpsSettings&) {}},
      Profile{"XPS-D", [](sim::NewportXpsSettings& s) { s.version = "XPS-D-N13006"; }}};
  apply_model(settings, config.emulator.stage_model, "stage_model", kModels);
  auto first = std::make_shared<sim::NewportXpsFirmware>(world, settings);
  first_ones[world] = first;
  return first;
}

std::shared_ptr<sim::Firmware> thorlabs_apt_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                     std::shared_ptr<sim::SimBench> world) {
  auto settings = stage_firmware_settings<sim::ThorlabsAptSettings>(config.stage, port);
  const auto stepper = [](sim::ThorlabsAptSettings& s) {
    s.velocity_per_count_s = 53.68;
    s.servo = false;
  };
  const bool one_axis = settings.axis_names[0].empty() || settings.axis_names[1].empty();
  std::string model = config.emulator.stage_model;
  if (model.empty()) model = "BBD202";
  if (model == "K10CR1") {
    stepper(settings);
    settings.model = model;
    settings.counts_per_degree = 409600.0 / 3.0;
    if (!one_axis)
      throw std::invalid_argument(
          "[emulator] stage_model = \"K10CR1\": it has one axis; required: [stage.x] and [stage.z] with a "
          "port each");
  } else if (model == "BSC202") {
    stepper(settings);
    settings.model = model;
    settings.stage = "HDR50";
    settings.counts_per_degree = 75091.0 / 0.99997;
  } else if (model != "BBD202") {
    throw std::invalid_argument("[emulator] stage_model is \"" + model +
                                "\"; required: one of BBD202, BSC202, K10CR1, or nothing");
  }
  return std::make_shared<sim::ThorlabsAptFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> iio_firmware(const BenchConfig& config, const InstrumentPort& port,
                                            std::shared_ptr<sim::SimBench> world) {
  const BenchItemConfig& item = config.item(port.item);
  sim::IioSettings settings;
  const std::string& serial_number = item.accelerometer.serial_number;
  if (!serial_number.empty()) settings.serial_number = serial_number;
  return std::make_shared<sim::IioFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> watlow_f4_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                  std::shared_ptr<sim::SimBench> world) {
  sim::WatlowF4Settings settings;
  settings.f4t = config.chamber.settings.model != "F4";
  settings.second_loop = config.emulator.chamber_model == "F4D";
  settings.tcp = has_tcp_frames(port.port);
  settings.address = config.chamber.settings.address;
  settings.fahrenheit = config.emulator.chamber_in_fahrenheit;
  settings.run_output = config.chamber.settings.run_output;
  settings.pause_output = config.chamber.settings.pause_output;
  settings.baud = line_baud(port).value_or(settings.baud);
  return std::make_shared<sim::WatlowF4Firmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> weiss_firmware(const BenchConfig& config, const InstrumentPort&,
                                              std::shared_ptr<sim::SimBench> world) {
  sim::WeissSettings settings;
  settings.simserv = config.chamber.settings.model != "ascii2";
  settings.address = config.chamber.settings.address;
  settings.pause_output = config.chamber.settings.pause_output;
  if (!config.chamber.settings.serial_number.empty())
    settings.serial_number = config.chamber.settings.serial_number;
  return std::make_shared<sim::WeissFirmware>(std::move(world), settings);
}

std::shared_ptr<sim::Firmware> described_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                  std::shared_ptr<sim::SimBench> world);

using MakeFirmware = std::shared_ptr<sim::Firmware> (*)(const BenchConfig&, const InstrumentPort&,
                                                        std::shared_ptr<sim::SimBench>);

/// Driver name -> the simulated instrument that it talks to.
const std::map<std::string, MakeFirmware>& firmwares() {
  static const std::map<std::string, MakeFirmware> all{{"described", described_firmware},
                                                       {"iio", iio_firmware},
                                                       {"mavlink", mavlink_firmware},
                                                       {"microstrain_mip", mip_firmware},
                                                       {"newport_esp", newport_esp_firmware},
                                                       {"newport_xps", newport_xps_firmware},
                                                       {"pi_gcs", pi_gcs_firmware},
                                                       {"scpi_single", scpi_single_firmware},
                                                       {"scpi_voltmeter", scpi_voltmeter_firmware},
                                                       {"text_line", text_line_firmware},
                                                       {"thorlabs_apt", thorlabs_apt_firmware},
                                                       {"vectornav", vectornav_firmware},
                                                       {"watlow_f4", watlow_f4_firmware},
                                                       {"weiss_simserv", weiss_firmware},
                                                       {"witmotion", witmotion_firmware},
                                                       {"xsens_mti", xsens_mti_firmware},
                                                       {"zaber_ascii", zaber_ascii_firmware}};
  return all;
}

/// The simulated instrument that the description names, or else one that is made of the description.
std::shared_ptr<sim::Firmware> described_firmware(const BenchConfig& config, const InstrumentPort& port,
                                                  std::shared_ptr<sim::SimBench> world) {
  auto description = std::make_shared<const StageDescription>(stage_description_of(config.stage));
  if (const auto own = firmwares().find(description->emulator_firmware); own != firmwares().end()) {
    InstrumentPort same = port;
    same.driver = description->emulator_firmware;
    return own->second(config, same, std::move(world));
  }
  auto settings = stage_firmware_settings<sim::DescribedSettings>(config.stage, port);
  settings.address = port.address;
  settings.units_per_degree = {config.stage.x.units_per_degree, config.stage.z.units_per_degree};
  return std::make_shared<sim::DescribedFirmware>(std::move(world), std::move(description), settings);
}

}  // namespace

namespace {

/// Schedules the faults and changes of an item, and all faults of the stage, in its world.
void schedule(const BenchConfig& config, int item, sim::SimBench& world) {
  for (const FaultConfig& fault : config.faults) {
    if (item_of_instrument(fault.instrument).value_or(item) != item) continue;
    if (const auto of_the_world = world_fault(fault, world.start())) world.inject(*of_the_world);
  }
  for (const ChangeConfig& change : config.changes) {
    if (change.item != item) continue;
    world.change(truth_on_platter(config, item, change.truth), world.start() + from_seconds(change.at_s));
  }
}

}  // namespace

SimWorlds make_worlds(const BenchConfig& config, Clock::Instant start) {
  SimWorlds worlds;
  for (int item = 1; item <= static_cast<int>(config.items.size()); ++item) {
    const sim::ItemTruth truth = item_truth(config, item);
    worlds.push_back(worlds.empty() ? std::make_shared<sim::SimBench>(truth, config.simulation, start)
                                    : worlds.front()->add_item(truth));
    schedule(config, item, *worlds.back());
  }
  return worlds;
}

std::shared_ptr<sim::SimBench> world_of(const SimWorlds& worlds, int item) {
  return worlds.empty() ? nullptr : worlds.at(static_cast<std::size_t>(item) - 1);
}

std::shared_ptr<sim::Firmware> make_firmware(const BenchConfig& config, const InstrumentPort& port,
                                             std::shared_ptr<sim::SimBench> world) {
  if (port.name == "environment") return environment_firmware(config, port, std::move(world));
  const auto found = firmwares().find(port.driver);
  if (found == firmwares().end()) {
    throw std::invalid_argument("driver \"" + port.driver +
                                "\" has no simulated firmware; required: a real port, or another driver");
  }
  return found->second(config, port, std::move(world));
}

}  // namespace abcal
