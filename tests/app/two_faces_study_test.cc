// Two faces on simulated benches: the uncertainties that the design promises, and whether the intervals hold.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <iostream>
#include <string_view>
#include <vector>

#include "app/results/analysis/analyses.h"
#include "app/studies/robustness/robustness_study.h"
#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/joint/joint_result.h"
#include "protocol/estimators/shared/intrinsic_properties.h"

namespace abcal {
namespace {

const Scenario& everything() {
  const std::vector<Scenario>& all = robustness_scenarios();
  return *std::ranges::find(all, "everything", &Scenario::name);
}

/// Mean squares of the stated u and of error / u over the outputs of a group, over the runs.
struct Group {
  double u2 = 0.0, z2 = 0.0;
  int count = 0;

  void add(double error, double u) {
    u2 += u * u;
    z2 += error * error / (u * u);
    ++count;
  }
  double rms_u() const { return std::sqrt(u2 / count); }
  double rms_z() const { return std::sqrt(z2 / count); }
};

struct Groups {
  Group s, offset, phi, stage_frame;
};

Eigen::Index place_of(const EffectFit& fit, std::string_view effect, int output) {
  const auto found = std::ranges::find_if(fit.unknowns, [&](const EffectUnknown& unknown) {
    return unknown.effect == effect && unknown.output == output;
  });
  return found - fit.unknowns.begin();
}

/// s_vz and s_wy in the frame of the stage, in which the X axis stands at its mean zero: turned by F_X from
/// that of the default orientation.
void add_stage_frame(const EffectFit& fit, const Eigen::Matrix3d& truth, Angle f_x, Group& group) {
  struct Element {
    int output, of, other;
    double sign;
  };
  for (const Element& e : {Element{1, 2, 1, 1.0}, Element{2, 1, 2, -1.0}}) {
    const Eigen::Index s = place_of(fit, "s", e.output), f = place_of(fit, "F_X", -1);
    const double size = fit.unit(e.output);
    const double found =
        fit.line(3 * e.output + e.of) + e.sign * fit.line(3 * e.output + e.other) * fit.value(f);
    const double variance = fit.covariance(s + e.of, s + e.of) + 2.0 * e.sign * fit.covariance(s + e.of, f) +
                            fit.covariance(f, f);
    const double right = truth(e.output, e.of) + e.sign * truth(e.output, e.other) * f_x.rad();
    group.add((found - right) / size, std::sqrt(variance));
  }
}

void add_run(std::uint64_t bench, int faces, int steps, Groups& groups) {
  Scenario scenario = everything();
  const auto effects = scenario.change;
  Angle f_x;
  scenario.change = [&](ScenarioBench& b, ScenarioDraw& draw) {
    effects(b, draw);
    b.faces = faces;
    b.steps = steps;
    f_x = b.truth.x.mean_step_error;
  };
  const SimulatedRun run = simulate_run(draw_bench(scenario, 41, bench));
  const ItemFit own = fit_item(run.record, {});
  ASSERT_TRUE(own.solution) << own.why;
  const CalibrationResult result = joint_result(run.record, own);
  const IntrinsicProperties truth = intrinsic_properties(run.truth.sensitivity_matrix);
  for (std::size_t j = 0; j < 3; ++j) {
    const auto row = static_cast<Eigen::Index>(j);
    const auto add = [](const Quantity& found, double right, Group& group) {
      group.add(found.value - right, found.standard_uncertainty);
    };
    add(result.intrinsic_sensitivity[j], truth.sensitivity(row), groups.s);
    add(result.intrinsic_angle[j], truth.angle_deg(row), groups.phi);
    add(result.offset[j], run.truth.offset(row), groups.offset);
  }
  add_stage_frame(own.solution->fit, run.truth.sensitivity_matrix, f_x, groups.stage_frame);
}

// The table of the design, row "two faces 6 x 36", is for noise of 1e-5 a mean and the default sizes. The
// coverage is that of 200 benches: the mean square of 600 ratios, of which the three of a bench are
// correlated, is known to sqrt(2/200) or better, its root to 5 %; three of these are allowed.
TEST(TwoFacesStudyTest, UncertaintiesAreThoseOfTheDesignAndErrorsAgreeWithThem) {
  Groups two, one;
  for (std::uint64_t bench = 0; bench < 200; ++bench) add_run(bench, 2, 72, two);
  for (std::uint64_t bench = 0; bench < 20; ++bench) add_run(bench, 1, 72, one);
  EXPECT_LE(two.s.rms_u(), 4.5e-6);
  EXPECT_LE(two.offset.rms_u(), 3.5e-5);
  EXPECT_LE(two.stage_frame.rms_u(), 4.5e-5);
  EXPECT_LE(two.phi.rms_u(), 2.8e-4);
  // One face with the same number of angles.
  EXPECT_GT(one.s.rms_u(), 1.5 * two.s.rms_u());
  EXPECT_GT(one.phi.rms_u(), 1.5 * two.phi.rms_u());
  EXPECT_NEAR(two.s.rms_z(), 1.0, 0.15);
  EXPECT_NEAR(two.offset.rms_z(), 1.0, 0.15);
  EXPECT_NEAR(two.stage_frame.rms_z(), 1.0, 0.15);
  EXPECT_NEAR(two.phi.rms_z(), 1.0, 0.15);
  std::cout
      << fmt::format(
             "u: s {:.2e}, O {:.2e}, s_vz and s_wy {:.2e}, phi {:.2e}; one face: s {:.2e}, phi {:.2e}\n",
             two.s.rms_u(), two.offset.rms_u(), two.stage_frame.rms_u(), two.phi.rms_u(), one.s.rms_u(),
             one.phi.rms_u())
      << fmt::format("rms z: s {:.2f}, O {:.2f}, s_vz and s_wy {:.2f}, phi {:.2f}\n", two.s.rms_z(),
                     two.offset.rms_z(), two.stage_frame.rms_z(), two.phi.rms_z());
}

// The five-minute plan: six angles in each circle, the second face shifted by 30 degrees.
TEST(TwoFacesStudyTest, TwelveAnglesThatInterleaveAreEnough) {
  Groups two, one;
  for (std::uint64_t bench = 0; bench < 100; ++bench) {
    add_run(bench, 2, 12, two);
    add_run(bench, 1, 12, one);
  }
  EXPECT_LT(two.s.rms_u(), 0.9 * one.s.rms_u());
  EXPECT_LT(two.phi.rms_u(), 0.6 * one.phi.rms_u());
  // As above, for 100 benches.
  EXPECT_NEAR(two.s.rms_z(), 1.0, 0.2);
  EXPECT_NEAR(two.phi.rms_z(), 1.0, 0.2);
}

/// The difference of the faces for an item and a stage without any error but those of `change`.
CalibrationResult abc_of(const std::function<void(ScenarioBench&)>& change, int faces = 2) {
  Scenario scenario{"two faces", "", ScenarioKind::kWithin, [&](ScenarioBench& b, ScenarioDraw&) {
                      sim::BenchTruth plain;
                      plain.sensitivity_matrix = b.truth.sensitivity_matrix;
                      plain.offset = b.truth.offset;
                      plain.seed = b.truth.seed;
                      b.truth = plain;
                      b.noise = 0.0;
                      b.faces = faces;
                      change(b);
                    }};
  return analyse_abc(simulate_run(draw_bench(scenario, 1, 1)).record);
}

TEST(TwoFacesAbcTest, OnAPerfectStageBothFacesGiveTheItem) {
  const CalibrationResult both = abc_of([](ScenarioBench&) {});
  const CalibrationResult one = abc_of([](ScenarioBench&) {}, 1);
  ASSERT_TRUE(both.faces);
  EXPECT_FALSE(one.faces);
  EXPECT_LT((both.sensitivity_values() - one.sensitivity_values()).cwiseAbs().maxCoeff(), 1e-12);
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_LT(std::abs(both.faces->difference.sensitivity_matrix[j][k].value), 1e-12);
      for (const LineResult& face : both.faces->face)
        EXPECT_NEAR(face.sensitivity_matrix[j][k].value, (*one.sensitivity_matrix)[j][k].value, 1e-12);
    }
    EXPECT_LT(std::abs(both.faces->difference.offset[j].value), 1e-12);
  }
}

