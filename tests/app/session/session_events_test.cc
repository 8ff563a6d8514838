#include "app/session/session_events.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

namespace abcal {
namespace {

using nlohmann::json;
using testing::HasSubstr;

DwellRecord a_dwell() {
  DwellRecord dwell;
  dwell.experiment = 2;
  dwell.n = 7;
  dwell.closing = true;
  dwell.alpha = Angle::degrees(390.1);
  dwell.commanded_x = Angle::degrees(-30.2);
  dwell.encoder_x = Angle::degrees(-30.19999);
  dwell.time_s = 1234.0 / 7.0;
  dwell.settle_time_s = 0.1;
  dwell.count = 1000;
  dwell.lost = 3;
  dwell.mean = Eigen::Vector3d(1.0 / 3.0, std::numeric_limits<double>::quiet_NaN(), -2.5e-308);
  dwell.spread = Eigen::Vector3d(std::numeric_limits<double>::infinity(), 0.0, 1e-5);
  dwell.u_mean = Eigen::Vector3d(1e-6, 2e-6, -std::numeric_limits<double>::infinity());
  dwell.flags = kFlagStuck | kFlagHeld;
  return dwell;
}

/// One of each kind, every member different from its default.
std::vector<SessionEvent> events() {
  RunBeganEvent began;
  began.file = "runs/a.run";
  began.resumed = true;
  began.bench = "bench 1";
  began.item = "SN 12";
  began.operator_name = "A. Operator";
  began.unit = "m/s2";
  began.stage = {"PI", "C-884", "0412"};
  began.accelerometer = {"VectorNav", "VN-100", "77"};
  began.rate_hz = 800.0;
  began.plan = {{1, 1, false, Angle{}, Angle{}, Angle{}},
                {3, 72, true, Angle::degrees(355), Angle::degrees(-90), Angle::degrees(0.1)}};
  began.measured = {{1, a_dwell()}};
  began.estimated_s = 3601.5;
  began.simulated_time = true;
  began.items = {{2, "SN 2", "VN-100", "m/s2", 100.0, "no reading", 7}};
  return {began,
          PhaseEvent{4, RunPhase::kTemperature},
          AngleBegunEvent{5},
          DwellDoneEvent{6, a_dwell(), {{2, {1.0, 2.0, 3.0}, kFlagStuck, 23.5}}},
          FlagEvent{"not quiet"},
          PortLostEvent{"the port is gone"},
          PortBackEvent{"it is back"},
          HeldEvent{7},
          ContinuedEvent{8},
          NoticeEvent{"temperature", "23.1 degC"},
          NoteStoredEvent{"door opened; 23 °C", "page 1"},
          AllMeasuredEvent{"a.run"},
          ReplayComparedEvent{38, 39, true, "complete"},
          FinishedEvent{"a.run", true, "usable", "nothing found", 219, 220, true}};
}

std::vector<SessionRequest> requests() {
  return {StartRequest{"[bench]\n", "bench.toml", "a.run", true},
          ResumeRequest{"a.run"},
          ReplayRequest{"a.run", "b.run"},
          HoldRequest{},
          ContinueRequest{},
          StopRequest{},
          NoteRequest{"a \"note\"", "me"}};
}

TEST(SessionEventsTest, EveryEventComesBackFromItsJsonText) {
  std::set<std::string> names;
  std::set<std::size_t> alternatives;
  for (const SessionEvent& event : events()) {
    const std::string text = to_json_object(event).dump();
    const SessionEvent back = event_from_json(json::parse(text));
    EXPECT_EQ(back.index(), event.index()) << text;
    EXPECT_EQ(to_json_object(back).dump(), text);
    names.insert(json::parse(text)["event"].get<std::string>());
    alternatives.insert(event.index());
  }
  EXPECT_EQ(alternatives.size(), std::variant_size_v<SessionEvent>) << "an event is not tested";
  EXPECT_EQ(names.size(), std::variant_size_v<SessionEvent>) << "two events have one name";
}

TEST(SessionEventsTest, EveryRequestComesBackFromItsJsonText) {
  std::set<std::string> names;
  for (const SessionRequest& request : requests()) {
    const std::string text = to_json_object(request).dump();
    const SessionRequest back = request_from_json(json::parse(text));
    EXPECT_EQ(back.index(), request.index()) << text;
    EXPECT_EQ(to_json_object(back).dump(), text);
    names.insert(json::parse(text)["request"].get<std::string>());
  }
  EXPECT_EQ(names.size(), std::variant_size_v<SessionRequest>);
}

TEST(SessionEventsTest, NumbersKeepEveryBitAndMayBeMissing) {
  const DwellRecord dwell = a_dwell();
  const SessionEvent event = DwellDoneEvent{3, dwell};
  const auto back =
      std::get<DwellDoneEvent>(event_from_json(json::parse(to_json_object(event).dump()))).dwell;
  EXPECT_EQ(back.experiment, dwell.experiment);
  EXPECT_EQ(back.n, dwell.n);
  EXPECT_EQ(back.closing, dwell.closing);
  EXPECT_EQ(back.alpha, dwell.alpha);
  EXPECT_EQ(back.commanded_x, dwell.commanded_x);
  EXPECT_EQ(back.encoder_x, dwell.encoder_x);
  EXPECT_EQ(back.encoder_z, std::nullopt);
  EXPECT_EQ(back.time_s, dwell.time_s);
  EXPECT_EQ(back.count, dwell.count);
  EXPECT_EQ(back.lost, dwell.lost);
  EXPECT_EQ(back.mean[0], dwell.mean[0]);
  EXPECT_TRUE(std::isnan(back.mean[1]));
  EXPECT_EQ(back.mean[2], dwell.mean[2]);
  EXPECT_EQ(back.spread, dwell.spread);
  ASSERT_TRUE(back.u_mean);
  EXPECT_EQ(*back.u_mean, *dwell.u_mean);
  EXPECT_EQ(back.temperature_degc, std::nullopt);
  EXPECT_EQ(back.flags, dwell.flags);
}

TEST(SessionEventsTest, MembersOfARunThatBeganComeBack) {
  const auto back = std::get<RunBeganEvent>(event_from_json(to_json_object(events().front())));
  EXPECT_EQ(back.file, "runs/a.run");
  EXPECT_TRUE(back.resumed);
  EXPECT_EQ(back.operator_name, "A. Operator");
  EXPECT_EQ(back.stage.model, "C-884");
  EXPECT_EQ(back.accelerometer.serial_number, "77");
  ASSERT_EQ(back.plan.size(), 2U);
  EXPECT_EQ(back.plan[1].alpha.deg(), 355.0);
  EXPECT_EQ(back.plan[1].z.deg(), 0.1);
  EXPECT_TRUE(back.plan[1].closing);
  ASSERT_EQ(back.measured.size(), 1U);
  EXPECT_EQ(back.measured[0].position, 1U);
  EXPECT_EQ(back.estimated_s, 3601.5);
}

TEST(SessionEventsTest, EveryPhaseHasAWordOfItsOwn) {
  for (int k = 0; k <= static_cast<int>(RunPhase::kParking); ++k) {
    const SessionEvent event = PhaseEvent{0, static_cast<RunPhase>(k)};
    EXPECT_EQ(std::get<PhaseEvent>(event_from_json(to_json_object(event))).phase, static_cast<RunPhase>(k));
  }
}

TEST(SessionEventsTest, RefusesWhatIsNone) {
  for (const char* text :
       {R"({})", R"([])", R"(3)", R"({"event": 3})", R"({"event": "no such"})", R"({"event": "phase"})",
        R"({"event": "phase", "position": "far", "phase": "moving"})",
        R"({"event": "phase", "position": 1, "phase": "dancing"})", R"({"request": "stop"})"}) {
    try {
      (void)event_from_json(json::parse(text));
      FAIL() << text;
    } catch (const std::invalid_argument& error) {
      EXPECT_THAT(error.what(), HasSubstr("required")) << text;
    }
  }
  EXPECT_THROW((void)request_from_json(json::parse(R"({"request": "start"})")), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
