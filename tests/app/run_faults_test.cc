// Instruments that fail in the middle of a run, at every call that a run makes and in every way that a
// simulated bench can go wrong (sim/faults.h). The run completes, or ends in time with the right fault in
// words and the stage at rest; either way its file is sound and the run can go on; and a result called usable
// is right.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <set>
#include <tuple>

#include "app/results/analysis/analyses.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/verify_run.h"
#include "sim/faults.h"
#include "tests/app/in_process_run.h"
#include "tests/app/instrument_cases.h"
#include "tests/app/repeatable_run.h"
#include "tests/support/failing_disk.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using sim::FaultKind;
using test::InProcessRun;
using testing::AnyOf;
using testing::HasSubstr;

bool has_event(const StoredRun& run, std::string_view kind) {
  return std::any_of(run.events.begin(), run.events.end(),
                     [&](const RunEvent& event) { return event.kind == kind; });
}

void expect_verified(const std::filesystem::path& run) {
  for (const IntegrityCheck& check : verify_run(run))
    EXPECT_TRUE(check.good) << check.what << ": " << check.found;
}

// ---- At every call

constexpr std::array kFaults{Fault::kRefused,    Fault::kNoReply,       Fault::kBadFrame, Fault::kLinkLost,
                             Fault::kCannotOpen, Fault::kWrongIdentity, Fault::kNotReady, Fault::kOutOfTravel,
                             Fault::kStalled,    Fault::kImplausible};

class FaultAtEveryCallTest : public testing::Test {
 protected:
  static std::string bench() {
    BenchText text = repeatable_bench();
    text.stage_driver = text.accelerometer_driver = "simulated";
    text.protocol =
        "steps = 5\nstep_deg = 72.0\nsettle_s = 0.05\ndwell_readings = 10\npoll_interval_s = 0.05\n" +
        text.protocol.substr(text.protocol.find("approach_deg"));
    return text.text();
  }

  void SetUp() override {
    InProcessRun whole(bench(), folder / "whole.run");
    whole.run_to_end();
    calls = whole.calls();
    expected_bits = measured_bits(whole.path());
  }

  void fail_all(std::size_t stride) {
    for (std::size_t k = 0; k <= kFaults.size(); ++k) {
      // From the last one back, and not the same calls for each fault.
      for (std::size_t at = calls - k % stride; at > 0 && at <= calls; at -= stride) {
        examine(at, k < kFaults.size() ? std::optional(kFaults[k]) : std::nullopt);
        if (HasFatalFailure()) return;
      }
    }
    fmt::print(
        "{} faults at the {} calls of a run: {} ended before there was a run, {} ended with the reason "
        "and went on, {} went on by themselves, {} could not be parked\n",
        tried, calls, never_begun, ended, reconnected, not_parked);
    EXPECT_GT(reconnected, 0);
    EXPECT_GT(not_parked, 0);
  }

  /// @param fault Nothing: an exception that is not an instrument's.
  void examine(std::size_t at, std::optional<Fault> fault) {
    InProcessRun run(bench(), folder / "a.run");
    std::string call, why;
    run.before_call = [&](std::string_view name, std::size_t number) {
      if (number != at) return;
      call = name;
      if (!fault) throw std::runtime_error("a bug (scripted)");
      throw InstrumentError("this instrument", *fault, "scripted");
    };
    try {
      run.run_to_end();
    } catch (const InstrumentError& error) {
      why = error.what();
      EXPECT_EQ(error.fault(), fault) << why;
    } catch (const std::runtime_error& error) {
      why = error.what();
      EXPECT_FALSE(fault) << why;
    }
    SCOPED_TRACE(fmt::format("{} at call {} ({}): {}", fault ? to_string(*fault) : "an exception", at, call,
                             why.empty() ? "completed" : why));
    ++tried;
    EXPECT_FALSE(call.empty());
    EXPECT_FALSE(run.left_moving());
    run.before_call = {};
    if (!run.exists()) {
      ++never_begun;
      EXPECT_THAT(why, HasSubstr("scripted"));
      EXPECT_EQ(run.halts(), 0U);
      return;
    }
    check_kept(run, why, fault);
    run.run_to_end();
    EXPECT_EQ(RunFile::load(run.path()).state, RunState::kComplete);
    EXPECT_EQ(measured_bits(run.path()), expected_bits);
    expect_verified(run.path());
    for (const char* suffix : {"", ".results"}) std::filesystem::remove(run.path().string() + suffix);
  }

