#!/usr/bin/env python3
"""thorlabs_apt_device with the emulated Thorlabs rack, over a serial line: it homes as it opens, and learns from the
status that comes without being asked for when the axis is homed.

It reads until nothing comes for 0.1 s, the period of the status, and writes only then: a command may wait for 5 s, after
which the controller sends no status without an acknowledgement.
"""

import os
import time

import emulated


def wait_until(holds, seconds):
    """Whether this holds within the time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if holds():
            return True
        time.sleep(0.02)
    return holds()


def run(arguments, checks):
    try:
        import thorlabs_apt_device
        from thorlabs_apt_device.devices.bbd import BBD202
    except ImportError:
        return None

    sections = emulated.STAGE.format(driver="thorlabs_apt", port="pty")
    with emulated.bench(arguments.abcal, sections) as bench:
        device = BBD202(serial_port=os.path.realpath(bench.ports["stage"]), serial_number=None, home=True)
        try:
            status = [bay[0] for bay in device.status_]
            checks.step("status comes without being asked for", lambda: wait_until(lambda: status[0]["msgid"] != 0, 3), True)
            checks.step("bay 1 is homed", lambda: wait_until(lambda: status[0]["homed"], 30), True)
            checks.step("bay 2 is homed", lambda: wait_until(lambda: status[1]["homed"], 30), True)
            checks.step("velocity parameters", lambda: device.velparams_[0][0]["max_velocity"], lambda v: v > 0)
            checks.step("parameters of homing", lambda: device.homeparams_[0][0]["home_velocity"], lambda v: v > 0)
            device.move_absolute(100000, bay=0)
            checks.step("absolute move", lambda: wait_until(lambda: abs(status[0]["position"] - 100000) < 20, 20), True)
            device.move_relative(-40000, bay=0)
            checks.step("relative move", lambda: wait_until(lambda: abs(status[0]["position"] - 60000) < 20, 20), True)
            before = status[1]["position"]
            device.set_jog_params(20000, 2000000, 2000000, bay=1)
            device.move_jog("forward", bay=1)
            checks.step("jog", lambda: wait_until(lambda: abs(abs(status[1]["position"] - before) - 20000) < 20, 20), True)
            device.move_velocity("forward", bay=0)
            checks.step("turns at a velocity", lambda: wait_until(lambda: abs(status[0]["position"] - 60000) > 5000, 10), True)
            device.stop(bay=0)
            checks.step("stop", lambda: wait_until(
                lambda: not (status[0]["moving_forward"] or status[0]["moving_reverse"]), 20), True)
            device.set_enabled(False, bay=0)
            checks.step("off", lambda: wait_until(lambda: not status[0]["channel_enabled"], 20), True)
            checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
        finally:
            device.close()
            wait_until(lambda: device._port is None, 20)  # its thread closes it
    return thorlabs_apt_device.__version__


emulated.main("thorlabs_apt_device", "Thorlabs BBD202 with DDR100 (thorlabs_apt), line of 115200 Bd", run)
