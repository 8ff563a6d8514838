#include "app/measure/session/session_events.h"

#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

namespace abcal {
namespace {

using nlohmann::json;

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

/// One event of each kind, every member different from its default.
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
  began.measured = {{1, {{1, a_dwell()}}}};
  began.estimated_s = 3601.5;
  began.simulated_time = true;
  began.simulated = "stage";
  began.items = {{2, "SN 2", "VN-100", "m/s2", 100.0, Message("no reading"), 7}};
  return {began,
          PhaseEvent{4, RunPhase::kTemperature},
          AngleBegunEvent{5},
          DwellDoneEvent{6, {{1, a_dwell()}}},
          FlagEvent{Message("not quiet")},
          PortLostEvent{Message("the port is gone")},
          PortBackEvent{Message("it is back")},
          HeldEvent{7},
          ContinuedEvent{8},
          NoticeEvent{"temperature", Message("23.1 degC")},
          NoteStoredEvent{"door opened; 23 °C", "page 1"},
          AllMeasuredEvent{"a.run"},
          ReplayComparedEvent{38, 39, true, "complete"},
          FinishedEvent{"a.run", true, "usable", Message("nothing found"), 219, 220, true}};
}

TEST(SessionEventsTest, EveryEventHasANameOfItsOwn) {
  std::set<std::string> names;
  std::set<std::size_t> alternatives;
  for (const SessionEvent& event : events()) {
    names.insert(to_json_object(event)["event"].get<std::string>());
    alternatives.insert(event.index());
  }
  EXPECT_EQ(alternatives.size(), std::variant_size_v<SessionEvent>) << "an event is not tested";
  EXPECT_EQ(names.size(), std::variant_size_v<SessionEvent>) << "two events have one name";
}

TEST(SessionEventsTest, NumbersKeepEveryBitAndMayBeMissing) {
  const DwellRecord dwell = a_dwell();
  const json message = json::parse(to_json_object(DwellDoneEvent{3, {{1, dwell}}}).dump());
  EXPECT_EQ(message["event"], "dwell_done");
  EXPECT_EQ(message["position"], 3);
  EXPECT_EQ(message["items"], json::array()) << "the dwell is that of item 1";
  const json& written = message["dwell"];
  EXPECT_EQ(written["experiment"], 2);
  EXPECT_EQ(written["n"], 7);
  EXPECT_EQ(written["closing"], true);
  EXPECT_EQ(written["alpha_deg"], dwell.alpha.deg());
  EXPECT_EQ(written["commanded_x_deg"], dwell.commanded_x.deg());
  EXPECT_EQ(written["encoder_x_deg"], dwell.encoder_x->deg());
  EXPECT_EQ(written["encoder_z_deg"], json());
  EXPECT_EQ(written["time_s"], *dwell.time_s);
  EXPECT_EQ(written["settle_time_s"], dwell.settle_time_s);
  EXPECT_EQ(written["count"], 1000);
  EXPECT_EQ(written["lost"], 3);
  EXPECT_EQ(written["mean"], json({dwell.mean[0], "nan", dwell.mean[2]}));
  EXPECT_EQ(written["spread"], json({"inf", 0.0, 1e-5}));
  EXPECT_EQ(written["u_mean"], json({1e-6, 2e-6, "-inf"}));
  EXPECT_EQ(written["temperature_degc"], json());
  EXPECT_EQ(written["flags"], kFlagStuck | kFlagHeld);
}

TEST(SessionEventsTest, EachOfSeveralItemsIsInADwell) {
  DwellRecord second = a_dwell();
  second.mean = {1.0, 2.0, 3.0};
  second.temperature_degc = 23.5;
  const json message = to_json_object(DwellDoneEvent{6, {{1, a_dwell()}, {2, second}}});
  EXPECT_EQ(message["dwell"]["mean"][0], 1.0 / 3.0) << "that of the first";
  ASSERT_EQ(message["items"].size(), 2U);
  EXPECT_EQ(message["items"][1], json({{"k", 2},
                                       {"mean", {1.0, 2.0, 3.0}},
                                       {"flags", kFlagStuck | kFlagHeld},
                                       {"temperature_degc", 23.5}}));
  // The number of the only remaining item is stated, unless it is the first.
  const json alone = to_json_object(DwellDoneEvent{6, {{2, second}}});
  EXPECT_EQ(alone["dwell"]["mean"][0], 1.0);
  EXPECT_EQ(alone["items"][0]["k"], 2);
}

TEST(SessionEventsTest, ARunThatBeganHasItsPlanAndItsItems) {
  const json message = to_json_object(events().front());
  EXPECT_EQ(message["file"], "runs/a.run");
  EXPECT_EQ(message["resumed"], true);
  EXPECT_EQ(message["operator"], "A. Operator");
  EXPECT_EQ(message["stage"]["model"], "C-884");
  EXPECT_EQ(message["accelerometer"]["serial_number"], "77");
  EXPECT_EQ(message["simulated"], "stage");
  ASSERT_EQ(message["plan"].size(), 2U);
  EXPECT_EQ(message["plan"][1]["alpha_deg"], 355.0);
  EXPECT_EQ(message["plan"][1]["z_deg"], 0.1);
  EXPECT_EQ(message["plan"][1]["closing"], true);
  ASSERT_EQ(message["measured"].size(), 1U);
  EXPECT_EQ(message["measured"][0]["position"], 1);
  EXPECT_EQ(message["estimated_s"], 3601.5);
  EXPECT_EQ(message["items"][0]["missing"], "no reading");
}

TEST(SessionEventsTest, EveryPhaseHasAWordOfItsOwn) {
  std::set<std::string> words;
  for (int k = 0; k <= static_cast<int>(RunPhase::kParking); ++k)
    words.insert(to_json_object(PhaseEvent{0, static_cast<RunPhase>(k)})["phase"].get<std::string>());
  EXPECT_EQ(words.size(), static_cast<std::size_t>(RunPhase::kParking) + 1);
}

TEST(SessionEventsTest, AMessageAboutAnItemNamesIt) {
  EXPECT_EQ(to_json_object(NoticeEvent{"item dropped", Message("item 2 takes no part"), 2})["item"], 2);
  EXPECT_EQ(to_json_object(FlagEvent{Message("item 3, not quiet"), 3})["item"], 3);
  EXPECT_EQ(to_json_object(NoticeEvent{"temperature", Message("23.1 degC")})["item"], json());
}

}  // namespace
}  // namespace abcal
