// Faults of a run, produced on a simulated bench: each must be marked and named, and a bench within its
// tolerances must not be.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <functional>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "protocol/estimators/checks/change_scan.h"
#include "protocol/estimators/checks/result_checks.h"
#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "tests/support/simulated_run.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using test::SimulatedRun;
using testing::AllOf;
using testing::HasSubstr;

constexpr double kRadians = std::numbers::pi / 180.0;

/// The results of both estimators that find a matrix, with all checks.
std::vector<CalibrationResult> analysed(const RunRecord& record) {
  std::vector<CalibrationResult> results{analyse_abc(record), analyse_joint(record)};
  const std::vector<Check> of_the_record = check_record(record);
  for (CalibrationResult& result : results) apply_checks(of_the_record, record, result);
  return results;
}

std::string failed_checks(const CalibrationResult& result) {
  std::string text;
  for (const Check& check : result.diagnostics.checks) {
    if (!check.passed) text += "[" + check.name + "] " + check.words + "\n";
  }
  return text;
}

class WrongNumbersTest : public testing::Test {
 protected:
  /// A bench within its tolerances, measured without any fault.
  SimulatedRun healthy(std::uint64_t seed) {
    SimulatedRun run;
    run.draw_healthy(seed);
    return run;
  }
  RunRecord measure(SimulatedRun& run) { return run.measure(folder / fmt::format("{}.run", ++runs_)).record; }
  /// From the first dwell to the last.
  double run_seconds() {
    SimulatedRun run;
    const RunRecord record = measure(run);
    return *record.dwells.back().time_s - *record.dwells.front().time_s;
  }

  /// Both results are marked, and the sentence `why` of each begins with the reason.
  static void expect_marked(const RunRecord& record, const std::string& check, const std::string& words) {
    for (const CalibrationResult& result : analysed(record)) {
      EXPECT_NE(result.verdict, Verdict::kUsable)
          << result.estimator;  // Grossly wrong readings need not be solved.
      EXPECT_THAT(failed_checks(result), AllOf(HasSubstr("[" + check + "]"), HasSubstr(words)))
          << result.estimator;
      EXPECT_THAT(result.why, HasSubstr(words)) << result.estimator;
      EXPECT_THAT(result.diagnostics.notes, testing::Contains(HasSubstr(words))) << result.estimator;
    }
  }

  /// The number of these runs that are called anything but usable, or have a flag or notice.
  int flagged(int runs, const std::function<void(SimulatedRun&)>& change = {}) {
    const double seconds = [&] {
      SimulatedRun run;
      if (change) change(run);
      const RunRecord record = measure(run);
      return *record.dwells.back().time_s - *record.dwells.front().time_s;
    }();
    int count = 0;
    for (int k = 0; k < runs; ++k) {
      SimulatedRun run = healthy(5000 + static_cast<std::uint64_t>(k));
      if (change) change(run);
      run.set_drift(seconds);
      const RunRecord record = measure(run);
      std::string what;
      for (const std::string& notice : run.notices) what += notice + "\n";
      for (const CalibrationResult& result : analysed(record)) {
        if (result.verdict != Verdict::kUsable) what += result.estimator + ": " + result.why + "\n";
        what += failed_checks(result);
      }
      if (what.empty()) continue;
      ++count;
      std::printf("run %d: %s", k, what.c_str());
    }
    std::printf("healthy runs flagged: %d of %d\n", count, runs);
    return count;
  }

  test::TemporaryFolder folder;

 private:
  int runs_ = 0;
};

TEST_F(WrongNumbersTest, NoneOf40HealthyRunsIsFlagged) {
  EXPECT_EQ(flagged(40), 0);
}

class LongWrongNumbersTest : public WrongNumbersTest {};

TEST_F(LongWrongNumbersTest, NoneOf200HealthyRunsIsFlagged) {
  EXPECT_EQ(flagged(200,
                    [](SimulatedRun& run) {
                      run.protocol.steps = 36;
                      run.protocol.step = Angle::degrees(10.0);
                    }),
            0);
}

