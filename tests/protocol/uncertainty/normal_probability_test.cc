#include "protocol/uncertainty/normal_probability.h"

#include <gtest/gtest.h>

namespace abcal {
namespace {

// Abramowitz and Stegun, tables 26.1 and 26.2, and mpmath's ncdf with 40 digits.
TEST(NormalProbabilityTest, KeepsItsDigitsInBothTails) {
  constexpr double kDigits = 1e-14;
  EXPECT_EQ(normal_below(0.0), 0.5);
  EXPECT_NEAR(normal_below(1.0) / 0.84134474606854293, 1.0, kDigits);
  EXPECT_NEAR(normal_below(-1.0) / 0.15865525393145705, 1.0, kDigits);
  EXPECT_NEAR(normal_below(-5.0) / 2.8665157187919391e-7, 1.0, kDigits);
  EXPECT_NEAR(normal_below(-10.0) / 7.6198530241605261e-24, 1.0, 1e-13);
  EXPECT_NEAR(normal_below(-30.0) / 4.9067139271484e-198, 1.0, 1e-12);
}

}  // namespace
}  // namespace abcal
