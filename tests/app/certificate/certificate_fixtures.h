#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <string>

#include "app/laboratory/certificate/certificate.h"
#include "app/results/analysis/report_data.h"
#include "protocol/plan/effect_sizes.h"
#include "tests/app/bench_text.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_data.h"

namespace abcal {

/// A bench file for certificates. Tests change its text by `replaced`. Its accelerometer reports no identity,
/// so that [item] may name any item.
inline std::string certificate_bench() {
  return R"([bench]
name = "bench 1"
g_loc_mps2 = 9.80101
g_loc_expanded_uncertainty_mps2 = 0.00003
g_loc_k = 2.0
g_loc_source = "survey of 2025, EX-GRAV-7"
[item]
maker = "Maker"
model = "M-3"
serial_number = "SN-42"
range = "8 g"
[operator]
name = "Operator N. N."
[stage]
driver = "pi_gcs"
port = "simulated"
[accelerometer]
driver = "simulated"
response_unit = "g"
rate_hz = 200.0
[environment]
temperature_degc = 23.0
humidity_percent = 45.0
)" + quick_calibration();
}

inline std::string example_laboratory() {
  return test::read_file(test::source_folder() / "docs/examples/laboratory.toml");
}

/// `text` with the first `from` replaced. Fails the test where there is none.
inline std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  if (at != std::string::npos) text.replace(at, from.size(), to);
  return text;
}

/// Makes a simulated run look as if measured by real instruments on a date, on a bench whose effects all have
/// a source.
inline void as_if_real(ReportData& data, const std::string& date = "2026-03-01") {
  data.simulated.clear();
  data.run->header.created_utc = date + "T12:00:00.000Z";
  for (RunEvent& event : data.run->events) event.utc = date + "T13:00:00.000Z";
  for (const EffectSizeKey& key : effect_size_keys())
    data.record.tolerances.sources[std::string(key.key)] = "data sheet";
}

inline Clock::UtcTime any_time() {
  return Clock::UtcTime(std::chrono::hours(24 * 365 * 56));
}

/// One measured run that all tests of a suite share: it is not changed by them (copies are).
class CertificateTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    shared_folder_ = new test::TemporaryFolder;
    measure(certificate_bench(), "a.run", *shared_folder_);
  }
  static void TearDownTestSuite() {
    delete shared_folder_;
    shared_folder_ = nullptr;
  }

  static void measure(const std::string& bench, const std::string& run, const test::TemporaryFolder& where) {
    test::write_file(where / (run + ".toml"), bench);
    const auto result = test::run_program({"run", run + ".toml", "-o", run}, where.path());
    ASSERT_EQ(result.exit_code, 0) << result.err;
  }

  static std::filesystem::path shared_run() { return *shared_folder_ / "a.run"; }

  /// A copy of the run and its results in this test's own folder.
  std::string own_run(const std::string& name = "a.run") {
    for (const std::string suffix : {"", ".results"})
      std::filesystem::copy_file(shared_run().string() + suffix, folder / (name + suffix));
    return name;
  }

  static CertificateRequest request(const std::string& laboratory = example_laboratory()) {
    CertificateRequest asked;
    asked.laboratory = parse_laboratory_file(laboratory, "lab.toml");
    asked.run = gather_report(shared_run(), any_time());
    return asked;
  }

  /// Why there is no certificate; empty: there is one.
  static std::string refusal(CertificateRequest asked) {
    try {
      make_certificate(std::move(asked));
    } catch (const std::exception& error) {
      return error.what();
    }
    return "";
  }

  test::ProgramResult abcal(const std::vector<std::string>& arguments) {
    return test::run_program(arguments, folder.path());
  }

  test::TemporaryFolder folder;

 private:
  static inline test::TemporaryFolder* shared_folder_ = nullptr;
};

}  // namespace abcal
