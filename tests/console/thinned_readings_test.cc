// Readings thinned out for a chart: nothing that stands out is lost, and their number has a bound.

#include "app/console/thinned_readings.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

namespace abcal::console {
namespace {

std::vector<StoredReading> readings(std::size_t count, double first_s) {
  std::vector<StoredReading> list(count);
  for (std::size_t i = 0; i < count; ++i) {
    list[i].time_s = first_s + 0.001 * static_cast<double>(i);
    list[i].output = {1.0, -2.0, std::sin(static_cast<double>(i))};
  }
  return list;
}

TEST(ThinnedReadingsTest, FewReadingsStayAsTheyAre) {
  ThinnedReadings thinned(1, 100);
  thinned.add(readings(150, 5.0));
  ASSERT_EQ(thinned.points().size(), 150U);
  EXPECT_DOUBLE_EQ(thinned.points()[149].time_s, 5.149);
  EXPECT_EQ(thinned.points()[7].lowest, thinned.points()[7].highest);
}

TEST(ThinnedReadingsTest, AMillionReadingsAreAThousandPointsAndASpikeIsAmongThem) {
  constexpr std::size_t kDwells = 1080, kEach = 926, kColumns = 1200;
  ThinnedReadings thinned(kDwells, kColumns);
  for (std::size_t k = 0; k < kDwells; ++k) {
    auto dwell = readings(kEach, static_cast<double>(k));
    if (k == 700) dwell[333].output[1] = 9.0;
    thinned.add(dwell);
  }
  EXPECT_EQ(thinned.count(), kDwells * kEach);
  EXPECT_GE(thinned.count(), 1000000U);
  EXPECT_LE(thinned.points().size(), 2 * kColumns);
  int spikes = 0;
  for (const auto& point : thinned.points()) {
    EXPECT_EQ(point.lowest[1], -2.0);
    if (point.highest[1] == 9.0) ++spikes;
  }
  EXPECT_EQ(spikes, 1);
}

TEST(ThinnedReadingsTest, MoreDwellsThanColumnsAreJoined) {
  ThinnedReadings thinned(1000, 100);
  for (std::size_t k = 0; k < 1000; ++k) thinned.add(readings(50, static_cast<double>(k)));
  ASSERT_EQ(thinned.points().size(), 100U);
  EXPECT_NEAR(thinned.points()[1].time_s, 14.5, 0.1);
}

TEST(ThinnedReadingsTest, WhatIsNoNumberIsLeftOut) {
  ThinnedReadings thinned(1, 1);
  auto dwell = readings(10, 0.0);
  dwell[3].output[0] = std::numeric_limits<double>::quiet_NaN();
  thinned.add(dwell);
  thinned.add({});
  ASSERT_EQ(thinned.points().size(), 1U);
  EXPECT_EQ(thinned.points()[0].lowest[0], 1.0);
  EXPECT_EQ(thinned.count(), 10U);
}

}  // namespace
}  // namespace abcal::console