TEST_F(LongWrongNumbersTest, NoneOf200HealthyRunsWithSmoothStageErrorsIsFlagged) {
  EXPECT_EQ(flagged(200,
                    [](SimulatedRun& run) {
                      // Half of the step errors' variance is a smooth map of either axis.
                      for (sim::AxisTruth* axis : {&run.truth.x, &run.truth.z}) {
                        const Angle part = run.tolerances.step * std::numbers::sqrt2 * 0.5;
                        axis->step_error_sd = part;
                        for (int order = 1; order <= 2; ++order)
                          axis->harmonics.push_back({order, part * 0.7, part * 0.7});
                      }
                    }),
            0);
}

// ---- Slips ---------------------------------------------------------------------------------------------

struct Slip {
  std::size_t after;  ///< Number of angles before it.
  Eigen::Vector3d rotation;
};

void let_slip(SimulatedRun& run, const Slip& slip) {
  run.after_dwell = [slip](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells != slip.after) return;
    sim::OutputTruth truth = world.output_truth(now);
    // Turning the accelerometer turns the rows s_j.
    truth.sensitivity_matrix *=
        Eigen::AngleAxisd(slip.rotation.norm(), slip.rotation.normalized()).toRotationMatrix().transpose();
    world.change(truth, now);
  };
}

TEST_F(WrongNumbersTest, ASlipOfATenthOfADegreeIsFoundAtItsAngle) {
  const double seconds = run_seconds();
  std::mt19937_64 engine(20);
  std::normal_distribution<double> normal;
  int marked = 0, named = 0, placed = 0, sized = 0;
  constexpr int kRuns = 20;
  for (int k = 0; k < kRuns; ++k) {
    SimulatedRun run = healthy(6000 + static_cast<std::uint64_t>(k));
    run.set_drift(seconds);
    const std::size_t angles = 3 * 13;
    const Slip slip{
        std::uniform_int_distribution<std::size_t>(1, angles - 2)(engine),
        Eigen::Vector3d(normal(engine), normal(engine), normal(engine)).normalized() * 0.1 * kRadians};
    let_slip(run, slip);
    const RunRecord record = measure(run);
    const auto results = analysed(record);
    marked += std::all_of(results.begin(), results.end(),
                          [](const auto& result) { return result.verdict == Verdict::kDoubtful; });
    const ChangeScan scan = scan_for_changes(record);
    if (scan.found.empty()) continue;
    const Change& first = scan.found.front();
    named += first.kind == ChangeKind::kSlip &&
             failed_checks(results.front()).find("the accelerometer slipped") != std::string::npos;
    placed += first.at == slip.after;
    sized += std::abs(first.magnitude - 0.1) < 0.03;
  }
  std::printf(
      "slips of 0.1 degrees: marked %d, named %d, at their angle %d, size within 0.03 degrees %d of %d\n",
      marked, named, placed, sized, kRuns);
  EXPECT_EQ(marked, kRuns);
  EXPECT_EQ(named, kRuns);
  EXPECT_GE(placed, kRuns - 2);
  EXPECT_GE(sized, kRuns - 2);
}

// ---- Missed steps ---------------------------------------------------------------------------------------

void let_miss(SimulatedRun& run, StageAxis axis, std::size_t after, double degrees, bool once) {
  run.after_dwell = [=](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells == after)
      world.inject({.kind = sim::FaultKind::kMissedStep, .at = now, .axis = axis, .value = degrees});
    if (once && dwells == after + 1) world.clear_faults(now);
  };
}

TEST_F(WrongNumbersTest, AMissedStepThatTheEncoderDoesNotSeeIsFound) {
  for (const StageAxis axis : kStageAxes) {
    for (const double degrees : {0.2, 1.0, -5.0}) {
      for (const std::size_t after : {8U, 18U, 31U}) {
        SimulatedRun run = healthy(7000 + after);
        let_miss(run, axis, after, degrees, false);
        const RunRecord record = measure(run);
        SCOPED_TRACE(fmt::format("axis {}, {} degrees after {} angles", to_string(axis), degrees, after));
        const auto results = analysed(record);
        for (const auto& result : results) EXPECT_EQ(result.verdict, Verdict::kDoubtful);
        EXPECT_THAT(failed_checks(results.front()), HasSubstr(fmt::format("axis {}", to_string(axis))));
        EXPECT_THAT(failed_checks(results.front()), HasSubstr("encoder does not see"));
        const ChangeScan scan = scan_for_changes(record);
        ASSERT_FALSE(scan.found.empty());
        EXPECT_EQ(scan.found.front().at, after);
      }
    }
  }
}

