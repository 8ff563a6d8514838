#!/usr/bin/env python3
"""pymeasure with the emulated ESP301, through pyvisa-py."""

import emulated


def run(arguments, checks):
    try:
        import pymeasure
        from pymeasure.instruments.newport import ESP300
    except ImportError:
        return None

    with emulated.bench(arguments.abcal,
                        emulated.STAGE.format(driver="newport_esp", port="tcp:0")) as bench:
        host, port = bench.tcp("stage")
        controller = checks.step("open", lambda: ESP300(
            f"TCPIP::{host}::{port}::SOCKET", visa_library="@py", timeout=5000,
            write_termination="\r", read_termination="\r\n"))
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


emulated.main("pymeasure", "Newport ESP300 (newport_esp), TCP", run)
