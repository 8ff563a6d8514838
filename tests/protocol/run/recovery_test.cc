#include "protocol/run/recovery.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/protocol/run/run_parts_fixture.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class ScriptedReconnector final : public Reconnector {
 public:
  bool stage_lost() const override { return stage_is_lost; }
  void reconnect() override {
    if (attempts_to_fail-- > 0) throw InstrumentError("stage", fault, "not there");
    ++reconnected;
  }
  bool stage_is_lost = false;
  int attempts_to_fail = 3;
  Fault fault = Fault::kCannotOpen;
  int reconnected = 0;
};

class RecoveryTest : public test::RunPartsTest {
 protected:
  bool wait(int times = 1) {
    const RunInstruments ports = instruments(&reconnector);
    const ItemChannels items(context(), ports, {});
    if (!plugged_in.empty()) accelerometer.serial_number = plugged_in;
    Recovery recovery(context(), ports, items);
    bool home_again = false;
    for (int k = 0; k < times; ++k) home_again = recovery.wait_for_ports(lost, 5);
    return home_again;
  }
  ScriptedReconnector reconnector;
  std::string plugged_in;  ///< Serial number of the replacement accelerometer; empty: the same one.
  InstrumentError lost{"accelerometer", Fault::kLinkLost, "end of file"};
};

TEST_F(RecoveryTest, WaitsUntilTheAccelerometerIsBackAndLeavesTheReferenceAlone) {
  EXPECT_FALSE(wait());
  EXPECT_EQ(reconnector.reconnected, 1);
  EXPECT_NEAR(to_seconds(clock.now() - Clock::Instant{}), 2.0, 1e-6) << "four attempts, 0.5 s apart";
  ASSERT_EQ(observer.notices.size(), 2U);
  EXPECT_EQ(observer.notices[0].first, kPortLostEvent);
  EXPECT_THAT(observer.notices[0].second, AllOf(HasSubstr("the port of accelerometer"),
                                                HasSubstr("end of file"), HasSubstr("the stage is halted")));
  EXPECT_EQ(observer.notices[1].first, kReconnectedEvent);
  EXPECT_EQ(stage.halts, 2) << "at once, and when all is back";
  EXPECT_EQ(observer.phases.back(), std::pair(std::size_t{5}, RunPhase::kReconnecting));
}

TEST_F(RecoveryTest, AStageThatWasLostIsHaltedAsFarAsItCanBeAndHomedAgain) {
  reconnector.stage_is_lost = true;
  EXPECT_TRUE(wait());
  EXPECT_GE(stage.halts, 2) << "another axis may still be reached";
  EXPECT_THAT(observer.notices[1].second, HasSubstr("after homing both axes again"));
}

TEST_F(RecoveryTest, AStageThatDoesNotAcknowledgeTheHaltIsSaidToBeSoAndEndsTheRun) {
  stage.acknowledges_halt = false;
  const auto [fault, words] = failure_of([&] { wait(); });
  EXPECT_EQ(fault, Fault::kNoReply);
  EXPECT_THAT(words, HasSubstr("stop it by its own switch"));
  EXPECT_THAT(observer.notices[0].second, HasSubstr("did not acknowledge the halt"));
}

TEST_F(RecoveryTest, WhatDoesNotComeBackEndsTheRunWithTheFirstCause) {
  reconnector.attempts_to_fail = 1'000'000;
  settings.protocol.replug_timeout_s = 10.0;
  const auto [fault, words] = failure_of([&] { wait(); });
  EXPECT_EQ(fault, Fault::kLinkLost);
  EXPECT_THAT(words, AllOf(HasSubstr("end of file"), HasSubstr("did not come back within 10 s")));
  EXPECT_NEAR(to_seconds(clock.now() - Clock::Instant{}), 10.0, 0.6);
}

TEST_F(RecoveryTest, AnotherInstrumentIsRefused) {
  plugged_in = "3";
  const auto [fault, words] = failure_of([&] { wait(); });
  EXPECT_EQ(fault, Fault::kWrongIdentity);
  EXPECT_THAT(words, AllOf(HasSubstr("SN 3"), HasSubstr("SN 2")));
}

TEST_F(RecoveryTest, PortsMayNotVanishForEver) {
  settings.limits.max_replugs = 2;
  const auto [fault, words] = failure_of([&] { wait(3); });
  EXPECT_EQ(fault, Fault::kLinkLost);
  EXPECT_THAT(words, AllOf(HasSubstr("vanished 3 times"), HasSubstr("at most 2")));
}

TEST_F(RecoveryTest, IsPossibleOnlyForALostPortThatCanBeOpenedAgain) {
  const RunInstruments with = instruments(&reconnector);
  const RunInstruments without = instruments();
  const InstrumentError stalled("stage", Fault::kStalled, "it stands");
  const ItemChannels items(context(), with, {});
  EXPECT_TRUE(Recovery(context(), with, items).is_possible(lost));
  EXPECT_FALSE(Recovery(context(), with, items).is_possible(stalled));
  EXPECT_FALSE(Recovery(context(), without, items).is_possible(lost));
  stop.request_stop();
  EXPECT_FALSE(Recovery(context(), with, items).is_possible(lost));
}

}  // namespace
}  // namespace abcal
