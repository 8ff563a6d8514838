#!/usr/bin/env python3
"""Zaber's earlier library for Python with the emulated Zaber controller, over a pseudo-terminal."""

import emulated


def run(arguments, checks):
    try:
        from zaber.serial import AsciiDevice, AsciiSerial
    except ImportError:
        return None

    sections = emulated.STAGE.format(driver="zaber_ascii", port="pty")
    with emulated.bench(arguments.abcal, sections) as bench:
        port = AsciiSerial(bench.ports["stage"])
        device = AsciiDevice(port, 1)
        axis = device.axis(1)
        checks.step("status", lambda: device.get_status(), lambda status: status in ("IDLE", "BUSY"))
        checks.step("home", lambda: axis.home().reply_flag, "OK")
        checks.step("move", lambda: axis.move_abs(38400).reply_flag, "OK")
        checks.step("position", lambda: int(axis.get_position()), 38400)
        checks.step("device id", lambda: device.send("get device.id").data, lambda text: int(text) > 0)
        checks.step("stop", lambda: axis.stop().reply_flag, "OK")
        port.close()
    return "0.9"


emulated.main("zaber.serial", "Zaber X-MCC2 (zaber_ascii), pseudo-terminal", run)
