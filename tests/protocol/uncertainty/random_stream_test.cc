#include "protocol/uncertainty/random_stream.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace abcal {
namespace {

// Known answers of philox4x32 with 10 rounds: Random123's kat_vectors.
TEST(RandomStreamTest, GivesThePublishedPhiloxNumbers) {
  const std::array<std::uint32_t, 4> zeros = RandomStream(0, StreamPurpose{0}, 0).bits(0);
  EXPECT_EQ(zeros, (std::array<std::uint32_t, 4>{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  const std::array<std::uint32_t, 4> ones =
      RandomStream(~std::uint64_t{0}, StreamPurpose{0xffffffff}, ~std::uint64_t{0}).bits(0xffffffff);
  EXPECT_EQ(ones, (std::array<std::uint32_t, 4>{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
}

TEST(RandomStreamTest, NormalsHaveTheMomentsAndTailsOfTheNormalDistribution) {
  constexpr int kN = 400'000;
  double sum = 0.0, squares = 0.0, cubes = 0.0, fourths = 0.0, products = 0.0, previous = 0.0;
  int beyond_2 = 0, beyond_3 = 0;
  RandomStream stream(7, StreamPurpose::kTest, 1);
  for (int i = 0; i < kN; ++i) {
    const double z = stream.normal();
    sum += z;
    squares += z * z;
    cubes += z * z * z;
    fourths += z * z * z * z;
    products += z * previous;
    previous = z;
    beyond_2 += std::abs(z) > 2.0 ? 1 : 0;
    beyond_3 += std::abs(z) > 3.0 ? 1 : 0;
  }
  const double n = kN;
  // Five standard deviations of each estimate: variances 1, 2, 15, 96 of z, z^2, z^3, z^4 and 1 of z z'.
  EXPECT_NEAR(sum / n, 0.0, 5.0 * std::sqrt(1.0 / n));
  EXPECT_NEAR(squares / n, 1.0, 5.0 * std::sqrt(2.0 / n));
  EXPECT_NEAR(cubes / n, 0.0, 5.0 * std::sqrt(15.0 / n));
  EXPECT_NEAR(fourths / n, 3.0, 5.0 * std::sqrt(96.0 / n));
  EXPECT_NEAR(products / n, 0.0, 5.0 * std::sqrt(1.0 / n));
  const double p2 = std::erfc(2.0 / std::sqrt(2.0)), p3 = std::erfc(3.0 / std::sqrt(2.0));
  EXPECT_NEAR(beyond_2 / n, p2, 5.0 * std::sqrt(p2 / n));
  EXPECT_NEAR(beyond_3 / n, p3, 5.0 * std::sqrt(p3 / n));
}

// The normals' own logarithm, sine and cosine against the C library's: Box and Muller undone.
TEST(RandomStreamTest, NormalsAreBoxAndMullersToAFewUnitsOfTheLastPlace) {
  const RandomStream stream(3, StreamPurpose::kTest, 5);
  for (std::uint32_t pair = 0; pair < 20'000; ++pair) {
    const std::array<std::uint32_t, 4> r = stream.bits(pair);
    const std::array<double, 2> z = stream.normal_pair(pair);
    const std::uint64_t a = (std::uint64_t{r[1]} << 32) | r[0];
    const double u = 1.0 - static_cast<double>(a >> 12) * 0x1p-52;
    const double radius = std::sqrt(-2.0 * std::log(u));
    EXPECT_NEAR(std::hypot(z[0], z[1]), radius, 2e-15 * radius);
    const std::uint64_t b = (std::uint64_t{r[3]} << 32) | r[2];
    const double angle = (static_cast<double>(b >> 12) * 0x1p-52 - 0.5) * std::acos(0.0);
    const bool swapped = (b & 2U) != 0;
    const double sine = swapped ? z[0] : z[1];
    const double cosine = swapped ? z[1] : z[0];
    EXPECT_NEAR(sine, radius * std::sin(angle), 2e-15 * radius);
    EXPECT_NEAR(std::abs(cosine), radius * std::cos(angle), 2e-15 * radius);
  }
}

TEST(RandomStreamTest, StreamsOfOtherSeedsPurposesAndTrialsAreOthers) {
  const double z = RandomStream(1, StreamPurpose::kTypeB, 10).normal();
  EXPECT_NE(z, RandomStream(2, StreamPurpose::kTypeB, 10).normal());
  EXPECT_NE(z, RandomStream(1, StreamPurpose::kTypeA, 10).normal());
  EXPECT_NE(z, RandomStream(1, StreamPurpose::kTypeB, 11).normal());
  EXPECT_NE(z, RandomStream(1, StreamPurpose::kTypeB, 10 + (std::uint64_t{1} << 32)).normal());
  EXPECT_EQ(z, RandomStream(1, StreamPurpose::kTypeB, 10).normal());
}

TEST(RandomStreamTest, UniformsFillTheOpenUnitInterval) {
  RandomStream stream(1, StreamPurpose::kTest, 0);
  double sum = 0.0;
  for (int i = 0; i < 100'000; ++i) {
    const double u = stream.uniform();
    ASSERT_GT(u, 0.0);
    ASSERT_LT(u, 1.0);
    sum += u;
  }
  EXPECT_NEAR(sum / 1e5, 0.5, 5.0 * std::sqrt(1.0 / 12.0 / 1e5));
}

}  // namespace
}  // namespace abcal