  void check_kept(const InProcessRun& run, const std::string& why, std::optional<Fault> fault) {
    const StoredRun stored = RunFile::load(run.path());
    EXPECT_THAT(stored.measured, testing::UnorderedElementsAreArray(run.reported()));
    if (why.empty()) {
      EXPECT_EQ(stored.state, RunState::kComplete);
      EXPECT_GT(run.halts(), 0U);
      const bool parked = !has_event(stored, "park failed");
      EXPECT_TRUE(!parked || fault == Fault::kLinkLost);
      EXPECT_EQ(stored.record.reconnections, parked ? 1 : 0);
      ++(parked ? reconnected : not_parked);
      return;
    }
    ++ended;
    EXPECT_EQ(stored.state, RunState::kInterrupted);
    EXPECT_EQ(run.halts(), 1U);
    EXPECT_THAT(why, AllOf(HasSubstr("scripted"), HasSubstr("the stage is halted")));
    EXPECT_THAT(stored.events.back().text, AllOf(HasSubstr("scripted"), HasSubstr("the stage is halted")));
  }

  test::TemporaryFolder folder;
  test::FailingDisk disk;  ///< Never fails here; avoids waiting for the real disk.
  std::size_t calls = 0;   ///< Number of calls in a whole run.
  std::vector<std::string> expected_bits;
  int tried = 0, never_begun = 0, ended = 0, reconnected = 0, not_parked = 0;
};

TEST_F(FaultAtEveryCallTest, HaltsTheStageSaysWhyAndTheRunGoesOnToTheSameBits) {
  fail_all(101);
}

class LongFaultAtEveryCallTest : public FaultAtEveryCallTest {};

TEST_F(LongFaultAtEveryCallTest, HaltsTheStageSaysWhyAndTheRunGoesOnToTheSameBits) {
  fail_all(1);
}

// ---- Every fault of sim/faults.h through every driver

/// Permitted faults in the reason of a run that has to end while a fault is still present.
std::set<Fault> right_faults(FaultKind kind) {
  using enum Fault;
  switch (kind) {
    case FaultKind::kLostController:
      return {kNoReply};
    case FaultKind::kSilence:
    case FaultKind::kLateReply:
    case FaultKind::kNoOutput:
      return {kNoReply, kImplausible};  // Implausible: more readings lost at an angle than may be.
    case FaultKind::kGarbage:
    case FaultKind::kFlippedBits:
    case FaultKind::kDroppedBytes:
      // Refused: a damaged command of the emulator's firmware is one that it does not know, and a damaged
      // reply of a protocol without checksums may be any other one.
      return {kBadFrame, kNoReply, kRefused, kStalled, kImplausible, kNotReady, kOutOfTravel, kWrongIdentity};
    case FaultKind::kReplacedReply:
      return {kRefused, kBadFrame, kNoReply, kOutOfTravel, kNotReady, kWrongIdentity, kImplausible};
    case FaultKind::kUnplug:
    case FaultKind::kPowerCycle:
      return {kLinkLost};
    case FaultKind::kStuckOutput:
    case FaultKind::kClippedOutput:
    case FaultKind::kNotFinite:
      return {kImplausible};
    case FaultKind::kStalledAxis:
      return {kStalled, kRefused};  // Refused: a controller that notices it says so itself.
    case FaultKind::kStopsShort:
    case FaultKind::kMovedAxis:
      return {kStalled};
    case FaultKind::kLostReference:
      return {kNotReady, kRefused};
    case FaultKind::kRefusedMove:
      return {kRefused};
    case FaultKind::kSplitFrame:
    case FaultKind::kMissedStep:
    case FaultKind::kChamberAlarm:
    case FaultKind::kChamberDoor:
      break;
  }
  return {};
}

