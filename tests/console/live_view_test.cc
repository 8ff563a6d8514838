#include "app/console/live_view.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <vector>

#include "tests/support/fake_clock.h"

namespace abcal::console {
namespace {

using Json = nlohmann::json;

DwellRecord dwell(int experiment, int n, double u) {
  DwellRecord record;
  record.experiment = experiment;
  record.n = n;
  record.alpha = Angle::degrees(30.0 * (n - 1));
  record.mean = {u, 0.5, 0.25};
  return record;
}

RunBegan run_of(int angles) {
  RunBegan began;
  began.file = "a.run";
  began.unit = "g";
  began.estimated_s = 10.0 * angles;
  for (int n = 1; n <= angles; ++n)
    began.plan.push_back({1, n, false, Angle::degrees(30.0 * (n - 1)), {}, {}});
  return began;
}

class LiveViewTest : public testing::Test {
 protected:
  Json apply(const Event& event) { return Json::parse(view.apply(event)); }
  Json snapshot() const { return Json::parse(view.snapshot()); }
  /// The constant of the fit so far, 1 + 0.5 sin + 0.25 cos given.
  Json measure(std::size_t position) {
    const double a = 30.0 * static_cast<double>(position) * M_PI / 180.0;
    return apply(
        DwellSeen{position,
                  dwell(1, static_cast<int>(position) + 1, 1.0 + 0.5 * std::sin(a) + 0.25 * std::cos(a)),
                  {}});
  }

  test::FakeClock clock;
  LiveView view{{{"program", "abcal"}}, clock};
};

TEST_F(LiveViewTest, BeginsWithNothing) {
  const Json json = snapshot();
  EXPECT_EQ(json["activity"]["activity"], "idle");
  EXPECT_TRUE(json["run"].is_null());
  EXPECT_TRUE(json["stage"]["x"]["encoder_deg"].is_null());
}

TEST_F(LiveViewTest, GrowsACurvePointByPoint) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  apply(run_of(12));
  EXPECT_TRUE(measure(0)["fit"]["outputs"][0].is_null());
  measure(1);
  measure(2);
  const Json fit = measure(3)["fit"]["outputs"][0];
  // Rounding of a solution of three unknowns near 1.
  EXPECT_NEAR(fit["constant"].get<double>(), 1.0, 1e-12);
  EXPECT_NEAR(fit["sine"].get<double>(), 0.5, 1e-12);
  EXPECT_NEAR(fit["cosine"].get<double>(), 0.25, 1e-12);
  EXPECT_EQ(snapshot()["run"]["dwells"].size(), 4U);
  EXPECT_EQ(snapshot()["run"]["fits"][0]["outputs"][0], fit);
}

TEST_F(LiveViewTest, FollowsEachOfSeveralItems) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  RunBegan began = run_of(12);
  began.items = {{1, "SN 1", "A", "g", 100.0, ""},
                 {2, "SN 2", "B", "m/s2", 50.0, ""},
                 {3, "SN 3", "A", "g", 100.0, "no answer"}};
  apply(began);
  EXPECT_EQ(snapshot()["run"]["items"][2]["dropped"], "no answer");
  const auto see = [&](std::size_t position, std::vector<ItemReading> items) {
    return apply(
        DwellSeen{position, dwell(1, static_cast<int>(position) + 1, 1.0), {}, std::move(items)})["items"];
  };
  see(0, {{1, {1, 0, 0}, 0}, {2, {9, 0, 0}, 0}});
  see(0, {{1, {1, 0, 0}, 0}, {2, {9, 0, 0}, 0}});  // Measured again.
  const Json both = see(1, {{1, {1, 0, 0}, 0}, {2, {9.5, 0, 0}, kFlagNotFinite}});
  EXPECT_EQ(both[1]["measured"], 2);
  EXPECT_EQ(both[1]["mean"][0], 9.5);
  EXPECT_NE(both[1]["flags"], "");
  EXPECT_EQ(both[2]["measured"], 0);
  EXPECT_EQ(both[2]["mean"], Json());

