#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench/chamber_config.h"
#include "app/bench/fault_schedule.h"
#include "drivers/instrument/angle.h"
#include "drivers/instrument/instrument_settings.h"
#include "protocol/plan/run_config.h"
#include "protocol/plan/tolerances.h"
#include "protocol/record/run_record.h"
#include "sim/bench_truth.h"

namespace abcal {

struct ItemConfig {
  std::string maker, model, serial_number, customer_number, range, filter, firmware, supply;
};

struct StageAxisConfig {
  std::string axis;  ///< The controller's name of the axis.
  int sign = +1;     ///< -1: the controller counts against the right-hand rule.
  Angle zero;        ///< Controller angle at the default orientation.
  std::optional<double> travel_min_deg, travel_max_deg;  ///< Narrower than the controller's own.
  std::optional<double> speed_deg_per_s;                 ///< Absent: as the controller has it.
  // Where the axis has a controller of its own; else empty.
  std::string driver, port;
  std::optional<int> baud;
  std::string address;
};

/// One controller and its two axes, or one controller for each axis.
struct StageConfig {
  std::string driver, port;
  std::optional<int> baud;  ///< Absent: the driver's usual one.
  std::string address;
  std::string serial_number;  ///< If given, any other controller is refused.
  std::string unit;           ///< Of the axes, where the controller does not tell it: "deg" or nothing.
  std::string
      level_file;  ///< Made by `abcal level`; empty: the alignment is known from [stage_uncertainty] only.
  StageAxisConfig x, z;

  bool split() const { return !x.driver.empty() || !z.driver.empty(); }
  /// An axis states the address of its controller.
  bool addressed() const { return !x.address.empty() || !z.address.empty(); }
  /// Of two controllers: in a daisy chain, both on one port. TCP port 0, any free one, is another one each
  /// time.
  bool chained() const {
    return split() && x.port == z.port && x.port != "simulated" && !x.port.ends_with(":0");
  }

  StageConfig() {
    x.axis = "1";
    z.axis = "2";
  }
};

struct AccelerometerConfig {
  std::string driver, port;
  std::optional<int> baud;
  double rate_hz = 100.0;
  std::string
      response_unit;  ///< Empty: that of the instrument; otherwise the instrument must report the same.
  std::optional<double> full_scale;
  std::string serial_number;
  // As in AccelerometerSettings: voltmeters and boards that print lines of text.
  Eigen::Vector3d scale = Eigen::Vector3d::Ones(), bias = Eigen::Vector3d::Zero();
  std::array<int, 3> channels = AccelerometerSettings{}.channels;
  double range_v = AccelerometerSettings{}.range_v;
  double integration_plc = AccelerometerSettings{}.integration_plc;
  std::array<int, 3> columns = AccelerometerSettings{}.columns;
  std::string separator = AccelerometerSettings{}.separator;
  std::string comment = AccelerometerSettings{}.comment;
  std::string names, number_unit;
  std::string decimal_mark = AccelerometerSettings{}.decimal_mark;
};

/// Typed in, or a sensor that prints lines of text.
struct EnvironmentConfig {
  std::optional<double> temperature_degc, humidity_percent, pressure_hpa;
  std::string driver, port;  ///< Empty: no sensor.
  std::optional<int> baud;
  int temperature_column = EnvironmentSettings{}.temperature_column;
  int humidity_column = EnvironmentSettings{}.humidity_column;
  int pressure_column = EnvironmentSettings{}.pressure_column;
  std::string separator = EnvironmentSettings{}.separator;
  std::string comment = EnvironmentSettings{}.comment;
};

/// [emulator]: which instruments `abcal emulate` and simulated ports show, and how their lines behave.
struct EmulatorConfig {
  std::string line = "real";           ///< Of pseudo-terminals: "real" or "ideal".
  std::string stage_model;             ///< Empty: the usual one of the driver.
  std::string accelerometer_model;     ///< Empty: the usual one of the driver.
  bool chamber_in_fahrenheit = false;  ///< As an F4T leaves the factory.
  std::string at_power_on;  ///< Of the accelerometer: "streaming", "silent", or empty: as its maker ships it.
};

/// [notify]: who is told of faults and the end of a run. Empty: nobody.
struct NotifyConfig {
  std::string
      webhook;  ///< http:// or https:// address, or "env:NAME": it stands in that environment variable.
  std::string mail_to, mail_from;
  std::string mail_server;  ///< smtp://HOST[:PORT] or smtps://HOST[:PORT]

  bool anybody() const { return !webhook.empty() || !mail_to.empty(); }
};

/// One [[item]] of several on the stage, with every default filled in.
struct TrayItem {
  ItemConfig item;
  ExpectedItem expected;
  AccelerometerConfig accelerometer;
  Tolerances tolerances;  ///< [item.item_uncertainty]; of the stage as for all.
  LimitsConfig limits;
  sim::OutputTruth simulation;      ///< Along the item's own axes.
  std::string accelerometer_model;  ///< As in EmulatorConfig.
  std::string at_power_on;          ///< As in EmulatorConfig.
  std::string left_out{};           ///< Not in the file: why its port is not opened; empty: it is opened.
};
inline constexpr std::size_t kMostItems = 32;

/// A bench file (schema abcal.bench/2; abcal.bench/1 is read), with every default filled in.
struct BenchConfig {
  std::string schema = "abcal.bench/2";
  std::string name;
  LocalGravity g_loc;
  std::optional<double> latitude_deg, height_m;
  ItemConfig item;
  ExpectedItem expected;  ///< In [item], too.
  std::string operator_name;
  StageConfig stage;
  AccelerometerConfig accelerometer;
  EnvironmentConfig environment;
  ChamberConfig chamber;
  TemperatureConfig temperature;
  ProtocolConfig protocol;
  Tolerances tolerances;  ///< [stage_uncertainty] and [item_uncertainty].
  LimitsConfig limits;
  NotifyConfig notify;
  sim::BenchTruth simulation;
  sim::LinkTiming link;  ///< Of the simulated instruments.
  EmulatorConfig emulator;
  std::vector<FaultConfig> faults;
  std::vector<ChangeConfig> changes;
  /// [[item]]: all items of several; `item`, `expected` and `accelerometer` are those of the first then.
  /// Empty: there is one.
  std::vector<TrayItem> tray;

  std::vector<std::string> warnings;  ///< Warnings: accepted, but unusual.
};

/// The bench as it is for one item of several (counted from 1), as if it were alone. Its simulated
/// accelerometer is turned by its mounting.
BenchConfig for_item(const BenchConfig& config, int item);

/// A bench file that cannot be used: every problem of it, with its line.
class BenchError : public std::runtime_error {
 public:
  BenchError(const std::string& file, std::vector<Problem> problems);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// Reads a bench file. @throws BenchError
BenchConfig read_bench(const std::filesystem::path& path);

/// The same from text; `source` names it in messages.
BenchConfig parse_bench(std::string_view toml, const std::string& source);

/// A fault or change as `abcal emulate --control` takes it, from one line of JSON with the keys of [[fault]]
/// or [[change]]; what a change does not name stays as it is in `now`. at_s counts from the start of the
/// world.
/// @throws BenchError
FaultConfig parse_fault(const std::string& json);
ChangeConfig parse_change(const std::string& json, const sim::OutputTruth& now);

/// The bench file with every default written out, so that a stored run keeps its meaning when a default
/// changes. parse_bench() reads it back to the same configuration.
std::string write_bench(const BenchConfig& config);

}  // namespace abcal
