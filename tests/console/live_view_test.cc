#include "app/console/live_view.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
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

RunBeganEvent run_of(int angles) {
  RunBeganEvent began;
  began.file = "a.run";
  began.unit = "g";
  began.estimated_s = 10.0 * angles;
  for (int n = 1; n <= angles; ++n)
    began.plan.push_back({1, n, false, Angle::degrees(30.0 * (n - 1)), {}, {}});
  return began;
}

FinishedEvent finished(bool complete, const std::string& reason) {
  FinishedEvent end;
  end.file = "a.run";
  end.complete = complete;
  end.verdict = complete ? "usable" : "";
  end.reason = Message::bare(reason);
  return end;
}

class LiveViewTest : public testing::Test {
 protected:
  Json apply(const Event& event) { return Json::parse(view.apply(event)); }
  /// An angle, with output u of each item.
  static DwellDoneEvent done(std::size_t position, const std::map<int, double>& u) {
    DwellDoneEvent event{position, {}};
    for (const auto& [item, output] : u)
      event.dwells[item] = dwell(1, static_cast<int>(position) + 1, output);
    return event;
  }
  Json snapshot() const { return Json::parse(view.snapshot()); }
  /// The constant of the fit so far, 1 + 0.5 sin + 0.25 cos given.
  Json measure(std::size_t position) {
    const double a = 30.0 * static_cast<double>(position) * M_PI / 180.0;
    return apply(done(position, {{1, 1.0 + 0.5 * std::sin(a) + 0.25 * std::cos(a)}}));
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
  EXPECT_EQ(snapshot()["run"]["measured"].size(), 4U);
  EXPECT_EQ(snapshot()["run"]["fits"][0]["outputs"][0], fit);
}

TEST_F(LiveViewTest, FollowsEachOfSeveralItems) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  RunBeganEvent began = run_of(12);
  began.items = {{1, "SN 1", "A", "g", 100.0, {}},
                 {2, "SN 2", "B", "m/s2", 50.0, {}},
                 {3, "SN 3", "A", "g", 100.0, Message("no answer")}};
  apply(began);
  const auto items = [&] { return snapshot()["run"]["items"]; };
  EXPECT_EQ(items()[2]["missing"], "no answer");
  apply(done(0, {{1, 1.0}, {2, 9.0}}));
  apply(done(0, {{1, 1.0}, {2, 9.0}}));  // Measured again.
  const Json message = apply(done(1, {{1, 1.0}, {2, 9.5}}));
  EXPECT_EQ(message["event"], "dwell_done");
  EXPECT_EQ(message["items"][1]["mean"][0], 9.5);
  EXPECT_EQ(items()[1]["measured"], 2);
  EXPECT_EQ(items()[2]["measured"], 0);

  const Message why("item {item}, accelerometer {model} (SN {serial}) is left out", 2, "B", "2");
  const Json dropped = apply(NoticeEvent{"item dropped", why, 2});
  EXPECT_EQ(dropped["event"], "notice");
  EXPECT_EQ(dropped["item"], 2);
  EXPECT_EQ(dropped["line"]["text"], why.english());
  EXPECT_EQ(dropped["messages"][0]["id"], why.id());
  EXPECT_EQ(dropped["line"]["messages"][0]["id"], why.id());
  EXPECT_EQ(dropped["line"]["grade"], "warning");
  EXPECT_EQ(items()[1]["missing"], why.english());
  apply(done(2, {{1, 1.0}}));  // Item 1 is the only one left.
  EXPECT_EQ(items()[0]["measured"], 3);
  EXPECT_EQ(items()[1]["measured"], 2);
  apply(run_of(12));
  EXPECT_EQ(items(), Json::array());
}

TEST_F(LiveViewTest, WhatIsSaidOfAnItemIsNotFoundInASentence) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  RunBeganEvent began = run_of(12);
  began.items = {{1, "SN 1", "A", "g", 100.0, {}}, {2, "SN 2", "B", "g", 100.0, {}}};
  apply(began);
  apply(NoticeEvent{"item dropped", Message("item 1 is well, this one is not"), 2});
  EXPECT_EQ(snapshot()["run"]["items"][0]["missing"], "");
  EXPECT_NE(snapshot()["run"]["items"][1]["missing"], "");
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
  RunBeganEvent began = run_of(12);
  began.items = {{1, "SN 1", "A", "g", 100.0, {}}, {2, "SN 2", "B", "g", 100.0, {}}};
  apply(began);
  for (std::size_t position = 0; position < 6; ++position) apply(done(position, {{1, 1.0}}));
  // Item 1 is left out: the view then shows item 2, without the angles of the other.
  EXPECT_TRUE(apply(done(6, {{2, -1.0}}))["fit"]["outputs"][0].is_null()) << "one angle";
  Json last;
  for (std::size_t position = 7; position < 11; ++position) last = apply(done(position, {{2, -1.0}}));
  EXPECT_EQ(last["items"][0]["k"], 2);
  EXPECT_EQ(last["progress"]["measured"], 11);
  EXPECT_NEAR(last["fit"]["outputs"][0]["constant"].get<double>(), -1.0, 1e-12);  // Rounding near 1.
}

