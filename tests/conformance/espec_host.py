#!/usr/bin/env python3
"""ESPEC's ChamberConnectLibrary with the emulated chamber controllers F4 (serial line) and F4T (TCP).

Needs a checkout for Python 3.
"""

import datetime
import importlib
import os
import pathlib
import sys
import types

import emulated


def library(arguments, module):
    """The module of the checkout; None if it is not there."""
    if arguments.host:
        # Without its __init__.py, which also loads the parts for other controllers.
        package = types.ModuleType("chamberconnectlibrary")
        package.__path__ = [str(pathlib.Path(arguments.host) / "chamberconnectlibrary")]
        sys.modules["chamberconnectlibrary"] = package
    try:
        return importlib.import_module(f"chamberconnectlibrary.{module}")
    except ImportError:
        return None


def constant(controller, checks):
    """What both controllers have: the loop, the chamber, the clock."""
    near = lambda value: lambda found: abs(found - value) < 0.1
    checks.step("process value", lambda: controller.get_loop_pv(1)["air"], near(23.0))
    checks.step("set point", lambda: controller.set_loop_sp(1, 42.5))
    checks.step("set point read", lambda: controller.get_loop_sp(1)["constant"], near(42.5))
    checks.step("range", lambda: controller.get_loop_range(1), {"max": 180.0, "min": -70.0})
    checks.step("enabled", lambda: controller.get_loop_en(1)["constant"], True)
    checks.step("mode", lambda: controller.get_loop_mode(1)["constant"], lambda mode: mode in ("On", "Auto"))
    checks.step("modes", lambda: controller.get_loop_modes(1), lambda modes: len(modes) > 0)
    checks.step("status", controller.get_status, "Standby")
    checks.step("start", controller.const_start)
    checks.step("runs", controller.get_status, "Constant")
    checks.step("power", lambda: controller.get_loop_power(1)["current"], lambda percent: percent > 0.0)
    checks.step("alarms", lambda: controller.get_alarm_status()["active"], [])
    checks.step("event", lambda: controller.set_event(3, True))
    checks.step("event read", lambda: controller.get_event(3)["current"], True)
    time = datetime.datetime(2024, 2, 29, 12, 34, 56)
    checks.step("clock", lambda: controller.set_datetime(time))
    checks.step("clock read", lambda: abs((controller.get_datetime() - time).total_seconds()), lambda late: late < 10.0)
    checks.step("stop", controller.stop)
    checks.step("stopped", controller.get_status, "Standby")


def f4t(arguments, checks):
    module = library(arguments, "watlowf4t")
    if module is None:
        return None
    with emulated.bench(arguments.abcal, emulated.CHAMBER.format(port="tcp:127.0.0.1:0", model="F4T")) as bench:
        host, port = bench.tcp("chamber")
        controller = checks.step("connect", lambda: module.WatlowF4T(interface="TCP", host=host, loops=1))
        if controller is None:
            return "(checkout)"
        # It always connects to port 502.
        controller.connect = lambda: setattr(controller, "client", module.ModbusTCP(1, host, port))
        checks.step("part number", lambda: controller.process_controller(update=False), lambda text: text.startswith("F4T"))
        constant(controller, checks)
        checks.step("units", lambda: controller.process_controller() and controller.get_loop_units(1),
                    lambda unit: unit.endswith("C"))
        checks.step("profile and step", lambda: (controller.get_prgm_cur(), controller.get_prgm_cstep()), (0, 0))
        checks.step("names of the profiles", lambda: len(controller.get_prgms()), 40)
        # Cards that are not there are refused, which it expects.
        slots = {f"read register {11250 + 60 * slot}" for slot in range(6)}
        checks.step("nothing else was refused", lambda: {one["command"] for one in bench.status()["unserved"]},
                    lambda unserved: unserved <= slots)
    return "(checkout)"


def f4(arguments, checks):
    module = library(arguments, "watlowf4")
    if module is None:
        return None
    with emulated.bench(arguments.abcal, emulated.CHAMBER.format(port="pty", model="F4"), 'chamber_model = "F4D"') as bench:
        controller = checks.step("connect", lambda: module.WatlowF4(
            interface="RTU", serialport=os.path.realpath(bench.ports["chamber"]), baudrate=19200, loops=2, cond_event=1))
        if controller is None:
            return "(checkout)"
        checks.step("kind", controller.process_controller, "Watlow F4D")
        constant(controller, checks)
        checks.step("units", lambda: controller.get_loop_units(1), lambda unit: unit.endswith("C"))
        checks.step("nothing was refused", lambda: bench.status()["unserved"], [])
    return "(checkout)"


emulated.main("ESPEC ChamberConnectLibrary", "F4T (watlow_f4), TCP", f4t, "F4D (watlow_f4), line of 19200 Bd", f4)
