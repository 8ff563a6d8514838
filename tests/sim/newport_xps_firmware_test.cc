#include "sim/firmware/newport_xps_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::HasSubstr;
using testing::StartsWith;

class NewportXpsFirmwareTest : public testing::Test {
 protected:
  std::string ask(const std::string& command, Clock::Duration wait = milliseconds(2)) {
    host.send(command);
    return host.listen(wait);
  }
  /// Ready, at 0.
  void start() {
    ask("GroupInitialize(Group1)");
    EXPECT_EQ(ask("GroupHomeSearch(Group1)", seconds(5)), "0,,EndOfAPI");
  }

  std::shared_ptr<SimBench> bench = std::make_shared<SimBench>(BenchTruth{});
  NewportXpsFirmware firmware{bench};
  FirmwareHost host{firmware};
};

TEST_F(NewportXpsFirmwareTest, SaysHowTheControllerIs) {
  EXPECT_EQ(ask("ControllerStatusGet(int *)"), "0,0,EndOfAPI");
  EXPECT_EQ(ask("ControllerStatusStringGet(0, char *)"), "0,Controller status OK,EndOfAPI");
  EXPECT_THAT(ask("GroupStatusListGet(char *)"), HasSubstr("44 : Moving state;"));
  EXPECT_EQ(ask("PositionerMotionDoneSet(Group1.Pos,0.01,0.2,0.3,0.04,5)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("PositionerMotionDoneGet(Group1.Pos,double *,double *,double *,double *,double *)"),
            "0,0.01,0.2,0.3,0.04,5,EndOfAPI");
  EXPECT_EQ(ask("PositionerBacklashEnable(Group2.Pos)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("PositionerBacklashGet(Group2.Pos,double *,char *)"), "0,0,Enable,EndOfAPI");
  EXPECT_EQ(ask("DoubleGlobalArraySet(3,1.5)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("DoubleGlobalArrayGet(3,double *)"), "0,1.5,EndOfAPI");
  EXPECT_THAT(ask("GroupSpinParametersSet(Group1,10,10)"), StartsWith("-8,")) << "no spindle";
  EXPECT_THAT(ask("MultipleAxesPVTVerification(Group1,a.trj)"), StartsWith("-8,"));
  EXPECT_TRUE(firmware.unserved().all().empty());
  EXPECT_THAT(ask("TCLScriptExecute(a.tcl,task,0)"), StartsWith("-4,"));
  ASSERT_EQ(firmware.unserved().all().size(), 1U);
  EXPECT_EQ(firmware.unserved().all()[0].bytes, "TCLScriptExecute(a.tcl,task,0)");
}

TEST_F(NewportXpsFirmwareTest, JogsAtAVelocity) {
  EXPECT_THAT(ask("GroupJogModeEnable(Group1)"), StartsWith("-22,")) << "not referenced";
  start();
  EXPECT_EQ(ask("GroupJogModeEnable(Group1)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("GroupStatusGet(Group1,int *)"), "0,47,EndOfAPI");
  EXPECT_EQ(ask("GroupJogParametersSet(Group1,-5,100)"), "0,,EndOfAPI");
  host.listen(seconds(2));
  EXPECT_EQ(ask("GroupJogParametersGet(Group1,double *,double *)"), "0,-5,100,EndOfAPI");
  EXPECT_THAT(ask("GroupJogCurrentGet(Group1,double *,double *)"), StartsWith("0,-5"));
  EXPECT_THAT(ask("GroupJogModeDisable(Group1)"), StartsWith("-22,")) << "it turns";
  EXPECT_EQ(ask("GroupJogParametersSet(Group1,0,100)"), "0,,EndOfAPI");
  host.listen(seconds(1));
  EXPECT_EQ(ask("GroupJogModeDisable(Group1)"), "0,,EndOfAPI");
  EXPECT_NEAR(bench->commanded_angle(StageAxis::kX, host.clock().now()).deg(), -10.0, 0.5);
  EXPECT_THAT(ask("GroupJogParametersSet(Group1,1,1)"), StartsWith("-22,")) << "not in the jog mode any more";
}

TEST_F(NewportXpsFirmwareTest, GathersWhileTheAxisMoves) {
  start();
  EXPECT_THAT(ask("GatheringRun(10,8)"), StartsWith("-32,"));
  EXPECT_THAT(ask("GatheringConfigurationSet(Group1.Pos.Colour)"), StartsWith("-29,"));
  EXPECT_EQ(ask("GatheringConfigurationSet(Group1.Pos.CurrentPosition,Group1.Pos.SetpointVelocity)"),
            "0,,EndOfAPI");
  EXPECT_EQ(ask("GatheringConfigurationGet(char *)"),
            "0,Group1.Pos.CurrentPosition;Group1.Pos.SetpointVelocity;,EndOfAPI");
  EXPECT_EQ(ask("EventExtendedConfigurationTriggerSet(Group1.Pos.SGamma.MotionStart,0,0,0,0)"),
            "0,,EndOfAPI");
  EXPECT_EQ(ask("EventExtendedConfigurationActionSet(GatheringRun,100,80,0,0)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("EventExtendedStart(int *)"), "0,1,EndOfAPI");
  EXPECT_EQ(ask("GatheringCurrentNumberGet(int *,int *)"), "0,0,500000,EndOfAPI");
  EXPECT_EQ(ask("GroupMoveAbsolute(Group1,30)", seconds(10)), "0,,EndOfAPI");
  EXPECT_EQ(ask("GatheringCurrentNumberGet(int *,int *)"), "0,100,500000,EndOfAPI");
  EXPECT_EQ(ask("GatheringDataGet(0,char *)"), "0,0;0,EndOfAPI");
  // 0.99 s after the start; the stage turns at 20 degrees/s by then.
  const std::string last = ask("GatheringDataGet(99,char *)");
  const double position = std::stod(last.substr(2));
  EXPECT_GT(position, 5.0);
  EXPECT_LT(position, 20.0);
  EXPECT_THAT(last, HasSubstr(";20"));
  EXPECT_THAT(ask("GatheringDataGet(100,char *)"), StartsWith("-17,"));
  const std::string lines = ask("GatheringDataMultipleLinesGet(0,100,char *)");
  EXPECT_EQ(std::count(lines.begin(), lines.end(), '\n'), 99);
  EXPECT_EQ(ask("EventExtendedRemove(1)"), "0,,EndOfAPI");
  EXPECT_THAT(ask("EventExtendedRemove(1)"), StartsWith("-83,"));
}

TEST_F(NewportXpsFirmwareTest, AHostCanSayWhereTheAxisIs) {
  ask("GroupInitialize(Group1)");
  EXPECT_EQ(ask("GroupReferencingStart(Group1)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("GroupReferencingActionExecute(Group1.Pos,SetPosition,None,12.5)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("GroupReferencingStop(Group1)"), "0,,EndOfAPI");
  EXPECT_EQ(ask("GroupStatusGet(Group1,int *)"), "0,11,EndOfAPI");
  EXPECT_EQ(ask("GroupPositionCurrentGet(Group1,double *)"), "0,12.5,EndOfAPI");
}

}  // namespace
}  // namespace abcal::sim
