#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/instrument_ports.h"

namespace abcal {

/// The ports of a bench that have bytes to serve.
/// @throws std::invalid_argument  if it has none
std::vector<InstrumentPort> ports_to_serve(const BenchConfig& config, bool with_stage);

/// The simulated instruments of a bench, served to other programs: each on the TCP port that the bench file
/// names, else on a pseudo-terminal. Commands that an instrument does not carry out are reported on standard
/// error when they arrive for the first time, or each time to `watch`.
class ServedBench {
 public:
  struct Options {
    std::filesystem::path link_dir = ".";  ///< Folder of the links to the pseudo-terminals; made if absent.
    double speed = 1.0;                    ///< Factor by which time passes faster.
    bool follow_stage = false;             ///< The stage is real, and the accelerometer follows its encoders.
    std::optional<std::uint16_t> control{};  ///< Loopback port for faults and changes; 0: any.
    /// Called with a line for each command that an instrument does not carry out, in the thread that serves.
    std::function<void(const std::string&)> watch{};
  };
  /// An instrument and its address: the path of its link, or "tcp:HOST:PORT".
  struct Place {
    std::string name, driver, address;
  };

  /// Opens the ports; they answer once serve() is called.
  /// @param bench_file  its name, for messages
  /// @throws BenchError if a true value does not fit the unit of its instrument, InstrumentError (a stage to
  ///         follow), std::invalid_argument, std::runtime_error
  ServedBench(const std::string& bench_file, const BenchConfig& config, const Options& options);
  ~ServedBench();  ///< Closes the ports and removes the links.

  std::vector<Place> places() const;
  std::optional<std::uint16_t> control_port() const;

  /// Serves until a stop is requested. @throws the error of a stage that can be followed no longer
  void serve(const std::stop_token& stop);

  /// Bytes of output that no client took in time, or that were more than their line carries; only grows.
  std::uint64_t dropped_bytes() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal
