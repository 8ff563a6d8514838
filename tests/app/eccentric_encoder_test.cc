// An encoder ring that is not centred, the commonest map of an axis: what covers it, and what is said where
// it is not stated.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <string>

#include "app/results/analysis/analyses.h"
#include "app/studies/robustness/robustness_study.h"

namespace abcal {
namespace {

using testing::HasSubstr;

constexpr int kBenches = 60;

/// The recipe of docs/effects.md for "accuracy 0.02 degrees", and an error with one period a turn on both
/// axes.
/// @param amplitude_deg  of that error, at a random phase
Scenario eccentric(double amplitude_deg, bool stated) {
  return {"eccentric", "", ScenarioKind::kWithin, [=](ScenarioBench& b, ScenarioDraw& draw) {
            b.steps = 36;
            b.stated.initial_turn = b.stated.zero = Angle::degrees(0.0115);
            b.stated.step = Angle::degrees(0.008);
            b.stated.step_smooth = Angle::degrees(0.0033);
            if (stated) b.stated.step_eccentric = Angle::degrees(0.02 / std::numbers::sqrt2);
            for (sim::AxisTruth* axis : {&b.truth.x, &b.truth.z}) {
              const double phase = 2.0 * std::numbers::pi * draw.uniform();
              axis->harmonics.push_back({1, Angle::degrees(amplitude_deg * std::sin(phase)),
                                         Angle::degrees(amplitude_deg * std::cos(phase))});
            }
          }};
}

struct Found {
  int usable = 0, named = 0;
  double square = 0.0;   ///< Squares of error / u of the offsets, summed over the runs.
  double largest = 0.0;  ///< Error over u, of the runs that are called usable.
  double rms_z() const { return std::sqrt(square / (3.0 * kBenches)); }
};

Found find(const Scenario& scenario) {
  Found found;
  for (std::uint64_t bench = 0; bench < kBenches; ++bench) {
    const SimulatedRun run = simulate_run(draw_bench(scenario, 3, bench));
    const CalibrationResult result = analyse(run.record, "joint");
    const bool usable = result.verdict == Verdict::kUsable;
    found.usable += usable ? 1 : 0;
    found.named += result.why.english().find("eccentricity of") != std::string::npos ? 1 : 0;
    for (int j = 0; j < 3; ++j) {
      const Quantity& offset = result.offset[static_cast<std::size_t>(j)];
      const double z = (offset.value - run.truth.offset[j]) / offset.standard_uncertainty;
      found.square += z * z;
      if (usable) found.largest = std::max(found.largest, std::abs(z));
    }
  }
  ::testing::Test::RecordProperty("usable", found.usable);
  ::testing::Test::RecordProperty("named", found.named);
  ::testing::Test::RecordProperty("rms_z", std::to_string(found.rms_z()));
  ::testing::Test::RecordProperty("largest", std::to_string(found.largest));
  return found;
}

// The item of these benches is linear, so that u has more in it than they do.
TEST(EccentricEncoderTest, WhatIsStatedIsCovered) {
  const Found found = find(eccentric(0.02, true));
  EXPECT_EQ(found.usable, kBenches);
  EXPECT_LT(found.rms_z(), 1.0);
  EXPECT_LT(found.largest, 3.0);
  EXPECT_EQ(found.named, 0);
}

// The same benches by sizes of six equal orders: what the statement is for.
TEST(EccentricEncoderTest, WithoutTheStatementTheOffsetsAreOff) {
  const Found found = find(eccentric(0.02, false));
  EXPECT_GT(found.rms_z(), 1.5);
}

TEST(EccentricEncoderTest, WhatIsNotStatedIsNamedBeforeTheOffsetsAreFarOff) {
  const Found found = find(eccentric(0.04, false));
  EXPECT_EQ(found.usable, 0);
  EXPECT_EQ(found.named, kBenches);
}

}  // namespace
}  // namespace abcal