TEST_F(WrongNumbersTest, OneWrongAngleIsFound) {
  for (const double degrees : {0.1, 0.5, 30.0}) {
    for (const std::size_t after : {4U, 20U, 34U}) {
      SimulatedRun run = healthy(7100 + after);
      let_miss(run, after >= 26 ? StageAxis::kZ : StageAxis::kX, after, -degrees, true);
      SCOPED_TRACE(fmt::format("{} degrees after {} angles", degrees, after));
      const RunRecord record = measure(run);
      for (const auto& result : analysed(record)) {
        EXPECT_EQ(result.verdict, Verdict::kDoubtful);
        // Where only one output responds to the angle, that output may as well be wrong.
        EXPECT_THAT(result.why, testing::AnyOf(HasSubstr("the readings are those of an angle"),
                                               HasSubstr("or the stage stood at another angle there")));
      }
      EXPECT_EQ(scan_for_changes(record).found.front().at, after);
    }
  }
}

TEST_F(WrongNumbersTest, AnAxisThatLeavesItsWindowIsMeasuredAgainOrEndsTheRun) {
  SimulatedRun sound = healthy(7200);
  const RunRecord before = measure(sound);
  // From the commit of one angle to the middle of the next dwell: what lies between the middles, less half a
  // dwell of 50 readings at 100 Hz.
  const double middle_s = *before.dwells[5].time_s - *before.dwells[4].time_s - 0.25;
  SimulatedRun run = healthy(7200);
  run.after_dwell = [middle_s](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    // Just beyond the window, from the middle of the next angle's dwell until after its end.
    if (dwells != 5) return;
    world.inject({.kind = sim::FaultKind::kMovedAxis,
                  .at = now + from_seconds(middle_s),
                  .until = now + from_seconds(middle_s + 0.5),
                  .axis = StageAxis::kX,
                  .value = 0.012});
  };
  const RunRecord record = measure(run);
  EXPECT_TRUE(record.dwells[5].flags & kFlagRepeated);
  EXPECT_FALSE(record.dwells[5].flags & kFlagOutsideWindow);
  EXPECT_THAT(run.notices, testing::Contains(HasSubstr("outside the position window; it is measured again")));
  EXPECT_EQ(analysed(record).front().verdict, Verdict::kUsable) << analysed(record).front().why;

  SimulatedRun lasting = healthy(7201);
  lasting.after_dwell = [](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells == 5)
      world.inject({.kind = sim::FaultKind::kMovedAxis, .at = now, .axis = StageAxis::kX, .value = 0.012});
  };
  EXPECT_THROW(measure(lasting), InstrumentError);
}

// ---- Outputs --------------------------------------------------------------------------------------------

TEST_F(WrongNumbersTest, AnOutputThatIsStuckForOneDwellIsFlagged) {
  for (int output = -1; output < 3; ++output) {
    SimulatedRun run = healthy(7300 + static_cast<std::uint64_t>(output + 1));
    run.after_dwell = [output](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
      if (dwells == 16) world.inject({.kind = sim::FaultKind::kStuckOutput, .at = now, .output = output});
      if (dwells == 17) world.clear_faults(now);
    };
    const RunRecord record = measure(run);
    EXPECT_TRUE(record.dwells[16].flags & kFlagStuck) << output;
    EXPECT_THAT(run.notices, testing::Contains(HasSubstr("stuck output")));
    for (const auto& result : analysed(record)) {
      EXPECT_EQ(result.verdict, Verdict::kDoubtful) << result.estimator << output << ": " << result.why;
    }
    EXPECT_THAT(analysed(record).front().why, HasSubstr("stuck"));
  }
}

