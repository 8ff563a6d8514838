#include "drivers/thorlabs_apt/stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "drivers/thorlabs_apt/codec.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/thorlabs_apt_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/reply_verdicts.h"
#include "tests/support/error_of.h"

namespace abcal::thorlabs_apt {
namespace {

using namespace std::chrono_literals;
using namespace std::string_literals;
using test::error_of;
using ::testing::HasSubstr;

class ThorlabsAptStageTest : public ::testing::Test {
 protected:
  std::unique_ptr<ThorlabsAptStage> connect(const StageSettings& settings = {},
                                            sim::ThorlabsAptSettings controller = {}) {
    controller.axis_names = settings.axis_names;
    firmware_ = std::make_shared<sim::ThorlabsAptFirmware>(world_, controller);
    return std::make_unique<ThorlabsAptStage>(std::make_unique<sim::FirmwareStream>(firmware_, clock_),
                                              clock_, settings);
  }

  static sim::ThorlabsAptSettings k10cr1() {
    sim::ThorlabsAptSettings controller;
    controller.model = "K10CR1";
    controller.serial_number = "55000001";
    controller.counts_per_degree = 409600.0 / 3.0;
    controller.velocity_per_count_s = 53.68;
    controller.servo = false;
    return controller;
  }

  void wait(ThorlabsAptStage& stage, StageAxis axis) {
    while (stage.motion_state(axis) == MotionState::kMoving) clock_.sleep_until(clock_.now() + 20ms);
  }

