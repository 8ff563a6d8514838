#!/usr/bin/env python3
"""iio_info, iio_attr and iio_readdev of libiio with the emulated iiod."""

import re
import shutil
import struct
import subprocess

import emulated

DEVICE = "adis16485"


def run(arguments, checks):
    if any(shutil.which(program) is None for program in ("iio_info", "iio_attr", "iio_readdev")):
        return None
    said = subprocess.run(["iio_info", "-V"], capture_output=True, text=True, timeout=20)
    version = re.search(r"version: ?([0-9.]+)", said.stdout + said.stderr).group(1)
    sections = emulated.ACCELEROMETER.format(driver="iio", port="tcp:0", more="")
    with emulated.bench(arguments.abcal, sections, simulation=emulated.IN_MPS2) as bench:
        host, port = bench.tcp("accelerometer")
        uri = ["-u", f"ip:{host}:{port}"]

        def call(program, *more):
            done = subprocess.run([program, *uri, *more], capture_output=True, timeout=30, check=True)
            return done.stdout

        def attribute(*more):
            return call("iio_attr", *more).decode().strip()

        checks.step("devices, channels, trigger (iio_info)", lambda: call("iio_info").decode(),
                    lambda text: f"iio:device0: {DEVICE} (buffer capable)" in text
                    and f"trigger0({DEVICE}-dev0)" in text and "accel_z:  (input, index: 5, format: be:S32/32>>0)" in text)
        scale = checks.step("attributes (iio_attr)", lambda: float(attribute("-c", DEVICE, "accel_z", "scale")),
                            lambda value: value > 0)
        checks.step("raw value", lambda: int(attribute("-c", DEVICE, "accel_z", "raw")) * scale,
                    lambda value: abs(value - 9.8) < 1e-5)
        checks.step("debug attributes", lambda: attribute("-D", DEVICE, "serial_number"), "0x2a51")
        checks.step("sampling frequency set", lambda: attribute("-d", DEVICE, "sampling_frequency", "200"), "200.000000")
        checks.step("correction set", lambda: attribute("-c", DEVICE, "accel_x", "calibbias", "1000"), "1000")

        def samples():
            bytes_read = call("iio_readdev", "-s", "40", "-b", "20", DEVICE, "accel_x", "accel_z", "timestamp")
            return list(struct.iter_unpack(">ii8s", bytes_read))

        def are_right(scans):
            times = [struct.unpack("<q", scan[2])[0] for scan in scans]
            return (len(scans) == 40 and all(abs(x - 1000) < 2 and abs(z * scale - 9.8) < 1e-5 for x, z, _ in scans)
                    and all(abs(b - a - 5e6) < 1e3 for a, b in zip(times, times[1:])))

        checks.step("samples with times (iio_readdev)", samples, are_right)
        checks.step("unserved", lambda: bench.status()["unserved"], [])
    return version + " (Debian 12)"


emulated.main("libiio utilities", "iiod with an ADIS16485 (iio), TCP", run)
