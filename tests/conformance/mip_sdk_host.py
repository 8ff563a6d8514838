#!/usr/bin/env python3
"""The maker's own examples in C (MicroStrain mip_sdk) with emulated 3DM devices, over serial lines of 115200 Bd.

Needs a checkout and a C compiler. The examples are built in a temporary folder, with our port and 3 s of data.
"""

import pathlib
import re
import shutil
import subprocess
import tempfile

import emulated

EXAMPLES = [("5_series/ahrs", "3DM-GX5-AHRS"), ("7_series/stream_imu", "3DM-GV7-AR"), ("7_series/ar", "3DM-GV7-AR"),
            ("7_series/ahrs", "3DM-CV7-AHRS")]
DEFINITIONS = ["-DMICROSTRAIN_LOGGING_MAX_LEVEL=MICROSTRAIN_LOGGING_LEVEL_INFO_",
               "-DMICROSTRAIN_TIMESTAMP_TYPE=uint64_t", "-DMIP_TIMESTAMP_TYPE=uint64_t"]


def build_library(checkout, folder):
    sources = sorted(str(path) for path in (checkout / "src" / "c").rglob("*.c"))
    subprocess.run(["gcc", "-w", "-O0", "-c", "-I", str(checkout / "src" / "c"), *DEFINITIONS, *sources], cwd=folder,
                   check=True)
    subprocess.run(["ar", "rcs", "libmip.a", *(path.name for path in pathlib.Path(folder).glob("*.o"))], cwd=folder,
                   check=True)


def build_example(checkout, folder, name, port):
    group, kind = name.split("/")
    source = checkout / "examples" / "c" / group / kind / f"{group}_{kind}_example.c"
    text = re.sub(r'(PORT_NAME = )"[^"]*"', rf'\1"{port}"', source.read_text())
    text = re.sub(r"(RUN_TIME_SECONDS = )\d+", r"\g<1>3", text)
    program = pathlib.Path(folder) / kind
    (pathlib.Path(folder) / f"{kind}.c").write_text(text)
    subprocess.run(["gcc", "-w", "-O0", "-I", str(checkout / "src" / "c"), *DEFINITIONS, f"{kind}.c", "libmip.a", "-lm", "-o",
                    str(program)], cwd=folder, check=True)
    return program


def run(arguments, checks):
    if not arguments.host or shutil.which("gcc") is None:
        return None
    checkout = pathlib.Path(arguments.host)
    with tempfile.TemporaryDirectory() as folder:
        build_library(checkout, folder)
        for name, model in EXAMPLES:
            sections = emulated.ACCELEROMETER.format(driver="microstrain_mip", port="pty", more="baud = 115200")
            with emulated.bench(arguments.abcal, sections, model=f'accelerometer_model = "{model}"') as bench:

                def example():
                    program = build_example(checkout, folder, name, bench.ports["accelerometer"])
                    done = subprocess.run([program], input="\n", capture_output=True, text=True, timeout=60)
                    if done.returncode != 0:
                        raise RuntimeError((done.stdout + done.stderr).strip().splitlines()[-1:])
                    return done.stdout + done.stderr

                checks.step(f"{name} ({model})", example, lambda text: "completed" in text.lower())
                # Events can be set, and are not carried out.
                checks.step("nothing else is not emulated", lambda: {one["command"] for one in bench.status()["unserved"]},
                            lambda unserved: unserved <= {"0C,2E", "0C,2F"})
    return "(examples)"


emulated.main("MicroStrain mip_sdk", "microstrain_mip, line of 115200 Bd", run)
