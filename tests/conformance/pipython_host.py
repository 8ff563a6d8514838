#!/usr/bin/env python3
"""PI's own library for Python with the emulated PI controller."""

import functools

import emulated


def run(arguments, checks, port):
    try:
        from pipython import pitools
        from pipython.pidevice.gcscommands import GCSCommands
        from pipython.pidevice.gcsmessages import GCSMessages
        from pipython.pidevice.interfaces.piserial import PISerial
        from pipython.pidevice.interfaces.pisocket import PISocket
    except ImportError:
        return None
    from pipython.version import __version__ as version

    with emulated.bench(arguments.abcal, emulated.STAGE.format(driver="pi_gcs", port=port)) as bench:
        def connect():
            if port == "pty":
                return PISerial(bench.ports["stage"], 115200)
            host, number = bench.tcp("stage")
            return PISocket(host=host, port=number)

        with connect() as gateway, GCSCommands(GCSMessages(gateway)) as device:
            checks.step("identify", device.qIDN, lambda text: "C-884" in text)
            checks.step("startup", lambda: pitools.startup(device, stages=None, refmodes=["FRF", "FRF"]))
            checks.step("referenced", lambda: all(device.qFRF().values()), True)
            checks.step("move", lambda: device.MOV({"1": 30.0, "2": -15.0}))
            checks.step("waitontarget", lambda: pitools.waitontarget(device))
            checks.step("position", lambda: [round(p, 4) for p in device.qPOS().values()], [30.0, -15.0])
            checks.step("parameter", lambda: float(device.qSPA("1", 0x4A)["1"][0x4A]) > 0, True)
            checks.step("stored parameter", lambda: device.qSEP("1", 0x3F)["1"][0x3F] is not None, True)
            checks.step("versions", device.qVER, lambda text: bool(text.strip()))
            checks.step("move on", lambda: device.MOV("1", 300.0))
            checks.step("stopall", lambda: pitools.stopall(device))
            checks.step("stopped", lambda: any(device.IsMoving().values()), False)
            checks.step("moveandwait", lambda: pitools.moveandwait(device, "1", 0.0))
    return version


emulated.main("PIPython", "PI C-884 (pi_gcs), TCP", functools.partial(run, port="tcp:0"),
              "PI C-884 (pi_gcs), line of 115200 Bd", functools.partial(run, port="pty"))