TEST_F(WrongNumbersTest, AnOutputThatIsStuckForAMomentIsMeasuredAgain) {
  SimulatedRun run = healthy(7310);
  run.after_dwell = [](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells == 16)
      world.inject({.kind = sim::FaultKind::kStuckOutput, .at = now, .until = now + std::chrono::seconds(4)});
  };
  const RunRecord record = measure(run);
  EXPECT_TRUE(record.dwells[16].flags & kFlagRepeated);
  EXPECT_FALSE(record.dwells[16].flags & kFlagStuck);
  EXPECT_EQ(analysed(record).front().verdict, Verdict::kUsable) << analysed(record).front().why;
}

TEST_F(WrongNumbersTest, AnOutputThatIsFrozenFromTheStartIsNamedAndSpoilsNoLaterAngle) {
  SimulatedRun sound = healthy(7330);
  const RunRecord unspoilt = measure(sound);
  const auto seconds = [](const RunRecord& record) {
    return *record.dwells.back().time_s - *record.dwells[3].time_s;
  };
  for (int output = 0; output < 3; ++output) {
    SCOPED_TRACE(output);
    SimulatedRun run = healthy(7330);
    run.before_run = [output](sim::SimBench& world, Clock::Instant now) {
      world.inject({.kind = sim::FaultKind::kStuckOutput, .at = now, .output = output});
    };
    run.after_dwell = [](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
      if (dwells == 3) world.clear_faults(now);
    };
    const RunRecord record = measure(run);
    for (std::size_t k = 0; k < record.dwells.size(); ++k)
      EXPECT_EQ((record.dwells[k].flags & kFlagStuck) != 0U, k < 3) << k;
    // No later angle is measured again.
    EXPECT_NEAR(seconds(record), seconds(unspoilt), 1.0);
    for (const auto& result : analysed(record)) {
      // Three of twelve angles of an experiment: grossly wrong readings need not be solved.
      EXPECT_NE(result.verdict, Verdict::kUsable);
      EXPECT_THAT(result.why, HasSubstr(fmt::format("output {} was stuck", "uvw"[output])));
      EXPECT_THAT(failed_checks(result), testing::Not(HasSubstr("axis Z")));
    }
  }
}

TEST_F(WrongNumbersTest, AnOutputThatKeepsItsOldMeanButIsNoisyIsFound) {
  // Like a channel whose multiplexer did not switch: the readings are live, but those of the angle before.
  SimulatedRun run = healthy(7320);
  const RunRecord sound = measure(run);
  for (const std::size_t at : {5U, 17U, 30U}) {
    for (int output = 0; output < 3; ++output) {
      RunRecord record = sound;
      const double change = record.dwells[at].mean(output) - record.dwells[at - 1].mean(output);
      if (std::abs(change) < 0.01) continue;  // it would have read nearly the same
      record.dwells[at].mean(output) = record.dwells[at - 1].mean(output);
      SCOPED_TRACE(fmt::format("output {} at {}", output, at));
      expect_marked(record, "single output", fmt::format("{} read what it had read", "uvw"[output]));
    }
    RunRecord record = sound;
    record.dwells[at].mean = record.dwells[at - 1].mean;
    SCOPED_TRACE(fmt::format("all outputs at {}", at));
    expect_marked(record, "single angle", "the outputs were stuck");
  }
}

TEST_F(WrongNumbersTest, AJumpOfAnOutputIsFoundAtItsAngle) {
  for (const std::size_t after : {6U, 20U, 33U}) {
    SimulatedRun run = healthy(7400 + after);
    run.after_dwell = [after](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
      if (dwells != after) return;
      sim::OutputTruth truth = world.output_truth(now);
      truth.offset(1) += 2e-3;
      world.change(truth, now);
    };
    const RunRecord record = measure(run);
    SCOPED_TRACE(after);
    expect_marked(record, "jump of an output", "output v jumped by 0.002");
    EXPECT_EQ(scan_for_changes(record).found.front().at, after);
  }
}

