#pragma once

#include <exception>
#include <filesystem>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>

#include "app/bench_file/bench_config.h"
#include "app/measure/emulator/served_bench.h"
#include "app/system/output.h"

namespace abcal {

/// Emulated instruments, served in a thread of its own as long as this lives.
class Emulation {
 public:
  /// @param links  folder of the links to the pseudo-terminals
  Emulation(const std::string& bench_file, const BenchConfig& config, const std::filesystem::path& links)
      : served_(bench_file, config, {links}), thread_([this](const std::stop_token& stop) { serve(stop); }) {}

  std::vector<ServedBench::Place> places() const { return served_.places(); }

 private:
  void serve(const std::stop_token& stop) noexcept {
    try {
      served_.serve(stop);
    } catch (const std::exception& error) {
      // The run that uses them ends as well: its ports do not answer any more.
      print_error(fmt::format("the emulated instruments: {}", error.what()));
    }
  }

  ServedBench served_;
  std::jthread thread_;
};

}  // namespace abcal