/// A fault, and the driver on whose instrument it is.
struct FaultOnDriver {
  StageCase stage;
  AccelerometerCase accelerometer;
  std::string instrument;  ///< Instrument of a fault of the wire.
  sim::FaultDescription fault;
};

void PrintTo(const FaultOnDriver& one, std::ostream* out) {
  *out << one.fault.name << " on " << one.stage.name << " with " << one.accelerometer.name;
}

std::vector<FaultOnDriver> faults_on_drivers() {
  std::vector<FaultOnDriver> all;
  std::size_t described = 0;
  for (const sim::FaultDescription& fault : sim::fault_descriptions()) {
    // These benches have no chamber; temperature_series_test has its faults.
    if (fault.kind == FaultKind::kChamberAlarm || fault.kind == FaultKind::kChamberDoor) continue;
    // Descriptions share a driver, whose calls meet every fault with every description in DriverFaults: here
    // each fault meets one of them.
    std::vector<StageCase> on_stages = stages();
    on_stages.push_back(described_stages()[described++ % described_stages().size()]);
    for (const StageCase& stage : on_stages) {
      if (fault.kind == FaultKind::kLostController && !stage.name.ends_with("_chain")) continue;
      all.push_back(
          {stage, accelerometers().front(), stage.name == "two_controllers" ? "stage-z" : "stage", fault});
    }
    for (const AccelerometerCase& accelerometer : accelerometers()) {
      if (fault.kind == FaultKind::kLostController) continue;
      // One voltmeter of three is enough.
      const bool three = accelerometer.name == "scpi_single";
      all.push_back({stages().front(), accelerometer, three ? "accelerometer-v" : "accelerometer", fault});
    }
  }
  return all;
}

class RunFaults : public testing::TestWithParam<FaultOnDriver> {
 protected:
  RunFaults() {
    const FaultOnDriver& one = GetParam();
    text = bench_text(one.stage, one.accelerometer, "simulated", "simulated", "simulated", "simulated");
    const std::string protocol = "[protocol]\n";
    text.insert(text.find(protocol) + protocol.size(),
                "replug_timeout_s = 20.0\nmotion_timeout_s = 5.0\nquiet_timeout_s = 2.0\n");
  }

  FaultConfig fault(double at_s, std::optional<double> for_s) const {
    const FaultOnDriver& one = GetParam();
    FaultConfig config;
    config.kind = one.fault.name;
    config.at_s = at_s;
    config.for_s = for_s;
    if (one.fault.on_the_wire) {
      config.instrument = one.instrument;
    } else {
      config.axis = "z";
    }
    config.delay_s = 20.0;
    config.text = "nothing that anyone can read\r\n";
    config.value = one.fault.kind == FaultKind::kClippedOutput ? 0.5 * one.accelerometer.scale : 0.5;
    return config;
  }

