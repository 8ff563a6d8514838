#include "protocol/estimators/shared/arrivals.h"

#include <gtest/gtest.h>

#include <numbers>

namespace abcal {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

DwellRecord at(int experiment, double x_deg, double z_deg) {
  DwellRecord dwell;
  dwell.experiment = experiment;
  dwell.commanded_x = Angle::degrees(x_deg);
  dwell.commanded_z = Angle::degrees(z_deg);
  return dwell;
}

RunRecord record_of(std::vector<DwellRecord> dwells) {
  RunRecord record;
  record.dwells = std::move(dwells);
  record.axes_order = AxesOrder::kXThenZ;
  record.approach = Angle::degrees(1.0);
  return record;
}

std::vector<ReadingArrival> arrivals_of(const RunRecord& record) {
  std::vector<const DwellRecord*> all;
  for (const DwellRecord& dwell : record.dwells) all.push_back(&dwell);
  return arrivals_at(record, all);
}

void expect_leg(const StageLeg& leg, bool about_x, double from_deg, double to_deg, double other_deg) {
  EXPECT_EQ(leg.about_x, about_x);
  EXPECT_NEAR(leg.from, from_deg * kDegree, 1e-12);
  EXPECT_NEAR(leg.to, to_deg * kDegree, 1e-12);
  EXPECT_NEAR(leg.other, other_deg * kDegree, 1e-12);
}

TEST(ArrivalsTest, TheWayToTheFirstDwellIsNotKnown) {
  const auto found = arrivals_of(record_of({at(1, 0, 0), at(1, 5, 0)}));
  EXPECT_FALSE(found[0].arrival.since_reading_before);
  EXPECT_TRUE(found[0].arrival.legs.empty());
  ASSERT_EQ(found[1].arrival.legs.size(), 1U);
  EXPECT_TRUE(found[1].arrival.since_reading_before);
  expect_leg(found[1].arrival.legs[0], true, 0, 5, 0);
}

TEST(ArrivalsTest, XMovesThenZEachFromBelow) {
  const auto found = arrivals_of(record_of({at(1, 355, 0), at(2, 0, -90)}));
  const std::vector<StageLeg>& legs = found[1].arrival.legs;
  ASSERT_EQ(legs.size(), 4U);
  expect_leg(legs[0], true, 355, -1, 0);
  expect_leg(legs[1], true, -1, 0, 0);
  expect_leg(legs[2], false, 0, -91, 0);
  expect_leg(legs[3], false, -91, -90, 0);
}

TEST(ArrivalsTest, CheckPosesAreOnTheWay) {
  RunRecord record = record_of({at(1, 10, 0), at(2, 20, 30)});
  record.check_poses.push_back({at(0, 15, 0), 1});
  const auto found = arrivals_of(record);
  const std::vector<StageLeg>& legs = found[1].arrival.legs;
  ASSERT_EQ(legs.size(), 3U);
  expect_leg(legs[0], true, 10, 15, 0);
  expect_leg(legs[1], true, 15, 20, 0);
  expect_leg(legs[2], false, 0, 30, 20);
}

TEST(ArrivalsTest, ADwellLeftOutIsOnTheWay) {
  const RunRecord record = record_of({at(1, 0, 0), at(1, 5, 0), at(1, 10, 0)});
  const auto found =
      arrivals_at(record, std::vector<const DwellRecord*>{&record.dwells[0], &record.dwells[2]});
  ASSERT_EQ(found.size(), 2U);
  EXPECT_EQ(found[1].arrival.legs.size(), 2U);
}

TEST(ArrivalsTest, WithoutAStatedOrderOnlyOneRisingAxisIsKnown) {
  RunRecord record = record_of({at(1, 0, 0), at(1, 5, 0), at(1, 3, 0), at(1, 6, -90), at(1, 7, -90)});
  record.axes_order.reset();
  record.approach.reset();
  const auto found = arrivals_of(record);
  EXPECT_EQ(found[1].arrival.legs.size(), 1U);
  EXPECT_FALSE(found[2].arrival.since_reading_before);
  EXPECT_FALSE(found[3].arrival.since_reading_before);
  EXPECT_TRUE(found[3].arrival.legs.empty());
  EXPECT_EQ(found[4].arrival.legs.size(), 1U);
}

TEST(ArrivalsTest, WithoutAStatedApproachWholeTurnsAreNotKnown) {
  RunRecord record = record_of({at(1, 175, 0), at(1, -180, 0), at(1, -175, 0)});
  record.axes_order.reset();
  record.approach.reset();
  const auto found = arrivals_of(record);
  ASSERT_EQ(found[1].arrival.legs.size(), 1U);
  expect_leg(found[1].arrival.legs[0], true, 175, 180, 0);
  ASSERT_EQ(found[2].arrival.legs.size(), 1U);
  expect_leg(found[2].arrival.legs[0], true, 180, 185, 0);
}

TEST(ArrivalsTest, AxesThatMoveAtOnceHaveNoKnownWay) {
  RunRecord record = record_of({at(1, 0, 0), at(2, 5, 5), at(2, 10, 5)});
  record.axes_order = AxesOrder::kTogether;
  const auto found = arrivals_of(record);
  EXPECT_FALSE(found[1].arrival.since_reading_before);
  EXPECT_EQ(found[2].arrival.legs.size(), 1U);
}

TEST(ArrivalsTest, ARepeatedDwellMayHaveBeenReachedAgain) {
  RunRecord record = record_of({at(1, 0, 0), at(1, 5, 0), at(1, 10, 0)});
  record.dwells[1].flags = kFlagRepeated;
  const auto found = arrivals_of(record);
  EXPECT_FALSE(found[1].arrival.since_reading_before);
  EXPECT_TRUE(found[1].arrival.legs.empty());
  EXPECT_EQ(found[2].arrival.legs.size(), 1U);
}

TEST(ArrivalsTest, AfterASweepTheAxisStandsSomewhere) {
  RunRecord record = record_of({at(1, 0, 0), at(1, 5, 0), at(1, 10, 0), at(1, 15, 0)});
  record.dwells[1].motion.emplace();
  const auto found = arrivals_of(record);
  EXPECT_FALSE(found[2].arrival.since_reading_before);
  EXPECT_TRUE(found[2].arrival.legs.empty());
  EXPECT_EQ(found[3].arrival.legs.size(), 1U);
}

}  // namespace
}  // namespace abcal