// The limit is 4.9 times the combined uncertainty of the drift, from its statement and from the readings.
// Together with drifts of higher order and of the sensitivity, and hysteresis, five times is at the limit
// itself.
TEST_F(WrongNumbersTest, DriftOfSixTimesItsToleranceIsFound) {
  const auto precise = [](SimulatedRun& run) { run.protocol.dwell_readings = 200; };
  SimulatedRun first;
  precise(first);
  const RunRecord duration = measure(first);
  const double seconds = *duration.dwells.back().time_s - *duration.dwells.front().time_s;
  int found = 0;
  constexpr int kRuns = 12;
  for (int k = 0; k < kRuns; ++k) {
    SimulatedRun run = healthy(7500 + static_cast<std::uint64_t>(k));
    precise(run);
    run.drift = (k % 2 == 0 ? 6.0 : -6.0) * run.tolerances.drift * Eigen::Vector3d::Unit(k % 3);
    run.set_drift(seconds);
    const RunRecord record = measure(run);
    const auto results = analysed(record);
    const bool marked = results[0].verdict == Verdict::kDoubtful && results[1].verdict == Verdict::kDoubtful;
    found += marked && failed_checks(results[0]).find(fmt::format("output {} drifted", "uvw"[k % 3])) !=
                           std::string::npos;
  }
  std::printf("drift of 6 times its tolerance: found %d of %d\n", found, kRuns);
  EXPECT_EQ(found, kRuns);
}

TEST_F(WrongNumbersTest, VibrationIsMeasuredAgainAndFlaggedIfItStays) {
  const auto shake = [](Clock::Duration how_long) {
    return [how_long](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
      if (dwells != 9) return;
      sim::OutputTruth truth = world.output_truth(now);
      const sim::OutputTruth quiet = truth;
      truth.noise *= 20.0;
      world.change(truth, now);
      world.change(quiet, now + how_long);
    };
  };
  SimulatedRun run = healthy(7600);
  run.protocol.quiet_timeout_s = 0.5;
  run.after_dwell = shake(std::chrono::seconds(4));
  RunRecord record = measure(run);
  EXPECT_TRUE(record.dwells[9].flags & kFlagRepeated);
  EXPECT_FALSE(record.dwells[9].flags & kFlagNotQuiet);
  EXPECT_EQ(analysed(record).front().verdict, Verdict::kUsable) << analysed(record).front().why;

  SimulatedRun longer = healthy(7601);
  longer.protocol.quiet_timeout_s = 0.5;
  longer.after_dwell = shake(std::chrono::seconds(12));
  record = measure(longer);
  EXPECT_TRUE(record.dwells[9].flags & kFlagNotQuiet);
  EXPECT_EQ(analysed(record).front().verdict, Verdict::kDoubtful);
  EXPECT_THAT(analysed(record).front().why, HasSubstr("not quiet"));
}

// ---- Unit, full scale, directions -----------------------------------------------------------------------

void scale(SimulatedRun& run, double factor) {
  run.truth.sensitivity_matrix *= factor;
  run.truth.offset *= factor;
}

TEST_F(WrongNumbersTest, AFullScaleThatIsWrongByOnePercentIsFound) {
  for (const double factor : {1.01, 0.99}) {
    for (std::uint64_t seed = 0; seed < 5; ++seed) {
      SimulatedRun run = healthy(7700 + seed);
      scale(run, factor);
      const RunRecord record = measure(run);
      SCOPED_TRACE(fmt::format("{} seed {}", factor, seed));
      expect_marked(record, "full scale", "full scale or scale factor is wrong");
      // Said already at the end of each experiment.
      EXPECT_THAT(run.notices, testing::Contains(HasSubstr("experiment 1: the response to local gravity")));
    }
  }
}