  void examine(double at_s, std::optional<double> for_s) {
    const FaultOnDriver& one = GetParam();
    InProcessRun run(text, folder / "a.run");
    run.change_bench = [&](BenchConfig& config) { config.faults = {fault(at_s, for_s)}; };
    std::string why;
    std::optional<Fault> found;
    try {
      run.run_to_end();
    } catch (const InstrumentError& error) {
      why = error.what();
      found = error.fault();
    }
    SCOPED_TRACE(fmt::format("{} from {} s{}: {}", testing::PrintToString(one), at_s,
                             for_s ? fmt::format(" for {} s", *for_s) : " on",
                             why.empty() ? "completed" : why));
    EXPECT_LT(run.longest_angle_s(), kLongestAngleS + for_s.value_or(0.0));
    ASSERT_TRUE(run.exists());
    EXPECT_EQ(integrity(run.path()), "ok");
    EXPECT_THAT(RunFile::load(run.path()).measured, testing::UnorderedElementsAreArray(run.reported()));
    if (found) {
      EXPECT_TRUE(right_faults(one.fault.kind).contains(*found)) << to_string(*found);
      const StoredRun stored = RunFile::load(run.path());
      EXPECT_EQ(stored.state, RunState::kInterrupted);
      const std::string last = stored.events.back().text;
      const bool acknowledged = last.find("the stage is halted") != std::string::npos;
      if (acknowledged) {
        EXPECT_FALSE(run.left_moving());
      } else {
        EXPECT_THAT(why, HasSubstr("the stage did not acknowledge the halt"));
        EXPECT_TRUE(one.instrument.starts_with("stage") &&
                    (one.fault.on_the_wire || one.fault.kind == FaultKind::kLostController));
      }
      EXPECT_THAT(why, HasSubstr(last.substr(last.find("; the stage"))));
      // The fault is removed.
      run.change_bench = [](BenchConfig& config) { config.faults.clear(); };
      std::filesystem::copy_file(run.path(), folder / "kept.run",
                                 std::filesystem::copy_options::overwrite_existing);
      run.run_to_end();
    } else {
      EXPECT_FALSE(run.left_moving());
    }
    ASSERT_TRUE(run.finished());
    EXPECT_EQ(run.finished()->stored().measured.size(), run.finished()->stored().header.plan.size());
    expect_verified(run.path());
    const CalibrationResult& result = run.finished()->items.front().results.front();
    const TruthComparison truth =
        compare_with_truth(result, run.finished()->stored().record, parse_bench(text, "bench.toml"));
    EXPECT_TRUE(result.verdict != Verdict::kUsable || truth.agrees()) << truth.text;
    for (const char* suffix : {"", ".results"}) std::filesystem::remove(run.path().string() + suffix);
  }

  /// Measured four times, each with two moves that take as long as they may, the longest wait for quiet and
  /// the longest for a reading; and once the longest wait for a port, the longest call of a driver, and a
  /// halt.
  static constexpr double kLongestAngleS = 4.0 * (2.0 * 5.0 + 2.0 + 2.0) + 20.0 + 17.0 + 15.0;

  test::TemporaryFolder folder;
  test::FailingDisk disk;  ///< Never fails here; avoids waiting for the real disk.
  std::string text;
};

TEST_P(RunFaults, EndInTimeWithTheRightFaultAndGoOnOrCompleteWithoutAWrongNumberThatLooksRight) {
  InProcessRun whole(text, folder / "whole.run");
  whole.run_to_end();
  ASSERT_TRUE(whole.finished());
  EXPECT_EQ(whole.finished()->items.front().results.front().verdict, Verdict::kUsable)
      << whole.finished()->items.front().results.front().why;
  // Between the first angle and the last: an axis that slips before the first one is an item mounted
  // otherwise.
  const std::vector<DwellRecord>& dwells = whole.finished()->stored().record.dwells;
  const double measured_s = dwells.back().time_s.value() - dwells.front().time_s.value();
  for (const double part : {0.25, 0.7}) {
    const double at_s = whole.simulated_s() - (1.0 - part) * measured_s;
    examine(at_s, 0.3);
    examine(at_s, std::nullopt);
    if (HasFatalFailure()) return;
  }
}

INSTANTIATE_TEST_SUITE_P(All, RunFaults, testing::ValuesIn(faults_on_drivers()), [](const auto& one) {
  std::string name =
      fmt::format("{}_{}_{}", one.param.fault.name, one.param.stage.name, one.param.accelerometer.name);
  std::replace(name.begin(), name.end(), '-', '_');
  return name + fmt::format("_{}", one.index);
});

}  // namespace
}  // namespace abcal
