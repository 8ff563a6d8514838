#include "protocol/estimators/checks/check_poses.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

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

constexpr const char* kOutputs[3] = {"u", "v", "w"};

/// A change of the item after a number of dwells, the check poses included.
struct LateChange {
  std::size_t after = 0;
  int output = 0;
  double gain = 0.0;    ///< Relative.
  double offset = 0.0;  ///< R
};

void let_change(SimulatedRun& run, const LateChange& change) {
  run.after_dwell = [change](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells != change.after) return;
    sim::OutputTruth truth = world.output_truth(now);
    truth.sensitivity_matrix.row(change.output) *= 1.0 + change.gain;
    truth.offset(change.output) += change.offset;
    world.change(truth, now);
  };
}

class CheckPosesTest : public testing::Test {
 protected:
  static SimulatedRun healthy(std::uint64_t seed) {
    SimulatedRun run;
    run.protocol.check_poses = true;
    run.draw_healthy(seed);
    return run;
  }
  RunRecord measure(SimulatedRun& run) { return run.measure(folder / fmt::format("{}.run", ++runs_)).record; }
  static CalibrationResult joint(const RunRecord& record) {
    CalibrationResult result = analyse_joint(record);
    apply_checks(check_record(record), record, result);
    return result;
  }
  static const Check* find(const std::vector<Check>& checks, const std::string& name) {
    for (const Check& check : checks)
      if (check.name == name) return &check;
    return nullptr;
  }

  /// Sound runs whose offsets drift within their statement: none may be marked.
  void expect_sound(std::uint64_t runs) {
    double seconds = 0.0;
    for (std::uint64_t seed = 0; seed < runs; ++seed) {
      SimulatedRun run = healthy(5000 + seed);
      if (seconds > 0.0) run.set_drift(seconds);
      const RunRecord record = measure(run);
      seconds = *record.dwells.back().time_s - *record.dwells.front().time_s;
      const std::vector<Check> checks = check_pose_checks(record);
      for (const Check& check : checks) EXPECT_TRUE(check.passed) << check.words;
      ASSERT_NE(find(checks, "gain of w at the check poses"), nullptr);
    }
  }

  test::TemporaryFolder folder;

 private:
  int runs_ = 0;
};

// 12 angles and the closing angle: 2 + 13 + 2 + 13 + 2 + 13 + 2 dwells. Experiment 3 begins after 32.
constexpr std::size_t kLateInExperiment3 = 32 + 11;

TEST_F(CheckPosesTest, AreVisitedFourTimesAndKeptApartFromThePlan) {
  SimulatedRun run = healthy(1);
  const StoredRun stored = run.measure(folder / "a.run");
  const RunRecord& record = stored.record;
  EXPECT_EQ(run.plan.size(), 47U);
  EXPECT_EQ(record.dwells.size(), 39U);
  ASSERT_EQ(record.check_poses.size(), 8U);
  for (std::size_t i = 0; i < 8; ++i) {
    EXPECT_EQ(record.check_poses[i].after, 13 * (i / 2));
    const std::size_t other = i % 2 == 0 ? i + 1 : i - 1;  // The other pose of the same visit, in either
                                                           // order.
    EXPECT_EQ(record.check_poses[other].dwell.n + record.check_poses[i].dwell.n, 3);
    EXPECT_EQ(record.check_poses[i].dwell.role, DwellRole::kCheck);
  }
  EXPECT_EQ(stored.measured.size(), 47U);
  EXPECT_EQ(stored.dwells.size(), 47U);
  EXPECT_EQ(dwells_in_time(record).size(), 47U);
  EXPECT_EQ(dwells_in_time(record)[15], &record.check_poses[2].dwell);
  // Every output sees gravity / sqrt 3, within the mounting of the item (1 degree) and its offset (0.02).
  for (const CheckDwell& check : record.check_poses) EXPECT_NEAR(check.dwell.mean.norm(), 1.0, 0.1);
  EXPECT_EQ(joint(record).verdict, Verdict::kUsable) << joint(record).why;
}

TEST_F(CheckPosesTest, ALateChangeOfAGainIsFoundForEveryOutputPlacedAndSized) {
  for (int output = 0; output < 3; ++output) {
    SCOPED_TRACE(kOutputs[output]);
    SimulatedRun run = healthy(100 + static_cast<std::uint64_t>(output));
    let_change(run, {kLateInExperiment3, output, 2e-3, 0.0});
    const RunRecord record = measure(run);
    const auto study = study_check_poses(record);
    ASSERT_TRUE(study);
    ASSERT_EQ(study->found.size(), 1U);
    const PoseChange& found = study->found.front();
    EXPECT_EQ(found.kind, PoseChangeKind::kGain);
    EXPECT_EQ(found.accelerometer, output);
    EXPECT_EQ(found.after_visit, 2U);
    EXPECT_LT(found.standard_uncertainty, 2e-4);  // Step errors 1.4e-4 radian at every return.
    EXPECT_NEAR(found.size, 2e-3, 4.0 * found.standard_uncertainty);
    const CalibrationResult result = joint(record);
    EXPECT_EQ(result.verdict, Verdict::kDoubtful);
    EXPECT_THAT(result.why,
                AllOf(HasSubstr(fmt::format("the gain of {} changed by +0.", kOutputs[output])),
                      HasSubstr("before experiment 3, alpha = 0 degrees"), HasSubstr("those at the end")));
    CalibrationResult abc = analyse_abc(record);
    apply_checks(check_record(record), record, abc);
    EXPECT_EQ(abc.verdict, Verdict::kDoubtful);
  }
}

