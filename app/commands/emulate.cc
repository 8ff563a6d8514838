#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "app/bench_config.h"
#include "app/commands/commands.h"
#include "app/exit_code.h"
#include "app/interrupt.h"
#include "app/make_bench.h"
#include "app/real_clock.h"
#include "drivers/wire/port_list.h"
#include "sim/emulator.h"

namespace abcal {
namespace {

/// Real time, passing `speed` times as fast.
class ScaledClock final : public Clock {
 public:
  explicit ScaledClock(double speed) : speed_(speed), start_(real_.now()), utc_start_(real_.utc_now()) {}
  Instant now() const override { return start_ + scaled(); }
  UtcTime utc_now() const override { return utc_start_ + scaled(); }
  void sleep_until(Instant instant) override {
    real_.sleep_until(start_ + from_seconds(to_seconds(instant - start_) / speed_));
  }

 private:
  Duration scaled() const { return from_seconds(to_seconds(real_.now() - start_) * speed_); }
  RealClock real_;
  double speed_;
  Instant start_;
  UtcTime utc_start_;
};

/// Where an instrument is served: on the TCP port that the bench file names, else on a pseudo-terminal.
sim::Endpoint endpoint(std::shared_ptr<sim::Firmware> firmware, const std::string& port,
                       const std::filesystem::path& link) {
  if (port.starts_with("tcp:")) {
    const wire::PortName name = wire::parse_port(port);
    return {std::move(firmware), sim::TcpPort{name.host, name.tcp_port}};
  }
  return {std::move(firmware), sim::PtyLink{link}};
}

}  // namespace

CLI::App* add_emulate(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    std::string link_dir = ".";
    double speed = 1.0;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "emulate", "Serve the bench's instruments, simulated, on pseudo-terminals or TCP until interrupted");
  command->add_option("BENCH", options->bench_file, "bench file (TOML); [simulation] is the truth")
      ->required();
  command->add_option("--link-dir", options->link_dir, "folder for the links `stage` and `accelerometer`");
  command->add_option("--speed", options->speed, "time passes so many times as fast")
      ->check(CLI::PositiveNumber);
  command->callback([options, &exit_code] {
    const BenchConfig config = read_bench(options->bench_file);
    if (!std::isfinite(options->speed)) throw CLI::ValidationError("--speed", "must be a finite number");
    ScaledClock clock(options->speed);
    const auto world = std::make_shared<sim::SimBench>(config.simulation, clock.now());
    std::error_code error;
    std::filesystem::create_directories(options->link_dir, error);
    if (error) throw std::runtime_error(options->link_dir + ": cannot be created: " + error.message());
    const std::filesystem::path links = options->link_dir;
    sim::Emulator emulator({endpoint(make_stage_firmware(config, world), config.stage.port, links / "stage"),
                            endpoint(make_accelerometer_firmware(config, world), config.accelerometer.port,
                                     links / "accelerometer")},
                           clock, options->speed);
    const std::vector<std::string> addresses = emulator.addresses();
    fmt::print("stage: {} on {}\naccelerometer: {} on {}\nServing until interrupted (Ctrl-C).\n",
               config.stage.driver, addresses.at(0), config.accelerometer.driver, addresses.at(1));
    std::fflush(stdout);
    emulator.run(interrupt_token());
    if (emulator.dropped_bytes() > 0) {
      fmt::print(stderr, "{} bytes of output were dropped because no program read them in time\n",
                 emulator.dropped_bytes());
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
