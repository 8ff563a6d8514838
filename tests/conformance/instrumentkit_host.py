#!/usr/bin/env python3
"""InstrumentKit with the emulated ESP301."""

import functools
import sys
import types

import emulated


def run(arguments, checks, port):
    # Transports that are not used here and that Debian does not have.
    for name in ("usbtmc", "vxi11"):
        sys.modules.setdefault(name, types.ModuleType(name))
    if arguments.host:
        sys.path.insert(0, arguments.host + "/src")
    try:
        import pint
        units = pint.get_application_registry()
        if "percent" not in units:  # as before version 0.21
            units.define("percent = 0.01 = %")
        import instruments
    except ImportError:
        return None
    version = getattr(instruments, "__version__", "of the checkout")

    with emulated.bench(arguments.abcal,
                        emulated.STAGE.format(driver="newport_esp", port=port)) as bench:
        if port == "pty":
            controller = instruments.newport.NewportESP301.open_serial(bench.ports["stage"], 19200)
        else:
            controller = instruments.newport.NewportESP301.open_tcpip(*bench.tcp("stage"))
        axis = controller.axis[0]
        degree = instruments.units.degree
        checks.step("enable", axis.enable)
        checks.step("read_setup", axis.read_setup, lambda setup: len(setup) > 10)
        checks.step("home search", lambda: axis.search_for_home())
        checks.step("wait for stop", lambda: axis.wait_for_stop())
        checks.step("move", lambda: axis.move(20 * degree, absolute=True, wait=True))
        checks.step("position", lambda: round(float(axis.position.magnitude), 3), 20.0)
        checks.step("velocity", lambda: float(axis.velocity.magnitude) > 0, True)
        checks.step("jog high speed", lambda: float(axis.jog_high_velocity.magnitude) > 0, True)
        checks.step("motion done", lambda: axis.is_motion_done, True)
        checks.step("stop", axis.stop_motion)
        checks.step("disable", axis.disable)
    return version


emulated.main("InstrumentKit", "Newport ESP301 (newport_esp), TCP", functools.partial(run, port="tcp:0"),
              "Newport ESP301 (newport_esp), line of 19200 Bd", functools.partial(run, port="pty"))
