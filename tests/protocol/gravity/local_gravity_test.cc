#include "protocol/gravity/local_gravity.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace abcal {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

struct Listed {
  double latitude_deg, height_m, grs80, wgs84, welmec, npl;
};

// docs/theory/gravity.md, ten decimals; the first and third rows are the published ge and gp, the second the
// published GRS80 gamma45 = 9.806199203.
constexpr std::array<Listed, 6> kListed{{
    {0, 0, 9.7803267715, 9.7803253359, 9.7803180000, 9.7803270000},
    {45, 0, 9.8061992025, 9.8061977694, 9.8061908532, 9.8061998770},
    {90, 0, 9.8321863685, 9.8321849379, 9.8321771582, 9.8321862059},
    {52.3, 80, 9.8124921225, 9.8124906900, 9.8124837099, 9.8124926597},
    {45, 1000, 9.8031143762, 9.8031129436, 9.8031058532, 9.8031138770},
    {39.1333, 130, 9.8005274050, 9.8005259715, 9.8005191595, 9.8005280484},
}};
constexpr double kHalfLastDigit = 0.5e-10;

TEST(LocalGravityTest, GivesTheListedValuesToEveryDigit) {
  for (const Listed& row : kListed) {
    const Angle latitude = Angle::degrees(row.latitude_deg);
    EXPECT_NEAR(formula_gravity(latitude, row.height_m, GravityFormula::kGrs80).value_mps2, row.grs80,
                kHalfLastDigit);
    EXPECT_NEAR(formula_gravity(latitude, row.height_m, GravityFormula::kWgs84).value_mps2, row.wgs84,
                kHalfLastDigit);
    EXPECT_NEAR(formula_gravity(latitude, row.height_m, GravityFormula::kWelmec).value_mps2, row.welmec,
                kHalfLastDigit);
    EXPECT_NEAR(formula_gravity(latitude, row.height_m, GravityFormula::kNpl).value_mps2, row.npl,
                kHalfLastDigit);
    EXPECT_EQ(formula_gravity(-latitude, row.height_m).value_mps2,
              formula_gravity(latitude, row.height_m).value_mps2);
  }
}

TEST(LocalGravityTest, UncertaintyCoversTheSurveyAtGaithersburg) {
  const FormulaGravity gravity = formula_gravity(Angle::degrees(39.1333), 130.0);
  EXPECT_NEAR(gravity.half_width_mps2, 5e-5 * gravity.value_mps2, 1e-15);
  EXPECT_NEAR(gravity.standard_uncertainty_mps2, 2.8e-4, 0.05e-4);  // docs/theory/gravity.md
  EXPECT_LT(std::abs(gravity.value_mps2 - 9.80101), gravity.half_width_mps2);
}

TEST(LocalGravityTest, SaysWhereItComesFromAndWarns) {
  const FormulaGravity gravity = formula_gravity(Angle::degrees(52.3), 80.0, GravityFormula::kWelmec);
  EXPECT_THAT(gravity.source, HasSubstr("WELMEC"));
  EXPECT_THAT(gravity.source, HasSubstr("52.3"));
  EXPECT_THAT(gravity.source, HasSubstr("80"));
  EXPECT_THAT(gravity.warning, HasSubstr("survey"));
}

TEST(LocalGravityTest, RefusesPlacesThatAreNotOnTheGround) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(formula_gravity(Angle::degrees(90.1), 0.0), std::invalid_argument);
  EXPECT_THROW(formula_gravity(Angle::degrees(nan), 0.0), std::invalid_argument);
  EXPECT_THROW(formula_gravity(Angle::degrees(0.0), nan), std::invalid_argument);
  EXPECT_THROW(formula_gravity(Angle::degrees(0.0), 12000.0), std::invalid_argument);
}

TEST(LocalGravityTest, NamesBothProblemsAtOnce) {
  try {
    formula_gravity(Angle::degrees(91.0), 1e6);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("latitude 91"), HasSubstr("-90 to 90"),
                                    HasSubstr("height 1000000"), HasSubstr("-500 to 9000")));
  }
}

}  // namespace
}  // namespace abcal