TEST_F(CheckPosesTest, WithoutThemTheOutputAlongTheAxisOfExperiment3ChangesUnseen) {
  SimulatedRun run = healthy(102);
  run.protocol.check_poses = false;
  let_change(run, {26 + 9, 2, 2e-3, 0.0});
  const RunRecord record = measure(run);
  EXPECT_EQ(joint(record).verdict, Verdict::kUsable) << joint(record).why;
  EXPECT_FALSE(study_check_poses(record));
  EXPECT_TRUE(check_pose_checks(record).empty());
}

TEST_F(CheckPosesTest, ALateChangeOfAnOffsetIsFoundForEveryOutput) {
  for (int output = 0; output < 3; ++output) {
    SCOPED_TRACE(kOutputs[output]);
    SimulatedRun run = healthy(200 + static_cast<std::uint64_t>(output));
    let_change(run, {kLateInExperiment3, output, 0.0, -1.5e-3});
    const auto study = study_check_poses(measure(run));
    ASSERT_TRUE(study);
    ASSERT_EQ(study->found.size(), 1U);
    const PoseChange& found = study->found.front();
    EXPECT_EQ(found.kind, PoseChangeKind::kOffset);
    EXPECT_EQ(found.accelerometer, output);
    EXPECT_EQ(found.after_visit, 2U);
    const double size = found.size * study->sensitivity[static_cast<std::size_t>(output)];
    EXPECT_NEAR(size, -1.5e-3, 4.0 * found.standard_uncertainty);
  }
}

TEST_F(CheckPosesTest, TwoChangesInTwoExperimentsAreToldApart) {
  SimulatedRun run = healthy(300);
  run.after_dwell = [](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells != 10 && dwells != kLateInExperiment3) return;
    sim::OutputTruth truth = world.output_truth(now);
    if (dwells == 10) truth.offset(0) += 3e-3;
    if (dwells != 10) truth.sensitivity_matrix.row(2) *= 1.002;
    world.change(truth, now);
  };
  const auto study = study_check_poses(measure(run));
  ASSERT_TRUE(study);
  ASSERT_EQ(study->found.size(), 2U);
  for (const PoseChange& found : study->found) {  // The most telling first, whichever that is.
    const bool offset = found.kind == PoseChangeKind::kOffset;
    EXPECT_EQ(found.accelerometer, offset ? 0 : 2);
    EXPECT_EQ(found.after_visit, offset ? 0U : 2U);
  }
  EXPECT_NE(study->found[0].kind, study->found[1].kind);
}

TEST_F(CheckPosesTest, ASlipIsATurnAndNoChangeOfGains) {
  SimulatedRun run = healthy(400);
  run.after_dwell = [](sim::SimBench& world, Clock::Instant now, std::size_t dwells) {
    if (dwells != kLateInExperiment3) return;
    sim::OutputTruth truth = world.output_truth(now);
    truth.sensitivity_matrix *=
        Eigen::AngleAxisd(-0.2 * 3.14159 / 180.0, Eigen::Vector3d(1, -1, 0).normalized()).toRotationMatrix();
    world.change(truth, now);
  };
  const auto study = study_check_poses(measure(run));
  ASSERT_TRUE(study);
  ASSERT_EQ(study->found.size(), 1U);
  EXPECT_EQ(study->found[0].kind, PoseChangeKind::kTurn);
  EXPECT_NEAR(study->found[0].size * 180.0 / 3.14159, 0.2, 4.0 * 0.012);  // zero and step, 0.008 each
}

TEST_F(CheckPosesTest, SoundRunsPassWithTheirDriftsAsStated) {
  expect_sound(4);
}

using LongCheckPosesTest = CheckPosesTest;

TEST_F(LongCheckPosesTest, NoneOf100SoundRunsIsMarked) {
  expect_sound(100);
}

TEST_F(CheckPosesTest, AVisitWithOnePoseOrWithoutUncertaintyIsLeftOut) {
  SimulatedRun run = healthy(500);
  RunRecord record = measure(run);
  record.check_poses[3].dwell.flags |= kFlagClipped;
  ASSERT_TRUE(study_check_poses(record));
  EXPECT_EQ(study_check_poses(record)->visits.size(), 3U);
  for (CheckDwell& check : record.check_poses) check.dwell.u_mean.reset();
  EXPECT_FALSE(study_check_poses(record));
  const std::vector<Check> checks = check_pose_checks(record);
  ASSERT_EQ(checks.size(), 1U);
  EXPECT_TRUE(checks.front().passed);
  EXPECT_THAT(checks.front().words, HasSubstr("not compared"));
}

}  // namespace
}  // namespace abcal