  const Json dropped = apply(ItemDropped{2, "item 2, accelerometer B (SN 2) is left out"});
  EXPECT_EQ(dropped["type"], "items");
  EXPECT_EQ(dropped["items"][1]["dropped"], "item 2, accelerometer B (SN 2) is left out");
  const Json alone = see(2, {});  // The first is the only one that is left.
  EXPECT_EQ(alone[0]["measured"], 3);
  EXPECT_EQ(alone[1]["measured"], 2);
  EXPECT_EQ(snapshot()["run"]["items"], alone);
  apply(run_of(12));
  EXPECT_EQ(snapshot()["run"]["items"], Json::array());
}

TEST_F(LiveViewTest, ShowsTheReadingsOfEachOfSeveralItems) {
  const auto group = [&](int item, std::size_t stream, double time_s) {
    StripSeen seen;
    seen.item = item;
    seen.stream = stream;
    seen.time_s = time_s;
    seen.temperature_degc = 20.0 + item;
    return apply(seen)["group"];
  };
  const auto kept = [&](int item) {
    std::vector<double> times;
    const Json all = snapshot();
    for (const Json& each : all["strip"])
      if (each["item"] == item) times.push_back(each["time_s"]);
    return times;
  };
  EXPECT_EQ(group(1, 1, 0.0)["temperature_degc"], 21.0);
  EXPECT_EQ(group(2, 1, 0.5)["item"], 2);
  group(1, 1, 1.0);
  EXPECT_THAT(kept(1), testing::ElementsAre(0.0, 1.0)) << "the other item's come between";
  // The readings of one item begin again; those of the other go on.
  group(2, 2, 0.0);
  EXPECT_THAT(kept(1), testing::ElementsAre(0.0, 1.0));
  EXPECT_THAT(kept(2), testing::ElementsAre(0.0));
  for (int i = 0; i < 1000; ++i) group(1 + i % 3, 2, i);
  EXPECT_EQ(snapshot()["strip"].size(), 400U) << "of all items together";
}

TEST_F(LiveViewTest, TheCurveIsThatOfOneItemAlone) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  RunBegan began = run_of(12);
  began.items = {{1, "SN 1", "A", "g", 100.0, ""}, {2, "SN 2", "B", "g", 100.0, ""}};
  apply(began);
  const auto see = [&](std::size_t position, int first, double u) {
    return apply(DwellSeen{
        position, dwell(1, static_cast<int>(position) + 1, u), {}, {{first, {u, 0.5, 0.25}, 0, 23.5}}});
  };
  for (std::size_t position = 0; position < 6; ++position)
    EXPECT_EQ(see(position, 1, 1.0)["dwell"]["item"], 1);
  // Item 1 is left out: what is shown then is of item 2, without the angles of the other.
  EXPECT_TRUE(see(6, 2, -1.0)["fit"]["outputs"][0].is_null()) << "one angle";
  Json last;
  for (std::size_t position = 7; position < 11; ++position) last = see(position, 2, -1.0);
  EXPECT_EQ(last["dwell"]["item"], 2);
  EXPECT_EQ(last["items"][1]["temperature_degc"], 23.5);
  EXPECT_EQ(last["progress"]["measured"], 11);
  EXPECT_NEAR(last["fit"]["outputs"][0]["constant"].get<double>(), -1.0, 1e-12);  // Rounding near 1.
}

TEST_F(LiveViewTest, ARunThatGoesOnHasTheItemsThatWereLeftOutBefore) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  RunBegan began = run_of(12);
  began.items = {{1, "SN 1", "A", "g", 100.0, "left out", 3}, {2, "SN 2", "B", "g", 100.0, "", 5}};
  began.measured.push_back({4, dwell(1, 5, 1.0), {}, {{2, {1, 0, 0}, 0}}});
  const Json run = apply(began)["run"];
  EXPECT_EQ(run["items"][0]["measured"], 3);
  EXPECT_EQ(run["items"][0]["dropped"], "left out");
  EXPECT_EQ(run["items"][1]["measured"], 5);
  EXPECT_EQ(run["dwells"][0]["item"], 2);
  const Json ended = apply(RunEnded{"a.run", false, "stopped"});
  EXPECT_EQ(ended["interrupted"]["items"], 1) << "one is left";
}

