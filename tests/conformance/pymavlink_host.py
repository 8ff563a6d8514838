#!/usr/bin/env python3
"""pymavlink with the emulated flight controller, over TCP. A checkout needs its dialect generated first (mavgen)."""

import os
import time

import emulated


def interval(link, mavlink, message, rate_hz):
    """Asks for a message at a rate; the result of the command."""
    link.mav.command_long_send(link.target_system, link.target_component,
                               mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, message,
                               1e6 / rate_hz if rate_hz else -1, 0, 0, 0, 0, 0)
    return link.recv_match(type="COMMAND_ACK", blocking=True, timeout=3).result


def messages(link, kind, count):
    """So many of a kind, and the seconds that they took."""
    first = link.recv_match(type=kind, blocking=True, timeout=3)
    start = time.monotonic()
    found = [first] + [link.recv_match(type=kind, blocking=True, timeout=3) for _ in range(count)]
    return found, time.monotonic() - start


def run(arguments, checks):
    os.environ["MAVLINK20"] = "1"
    os.environ["MAVLINK_DIALECT"] = "common"
    try:
        import pymavlink
        from pymavlink import mavutil
        from pymavlink.dialects.v20 import common as mavlink
    except ImportError:
        return None

    sections = emulated.ACCELEROMETER.format(driver="mavlink", port="tcp:127.0.0.1:0",
                                             more='rate_hz = 100.0\n')
    truth = "sensitivity_matrix = [[9.81, 0.0, 0.0], [0.0, 9.81, 0.0], [0.0, 0.0, 9.81]]"
    with emulated.bench(arguments.abcal, sections, simulation=truth) as bench:
        host, port = bench.tcp("accelerometer")
        link = mavutil.mavlink_connection(f"tcp:{host}:{port}", dialect="common")
        checks.step("heartbeat", lambda: link.wait_heartbeat(timeout=3).autopilot, 12)
        checks.step("system", lambda: link.target_system, 1)
        link.mav.command_long_send(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        checks.step("autopilot version", lambda: link.recv_match(
            type="AUTOPILOT_VERSION", blocking=True, timeout=3).uid, lambda uid: uid > 0)
        link.recv_match(type="COMMAND_ACK", blocking=True, timeout=3)
        checks.step("interval of HIGHRES_IMU", lambda: interval(link, mavlink, 105, 100), 0)
        found, seconds = messages(link, "HIGHRES_IMU", 100)
        checks.step("rate", lambda: 100 / seconds, lambda rate: 80 < rate < 120)
        checks.step("HIGHRES_IMU", lambda: (found[0].zacc, found[0].fields_updated & 7),
                    lambda pair: abs(pair[0] - 9.81) < 0.05 and pair[1] == 7)
        checks.step("time", lambda: found[-1].time_usec - found[0].time_usec, 1000000)
        checks.step("off", lambda: interval(link, mavlink, 105, 0), 0)
        checks.step("interval of SCALED_IMU", lambda: interval(link, mavlink, 26, 20), 0)
        found, seconds = messages(link, "SCALED_IMU", 2)
        checks.step("SCALED_IMU", lambda: found[0].zacc, lambda acc: abs(acc - 1000) <= 2)
        checks.step("unknown message", lambda: interval(link, mavlink, 33, 20), lambda result: result != 0)
        checks.step("no bad frames", lambda: link.mav.total_receive_errors, 0)
        link.close()
    return getattr(pymavlink, "__version__", "checkout")


emulated.main("pymavlink", "MAVLink flight controller (mavlink), TCP", run)
