#include "app/laboratory/certificate/derived.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <random>
#include <stdexcept>

#include "app/laboratory/certificate/stated_result.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr double kU = 1e-4;

/// A result with these outputs and a full covariance; g_loc 9.81 with u_rel = 3e-5.
CalibrationResult result_of(const Eigen::Matrix3d& s, const Eigen::Vector3d& offset, double g = 9.81) {
  CalibrationResult result;
  result.verdict = Verdict::kUsable;
  result.response_unit = "V";
  result.g_loc.value = g;
  result.g_loc.standard_uncertainty = 3e-5 * g;
  const IntrinsicProperties intrinsic = intrinsic_properties(s);
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  Covariance12 root = Covariance12::NullaryExpr([&] { return kU * normal(random); });
  result.covariance = root * root.transpose();
  result.covariance_type_a = 0.25 * *result.covariance;
  result.covariance_type_b = 0.75 * *result.covariance;
  result.sensitivity_matrix.emplace();
  for (std::size_t j = 0; j < 3; ++j) {
    const auto row = static_cast<Eigen::Index>(j);
    for (std::size_t k = 0; k < 3; ++k) {
      Quantity& q = (*result.sensitivity_matrix)[j][k];
      const auto i = static_cast<Eigen::Index>(3 * j + k);
      q.value = s(row, static_cast<Eigen::Index>(k));
      q.standard_uncertainty = std::sqrt((*result.covariance)(i, i));
      q.unit = "V/g_loc";
    }
    result.offset[j].value = offset(row);
    result.offset[j].unit = "V";
    result.intrinsic_sensitivity[j].value = intrinsic.sensitivity(row);
    result.intrinsic_sensitivity[j].unit = "V/g_loc";
    result.intrinsic_angle[j].value = intrinsic.angle_deg(row);
    result.intrinsic_angle[j].unit = "degree";
  }
  return result;
}

const Eigen::Matrix3d kMatrix{{1.0021, -0.047, 0.037}, {0.069, 0.9982, 0.086}, {-0.0117, 0.064, -1.0009}};
const Eigen::Vector3d kOffset{0.0054, -0.0183, 0.0226};

std::map<std::string, DerivedQuantity> by_name(const CalibrationResult& result,
                                               const std::vector<SensitivityUnit>& units = {}) {
  std::map<std::string, DerivedQuantity> all;
  for (const DerivedGroup& group : derive(result, {.units = units}))
    for (const DerivedQuantity& quantity : group.quantities)
      all.emplace(quantity.name + " " + quantity.value.unit, quantity);
  return all;
}

// Every derivative against central differences, of all quantities at once.
TEST(DerivedTest, GradientsAreThoseOfCentralDifferences) {
  const auto exact = by_name(result_of(kMatrix, kOffset));
  ASSERT_EQ(exact.size(), 9U + 3U + 3U + 3U + 3U + 3U + 3U);
  for (int input = 0; input < 13; ++input) {
    constexpr double kStep = 1e-6;
    const auto moved = [&](double by) {
      Eigen::Matrix3d s = kMatrix;
      Eigen::Vector3d offset = kOffset;
      double g = 9.81;
      if (input < 9) s(input / 3, input % 3) += by;
      if (input >= 9 && input < 12) offset(input - 9) += by;
      if (input == 12) g += by;
      return by_name(result_of(s, offset, g));
    };
    const auto up = moved(kStep), down = moved(-kStep);
    for (const auto& [name, quantity] : exact) {
      const double difference = (up.at(name).value.value - down.at(name).value.value) / (2.0 * kStep);
      // Rounding of the difference, 1e-16 x value / step, and its third order, value x step^2.
      const double allowed =
          1e-8 * std::max(1.0, std::abs(quantity.value.value)) + 1e-8 * std::abs(difference);
      EXPECT_NEAR(quantity.gradient[input], difference, allowed) << name << " by input " << input;
    }
  }
}