TEST_F(LiveViewTest, ARunThatGoesOnHasTheItemsThatWereLeftOutBefore) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  RunBeganEvent began = run_of(12);
  began.resumed = true;
  began.items = {{1, "SN 1", "A", "g", 100.0, Message("left out"), 3}, {2, "SN 2", "B", "g", 100.0, {}, 5}};
  began.measured.push_back(done(4, {{2, 1.0}}));
  const Json whole = apply(began);
  EXPECT_EQ(whole["log"].back()["text"], "Run a.run continues: 1 of 12 angles are measured.");
  const Json run = whole["run"];
  EXPECT_EQ(run["items"][0]["measured"], 3);
  EXPECT_EQ(run["items"][0]["missing"], "left out");
  EXPECT_EQ(run["items"][1]["measured"], 5);
  EXPECT_EQ(run["measured"][0]["items"][0]["k"], 2);
  const Json ended = apply(finished(false, "stopped"));
  EXPECT_EQ(ended["interrupted"]["items"], 1) << "one is left";
}

TEST_F(LiveViewTest, AnInterruptedRunIsOfferedUntilOneBegins) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  apply(run_of(12));
  measure(0);
  apply(finished(false, "stopped"));
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
  BenchOpened opened;
  opened.protocol.reading_timeout_s = 2.0;
  opened.simulated_time = true;
  EXPECT_EQ(view.apply(opened), "") << "pages need not be told";
  const Json phase = apply(PhaseEvent{0, RunPhase::kDwelling});
  EXPECT_EQ(phase["phase"], "reading");
  EXPECT_EQ(phase["limit_s"], 2.0);
  EXPECT_EQ(phase["limit_words"], "without any reading");
  EXPECT_EQ(phase["limit_simulated"], true);
  EXPECT_EQ(snapshot()["phase"], phase);
  EXPECT_EQ(apply(PhaseEvent{0, RunPhase::kHolding})["limit_s"], Json());
}

TEST_F(LiveViewTest, TellsTheTimeLeftFromWhatTheLatestAnglesTook) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  EXPECT_EQ(apply(run_of(12))["run"]["progress"]["left_s"], 120.0);
  for (std::size_t position = 0; position < 5; ++position) {
    measure(position);
    clock.advance(std::chrono::seconds(4));
  }
  EXPECT_EQ(measure(5)["progress"]["left_s"], 6 * 4.0);
  // The duration of a hold does not count as that of an angle.
  apply(PhaseEvent{6, RunPhase::kHolding});
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
  EXPECT_EQ(view.apply(done(0, {{1, 1.0}})), "");
  EXPECT_TRUE(snapshot()["run"].is_null());
}

TEST_F(LiveViewTest, KeepsOnlyTheLatestOfWhatGrowsWithoutEnd) {
  for (int i = 0; i < 5000; ++i) {
    StripSeen group;
    group.time_s = i;
    group.mean = group.lowest = group.highest = Eigen::Vector3d::Zero();
    apply(group);
    apply(LogLine{LogLine::Grade::kInfo, Message("line {number}", i)});
  }
  const Json json = snapshot();
  EXPECT_EQ(json["strip"].size(), 400U);
  EXPECT_EQ(json["strip"].back()["time_s"], 4999.0);
  EXPECT_EQ(json["log"].size(), 200U);
  EXPECT_EQ(json["log"].back()["text"], "line 4999");
}

TEST_F(LiveViewTest, WhatIsNoNumberIsNone) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  apply(run_of(12));
  const Json message = apply(done(0, {{1, std::numeric_limits<double>::quiet_NaN()}}));
  EXPECT_EQ(message["dwell"]["mean"][0], "nan");
  EXPECT_EQ(message["dwell"]["mean"][1], 0.5);
}

TEST_F(LiveViewTest, WhatIsToldOfTheRunIsTheEventOfItsSession) {
  apply(ActivitySeen{Activity::kRunning, false, false});
  const RunBeganEvent began = run_of(12);
  const Json run = apply(began)["run"];
  const Json as_event = to_json_object(began);
  for (const auto& [key, value] : as_event.items()) EXPECT_EQ(run[key], value) << key;
  const DwellDoneEvent event = done(3, {{1, 1.0}});
  const Json message = apply(event), dwell_as_event = to_json_object(event);
  for (const auto& [key, value] : dwell_as_event.items()) EXPECT_EQ(message[key], value) << key;
  EXPECT_EQ(snapshot()["run"]["measured"][0]["dwell"], dwell_as_event["dwell"]);
  EXPECT_EQ(view.apply(AngleBegunEvent{4}), "") << "the phase says so";
}

TEST_F(LiveViewTest, EveryFlagHasItsWords) {
  const Json words = snapshot()["about"]["flags"];
  std::string all;
  for (const Json& each : words) all += (all.empty() ? "" : ", ") + each.get<std::string>();
  EXPECT_EQ(all, describe_flags(kAllFlags));
}

TEST_F(LiveViewTest, WhatAnInstrumentSaysMayBeAnyBytes) {
  EXPECT_EQ(apply(LogLine{LogLine::Grade::kProblem, Message("said \xff\xfe <b>")})["line"]["text"],
            "said \xEF\xBF\xBD\xEF\xBF\xBD <b>");
}

}  // namespace
}  // namespace abcal::console
