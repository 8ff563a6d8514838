#!/usr/bin/env python3
"""sigrok-cli with the emulated 34401A, over a raw TCP port."""

import re
import shutil
import subprocess

import emulated


def run(arguments, checks):
    program = shutil.which("sigrok-cli")
    if program is None:
        return None
    version = subprocess.run([program, "--version"], capture_output=True, text=True).stdout.split()[1]
    ports = "tcp:0 tcp:0 tcp:0"
    with emulated.bench(arguments.abcal, emulated.ACCELEROMETER.format(driver="scpi_single", port=ports, more=""),
                        model='accelerometer_model = "34465A"') as bench:
        host, port = bench.tcp("accelerometer-w")
        driver = f"scpi-dmm:conn=tcp-raw/{host}/{port}"

        def call(*more):
            done = subprocess.run([program, "-d", driver, *more], capture_output=True, text=True, timeout=60)
            return done.stdout + done.stderr

        checks.step("scan", lambda: call("--scan"), lambda text: "34465A" in text)
        checks.step("functions", lambda: call("--show"), lambda text: "measured_quantity" in text)
        # w is at 1 V: one g_loc of an ideal accelerometer of 1 V.
        checks.step("readings", lambda: re.findall(r"P1: ([0-9.]+) ?(m?)V DC", call("--samples", "3")),
                    lambda found: len(found) == 3 and all(
                        abs(float(number) * (1e-3 if milli else 1.0) - 1.0) < 1e-3 for number, milli in found))
        checks.step("unserved", lambda: {one["command"] for one in bench.status()["unserved"]},
                    lambda unserved: unserved <= {"MEAS"})  # which a real one does not know, either
    return version + " (Debian 12)"


emulated.main("sigrok-cli", "34465A (scpi_single), TCP", run)
