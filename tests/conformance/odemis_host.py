#!/usr/bin/env python3
"""odemis's driver of PI controllers with two emulated ones in a daisy chain.

Its part below the units, as it knows only micrometres and millimetres, and these are degrees. Its framework is
replaced by empty modules.
"""

import socket
import sys
import time
import types

import emulated


class HwError(IOError):
    """As odemis has it."""


class Actuator:
    """Its documentation is taken over."""

    moveRel = moveAbs = reference = stop = lambda self: None


def empty_modules():
    model = types.ModuleType("odemis.model")
    model.HwError = HwError
    model.Actuator = Actuator
    model.isasync = lambda function: function
    model.CancellableFuture = model.CancellableThreadPoolExecutor = object
    util = types.ModuleType("odemis.util")
    util.driver = types.SimpleNamespace(getSerialDriver=lambda port: port)
    util.to_str_escape = repr
    package = types.ModuleType("odemis")
    package.model, package.util = model, util
    package.__path__ = []
    sys.modules.update({"odemis": package, "odemis.model": model, "odemis.util": util})


def run(arguments, checks):
    if not arguments.host:
        return None
    empty_modules()
    sys.path.insert(0, arguments.host + "/src/odemis/driver")
    try:
        import pigcs
    except ImportError as error:
        print(error, file=sys.stderr)
        return None

    section = emulated.STAGE.format(driver="pi_gcs", port="tcp:0")
    section += '[stage.x]\naxis = "1 1"\n[stage.z]\naxis = "2 1"\n'
    with emulated.bench(arguments.abcal, section, model='stage_model = "E-861"') as bench:
        connection = socket.create_connection(bench.tcp("stage"), timeout=5)
        bus = pigcs.IPBusAccesser(connection, master=None)
        controllers = {}
        for address in (1, 2):
            # Its class by the model checks units; the base is what all of them share.
            controller = controllers[address] = object.__new__(pigcs.Controller)
            checks.step(f"start of controller {address}",
                        lambda: pigcs.Controller.__init__(controller, bus, address, {"1": True}))
        two = controllers[2]
        checks.step("identification", two.GetIdentification, lambda text: "E-861" in text)
        checks.step("commands", two.GetAvailableCommands, lambda commands: "MOV" in commands)
        checks.step("parameters", two.GetAvailableParameters, lambda parameters: 0x7000601 in parameters)
        checks.step("switches", lambda: (two.HasLimitSwitches("1"), two.HasRefSwitch("1")), (True, True))
        checks.step("unit", lambda: two.GetParameter("1", 0x7000601).lower(), "deg")
        checks.step("servo", lambda: two.SetServo("1", True))
        checks.step("reference", lambda: two.ReferenceToSwitch("1"))
        time.sleep(0.5)
        checks.step("referenced", lambda: two.IsReferenced("1"), True)
        checks.step("the other one is not", lambda: controllers[1].IsReferenced("1"), False)
        checks.step("move", lambda: two.MoveAbs("1", 12.5))
        time.sleep(0.5)
        checks.step("motion status", two.GetMotionStatus, lambda moving: not moving)
        checks.step("position", lambda: round(two.GetPosition("1"), 3), 12.5)
        checks.step("stop", two.Stop)
        checks.step("error of a stop", lambda: two.GetErrorNum() in (0, 10), True)
        checks.step("unserved", lambda: bench.status()["unserved"], [])
    return "of the checkout"


emulated.main("odemis pigcs", "two PI E-861 in a daisy chain (pi_gcs), TCP", run)
