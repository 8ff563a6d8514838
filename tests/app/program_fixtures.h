#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "tests/app/bench_text.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {

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