TEST_F(LiveViewTest, AnInterruptedRunIsOfferedUntilOneBegins) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  apply(run_of(12));
  measure(0);
  apply(RunEnded{"a.run", false, "stopped"});
  apply(ActivitySeen{Activity::kIdle, false, false});
  // A check, or a resumption that an instrument refuses.
  apply(ActivitySeen{Activity::kRunning, false, false});
  apply(ActivitySeen{Activity::kIdle, false, false});
  EXPECT_EQ(snapshot()["interrupted"]["file"], "a.run");
  apply(run_of(12));
  EXPECT_EQ(snapshot()["interrupted"], Json());
}

TEST_F(LiveViewTest, ALimitIsInTheTimeOfTheBench) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  const Json phase = apply(PhaseSeen{0, RunPhase::kDwelling, TimeLimit{2.0, "without any reading", true}});
  EXPECT_EQ(phase["limit_s"], 2.0);
  EXPECT_EQ(phase["limit_simulated"], true);
  EXPECT_EQ(apply(PhaseSeen{0, RunPhase::kHolding, {}})["limit_s"], Json());
}

TEST_F(LiveViewTest, TellsTheTimeLeftFromWhatTheLatestAnglesTook) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  EXPECT_EQ(apply(run_of(12))["run"]["progress"]["left_s"], 120.0);
  for (std::size_t position = 0; position < 5; ++position) {
    measure(position);
    clock.advance(std::chrono::seconds(4));
  }
  EXPECT_EQ(measure(5)["progress"]["left_s"], 6 * 4.0);
  // An hour's hold is no angle's time.
  apply(PhaseSeen{6, RunPhase::kHolding, {}});
  clock.advance(std::chrono::hours(1));
  EXPECT_EQ(measure(6)["progress"]["left_s"], 5 * 4.0);
}

TEST_F(LiveViewTest, AnAngleMeasuredAgainTakesThePlaceOfTheFirst) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  apply(run_of(12));
  measure(0);
  const Json progress = measure(0)["progress"];
  EXPECT_EQ(progress["measured"], 1);
}

TEST_F(LiveViewTest, TheTurnOfACheckIsNoRun) {
  apply(ActivitySeen{Activity::kChecking, false, false});
  EXPECT_EQ(measure(0)["type"], "nothing");
  EXPECT_TRUE(snapshot()["run"].is_null());
}

TEST_F(LiveViewTest, KeepsOnlyTheLatestOfWhatGrowsWithoutEnd) {
  for (int i = 0; i < 5000; ++i) {
    StripSeen group;
    group.time_s = i;
    group.mean = group.lowest = group.highest = Eigen::Vector3d::Zero();
    apply(group);
    apply(LogLine{LogLine::Grade::kInfo, "line " + std::to_string(i)});
  }
  const Json json = snapshot();
  EXPECT_EQ(json["strip"].size(), 400U);
  EXPECT_EQ(json["strip"].back()["time_s"], 4999.0);
  EXPECT_EQ(json["log"].size(), 200U);
  EXPECT_EQ(json["log"].back()["text"], "line 4999");
}

TEST_F(LiveViewTest, WhatIsNoNumberIsNull) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  apply(run_of(12));
  const Json message = apply(DwellSeen{0, dwell(1, 1, std::numeric_limits<double>::quiet_NaN()), {}});
  EXPECT_TRUE(message["dwell"]["mean"][0].is_null());
  EXPECT_EQ(message["dwell"]["mean"][1], 0.5);
}

TEST_F(LiveViewTest, WhatAnInstrumentSaysMayBeAnyBytes) {
  EXPECT_EQ(apply(LogLine{LogLine::Grade::kProblem, "said \xff\xfe <b>"})["line"]["text"],
            "said \xEF\xBF\xBD\xEF\xBF\xBD <b>");
}

}  // namespace
}  // namespace abcal::console
