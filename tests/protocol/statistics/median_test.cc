#include "protocol/statistics/median.h"

#include <gtest/gtest.h>

namespace abcal {
namespace {

TEST(MedianTest, IsTheValueInTheMiddleAndTheUpperOfTwo) {
  EXPECT_EQ(median({3.0}), 3.0);
  EXPECT_EQ(median({5.0, 1.0, 2.0}), 2.0);
  EXPECT_EQ(median({4.0, 1.0, 3.0, 2.0}), 3.0);
}

}  // namespace
}  // namespace abcal