TEST_F(WrongNumbersTest, ANominalSensitivityMakesItSoForVoltsToo) {
  SimulatedRun run = healthy(7710);
  run.unit = "V";
  scale(run, 0.66);
  EXPECT_EQ(analysed(measure(run)).front().verdict, Verdict::kUsable);  // nothing to compare with
  run.expected.nominal_sensitivity = 0.66;
  EXPECT_EQ(analysed(measure(run)).front().verdict, Verdict::kUsable);
  run.expected.nominal_sensitivity = 0.66 / 1.01;
  expect_marked(measure(run), "full scale", "full scale or scale factor is wrong");
  run.expected.sensitivity_tolerance = 0.02;
  EXPECT_EQ(analysed(measure(run)).front().verdict, Verdict::kUsable);
}

TEST_F(WrongNumbersTest, AnotherUnitIsNamed) {
  const struct {
    double factor;
    const char* unit;
    const char* words;
  } cases[] = {{kStandardGravity, "g", "the readings are in m/s2, not in g"},
               {1.0, "m/s2", "the readings are in g, not in m/s2"},
               {1000.0, "g", "thousandths of g"},
               {1.0, "mg", "thousands of mg"},
               {0.5, "g", "wrong by a factor of 1/2"},
               {4.0, "g", "wrong by a factor of 4"}};
  for (const auto& [factor, unit, words] : cases) {
    SimulatedRun run = healthy(7720);
    run.unit = unit;
    scale(run, factor);
    run.truth.noise *= factor;
    const RunRecord record = measure(run);
    SCOPED_TRACE(words);
    expect_marked(record, "full scale", words);
    EXPECT_TRUE(record.dwells[0].flags & kFlagNorm);  // from the first angle on
  }
}

TEST_F(WrongNumbersTest, ExchangedAndReversedOutputsAreNamed) {
  const auto rows = [](SimulatedRun& run, const std::array<int, 3>& from, const std::array<int, 3>& sign) {
    const Eigen::Matrix3d s = run.truth.sensitivity_matrix;
    for (int j = 0; j < 3; ++j) {
      const auto at = static_cast<std::size_t>(j);
      run.truth.sensitivity_matrix.row(j) = sign[at] * s.row(from[at]);
    }
  };
  const struct {
    std::array<int, 3> from, sign;
    std::vector<std::string> words;
  } cases[] = {
      {{1, 0, 2}, {1, 1, 1}, {"along +y, +x, +z", "u is v, v is u"}},
      {{0, 2, 1}, {1, 1, 1}, {"along +x, +z, +y", "v is w, w is v"}},
      {{1, 2, 0}, {1, 1, 1}, {"turned by 120 degrees", "exchanged in turn"}},
      {{0, 1, 2}, {1, 1, -1}, {"along +x, +y, -z", "w is reversed"}},
      {{0, 1, 2}, {-1, 1, 1}, {"u is reversed", "stage axis Z counts the wrong way"}},
      {{0, 1, 2}, {1, -1, 1}, {"v is reversed", "both stage axes count the wrong way"}},
      {{0, 1, 2}, {-1, -1, 1}, {"turned by 180 degrees about", "stage axis X counts the wrong way"}},
      {{1, 0, 2}, {1, -1, 1}, {"turned by 90 degrees about (0, 0, "}},
  };
  for (const auto& [from, sign, words] : cases) {
    SimulatedRun run = healthy(7800);
    rows(run, from, sign);
    const RunRecord record = measure(run);
    for (const std::string& word : words) {
      SCOPED_TRACE(word);
      expect_marked(record, "directions of the outputs", word);
    }
  }
}

TEST_F(WrongNumbersTest, AStageAxisThatCountsTheWrongWayIsNamed) {
  const struct {
    std::array<int, 2> sign;
    const char* words;
  } cases[] = {{{-1, 1}, "stage axis X counts the wrong way"},
               {{1, -1}, "stage axis Z counts the wrong way"},
               {{-1, -1}, "both stage axes count the wrong way"}};
  for (const auto& [sign, words] : cases) {
    SimulatedRun run = healthy(7900);
    run.stage_sign = sign;
    SCOPED_TRACE(words);
    expect_marked(measure(run), "directions of the outputs", words);
  }
}

