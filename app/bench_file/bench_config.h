#pragma once

#include <array>
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/chamber_config.h"
#include "app/bench_file/fault_config.h"
#include "drivers/instrument/angle.h"
#include "drivers/instrument/instrument_settings.h"
#include "protocol/plan/run_config.h"
#include "protocol/plan/tolerances.h"
#include "protocol/record/run_record.h"
#include "sim/bench_truth.h"
#include "sim/fault_kinds.h"

namespace abcal {

struct ItemConfig {
  std::string maker, model, serial_number, customer_number, range, filter, firmware, supply;
  // The mounting: what ties u, v, w to the housing, and how the housing is held.
  std::string reference_surface, direction_marks, fasteners, cable;
  std::optional<double> torque_newton_metre;  ///< Torque of the fasteners.

  bool operator==(const ItemConfig&) const = default;
};

struct StageAxisConfig {
  std::string axis;  ///< The controller's name of the axis.
  int sign = +1;     ///< -1: the controller counts against the right-hand rule.
  Angle zero;        ///< Controller angle at the default orientation.
  std::optional<double> travel_min_deg, travel_max_deg;  ///< Limits narrower than the controller's.
  std::optional<double> speed_deg_per_s;                 ///< Absent: as set in the controller.
  /// For the driver `described`: units of the controller in a degree, where the description leaves them open.
  std::optional<double> units_per_degree;
  std::optional<double> wraps_deg;  ///< 360: the controller counts modulo 360 and takes the shorter way.
  // Only if the axis has its own controller; else empty.
  std::string driver, port;
  std::optional<int> baud;
  std::string address;

  bool operator==(const StageAxisConfig&) const = default;
};

/// The driver that is made from a description of the stage.
inline constexpr const char* kDescribed = "described";

/// One controller and its two axes, or one controller for each axis.
struct StageConfig {
  std::string driver, port;
  std::optional<int> baud;  ///< Absent: the driver's usual one.
  std::string address;
  std::string serial_number;  ///< If given, any other controller is refused.
  std::string unit;           ///< Unit of the axes if the controller does not report it: "deg" or empty.
  std::string
      level_file;  ///< Made by `abcal level`; empty: the alignment is known from [stage_uncertainty] only.
  std::string
      record;  ///< Made by `abcal stage learn`; empty: the stage is known from [stage_uncertainty] only.
  /// For the driver `described`: the name of a shipped description, or a file.
  std::string description;
  std::string description_text;  ///< The description itself, as a run keeps it.
  StageAxisConfig x, z;

  bool split() const { return !x.driver.empty() || !z.driver.empty(); }
  /// Whether an axis states the address of its controller.
  bool addressed() const { return !x.address.empty() || !z.address.empty(); }
  /// Whether an axis is turned by the driver `described`.
  bool is_described() const {
    return driver == kDescribed || x.driver == kDescribed || z.driver == kDescribed;
  }
  /// Whether two controllers are in a daisy chain on one port. TCP port 0 stands for any free port, a
  /// different one each time.
  bool chained() const {
    return split() && x.port == z.port && x.port != "simulated" && !x.port.ends_with(":0");
  }

  StageConfig() {
    x.axis = "1";
    z.axis = "2";
  }

  bool operator==(const StageConfig&) const = default;
};

struct AccelerometerConfig {
  std::string driver, port;
  std::optional<int> baud;
  std::string serial_number;
  AccelerometerSettings settings;  ///< Its `unit` is the key response_unit.

  bool operator==(const AccelerometerConfig&) const = default;
};

/// Typed in, or a sensor that prints lines of text.
struct EnvironmentConfig {
  std::optional<double> temperature_degc, humidity_percent, pressure_hpa;
  std::string driver, port;  ///< Empty: no sensor.
  std::optional<int> baud;
  EnvironmentSettings settings;

  bool operator==(const EnvironmentConfig&) const = default;
};

/// [emulator]: models behind `abcal emulate` and simulated ports, and behaviour of their lines.
struct EmulatorConfig {
  std::string line = "real";           ///< Behaviour of pseudo-terminals: "real" or "ideal".
  std::string stage_model;             ///< Empty: the driver's usual one.
  std::string chamber_model;           ///< Empty: the driver's usual one.
  bool chamber_in_fahrenheit = false;  ///< Factory setting of an F4T.

  bool operator==(const EmulatorConfig&) const = default;
};

/// [notify]: recipients of messages on faults and the end of a run. Empty: none.
struct NotifyConfig {
  std::string
      webhook;  ///< http:// or https:// address, or "env:NAME": the environment variable that holds it.
  std::string mail_to, mail_from;
  std::string mail_server;  ///< smtp://HOST[:PORT] or smtps://HOST[:PORT]

  bool anybody() const { return !webhook.empty() || !mail_to.empty(); }