// A tilt of the X axis turns the item by it in one face and back in the other: each face is off by it, their
// mean is not, and a tilt beyond its stated size makes the run doubtful.
TEST(TwoFacesAbcTest, ATiltedAxisIsInTheDifferenceAndNotInTheMean) {
  const CalibrationResult level = abc_of([](ScenarioBench&) {});
  const CalibrationResult tilted = abc_of([](ScenarioBench& b) { b.truth.xz = 0.01; });
  double largest_difference = 0.0, largest_change = 0.0;
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      const Quantity& difference = tilted.faces->difference.sensitivity_matrix[j][k];
      largest_difference = std::max(largest_difference, std::abs(difference.value));
      largest_change = std::max(largest_change, std::abs((*tilted.sensitivity_matrix)[j][k].value -
                                                         (*level.sensitivity_matrix)[j][k].value));
    }
  }
  EXPECT_GT(largest_difference, 0.005);
  EXPECT_LT(largest_change, 0.25 * largest_difference);
  EXPECT_EQ(tilted.verdict, Verdict::kDoubtful);
  EXPECT_THAT(tilted.diagnostics.notes,
              testing::Contains(testing::HasSubstr("of face 1 and of face 2 differ by")));
}

// The stated uncertainty of the difference and of each face are those of their errors.
TEST(TwoFacesAbcTest, ErrorsOfEachFaceAndOfTheDifferenceAgreeWithTheirUncertainties) {
  Group difference, of_face;
  for (std::uint64_t bench = 0; bench < 60; ++bench) {
    Scenario scenario = everything();
    const auto effects = scenario.change;
    scenario.change = [&](ScenarioBench& b, ScenarioDraw& draw) {
      effects(b, draw);
      b.faces = 2;
    };
    const SimulatedRun run = simulate_run(draw_bench(scenario, 43, bench));
    const CalibrationResult result = analyse_abc(run.record);
    ASSERT_TRUE(result.faces) << result.why;
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t k = 0; k < 3; ++k) {
        const Quantity& d = result.faces->difference.sensitivity_matrix[j][k];
        difference.add(d.value, d.standard_uncertainty);
        const double truth =
            run.truth.sensitivity_matrix(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(k));
        for (const LineResult& face : result.faces->face) {
          const Quantity& s = face.sensitivity_matrix[j][k];
          of_face.add(s.value - truth, s.standard_uncertainty);
        }
      }
    }
  }
  // 60 benches with nine correlated elements each: 540 ratios, at least 120 of them independent.
  EXPECT_NEAR(difference.rms_z(), 1.0, 0.2);
  EXPECT_NEAR(of_face.rms_z(), 1.0, 0.2);
}

}  // namespace
}  // namespace abcal
