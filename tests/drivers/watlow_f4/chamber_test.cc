#include "drivers/watlow_f4/chamber.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/instrument/instrument_error.h"
#include "sim/faults.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/watlow_f4_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/reply_verdicts.h"

namespace abcal::watlow_f4 {
namespace {

using namespace std::string_literals;
using testing::HasSubstr;

struct Rig {
  explicit Rig(const sim::WatlowF4Settings& settings, ChamberSettings own = {},
               std::vector<sim::WireFault> faults = {}) {
    own.tcp_framing = settings.tcp;
    own.pause_output = 2;
    world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
    std::unique_ptr<wire::ByteStream> stream = std::make_unique<sim::FirmwareStream>(
        std::make_shared<sim::WatlowF4Firmware>(world, settings), clock);
    auto faulty = std::make_unique<sim::FaultyStream>(std::move(stream), clock, std::move(faults));
    link = faulty.get();
    stream = std::move(faulty);
    chamber = std::make_unique<WatlowChamber>(std::move(stream), clock, own);
  }
  void wait(double seconds) { clock.sleep_until(clock.now() + from_seconds(seconds)); }
  sim::SimClock clock;
  std::shared_ptr<sim::SimBench> world;
  sim::FaultyStream* link = nullptr;
  std::unique_ptr<WatlowChamber> chamber;
};

class WatlowChamberTest : public testing::TestWithParam<std::pair<bool, bool>> {
 protected:
  sim::WatlowF4Settings settings() const { return {.f4t = GetParam().first, .tcp = GetParam().second}; }
};

TEST_P(WatlowChamberTest, HeatsAndCools) {
  Rig rig(settings());
  const ChamberInfo info = rig.chamber->identify();
  EXPECT_EQ(info.least_set_degc, -70.0);
  EXPECT_EQ(info.most_set_degc, 180.0);
  EXPECT_EQ(info.can_ramp, GetParam().first);
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

TEST_P(WatlowChamberTest, ASetPointOutsideItsHardwareIsNeverSent) {
  Rig rig(settings());
  rig.chamber->identify();
  try {
    rig.chamber->set_temperature(200.0, std::nullopt);
    FAIL();
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kOutOfTravel);
    EXPECT_THAT(error.what(), HasSubstr("-70 to 180 degC"));
  }
  EXPECT_FALSE(rig.world->commanded_chamber().running);
}

TEST_P(WatlowChamberTest, DegreesFahrenheitAreRefusedBeforeAnythingIsSet) {
  sim::WatlowF4Settings settings = this->settings();
  settings.fahrenheit = true;
  Rig rig(settings);
  try {
    rig.chamber->identify();
    FAIL();
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
    EXPECT_THAT(error.what(), testing::AllOf(HasSubstr("degF"), HasSubstr("required: degC")));
  }
}

TEST_P(WatlowChamberTest, AlarmAndDoorAreTold) {
  ChamberSettings own;
  if (!GetParam().first) own.door_input = 1;
  Rig rig(settings(), own);
  rig.chamber->identify();
  EXPECT_TRUE(rig.chamber->read().alarms.empty());
  EXPECT_FALSE(rig.chamber->read().door_open);
  rig.world->inject({.kind = sim::FaultKind::kChamberAlarm, .at = rig.clock.now()});
  EXPECT_EQ(rig.chamber->read().alarms.size(), 1U);
  rig.world->clear_faults(rig.clock.now());
  rig.wait(1.0);
  rig.world->inject({.kind = sim::FaultKind::kChamberDoor, .at = rig.clock.now()});
  const ChamberReading reading = rig.chamber->read();
  EXPECT_TRUE(reading.door_open || !reading.alarms.empty());
}

// At every call the chamber does as requested, or reports the fault within seconds.
TEST_P(WatlowChamberTest, FaultsOfTheWireAtEveryWrite) {
  const auto series = [](Rig& rig) {
    rig.chamber->identify();
    rig.chamber->set_temperature(60.0, 2.0);
    rig.chamber->run();
    const double air = rig.chamber->read().air_degc;
    EXPECT_NEAR(air, 23.0, 1.5);
    EXPECT_NEAR(rig.world->commanded_chamber().target_degc, 60.0, 1e-3);
    EXPECT_TRUE(rig.world->commanded_chamber().running);
  };
  for (const sim::FaultKind kind :
       {sim::FaultKind::kSilence, sim::FaultKind::kGarbage, sim::FaultKind::kFlippedBits,
        sim::FaultKind::kDroppedBytes, sim::FaultKind::kSplitFrame, sim::FaultKind::kLateReply,
        sim::FaultKind::kReplacedReply, sim::FaultKind::kUnplug}) {
    for (std::size_t write = 1; write <= 24; ++write) {
      sim::WireFault fault;
      fault.kind = kind;
      fault.at_write = write;
      fault.for_writes = 1;
      fault.text = "?\r\n";
      Rig rig(settings(), {.model = GetParam().first ? "F4T" : "F4"}, {fault});
      const Clock::Instant start = rig.clock.now();
      try {
        series(rig);
        EXPECT_FALSE(kind == sim::FaultKind::kUnplug && rig.link->writes() >= write) << write;
      } catch (const InstrumentError& error) {
        // Modbus TCP has no checksum of its own: TCP has one. A wrong bit in it is made here, never on a
        // line.
        const bool damaged = GetParam().second && kind == sim::FaultKind::kFlippedBits;
        const bool told = error.fault() == Fault::kNoReply || error.fault() == Fault::kBadFrame ||
                          error.fault() == Fault::kLinkLost || damaged;
        EXPECT_TRUE(told) << static_cast<int>(kind) << ' ' << write << ": " << error.what();
      }
      EXPECT_LT(to_seconds(rig.clock.now() - start), 12.0) << static_cast<int>(kind) << ' ' << write;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, WatlowChamberTest,
                         testing::Values(std::pair(true, true), std::pair(true, false),
                                         std::pair(false, false)),
                         [](const auto& one) {
                           return std::string(one.param.first ? "F4T" : "F4") +
                                  (one.param.second ? "Tcp" : "Rtu");
                         });

TEST(WatlowChamberTest, AnF4KeepsItsSetPointWhereItIsThereAlready) {
  Rig rig(sim::WatlowF4Settings{.f4t = false, .decimals = 2});
  rig.chamber->identify();
  rig.chamber->set_temperature(-40.25, std::nullopt);
  rig.chamber->run();
  EXPECT_NEAR(rig.world->commanded_chamber().target_degc, -40.25, 1e-9);
}

TEST(WatlowChamberTest, TheRampIsTheControllers) {
  Rig rig(sim::WatlowF4Settings{});
  rig.chamber->identify();
  rig.chamber->set_temperature(83.0, 1.0);
  rig.chamber->run();
  rig.wait(1800.0);
  EXPECT_NEAR(rig.chamber->read().set_degc, 53.0, 0.5);
  rig.wait(3600.0);
  EXPECT_NEAR(rig.chamber->read().air_degc, 83.0, 0.1);
}

TEST(WatlowChamberTest, TheRecipeOfAnF4TellsAnswersApart) {
  using enum test::Verdict;
  Rig rig(sim::WatlowF4Settings{.f4t = false});
  rig.chamber->identify();
  const HaltRecipe recipe = rig.chamber->rest_recipe(ChamberPolicy::kAmbient).value();
  ASSERT_TRUE(recipe.binary);
  ASSERT_EQ(recipe.questions.size(), 3U);
  const std::string pause_off = "\x01\x06\x07\xda\x00\x00\xa9\x45"s,
                    set = "\x01\x06\x01\x2c\x00\xe6\xc8\x75"s;
  test::expect_verdicts(recipe, recipe.questions[0],
                        {{pause_off, kStanding},
                         {"\x00\x01"s + pause_off + "\x01"s, kStanding},  // At any byte.
                         {"\x01\x06\x07\xda\x00\x01\x68\x85"s, kOther},
                         {"\x01\x06\x07\xd0\x00\x00\x89\x47"s, kOther},
                         {"\x01\x86\x03\x02\x61"s, kOther},
                         {set, kOther},
                         {pause_off.substr(0, 7), kOther},
                         {pause_off.substr(1), kOther},
                         {"", kOther}});
  test::expect_verdicts(recipe, recipe.questions[1],
                        {{set, kStanding},
                         {"\x01\x06\x01\x2c\xfe\x70\x08\x7b"s, kOther},  // -40 degC
                         {"\x02\x06\x01\x2c\x00\xe6\xc8\x46"s, kOther},  // Another unit.
                         {"\x01\x06\x01\x2c\x00\xe6\xc8\x74"s, kOther},
                         {pause_off, kOther},
                         {"\x01\x86\x03\x02\x61"s, kOther}});
  test::expect_verdicts(recipe, recipe.questions[2],
                        {{"\x01\x03\x02\x00\xe6\x39\xce"s, kStanding},
                         {"\x01\x03\x02\xfe\x70\xf9\xc0"s, kMoving},
                         {"\x01\x03\x02\x0d\x0a\x3c\xd3"s, kMoving},
                         {"\x01\x03\x02\x00"s, kOther},
                         {"\x01\x83\x02\xc0\xf1"s, kOther},
                         {"\x01\x03\x04\x00\x00\x41\xb8"s, kOther},
                         {"\x02\x03\x02\x00\xe6"s, kOther},
                         {set, kOther},
                         {"", kOther}});
}

TEST(WatlowChamberTest, TheRecipeOfAnF4TTellsAnswersApart) {
  using enum test::Verdict;
  Rig rig(sim::WatlowF4Settings{.f4t = true, .tcp = true});
  rig.chamber->identify();
  const HaltRecipe recipe = rig.chamber->rest_recipe(ChamberPolicy::kOff).value();
  ASSERT_TRUE(recipe.binary);
  ASSERT_EQ(recipe.questions.size(), 4U);
  const std::string head = "\xff\xff\x00\x00\x00\x06\x01"s;
  const std::string event_off = head + "\x06\x40\xd4\x00\x3e"s, ramp_off = head + "\x06\x0a\xea\x00\x3e"s,
                    set = head + "\x10\x0a\xde\x00\x02"s;
  const std::string older = "\x00\x07"s + set.substr(2);
  const std::string exception = "\xff\xff\x00\x00\x00\x03\x01\x90\x03"s;
  test::expect_verdicts(recipe, recipe.questions[0],
                        {{event_off, kStanding}, {ramp_off, kOther}, {set, kOther}, {exception, kOther}});
  test::expect_verdicts(recipe, recipe.questions[1],
                        {{ramp_off, kStanding}, {event_off, kOther}, {set, kOther}, {exception, kOther}});
  test::expect_verdicts(recipe, recipe.questions[2],
                        {{set, kStanding},
                         {"x" + set + "x", kStanding},
                         {older, kOther},
                         {ramp_off, kOther},
                         {exception, kOther},
                         {set.substr(0, set.size() - 1), kOther}});
  const std::string value = "\xff\xff\x00\x00\x00\x07\x01\x03\x04"s;
  test::expect_verdicts(recipe, recipe.questions[3],
                        {{value + "\x00\x00\x41\xb8"s, kStanding},  // 23
                         {value + "\x33\x33\x41\xbb"s, kMoving},    // 23.4
                         {value + "\x00\x00\xc2\x20"s, kMoving},    // -40
                         {value + "\x00\x00\x41"s, kOther},
                         {"\xff\xff\x00\x00\x00\x03\x01\x83\x02"s, kOther},
                         {set, kOther},
                         {"", kOther}});
}

}  // namespace
}  // namespace abcal::watlow_f4
