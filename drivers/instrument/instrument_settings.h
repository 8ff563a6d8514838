#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

namespace abcal {

struct StageDescription;

/// Settings of a stage in a bench file, as far as a driver needs them.
struct StageSettings {
  std::array<std::string, 2> axis_names{"1", "2"};       ///< The controller's names of X and Z.
  std::array<std::optional<double>, 2> speed_deg_per_s;  ///< Absent: the controller's own setting.
  /// Units of the controller in a degree, where its description leaves them to the bench file.
  std::array<std::optional<double>, 2> units_per_degree{};
  std::string address;  ///< Address of a controller in a daisy chain; empty: none.
  std::string unit{};   ///< Unit of the axes if the controller does not report it: "deg"; empty: not known.
  std::shared_ptr<const StageDescription>
      description{};  ///< For the driver `described`; null for all others.
};

/// Settings of an accelerometer in a bench file, as far as a driver needs them. Each driver reads only those
/// that concern it.
struct AccelerometerSettings {
  double rate_hz = 100.0;
  std::optional<double> full_scale;          ///< In the output unit, if the instrument does not report it.
  std::optional<double> link_bytes_per_s{};  ///< Capacity of the link, where known (a UART: baud / 10).

  // Analog accelerometers behind voltmeters, and boards that print lines of text: an output is
  // (value - bias) / scale, value being volts or the number of the line.
  std::array<double, 3> scale{1.0, 1.0, 1.0};
  std::array<double, 3> bias{0.0, 0.0, 0.0};
  /// Unit of the output after scaling. Empty: "V" of a voltmeter, "R" of a line of text, otherwise that of
  /// the instrument; if it is stated, the instrument must report the same.
  std::string unit{};

  std::array<int, 3> channels{101, 102, 103};  ///< Voltmeter: where u, v, w are wired.
  double range_v = 10.0;                       ///< Voltmeter: fixed measuring range in volts.
  double integration_plc = 1.0;  ///< Voltmeter: integration time of a channel in power line cycles.

  std::array<int, 3> columns{1, 2, 3};  ///< Line of text: u, v, w; the first column is 1.
  std::string separator{","};           ///< Line of text; " ": any run of blanks and tabs.
  std::string comment{"#"};             ///< Line of text: a line that begins so is skipped; empty: none.
  std::string names;                    ///< Line of text: names of u, v, w in place of columns, "ax ay az".
  std::string number_unit;              ///< Line of text: unit that may directly follow a number, "g".
  std::string decimal_mark{"."};        ///< Line of text: or ",".

  bool operator==(const AccelerometerSettings&) const = default;
};

/// Settings in a bench file of a thermometer, hygrometer or barometer that prints lines of text.
struct EnvironmentSettings {
  int temperature_column = 1;  ///< degC; the first column is 1; 0: absent.
  int humidity_column = 0;     ///< Relative humidity in percent; 0: absent.
  int pressure_column = 0;     ///< hPa; 0: absent.
  std::string separator{","};  ///< " ": any run of blanks and tabs.
  std::string comment{"#"};    ///< A line that begins so is skipped; empty: none.

  bool operator==(const EnvironmentSettings&) const = default;
};

}  // namespace abcal