TEST(DerivedTest, ValuesByHand) {
  const auto all = by_name(result_of(kMatrix, kOffset));
  const double su = kMatrix.row(0).norm();
  EXPECT_NEAR(all.at("intrinsic_sensitivity_u V/(m/s2)").value.value, su / 9.81, 1e-16);
  EXPECT_NEAR(all.at("sensitivity_vz V/(m/s2)").value.value, 0.086 / 9.81, 1e-17);
  EXPECT_NEAR(all.at("transverse_sensitivity_u %").value.value, 100.0 * std::hypot(0.047, 0.037) / 1.0021,
              1e-13);
  // The axis of w points down: its transverse sensitivity and misalignment are those about that axis.
  EXPECT_NEAR(all.at("misalignment_w mrad").value.value, 1e3 * std::atan(std::hypot(0.0117, 0.064) / 1.0009),
              1e-12);
  EXPECT_NEAR(all.at("transverse_azimuth_u degree").value.value, std::atan2(0.037, -0.047) * 180.0 / M_PI,
              1e-12);
  EXPECT_NEAR(all.at("transverse_azimuth_v degree").value.value, std::atan2(0.069, 0.086) * 180.0 / M_PI,
              1e-12);
  EXPECT_NEAR(all.at("bias_v mg").value.value, -0.0183 / kMatrix.row(1).norm() * 9.81 / 9.80665e-3, 1e-12);
  const double phi = intrinsic_properties(kMatrix).angle_deg(0);
  EXPECT_NEAR(all.at("non_orthogonality_uv mrad").value.value, (phi - 90.0) * M_PI / 180.0 * 1e3, 1e-11);
}

TEST(DerivedTest, LocalGravityEntersWhatIsPerMetreAndSecond) {
  const auto all = by_name(result_of(kMatrix, kOffset));
  const DerivedQuantity& s = all.at("intrinsic_sensitivity_u V/(m/s2)");
  const double by_gravity = 3e-5 * s.value.value;
  const Eigen::Matrix<double, 12, 1> g = s.gradient.head<12>();
  const double of_outputs = g.dot(*result_of(kMatrix, kOffset).covariance * g);
  EXPECT_NEAR(s.value.standard_uncertainty, std::sqrt(of_outputs + by_gravity * by_gravity), 1e-18);
  EXPECT_NEAR(*s.value.type_a, std::sqrt(0.25 * of_outputs), 1e-18);
  EXPECT_NEAR(*s.value.type_b, std::sqrt(0.75 * of_outputs + by_gravity * by_gravity), 1e-18);
  // Not where a ratio of outputs is asked for.
  EXPECT_EQ(all.at("transverse_sensitivity_u %").gradient[12], 0.0);
  EXPECT_EQ(all.at("misalignment_u mrad").gradient[12], 0.0);
  EXPECT_EQ(all.at("non_orthogonality_uv mrad").gradient[12], 0.0);
}

TEST(DerivedTest, NonOrthogonalityDoesNotChangeWithTheMounting) {
  const Eigen::Matrix3d turned =
      kMatrix * Eigen::AngleAxisd(0.7, Eigen::Vector3d(1.0, 2.0, -0.5).normalized()).toRotationMatrix();
  const auto here = by_name(result_of(kMatrix, kOffset)), there = by_name(result_of(turned, kOffset));
  for (const std::string name : {"non_orthogonality_uv mrad", "non_orthogonality_vw mrad", "bias_u mg",
                                 "intrinsic_sensitivity_w V/(m/s2)"})
    EXPECT_NEAR(here.at(name).value.value, there.at(name).value.value, 1e-11) << name;
  EXPECT_GT(
      std::abs(here.at("misalignment_u mrad").value.value - there.at("misalignment_u mrad").value.value),
      1.0);
}

