#!/usr/bin/env python3
"""QMI's driver of the Thorlabs K10CR1 with the emulated one, over a serial line."""

import os
import sys
import tempfile
import types

import emulated

SECTIONS = """
[stage.x]
driver = "thorlabs_apt"
port = "pty"
axis = "1"
[stage.z]
driver = "thorlabs_apt"
port = "tcp:0"
axis = "1"
[accelerometer]
driver = "simulated"
"""


def run(arguments, checks):
    # It keeps its records in the home folder.
    os.environ["QMI_HOME"] = tempfile.gettempdir()
    # Transports that are not used here.
    for name in ("vxi11", "usb", "usb.core", "usb.util"):
        try:
            __import__(name)
        except ImportError:
            sys.modules[name] = types.ModuleType(name)
            sys.modules[name].Instrument = object
    try:
        import qmi
        from qmi.core.context import QMI_Context
        from qmi.instruments.thorlabs import k10cr1
    except ImportError:
        return None

    with emulated.bench(arguments.abcal, SECTIONS, 'stage_model = "K10CR1"') as bench:
        context = QMI_Context("conformance")
        context.start()
        try:
            mount = k10cr1.Thorlabs_K10CR1(context, "mount", "serial:" + os.path.realpath(bench.ports["stage-x"]))
            if checks.step("open", lambda: mount.open() or "open", "open") is None:
                return qmi.__version__
            checks.step("identity", lambda: mount.get_idn().model, "K10CR1")
            checks.step("enabled", mount.get_chan_enable_state, True)
            checks.step("parameters of homing", mount.get_home_params, lambda home: home.home_direction.value == 2)

            def set_homing():
                home = mount.get_home_params()
                mount.set_home_params(home.home_direction, home.limit_switch, 4.0, home.offset_distance)

            checks.step("set them", set_homing)
            checks.step("read again", lambda: mount.get_home_params().home_velocity, lambda v: abs(v - 4.0) < 0.01)
            checks.step("velocity", lambda: mount.set_velocity_params(10.0, 10.0))
            checks.step("velocity read", mount.get_velocity, lambda v: abs(v - 10.0) < 0.01)
            checks.step("acceleration read", mount.get_acceleration, lambda a: abs(a - 10.0) < 0.01)
            checks.step("backlash", lambda: mount.set_backlash_distance(1.0))
            checks.step("backlash read", mount.get_backlash_distance, lambda d: abs(d - 1.0) < 0.01)
            checks.step("home", mount.move_home)
            checks.step("wait for home", lambda: mount.wait_move_complete(20.0))
            checks.step("homed", lambda: mount.get_motor_status().homed, True)
            checks.step("move", lambda: mount.move_absolute(12.5))
            checks.step("wait", lambda: mount.wait_move_complete(20.0))
            checks.step("position", mount.get_absolute_position, lambda angle: abs(angle - 12.5) < 0.01)
            checks.step("relative move", lambda: mount.move_relative(-2.5))
            checks.step("wait again", lambda: mount.wait_move_complete(20.0))
            checks.step("position again", mount.get_absolute_position, lambda angle: abs(angle - 10.0) < 0.01)
            checks.step("stop", mount.move_stop)
            checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
            mount.close()
        finally:
            context.stop()
    return qmi.__version__


emulated.main("QMI", "Thorlabs K10CR1 (thorlabs_apt), line of 115200 Bd", run)