TEST_F(WrongNumbersTest, AnotherMountingMayBeMeant) {
  SimulatedRun run = healthy(7910);
  run.truth.sensitivity_matrix *=
      Eigen::AngleAxisd(0.5 * std::numbers::pi, Eigen::Vector3d::UnitZ()).matrix();
  RunRecord record = measure(run);
  EXPECT_EQ(analysed(record).front().verdict, Verdict::kDoubtful);
  record.expected.mounting = "-y x z";
  EXPECT_EQ(analysed(record).front().verdict, Verdict::kUsable) << analysed(record).front().why;
}

// ---- Temperature ----------------------------------------------------------------------------------------

/// Warmer by this many degrees from the 10th angle on, for this time.
auto warmer(double degc, Clock::Duration how_long) {
  return [=](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells != 10) return;
    sim::OutputTruth truth = world.output_truth(now);
    const sim::OutputTruth before = truth;
    truth.temperature_degc += degc;
    world.change(truth, now);
    world.change(before, now + how_long);
  };
}

TEST_F(WrongNumbersTest, ATemperatureAtTwiceItsLimitIsFlagged) {
  SimulatedRun run = healthy(8000);
  const double limit = temperature_change_limit_degc(run.limits, run.tolerances);
  run.limits.temperature_wait_s = 0.0;
  run.after_dwell = warmer(2.0 * limit, std::chrono::hours(10));
  const RunRecord record = measure(run);
  EXPECT_FALSE(record.dwells[9].flags & kFlagTemperature);
  EXPECT_TRUE(record.dwells[10].flags & kFlagTemperature);
  expect_marked(record, "temperature", "from the first angle");
}

TEST_F(WrongNumbersTest, TheRunHoldsUntilTheTemperatureIsBack) {
  SimulatedRun run = healthy(8001);
  const double limit = temperature_change_limit_degc(run.limits, run.tolerances);
  run.after_dwell = warmer(2.0 * limit, std::chrono::minutes(20));
  const RunRecord record = measure(run);
  EXPECT_EQ(record.dwells[10].flags, kFlagHeld);
  EXPECT_GT(*record.dwells[10].time_s - *record.dwells[9].time_s, 1200.0);
  EXPECT_THAT(run.notices, testing::Contains(HasSubstr("the temperature came back after")));
  EXPECT_THAT(failed_checks(analysed(record).front()), testing::Not(HasSubstr("temperature")));
}

TEST_F(WrongNumbersTest, ATemperatureThatStaysAwayEndsTheRun) {
  SimulatedRun run = healthy(8002);
  const double limit = temperature_change_limit_degc(run.limits, run.tolerances);
  run.limits.temperature_wait_s = 600.0;
  run.after_dwell = warmer(2.0 * limit, std::chrono::hours(10));
  try {
    measure(run);
    FAIL() << "the run did not end";
  } catch (const InstrumentError& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("did not come back within 600 s"), HasSubstr("from the first")));
  }
  const StoredRun stored = RunFile::load(folder / "1.run");
  EXPECT_EQ(stored.state, RunState::kInterrupted);
  EXPECT_EQ(stored.record.dwells.size(), 10U);
}

// ---- Before the first angle -----------------------------------------------------------------------------

TEST_F(WrongNumbersTest, TheFirstAngleWaitsForStability) {
  SimulatedRun run = healthy(8100);
  run.truth.temperature_per_hour = 30.0;  // warms by 1 degC in two minutes
  run.protocol.stability_s = 60.0;
  run.limits.stability_degc = 1.0;
  const RunRecord record = measure(run);
  EXPECT_THAT(run.notices, testing::Contains(HasSubstr("stable after")));
  EXPECT_GT(*record.dwells.front().time_s, 60.0);

  SimulatedRun never = healthy(8101);
  never.truth.temperature_per_hour = 120.0;
  never.protocol.stability_s = 60.0;
  never.protocol.stability_timeout_s = 300.0;
  EXPECT_THROW(measure(never), InstrumentError);
  EXPECT_EQ(RunFile::load(folder / "2.run").record.dwells.size(), 0U);
}

}  // namespace
}  // namespace abcal
