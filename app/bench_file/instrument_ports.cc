#include "app/bench_file/instrument_ports.h"

#include <sstream>
#include <utility>

#include "drivers/instrument/driver_catalogue.h"
#include "drivers/text/text.h"

namespace abcal {
namespace {

/// Whether a driver exchanges bytes with its instrument.
bool has_bytes(const std::vector<CataloguedDriver>& drivers, const std::string& driver) {
  return !driver.empty() && driver != kSimulated && find_in(drivers, driver).has_port;
}

}  // namespace

std::array<std::string, 2> InstrumentPort::axis_names(const StageConfig& stage) const {
  std::array<std::string, 2> names{stage.x.axis, stage.z.axis};
  if (stage.chained() || !stage.split()) {
    if (!stage.x.address.empty()) names[0] = stage.x.address + " " + names[0];
    if (!stage.z.address.empty()) names[1] = stage.z.address + " " + names[1];
  }
  if (axis) names[1 - index(*axis)].clear();
  return names;
}

std::vector<InstrumentPort> stage_ports(const StageConfig& stage) {
  if (stage.chained()) return {{"stage", stage.x.driver, stage.x.port, stage.x.baud}};
  if (stage.split()) {
    return {{"stage-x", stage.x.driver, stage.x.port, stage.x.baud, stage.x.address, 0, 0, StageAxis::kX},
            {"stage-z", stage.z.driver, stage.z.port, stage.z.baud, stage.z.address, 1, 0, StageAxis::kZ}};
  }
  if (!has_bytes(driver_catalogue().stages, stage.driver)) return {};
  return {{"stage", stage.driver, stage.port, stage.baud, stage.address}};
}

std::vector<InstrumentPort> connections_of(const InstrumentPort& port, std::size_t count) {
  std::vector<InstrumentPort> all{port};
  while (all.size() < count) {
    all.push_back(port);
    all.back().connection = all.size() - 1;
    all.back().name += "-" + std::to_string(all.size());
  }
  return all;
}

std::vector<InstrumentPort> accelerometer_ports(const BenchConfig& config, int item) {
  const AccelerometerConfig& accelerometer = config.item(item).accelerometer;
  const std::vector<CataloguedDriver> drivers = driver_catalogue().accelerometers;
  if (!has_bytes(drivers, accelerometer.driver)) return {};
  InstrumentPort port{accelerometer_name(config, item), accelerometer.driver, accelerometer.port,
                      accelerometer.baud};
  port.item = item;
  const std::size_t count = find_in(drivers, accelerometer.driver).ports;
  if (count <= 1) return {port};
  std::vector<InstrumentPort> ports(count, port);
  std::istringstream words(accelerometer.port);
  for (std::size_t j = 0; j < count; ++j) {
    // A word that is missing repeats the one before: "simulated" stands for all.
    if (std::string word; words >> word) port.port = word;
    ports[j].port = port.port;
    ports[j].part = j;
    ports[j].name += std::string("-") + "uvw"[j];
  }
  return ports;
}

std::vector<InstrumentPort> all_accelerometer_ports(const BenchConfig& config) {
  std::vector<InstrumentPort> ports;
  for (int item = 1; item <= static_cast<int>(config.items.size()); ++item) {
    if (!config.item(item).left_out.empty()) continue;
    for (InstrumentPort& port : accelerometer_ports(config, item)) ports.push_back(std::move(port));
  }
  return ports;
}

std::vector<InstrumentPort> environment_ports(const EnvironmentConfig& environment) {
  if (environment.driver.empty()) return {};
  return {{"environment", environment.driver, environment.port, environment.baud}};
}

std::vector<InstrumentPort> chamber_ports(const ChamberConfig& chamber) {
  if (!has_bytes(driver_catalogue().chambers, chamber.driver)) return {};
  return {{"chamber", chamber.driver, chamber.port, chamber.baud}};
}

bool has_tcp_frames(const std::string& port) {
  return port.starts_with("tcp:") || pieces::lower(port).starts_with("tcpip");
}

}  // namespace abcal
