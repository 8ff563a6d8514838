#include "protocol/plan/response_unit.h"

#include <gtest/gtest.h>

namespace abcal {
namespace {

TEST(ResponseUnitTest, AUnitOfAccelerationIsKnownInMetresPerSecondSquared) {
  EXPECT_EQ(acceleration_unit_mps2("g"), 9.80665);
  EXPECT_DOUBLE_EQ(*acceleration_unit_mps2("mg"), 9.80665e-3);
  EXPECT_DOUBLE_EQ(*acceleration_unit_mps2("ug"), 9.80665e-6);
  EXPECT_DOUBLE_EQ(*acceleration_unit_mps2("\u00b5g"), 9.80665e-6);
  for (const char* name : {"m/s2", "m/s^2", "m/s\u00b2"})
    EXPECT_EQ(acceleration_unit_mps2(name), 1.0) << name;
  for (const char* name : {"V", "LSB", "R", "", "mm/s2"}) EXPECT_FALSE(acceleration_unit_mps2(name)) << name;
}

// Powers of ten of one unit stay exact.
TEST(ResponseUnitTest, ARatioIsThatOfUnitsOfOneKind) {
  EXPECT_EQ(unit_ratio("V", "mV"), 1.0 / 1e-3);
  EXPECT_EQ(unit_ratio("g", "mg"), 1.0 / 1e-3);
  EXPECT_EQ(unit_ratio("counts", "LSB"), 1.0);
  EXPECT_DOUBLE_EQ(*unit_ratio("g", "m/s2"), 9.80665);
  EXPECT_FALSE(unit_ratio("V", "g"));
  EXPECT_FALSE(unit_ratio("R", "LSB"));
}

}  // namespace
}  // namespace abcal