  bool operator==(const NotifyConfig&) const = default;
};

/// One item on the stage and its accelerometer, with every default filled in: [item] and [accelerometer], or
/// one [[item]] of several.
struct BenchItemConfig {
  ItemConfig item;
  ExpectedItem expected;
  AccelerometerConfig accelerometer;
  Tolerances tolerances;  ///< [item_uncertainty], and [stage_uncertainty], which is the same for all items.
  LimitsConfig limits;
  sim::OutputTruth simulation;      ///< As stated in the bench file; item_truth() gives the simulated truth.
  std::string accelerometer_model;  ///< [emulator]; empty: the driver's usual one.
  std::string at_power_on;          ///< [emulator]: "streaming", "silent", or empty: as the maker ships it.
  int serial_port = 1;              ///< [emulator]: the port of a VectorNav that is wired, 1 or 2.
  std::string left_out{};           ///< Not in the file: reason why its port is not opened; empty: none.

  bool operator==(const BenchItemConfig&) const = default;
};
inline constexpr std::size_t kMostItems = 32;

/// `[simulation] draw`: the truth is drawn from the stated sizes.
inline constexpr const char* kDrawStated = "stated";

/// A bench file (schema abcal.bench/2; abcal.bench/1 is read), with every default filled in.
struct BenchConfig {
  std::string schema = "abcal.bench/2";
  std::string name;
  LocalGravity g_loc;
  std::optional<double> latitude_deg, height_m;
  std::string operator_name;
  StageConfig stage;
  EnvironmentConfig environment;
  ChamberConfig chamber;
  TemperatureConfig temperature;
  ProtocolConfig protocol;
  NotifyConfig notify;
  sim::StageTruth simulation;
  /// kDrawStated: values of `simulation` and of the items' that the file does not give are drawn
  /// (stated_truth.h); empty: they are the defaults.
  std::string draw;
  sim::LinkTiming link;  ///< Timing of the simulated instruments' links.
  EmulatorConfig emulator;
  std::vector<FaultConfig> faults;
  std::vector<ChangeConfig> changes;
  std::vector<BenchItemConfig> items = std::vector<BenchItemConfig>(1);  ///< One or more.

  std::vector<std::string> warnings;  ///< Accepted, but unusual.

  /// The item of a number, counted from 1. @throws std::out_of_range
  const BenchItemConfig& item(int k) const { return items.at(static_cast<std::size_t>(k) - 1); }
  BenchItemConfig& item(int k) { return items.at(static_cast<std::size_t>(k) - 1); }
  bool has_several_items() const { return items.size() > 1; }
  /// Runs of several items and series over temperature are measured in one face.
  bool allows_two_faces() const { return !has_several_items() && temperature.set_points_degc.empty(); }

  /// A stage that is turned by hand has no rate, and series over temperature are measured in steps.
  bool allows_constant_rate() const { return !turned_by_hand() && temperature.set_points_degc.empty(); }
  /// The stage has no port: a person turns it.
  bool turned_by_hand() const;

  bool operator==(const BenchConfig&) const = default;
  /// Equal but for the warnings of the file that was read.
  bool is_same_bench(BenchConfig other) const { return other.warnings = warnings, *this == other; }
};

/// "item 3, ", the beginning of a message about an item. Empty if the bench has one item only.
std::string item_words(const BenchConfig& config, int item);

/// The name of an item's accelerometer in faults, run files and recordings: "item-3"; "accelerometer" where
/// the bench has one item only.
std::string accelerometer_name(const BenchConfig& config, int item);

/// Turns a truth stated for an item to the axes of the platter. That of a single item is along them already;
/// that of each of several items is along its own axes and is turned by its mounting.
sim::OutputTruth truth_on_platter(const BenchConfig& config, int item, sim::OutputTruth stated);

/// The simulated truth of an item along the axes of the platter, and the seed of its noise.
sim::ItemTruth item_truth(const BenchConfig& config, int item);

/// A bench file that cannot be used, with all its problems and their lines.
class BenchError : public std::runtime_error {
 public:
  BenchError(const std::string& file, std::vector<Problem> problems);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// Reads a bench file. @throws BenchError
BenchConfig read_bench(const std::filesystem::path& path);

/// As above, from text; `source` names it in messages.
BenchConfig parse_bench(std::string_view toml, const std::string& source);
/// As parse_bench(), with `[simulation] draw = "stated"` and this seed, regardless of the text.
BenchConfig parse_drawn_bench(std::string_view toml, const std::string& source, std::uint64_t seed);

/// A fault or change as `abcal emulate --control` accepts it: a JSON object with the keys of [[fault]] or
/// [[change]]. Quantities that a change does not name keep their values in `now`. at_s counts from the start
/// of the world.
/// @throws BenchError
FaultConfig parse_fault(const nlohmann::json& json);
ChangeConfig parse_change(const nlohmann::json& json, const sim::OutputTruth& now);

/// The bench file with every default written out, so that a stored run keeps its meaning when a default
/// changes. parse_bench() reads it back to the same configuration.
std::string write_bench(const BenchConfig& config);

}  // namespace abcal
