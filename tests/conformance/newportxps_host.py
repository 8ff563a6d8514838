#!/usr/bin/env python3
"""The functions of newportxps with the emulated XPS controller. Its upper class also wants FTP, for system.ini, which
is not emulated."""

import pathlib
import sys
import threading
import time
import types

import emulated


def run(arguments, checks):
    if arguments.host:
        # Without its __init__.py, which wants libraries for FTP and SFTP.
        package = types.ModuleType("newportxps")
        package.__path__ = [str(pathlib.Path(arguments.host) / "newportxps")]
        sys.modules["newportxps"] = package
    try:
        from newportxps.XPS_C8_drivers import XPS
    except ImportError:
        return None

    sections = emulated.STAGE.format(driver="newport_xps", port="tcp:127.0.0.1:0")
    with emulated.bench(arguments.abcal, sections) as bench:
        host, port = bench.tcp("stage")
        xps = XPS()
        status = xps.TCP_ConnectToServer(host, port, 20)
        motion = xps.TCP_ConnectToServer(host, port, 20)
        checks.step("two connections", lambda: (status, motion), lambda ids: ids[0] >= 0 and ids[1] > 0)
        checks.step("error list", lambda: len(xps.errorcodes), lambda count: count > 10)
        checks.step("login", lambda: xps.Login(status, "Administrator", "Administrator")[0], 0)
        checks.step("firmware", lambda: xps.FirmwareVersionGet(status)[1], lambda text: "XPS" in text)
        checks.step("elapsed time", lambda: float(xps.ElapsedTimeGet(status)[1]), lambda s: s >= 0.0)
        checks.step("objects", lambda: xps.ObjectsListGet(status)[1], lambda text: "Group1.Pos" in text)
        checks.step("status", lambda: xps.GroupStatusGet(status, "Group1")[:2], [0, 0])
        checks.step("status in words", lambda: xps.GroupStatusStringGet(status, 0)[0], 0)
        checks.step("kill", lambda: xps.GroupKill(status, "Group1")[0], 0)
        checks.step("initialize", lambda: xps.GroupInitialize(status, "Group1")[0], 0)
        checks.step("home search", lambda: xps.GroupHomeSearch(motion, "Group1")[0], 0)
        checks.step("homed", lambda: xps.GroupStatusGet(status, "Group1")[1], 11)
        checks.step("maxima", lambda: xps.PositionerMaximumVelocityAndAccelerationGet(status, "Group1.Pos")[0], 0)
        checks.step("travel", lambda: xps.PositionerUserTravelLimitsGet(status, "Group1.Pos")[:1], [0])
        profile = xps.PositionerSGammaParametersGet(status, "Group1.Pos")
        checks.step("profile", lambda: len(profile), 5)
        checks.step("set profile", lambda: xps.PositionerSGammaParametersSet(
            status, "Group1.Pos", 100.0, *profile[2:])[0], 0)
        checks.step("blocking move", lambda: xps.GroupMoveAbsolute(motion, "Group1.Pos", [30.0])[0], 0)
        checks.step("position", lambda: xps.GroupPositionCurrentGet(status, "Group1.Pos", 1)[1],
                    lambda angle: abs(angle - 30.0) < 1e-3)
        checks.step("relative move", lambda: xps.GroupMoveRelative(motion, "Group1", [-10.0])[0], 0)
        checks.step("target", lambda: xps.GroupPositionTargetGet(status, "Group1", 1)[1],
                    lambda angle: abs(angle - 20.0) < 1e-3)
        replies = []
        mover = threading.Thread(
            target=lambda: replies.append(xps.GroupMoveAbsolute(motion, "Group1", [300.0])[0]))
        mover.start()
        deadline = time.monotonic() + 5
        while xps.GroupStatusGet(status, "Group1")[1] != 44 and time.monotonic() < deadline:
            time.sleep(0.01)
        checks.step("abort from another connection", lambda: xps.GroupMoveAbort(status, "Group1")[0], 0)
        mover.join(5)
        checks.step("the aborted move answers -27", lambda: replies, [-27])
        checks.step("errors of the positioner", lambda: xps.PositionerErrorGet(status, "Group1.Pos")[:2], [0, 0])
        checks.step("hardware status", lambda: xps.PositionerHardwareStatusGet(status, "Group1.Pos")[0], 0)
        checks.step("error in words", lambda: xps.ErrorStringGet(status, -22)[1], "Not allowed action")
        checks.step("refusal", lambda: xps.GroupInitialize(status, "Group1")[0], -22)
        zero = lambda answer: answer[0] == 0
        checks.step("controller status", lambda: xps.ControllerStatusGet(status)[:2], [0, 0])
        checks.step("controller status in words", lambda: xps.ControllerStatusStringGet(status, 0)[0], 0)
        checks.step("list of states", lambda: xps.GroupStatusListGet(status)[1], lambda text: "Moving state" in text)
        checks.step("windows of a motion", lambda: xps.PositionerMotionDoneGet(status, "Group1.Pos"), zero)
        checks.step("backlash", lambda: xps.PositionerBacklashGet(status, "Group1.Pos"), zero)
        checks.step("corrector", lambda: xps.PositionerCorrectorPIDFFVelocityGet(status, "Group1.Pos"), zero)
        checks.step("times of the motion", lambda: xps.PositionerSGammaPreviousMotionTimesGet(status, "Group1.Pos"), zero)
        checks.step("following error", lambda: xps.GroupCurrentFollowingErrorGet(status, "Group1", 1), zero)
        checks.step("global values", lambda: xps.DoubleGlobalArraySet(status, 1, 2.5)[0]
                    or xps.DoubleGlobalArrayGet(status, 1)[1], 2.5)
        checks.step("configure gathering", lambda: xps.GatheringConfigurationSet(
            status, ["Group1.Pos.CurrentPosition", "Group1.Pos.SetpointVelocity"]), zero)
        checks.step("trigger", lambda: xps.EventExtendedConfigurationTriggerSet(
            status, ["Group1.Pos.SGamma.MotionStart"], ["0"], ["0"], ["0"], ["0"]), zero)
        checks.step("action", lambda: xps.EventExtendedConfigurationActionSet(
            status, ["GatheringRun"], ["100"], ["8"], ["0"], ["0"]), zero)
        event = xps.EventExtendedStart(status)
        checks.step("event", lambda: event, zero)
        checks.step("move with gathering", lambda: xps.GroupMoveRelative(motion, "Group1", [30.0])[0], 0)
        checks.step("samples", lambda: xps.GatheringCurrentNumberGet(status)[1], 100)
        checks.step("lines", lambda: len(xps.GatheringDataMultipleLinesGet(status, 0, 100)[1].split("\n")), 100)
        checks.step("end of the event", lambda: xps.EventExtendedRemove(status, event[1])[0], 0)
        checks.step("jog mode", lambda: xps.GroupJogModeEnable(status, "Group1")[0], 0)
        checks.step("jog", lambda: xps.GroupJogParametersSet(status, "Group1", ["5"], ["100"])[0], 0)
        time.sleep(0.5)
        checks.step("velocity of jogging", lambda: xps.GroupJogCurrentGet(status, "Group1", 1)[1],
                    lambda velocity: abs(velocity - 5.0) < 0.1)
        checks.step("end of jogging", lambda: xps.GroupJogParametersSet(status, "Group1", ["0"], ["100"])[0], 0)
        time.sleep(0.5)
        checks.step("end of jog mode", lambda: xps.GroupJogModeDisable(status, "Group1")[0], 0)
        checks.step("spindles are refused", lambda: xps.GroupSpinParametersSet(status, "Group1", 5, 5)[0], -8)
        checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
        xps.TCP_CloseSocket(status)
        xps.TCP_CloseSocket(motion)
    return "XPS_C8_drivers"


emulated.main("newportxps", "Newport XPS-C8 (newport_xps), TCP", run)
