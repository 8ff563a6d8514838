#include "app/document/number_text.h"

#include <gtest/gtest.h>

namespace abcal {
namespace {

TEST(NumberTextTest, PowersOfTenAreTypeset) {
  EXPECT_EQ(typeset_numbers("1.2e-05"), "1.2 × 10⁻⁵");
  EXPECT_EQ(typeset_numbers("1,2e-05, 3,4"), "1,2 × 10⁻⁵, 3,4");
  EXPECT_EQ(typeset_numbers("-3.0e-12 ± 1.0e-13"), "−3.0 × 10⁻¹² ± 1.0 × 10⁻¹³");
  EXPECT_EQ(typeset_numbers("+4e+10"), "+4 × 10¹⁰");
  EXPECT_EQ(typeset_numbers("1.0e+00"), "1.0");
  EXPECT_EQ(typeset_numbers("-1,2e-05"), "−1,2 × 10⁻⁵");
  EXPECT_EQ(typeset_numbers("constant to 3.1e-06 (rms), -90 degrees"),
            "constant to 3.1 × 10⁻⁶ (rms), −90 degrees");
}

TEST(NumberTextTest, NamesDatesAndRangesStay) {
  for (const char* text :
       {"", "-", "2026-11-25 10:00:00 UTC", "SN-12e-05x", "x1e-05", "1e-05b", "harmonics 2-5", "A1+B3",
        "k2, k3", "1.0.0", "12e", "db08c5993f8e", "f_1(1..72)", "1,2", "1, 2"})
    EXPECT_EQ(typeset_numbers(text), text);
}

TEST(NumberTextTest, AZeroHasNoSign) {
  EXPECT_EQ(without_negative_zero("-0.0"), "0.0");
  EXPECT_EQ(without_negative_zero("-0.00e+00"), "0.00e+00");
  EXPECT_EQ(without_negative_zero("-0.1"), "-0.1");
  EXPECT_EQ(without_negative_zero("-"), "-");
  EXPECT_EQ(without_negative_zero("+0.0"), "+0.0");
}

TEST(NumberTextTest, TheSecondDigitIsThatOfTheRoundedNumber) {
  EXPECT_EQ(place_of_second_digit(0.0123), -3);
  EXPECT_EQ(place_of_second_digit(0.0994), -3);
  EXPECT_EQ(place_of_second_digit(0.0996), -2);
  EXPECT_EQ(place_of_second_digit(120.0), 1);
}

TEST(NumberTextTest, PowersAlone) {
  EXPECT_EQ(power_of_ten(-6), "10⁻⁶");
  EXPECT_EQ(power_of_ten(12), "10¹²");
  EXPECT_EQ(power_of_ten(0), "1");
}

}  // namespace
}  // namespace abcal