// Seen in version 1.1: mounted "y z x", an item had a transverse sensitivity of 2.7e4 %, and failed.
TEST(DerivedTest, WhatDependsOnTheMountingIsAboutTheStatedOne) {
  const auto as_built = by_name(result_of(kMatrix, kOffset));
  for (const char* mounting : {"y z x", "z x y", "-y x z", "x -z y", "-z -x y", "x -y -z"}) {
    const Eigen::Matrix3d directions = mounting_matrix(mounting).value();
    const CalibrationResult mounted = result_of(kMatrix * directions, kOffset);
    for (const DerivedGroup& group : derive(mounted, {.mounting = directions}))
      for (const DerivedQuantity& quantity : group.quantities) {
        if (group.name == "sensitivity") continue;
        const DerivedQuantity& same = as_built.at(quantity.name + " " + quantity.value.unit);
        EXPECT_NEAR(quantity.value.value, same.value.value, 1e-9 * (1.0 + std::abs(same.value.value)))
            << quantity.name << " mounted " << mounting;
      }
  }
}

// Whether the readings tell a direction does not change by chance: near zero both components count.
TEST(DerivedTest, ASmallTransverseSensitivityHasTheUncertaintyOfBothComponents) {
  Eigen::Matrix3d s = Eigen::Matrix3d::Identity();
  const CalibrationResult at_zero = result_of(s, kOffset);
  const auto& row = (*at_zero.sensitivity_matrix)[0];
  const double both = std::hypot(row[1].standard_uncertainty, row[2].standard_uncertainty);
  for (const double part : {0.0, 0.01, 1.9}) {
    s(0, 1) = part * both;
    const auto all = by_name(result_of(s, kOffset));
    EXPECT_NEAR(all.at("transverse_sensitivity_u %").value.standard_uncertainty, 100.0 * both, 1e-2 * both);
    EXPECT_NEAR(all.at("misalignment_u mrad").value.standard_uncertainty, 1e3 * both, both);
    EXPECT_TRUE(std::isnan(all.at("transverse_azimuth_u degree").value.value)) << part;
  }
  s(0, 1) = 10.0 * both;
  const auto all = by_name(result_of(s, kOffset));
  EXPECT_NEAR(all.at("transverse_sensitivity_u %").value.standard_uncertainty,
              100.0 * row[1].standard_uncertainty, both);  // first order in s_uz, which is 0
  EXPECT_FALSE(std::isnan(all.at("transverse_azimuth_u degree").value.value));
}

TEST(DerivedTest, AnAxisWithoutTransverseSensitivityHasNoAzimuthButAnUncertainty) {
  const CalibrationResult result = result_of(Eigen::Matrix3d::Identity(), kOffset);
  const auto all = by_name(result);
  const auto& row = (*result.sensitivity_matrix)[0];
  EXPECT_EQ(all.at("transverse_sensitivity_u %").value.value, 0.0);
  EXPECT_NEAR(all.at("transverse_sensitivity_u %").value.standard_uncertainty,
              100.0 * std::hypot(row[1].standard_uncertainty, row[2].standard_uncertainty), 1e-15);
  EXPECT_TRUE(std::isnan(all.at("transverse_azimuth_u degree").value.value));
}

TEST(DerivedTest, UnitsThatACustomerAsksFor) {
  const CalibrationResult result = result_of(kMatrix, kOffset);
  const auto all = by_name(result, {sensitivity_unit("mV/g_n", "V"), sensitivity_unit("uV/(m/s2)", "V")});
  const double per_mps2 = kMatrix.row(0).norm() / 9.81;
  EXPECT_NEAR(all.at("intrinsic_sensitivity_u mV/g_n").value.value, per_mps2 * 9.80665 * 1e3, 1e-9);
  EXPECT_NEAR(all.at("intrinsic_sensitivity_u uV/(m/s2)").value.value, per_mps2 * 1e6, 1e-6);
  EXPECT_EQ(sensitivity_unit("LSB/g_n", "counts").output_factor, 1.0);
  EXPECT_DOUBLE_EQ(sensitivity_unit("mg/g_n", "g").output_factor, 1e3);
  EXPECT_THROW(sensitivity_unit("mV/g_n", "LSB"), std::invalid_argument);
  EXPECT_THROW(sensitivity_unit("mV/g", "V"), std::invalid_argument);  // Standard or local gravity.
  EXPECT_THROW(sensitivity_unit("mV", "V"), std::invalid_argument);
  EXPECT_THROW(sensitivity_unit("mV/s", "V"), std::invalid_argument);
}

