#!/usr/bin/env python3
"""pymeasure with the emulated ESP301, through pyvisa-py."""

import functools
import os

import emulated


def run(arguments, checks, port):
    try:
        import pymeasure
        from pymeasure.instruments.newport import ESP300
    except ImportError:
        return None

    with emulated.bench(arguments.abcal,
                        emulated.STAGE.format(driver="newport_esp", port=port)) as bench:
        if port == "pty":
            # pyvisa-py takes only names of ports in /dev.
            resource = "ASRL" + os.path.realpath(bench.ports["stage"]) + "::INSTR"
            line = {"baud_rate": 19200}
        else:
            resource = "TCPIP::{}::{}::SOCKET".format(*bench.tcp("stage"))
            line = {}
        controller = checks.step("open", lambda: ESP300(
            resource, visa_library="@py", timeout=5000, write_termination="\r", read_termination="\r\n", **line))
        if controller is None:
            return pymeasure.__version__
        axis = controller.x
        checks.step("enable", axis.enable)
        checks.step("home", axis.home)
        checks.step("wait for stop", axis.wait_for_stop)
        checks.step("units", lambda: axis.units, "degree")

        def move():
            axis.position = 12.5
            axis.wait_for_stop()
            return round(axis.position, 3)

        checks.step("move", move, 12.5)
        checks.step("limits", lambda: axis.left_limit < 0.0 < axis.right_limit, True)
        checks.step("motion done", lambda: bool(axis.motion_done), True)
        checks.step("errors", lambda: controller.errors, [])
        checks.step("disable", axis.disable)
    return pymeasure.__version__


emulated.main("pymeasure", "Newport ESP300 (newport_esp), TCP", functools.partial(run, port="tcp:0"),
              "Newport ESP300 (newport_esp), line of 19200 Bd", functools.partial(run, port="pty"))
