#pragma once

#include <array>
#include <optional>
#include <string>

namespace abcal {

/// What a bench file says of a stage, as far as a driver needs it.
struct StageSettings {
  std::array<std::string, 2> axis_names{"1", "2"};       ///< The controller's names of X and Z.
  std::array<std::optional<double>, 2> speed_deg_per_s;  ///< Absent: as the controller has it.
  std::string address;                                   ///< Of a controller in a daisy chain; empty: none.
  std::string unit{};  ///< Of the axes, where the controller does not tell it: "deg"; empty: not known.
};

/// What a bench file says of an accelerometer, as far as a driver needs it. A driver reads what concerns it.
struct AccelerometerSettings {
  double rate_hz = 100.0;
  std::optional<double> full_scale;          ///< In the output unit, where the instrument does not say.
  std::optional<double> link_bytes_per_s{};  ///< What the link carries, where known (a UART: baud / 10).

  // Analog accelerometers behind voltmeters, and boards that print lines of text: an output is
  // (value - bias) / scale, value being volts or the number of the line.
  std::array<double, 3> scale{1.0, 1.0, 1.0};
  std::array<double, 3> bias{0.0, 0.0, 0.0};
  std::string unit{};  ///< Of the output after scaling; empty: "V" of a voltmeter, "R" of a line of text.

  std::array<int, 3> channels{101, 102, 103};  ///< Voltmeter: where u, v, w are wired.
  double range_v = 10.0;                       ///< Voltmeter: fixed measuring range in volts.
  double integration_plc = 1.0;  ///< Voltmeter: integration time of a channel in power line cycles.

  std::array<int, 3> columns{1, 2, 3};  ///< Line of text: u, v, w; the first column is 1.
  std::string separator{","};           ///< Line of text; " ": any run of blanks and tabs.
  std::string comment{"#"};             ///< Line of text: a line that begins so is skipped; empty: none.
  std::string names;                    ///< Line of text: names of u, v, w in place of columns, "ax ay az".
  std::string number_unit;              ///< Line of text: what may follow a number at once, "g".
  std::string decimal_mark{"."};        ///< Line of text: or ",".
};

/// What a bench file says of a thermometer, hygrometer or barometer that prints lines of text.
struct EnvironmentSettings {
  int temperature_column = 1;  ///< degC; the first column is 1; 0: absent.
  int humidity_column = 0;     ///< Relative humidity in percent; 0: absent.
  int pressure_column = 0;     ///< hPa; 0: absent.
  std::string separator{","};  ///< " ": any run of blanks and tabs.
  std::string comment{"#"};    ///< A line that begins so is skipped; empty: none.
};

}  // namespace abcal
