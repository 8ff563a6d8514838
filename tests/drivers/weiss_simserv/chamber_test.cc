#include "drivers/weiss_simserv/chamber.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/instrument/instrument_error.h"
#include "sim/faults.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/weiss_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/reply_verdicts.h"

namespace abcal::weiss_simserv {
namespace {

using testing::HasSubstr;

struct Rig {
  explicit Rig(const sim::WeissSettings& settings, ChamberSettings own = {},
               std::vector<sim::WireFault> faults = {}) {
    own.pause_output = 3;
    world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
    std::unique_ptr<wire::ByteStream> stream =
        std::make_unique<sim::FirmwareStream>(std::make_shared<sim::WeissFirmware>(world, settings), clock);
    auto faulty = std::make_unique<sim::FaultyStream>(std::move(stream), clock, std::move(faults));
    link = faulty.get();
    stream = std::move(faulty);
    chamber = std::make_unique<WeissChamber>(std::move(stream), clock, own);
  }
  void wait(double seconds) { clock.sleep_until(clock.now() + from_seconds(seconds)); }
  sim::SimClock clock;
  std::shared_ptr<sim::SimBench> world;
  sim::FaultyStream* link = nullptr;
  std::unique_ptr<WeissChamber> chamber;
};

class WeissChamberTest : public testing::TestWithParam<bool> {
 protected:
  sim::WeissSettings settings() const {
    sim::WeissSettings settings;
    settings.simserv = GetParam();
    return settings;
  }
};

TEST_P(WeissChamberTest, HeatsAndCools) {
  Rig rig(settings());
  const ChamberInfo info = rig.chamber->identify();
  EXPECT_EQ(info.least_set_degc, -77.0);
  EXPECT_EQ(info.most_set_degc, 182.0);
  EXPECT_TRUE(info.can_ramp);
  EXPECT_TRUE(info.has_humidity);
  EXPECT_FALSE(rig.chamber->read().running);
  rig.chamber->set_temperature(-40.0, std::nullopt);
  rig.wait(3600.0);
  EXPECT_NEAR(rig.chamber->read().air_degc, 23.0, 0.1) << "it was not started";
  rig.chamber->run();
  rig.wait(3600.0);
  EXPECT_NEAR(rig.chamber->read().air_degc, -40.0, 0.1);
  EXPECT_NEAR(rig.world->temperature_degc(rig.clock.now()), -40.0, 0.5);
  EXPECT_TRUE(rig.chamber->pause(true));
  rig.wait(600.0);
  EXPECT_GT(rig.chamber->read().air_degc, -35.0);
  rig.chamber->pause(false);
  rig.chamber->stop();
  EXPECT_FALSE(rig.chamber->read().running);
}

TEST_P(WeissChamberTest, ASetPointOutsideItsHardwareIsNeverSent) {
  Rig rig(settings());
  rig.chamber->identify();
  try {
    rig.chamber->set_temperature(200.0, std::nullopt);
    FAIL();
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kOutOfTravel);
    EXPECT_THAT(error.what(), HasSubstr("-77 to 182 degC"));
  }
  EXPECT_FALSE(rig.world->commanded_chamber().running);
}

TEST_P(WeissChamberTest, WithoutExternalModeItSaysSo) {
  sim::WeissSettings settings = this->settings();
  settings.external_mode = false;
  Rig rig(settings);
  rig.chamber->identify();
  EXPECT_THROW(rig.chamber->set_temperature(40.0, std::nullopt), InstrumentError);
}

TEST_P(WeissChamberTest, AlarmAndDoorAreToldBySimserv) {
  if (!GetParam()) GTEST_SKIP() << "ASCII-2 has no messages";
  Rig rig(settings());
  rig.chamber->identify();
  EXPECT_TRUE(rig.chamber->read().alarms.empty());
  rig.world->inject({.kind = sim::FaultKind::kChamberAlarm, .at = rig.clock.now()});
  rig.world->inject({.kind = sim::FaultKind::kChamberDoor, .at = rig.clock.now()});
  EXPECT_EQ(rig.chamber->read().alarms.size(), 1U);
  EXPECT_TRUE(rig.chamber->read().door_open);
}

// At every call the chamber does as requested, or reports the fault within seconds.
TEST_P(WeissChamberTest, FaultsOfTheWireAtEveryWrite) {
  bool undamaged = true;
  const auto series = [&undamaged](Rig& rig) {
    rig.chamber->identify();
    rig.chamber->set_temperature(60.0, 2.0);
    rig.chamber->run();
    const double air = rig.chamber->read().air_degc;
    if (undamaged) {
      EXPECT_NEAR(air, 23.0, 1.5);
    }
    EXPECT_NEAR(rig.world->commanded_chamber().target_degc, 60.0, 1e-3);
    EXPECT_TRUE(rig.world->commanded_chamber().running);
  };
  for (const sim::FaultKind kind :
       {sim::FaultKind::kSilence, sim::FaultKind::kGarbage, sim::FaultKind::kFlippedBits,
        sim::FaultKind::kDroppedBytes, sim::FaultKind::kSplitFrame, sim::FaultKind::kLateReply,
        sim::FaultKind::kReplacedReply, sim::FaultKind::kUnplug}) {
    undamaged = kind != sim::FaultKind::kFlippedBits && kind != sim::FaultKind::kDroppedBytes;
    for (std::size_t write = 1; write <= 24; ++write) {
      sim::WireFault fault;
      fault.kind = kind;
      fault.at_write = write;
      fault.for_writes = 1;
      fault.text = "?\r\n";
      Rig rig(settings(), {.model = GetParam() ? "simserv" : "ascii2"}, {fault});
      const Clock::Instant start = rig.clock.now();
      try {
        series(rig);
        EXPECT_FALSE(kind == sim::FaultKind::kUnplug && rig.link->writes() >= write) << write;
      } catch (const InstrumentError& error) {
        // Neither language has a checksum: a digit that is changed or lost passes, or is reported as another
        // fault.
        const bool damaged = kind == sim::FaultKind::kFlippedBits || kind == sim::FaultKind::kDroppedBytes ||
                             kind == sim::FaultKind::kReplacedReply;
        const bool told = error.fault() == Fault::kNoReply || error.fault() == Fault::kBadFrame ||
                          error.fault() == Fault::kLinkLost || damaged;
        EXPECT_TRUE(told) << static_cast<int>(kind) << ' ' << write << ": " << error.what();
      }
      EXPECT_LT(to_seconds(rig.clock.now() - start), 12.0) << static_cast<int>(kind) << ' ' << write;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, WeissChamberTest, testing::Bool(),
                         [](const auto& one) { return std::string(one.param ? "Simserv" : "Ascii2"); });

TEST(WeissChamberTest, TheRampIsTheControllers) {
  Rig rig(sim::WeissSettings{.simserv = false});
  rig.chamber->identify();
  rig.chamber->set_temperature(83.0, 1.0);
  rig.chamber->run();
  rig.wait(1800.0);
  EXPECT_NEAR(rig.chamber->read().set_degc, 53.0, 0.5);
  rig.wait(3600.0);
  EXPECT_NEAR(rig.chamber->read().air_degc, 83.0, 0.1);
}

TEST(WeissChamberTest, TheRecipeInSimservTellsAnswersApart) {
  using enum test::Verdict;
  Rig rig(sim::WeissSettings{});
  rig.chamber->identify();
  const HaltRecipe recipe = rig.chamber->rest_recipe(ChamberPolicy::kAmbient).value();
  ASSERT_EQ(recipe.questions.size(), 5U);
  for (const std::size_t step : {0U, 1U, 2U, 3U})
    test::expect_verdicts(recipe, recipe.questions[step],
                          {{"1", kStanding},
                           {"", kOther},
                           {"0", kOther},
                           {"-5", kOther},
                           {"-6", kOther},
                           {"-8", kOther},
                           {"11", kOther},
                           {"1 ", kOther},
                           {" 1", kOther},
                           {"1\xB6", kOther},
                           {"1\xB6"
                            "23.0",
                            kOther}});
  test::expect_verdicts(recipe, recipe.questions[4],
                        {{"1\xB6"
                          "23",
                          kStanding},
                         {"1\xB6"
                          "23.",
                          kStanding},
                         {"1\xB6"
                          "23.0",
                          kStanding},
                         {"1\xB6"
                          "23.000",
                          kStanding},
                         {"1\xB6"
                          "0023.0",
                          kStanding},
                         {"1 23.0", kStanding},
                         {"1\xB6"
                          "23.01",
                          kMoving},
                         {"1\xB6"
                          "23.5",
                          kMoving},
                         {"1\xB6"
                          "230",
                          kMoving},
                         {"1\xB6"
                          "-23.0",
                          kMoving},
                         {"1\xB6"
                          "+23.0",
                          kMoving},
                         {"1\xB6-40.0", kMoving},
                         {"1\xB6"
                          "2.3",
                          kMoving},
                         {"1\xB6"
                          "0",
                          kMoving},
                         {"", kOther},
                         {"1", kOther},
                         {"1\xB6", kOther},
                         {"-5", kOther},
                         {"-8\xB6"
                          "23.0",
                          kOther},
                         {"2\xB6"
                          "23.0",
                          kOther},
                         {"1\xB6"
                          "23.0\xB6",
                          kOther},
                         {"1\xB6 23.0", kOther},
                         {"1\xB6"
                          "23,0",
                          kOther},
                         {"1\xB6LabEvent T/110/70/5", kOther}});
  const HaltRecipe hold = rig.chamber->rest_recipe(ChamberPolicy::kHold).value();
  ASSERT_EQ(hold.questions.size(), 2U);
  test::expect_verdicts(hold, hold.questions[1],
                        {{"1\xB6LabEvent T/110/70/5", kStanding},
                         {"1\xB6", kStanding},
                         {"11", kStanding},
                         {"1", kOther},
                         {"", kOther},
                         {"-5", kOther},
                         {"-8\xB6", kOther}});
}

TEST(WeissChamberTest, TheRecipeInAscii2TellsAnswersApart) {
  using enum test::Verdict;
  Rig rig(sim::WeissSettings{.simserv = false});
  rig.chamber->identify();
  const HaltRecipe recipe = rig.chamber->rest_recipe(ChamberPolicy::kAmbient).value();
  ASSERT_EQ(recipe.questions.size(), 3U);
  for (const std::size_t step : {0U, 1U})
    test::expect_verdicts(recipe, recipe.questions[step],
                          {{"0", kStanding},
                           {"", kOther},
                           {"1", kOther},
                           {"00", kOther},
                           {"0 ", kOther},
                           {"-5", kOther},
                           {"0023.0 0022.9 0100", kOther}});
  const std::string channels = "01000000000000000000000000000000";
  test::expect_verdicts(recipe, recipe.questions[2],
                        {{"0023.0 0022.9 0050.0 0049.8 " + channels, kStanding},
                         {"0023.0 0022.9 0050.0 0049.8 " + channels + "Z", kStanding},
                         {"23.0 -40.0 0", kStanding},
                         {"23. x 1", kStanding},
                         {"23.00  1", kStanding},
                         {"0023.1 0022.9 0050.0 0049.8 " + channels, kMoving},
                         {"-040.0 0022.9 0050.0 0049.8 " + channels, kMoving},
                         {"0-40.0 0022.9 0050.0 0049.8 " + channels, kMoving},
                         {"+023.0 0022.9 " + channels, kMoving},
                         {"0230.0 0022.9 " + channels, kMoving},
                         {"0023 0022.9 " + channels, kMoving},
                         {"", kOther},
                         {"0", kOther},
                         {"0023.0", kOther},
                         {"0023.0 " + channels, kOther},
                         {"0023.0 0022.9 ", kOther},
                         {"0023.0 0022.9 0120", kOther},
                         {"0023.0 0022.9 01ZZ", kOther},
                         {"0023.0 0022.9 Z", kOther},
                         {" 0023.0 0022.9 01", kOther},
                         {"x 0022.9 01", kOther},
                         {"0023.0 0022.9 01 ", kOther},
                         {"ASCII-2 Protocol", kOther}});
}

}  // namespace
}  // namespace abcal::weiss_simserv