TEST(DerivedTest, EveryNameThatLimitsMayUseIsThere) {
  const CalibrationResult result = result_of(kMatrix, kOffset);
  const StatedResult stated = stated_result(result);
  for (const std::string& name : names_of_quantities()) EXPECT_TRUE(stated_quantity(stated, name)) << name;
  EXPECT_EQ(stated_quantity(stated, "intrinsic_sensitivity_u")->unit, "V/(m/s2)");
  EXPECT_FALSE(stated_quantity(stated, "intrinsic_sensitivity_x"));
}

TEST(DerivedTest, NothingFromAResultWithoutMatrixOrGravity) {
  CalibrationResult result = result_of(kMatrix, kOffset);
  result.g_loc = Quantity{};
  EXPECT_THROW(derive(result), std::invalid_argument);
  EXPECT_THROW(derive(CalibrationResult{}), std::invalid_argument);
}

// A larger U by Monte Carlo takes the place of the result's own, in every unit; none becomes smaller.
TEST(StatedResultTest, ALargerUByMonteCarloIsStated) {
  CalibrationResult result = result_of(kMatrix, kOffset);
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(kMatrix);
  result.covariance_intrinsic = jacobian * *result.covariance * jacobian.transpose();
  const auto u_of = [&](Eigen::Index i) { return std::sqrt((*result.covariance_intrinsic)(i, i)); };
  for (std::size_t j = 0; j < 3; ++j) {
    const auto i = static_cast<Eigen::Index>(j);
    result.intrinsic_sensitivity[j].standard_uncertainty = u_of(i);
    result.intrinsic_angle[j].standard_uncertainty = u_of(3 + i);
    result.offset[j].standard_uncertainty = std::sqrt((*result.covariance)(9 + i, 9 + i));
  }
  CertifiedUncertainty made;
  made.mean_squares.topLeftCorner<12, 12>() = *result.covariance;
  for (CertifiedExpanded& one : made.outputs) one = {1.0, {1.0, 1.0}};
  const StatedResult before = stated_result(result);
  const auto same = stated_result(result, {.monte_carlo = &made});
  EXPECT_EQ(*same.result.covariance, *result.covariance);

  const double s_ux = 3.0 * (*result.sensitivity_matrix)[0][0].standard_uncertainty;
  const double phi_vw = 2.0 * result.intrinsic_angle[1].standard_uncertainty;
  made.outputs[0] = {1.0, {2.0 * s_ux, 2.0}};
  made.outputs[kFirstIntrinsicAngle + 1] = {1.0, {2.0 * phi_vw, 2.0}};
  const StatedResult after = stated_result(result, {.monte_carlo = &made});
  EXPECT_NEAR((*after.result.sensitivity_matrix)[0][0].standard_uncertainty / s_ux, 1.0, 1e-9);
  EXPECT_NEAR(std::sqrt((*after.result.covariance)(0, 0)) / s_ux, 1.0, 1e-9);
  EXPECT_GE(after.result.intrinsic_angle[1].standard_uncertainty, phi_vw * (1.0 - 1e-9));
  EXPECT_GE(stated_quantity(after, "non_orthogonality_vw")->standard_uncertainty,
            2.0 * (1.0 - 1e-9) * stated_quantity(before, "non_orthogonality_vw")->standard_uncertainty);
  for (const char* name : {"sensitivity_vy", "intrinsic_sensitivity_w", "intrinsic_angle_uv", "offset_w"})
    EXPECT_GE(stated_quantity(after, name)->standard_uncertainty,
              (1.0 - 1e-9) * stated_quantity(before, name)->standard_uncertainty)
        << name;
}

}  // namespace
}  // namespace abcal
