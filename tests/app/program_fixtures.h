#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {

/// A bench file of a PI stage and a MicroStrain accelerometer, quick enough for a test.
struct BenchText {
  std::string stage_port = "simulated";
  std::string accelerometer_port = "simulated";
  std::string protocol = "steps = 12\nstep_deg = 30.0\nsettle_s = 0.05\ndwell_readings = 10\n";
  std::string simulation;
  std::string motion = "speed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\n";

  std::string text() const {
    return "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"" + stage_port +
           "\"\n[accelerometer]\ndriver = \"microstrain_mip\"\nport = \"" + accelerometer_port +
           "\"\nrate_hz = 200.0\n[protocol]\n" + protocol +
           "[simulation]\nnoise = 1e-4\noffset = [0.01, 0.02, 0.03]\n" + simulation + "[simulation.x]\n" +
           motion + "step_error_deg = 0.005\n[simulation.z]\n" + motion + "step_error_deg = 0.005\n";
  }
};

/// Runs the program in a folder of its own.
class ProgramTest : public testing::Test {
 protected:
  std::string write_bench(const BenchText& bench, const std::string& name = "bench.toml") {
    test::write_file(folder / name, bench.text());
    return name;
  }
  test::ProgramResult abcal(const std::vector<std::string>& arguments) {
    return test::run_program(arguments, folder.path());
  }

  test::TemporaryFolder folder;
};

/// A bench served by a process of its own on pseudo-terminals.
class EmulatedBenchTest : public ProgramTest {
 protected:
  EmulatedBenchTest() {
    bench.stage_port = "links/stage";
    bench.accelerometer_port = "links/accelerometer";
  }
  void start_emulator() {
    emulator = std::make_unique<test::Program>(
        std::vector<std::string>{"emulate", write_bench(bench), "--link-dir", "links"}, folder.path());
    ASSERT_TRUE(test::wait_for([&] { return std::filesystem::exists(folder / "links/accelerometer"); },
                               std::chrono::seconds(20)))
        << emulator->err();
  }
  std::size_t measured(const std::string& run) {
    try {
      return RunFile::load(folder / run).measured.size();
    } catch (const RunFileError&) {
      return 0;
    }
  }
  BenchText bench;
  std::unique_ptr<test::Program> emulator;
};

}  // namespace abcal