  sim::SimClock clock_;
  std::shared_ptr<sim::SimBench> world_ = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock_.now());
  std::shared_ptr<sim::ThorlabsAptFirmware> firmware_;
};

TEST_F(ThorlabsAptStageTest, SaysWhatTheControllerIs) {
  const StageInfo info = connect()->identify();
  EXPECT_EQ(info.maker, "Thorlabs");
  EXPECT_EQ(info.model, "BBD202");
  EXPECT_EQ(info.serial_number, "73123456");
  EXPECT_EQ(info.firmware, "2.0.4");
  EXPECT_EQ(info.axes[0].stage_name, "DDR100");
  EXPECT_NEAR(info.axes[0].speed_deg_per_s, 20.0, 1e-3);
  EXPECT_FALSE(info.axes[1].referenced);
}

TEST_F(ThorlabsAptStageTest, AUnitIsOneAxis) {
  StageSettings settings;
  settings.axis_names = {"", "1"};
  const auto stage = connect(settings, k10cr1());
  const StageInfo info = stage->identify();
  EXPECT_EQ(info.model, "K10CR1");
  EXPECT_EQ(info.axes[1].stage_name, "K10CR1");
  stage->home(StageAxis::kZ);
  wait(*stage, StageAxis::kZ);
  EXPECT_TRUE(stage->identify().axes[1].referenced);
  stage->move_to(StageAxis::kZ, Angle::degrees(-33.3));
  wait(*stage, StageAxis::kZ);
  EXPECT_NEAR(stage->encoder_angle(StageAxis::kZ).deg(), -33.3, 1e-3);
  EXPECT_NEAR(world_->commanded_angle(StageAxis::kZ, clock_.now()).deg(), -33.3, 1e-3);
  EXPECT_EQ(error_of([&] { stage->home(StageAxis::kX); }).fault(), Fault::kNotReady);
}

TEST_F(ThorlabsAptStageTest, WhichStageAStepperControllerDrivesMustBeSaid) {
  sim::ThorlabsAptSettings controller = k10cr1();
  controller.model = "BSC202";
  controller.counts_per_degree = 75091.0 / 0.99997;
  const auto unknown = connect({}, controller);
  const auto error = error_of([&] { unknown->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.detail(), HasSubstr("axis = \"1 HDR50\""));

  StageSettings settings;
  settings.axis_names = {"1 HDR50", "2 HDR50"};
  const auto stage = connect(settings, controller);
  EXPECT_EQ(stage->identify().axes[0].stage_name, "HDR50");
  stage->home(StageAxis::kX);
  wait(*stage, StageAxis::kX);
  stage->move_to(StageAxis::kX, Angle::degrees(90.0));
  wait(*stage, StageAxis::kX);
  EXPECT_NEAR(world_->commanded_angle(StageAxis::kX, clock_.now()).deg(), 90.0, 1e-3);
}

TEST_F(ThorlabsAptStageTest, TheSpeedOfTheBenchFileIsSetAndReadBack) {
  StageSettings settings;
  settings.speed_deg_per_s[0] = 7.5;
  const auto stage = connect(settings);
  stage->home(StageAxis::kX);
  EXPECT_NEAR(world_->motion_limits(StageAxis::kX).speed_deg_per_s, 7.5, 1e-3);
}

TEST_F(ThorlabsAptStageTest, AMoveBeforeHomingIsNotReady) {
  const auto stage = connect();
  EXPECT_EQ(error_of([&] { stage->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNotReady);
}

TEST_F(ThorlabsAptStageTest, AMotionThatSomebodyElseStopsIsNoArrival) {
  const auto stage = connect();
  stage->home(StageAxis::kX);
  wait(*stage, StageAxis::kX);
  stage->move_to(StageAxis::kX, Angle::degrees(100.0));
  world_->halt(StageAxis::kX, clock_.now());
  clock_.sleep_until(clock_.now() + 2s);
  const auto error = error_of([&] { stage->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.detail(), HasSubstr("from its target"));
  EXPECT_EQ(stage->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST_F(ThorlabsAptStageTest, SettingsThatCannotBeAreRefused) {
  StageSettings settings;
  for (const std::array<std::string, 2>& names : {std::array<std::string, 2>{"1", "1"},
                                                  {"0", "1"},
                                                  {"X", "1"},
                                                  {"1 LTS150", "2"},
                                                  {"1 HDR50 2", "2"}}) {
    settings.axis_names = names;
    EXPECT_THROW(ThorlabsAptStage(std::make_unique<sim::FirmwareStream>(nullptr, clock_), clock_, settings),
                 std::invalid_argument)
        << names[0];
  }
}

// ---- The simulated controller

TEST_F(ThorlabsAptStageTest, HalfAMessageIsDroppedAfterAWhile) {
  connect();
  firmware_->receive("*IDN?\r\n", clock_.now());
  clock_.sleep_until(clock_.now() + 200ms);
  firmware_->receive(short_message(kRequestInfo, 0, 0, kRack), clock_.now());
  clock_.sleep_until(clock_.now() + 200ms);
  EXPECT_EQ(firmware_->transmit(clock_.now()).size(), 90U);
}

TEST_F(ThorlabsAptStageTest, MessagesForOthersArePassedOver) {
  connect();
  firmware_->receive(short_message(kRequestInfo, 0, 0, kUnit), clock_.now());
  firmware_->receive(short_message(kRequestServoStatus, 1, 0, 0x25), clock_.now());
  clock_.sleep_until(clock_.now() + 200ms);
  EXPECT_EQ(firmware_->transmit(clock_.now()), "");
}

/// The message of the status bits, as a bay or a unit sends it.
std::string status_bits(char source, const std::string& bits) {
  return "\x2a\x04\x06\x00\x81"s + source + "\x01\x00"s + bits;
}

TEST_F(ThorlabsAptStageTest, ItsRecipeTellsStandingAxesFromMovingOnesAndFromOtherMessages) {
  using enum test::Verdict;
  const auto stage = connect();
  const HaltRecipe recipe = stage->halt_recipes().at(0);
  ASSERT_TRUE(recipe.binary);
  ASSERT_EQ(recipe.questions.size(), 2U);
  const std::string stands = status_bits('\x21', "\x00\x04\x00\x80"s),
                    moves = status_bits('\x21', "\x10\x04\x00\x80"s);
  test::expect_verdicts(
      recipe, recipe.questions[0],
      {{stands, kStanding},
       {moves, kMoving},
       {status_bits('\x50', "\x00\x04\x00\x80"s), kStanding},  // A unit without bays.
       {status_bits('\x50', "\x20\x04\x00\x80"s), kMoving},
       {status_bits('\x22', "\x00\x04\x00\x80"s), kOther},
       {"", kOther},
       {std::string(12, '\0'), kOther},
       {"\x2a\x04\x06\x00\x81\x21\x02\x00\x00\x04\x00\x80"s, kOther},  // Channel 2.
       {"\x81\x04\x06\x00\x81\x21\x01\x00\x00\x04\x00\x80"s, kOther},  // Another message.
       {"\x2a\x04\x06\x00\x82\x21\x01\x00\x00\x04\x00\x80"s, kOther},  // To somebody else.
       {"\x64\x04\x0e\x00\x81\x21\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x04\x00\x80"s, kOther},
       {"\x81\x00\x44\x00\x81\x21"s + std::string(68, 'x'), kOther},  // An error.
       // At any byte, after and before other messages; its last three bytes may be the beginning of the next.
       {"\x64\x04\x2a"s + stands, kStanding},
       {stands + "\x2a\x04\x06"s, kStanding},
       {stands.substr(0, 5) + stands, kStanding},
       {stands.substr(0, 11), kOther},
       {stands.substr(1), kOther}});
  test::expect_verdicts(recipe, recipe.questions[1],
                        {{status_bits('\x22', "\x00\x04\x00\x80"s), kStanding},
                         {status_bits('\x22', "\x80\x04\x00\x80"s), kMoving},
                         {stands, kOther},
                         {status_bits('\x50', "\x00\x04\x00\x80"s), kOther}});
  // Each value of the bytes in which bits 4 to 7 and 9 are.
  const std::string hexadecimal = "0123456789abcdef", bit_9_clear = "014589cd";
  for (unsigned first = 0; first < 256; ++first) {
    for (unsigned second = 0; second < 256; ++second) {
      const std::string bits{static_cast<char>(first), static_cast<char>(second), '\x0d', '\x0a'};
      const bool still =
          hexadecimal[first / 16] == '0' && bit_9_clear.find(hexadecimal[second % 16]) != std::string::npos;
      ASSERT_EQ(test::verdict_on(recipe, recipe.questions[0], status_bits('\x21', bits)),
                still ? kStanding : kMoving)
          << first << ' ' << second;
    }
  }
}

TEST_F(ThorlabsAptStageTest, OnceIdentifiedItsRecipeAsksOnePlace) {
  using enum test::Verdict;
  const auto stage = connect();
  stage->identify();
  const HaltRecipe recipe = stage->halt_recipes().at(0);
  test::expect_verdicts(recipe, recipe.questions.at(0),
                        {{status_bits('\x21', "\x00\x04\x00\x80"s), kStanding},
                         {status_bits('\x21', "\x40\x04\x00\x80"s), kMoving},
                         {status_bits('\x50', "\x00\x04\x00\x80"s), kOther}});
}

}  // namespace
}  // namespace abcal::thorlabs_apt
