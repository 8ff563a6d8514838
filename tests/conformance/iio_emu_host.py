#!/usr/bin/env python3
"""Our driver `iio` with Analog Devices' emulator iio-emu (on libtinyiiod): six parts stream. Needs the program iio-emu,
which is given as the checkout: a folder with it in it, or in its folder `b` or `build`.

The files of samples are made here: the part lies still with z up, at 9.8 m/s2.
"""

import contextlib
import pathlib
import re
import socket
import struct
import subprocess
import tempfile
import time

import emulated

# Name, sample rate [Hz], bits, storage bits, shift, byte order, scale [m/s2 per count].
PARTS = [("adxl345", "100", 16, 16, 0, "le", 0.0383), ("adxl355", "125", 20, 32, 12, "be", 3.8245e-5),
         ("adxl362", "100", 12, 16, 0, "le", 9.80665e-3), ("adxl367", "100", 14, 16, 0, "be", 2.4516e-3),
         ("adis16485", "100", 32, 32, 0, "be", 3.74e-8), ("adis16475", "100", 32, 32, 0, "be", 3.74e-8)]
DOCUMENT = ('<?xml version="1.0" encoding="utf-8"?><!DOCTYPE context [<!ELEMENT context (device | context-attribute)*>'
            '<!ELEMENT context-attribute EMPTY><!ELEMENT device (channel | attribute | debug-attribute | '
            'buffer-attribute)*><!ELEMENT channel (scan-element?, attribute*)><!ELEMENT attribute EMPTY>'
            '<!ELEMENT scan-element EMPTY><!ELEMENT debug-attribute EMPTY><!ELEMENT buffer-attribute EMPTY>'
            '<!ATTLIST context name CDATA #REQUIRED description CDATA #IMPLIED><!ATTLIST context-attribute name CDATA '
            '#REQUIRED value CDATA #REQUIRED><!ATTLIST device id CDATA #REQUIRED name CDATA #IMPLIED><!ATTLIST channel '
            'id CDATA #REQUIRED type (input|output) #REQUIRED name CDATA #IMPLIED><!ATTLIST scan-element index CDATA '
            '#REQUIRED format CDATA #REQUIRED scale CDATA #IMPLIED><!ATTLIST attribute name CDATA #REQUIRED filename '
            'CDATA #IMPLIED value CDATA #IMPLIED><!ATTLIST debug-attribute name CDATA #REQUIRED value CDATA #IMPLIED>'
            '<!ATTLIST buffer-attribute name CDATA #REQUIRED value CDATA #IMPLIED>]>')

BENCH = """
schema = "abcal.bench/2"
[bench]
g_loc_mps2 = 9.80101
[stage]
driver = "simulated"
[accelerometer]
driver = "iio"
port = "tcp:127.0.0.1:{port}"
rate_hz = {rate}
"""


def description(part):
    name, rate, bits, storage, shift, order, scale = part
    channels = "".join(
        f'<channel id="accel_{axis}" type="input"><scan-element index="{n}" format="{order}:S{bits}/{storage}&gt;&gt;'
        f'{shift}" scale="{scale:.9f}"/><attribute name="raw" filename="in_accel_{axis}_raw" value="0"/>'
        f'<attribute name="scale" filename="in_accel_scale" value="{scale:.12f}"/></channel>'
        for n, axis in enumerate("xyz"))
    return (f'{DOCUMENT}<context name="xml" description="made for a test"><device id="iio:device0" name="{name}">'
            f'{channels}<attribute name="sampling_frequency" value="{rate}"/></device>'
            f'<device id="trigger0" name="{name}-dev0"></device></context>')


def samples(part, count):
    """One scan after the other: 0, 0, 9.8 m/s2, and a count more or less."""
    _, _, bits, storage, shift, order, scale = part
    letter = {16: "h", 32: "i"}[storage]
    form = ("<" if order == "le" else ">") + 3 * letter
    up = min(round(9.8 / scale), 2 ** (bits - 1) - 2)
    return b"".join(struct.pack(form, *((value + n % 2) << shift for value in (0, 0, up))) for n in range(count))


def free_port():
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]


@contextlib.contextmanager
def served(program, part, folder):
    """iio-emu with one part, from when it listens."""
    (folder / "part.xml").write_text(description(part))
    (folder / "samples").write_bytes(samples(part, 4000))
    port = free_port()
    process = subprocess.Popen([program, "generic", "part.xml", "iio:device0@samples", "-p", str(port)], cwd=folder,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(100):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
                break
            time.sleep(0.05)
        yield port
    finally:
        process.terminate()
        process.wait(10)


def run(arguments, checks):
    if not arguments.host:
        return None
    folders = [pathlib.Path(arguments.host) / name for name in ("", "b", "build")]
    program = next((folder / "iio-emu" for folder in folders if (folder / "iio-emu").is_file()), None)
    if program is None:
        return None
    for part in PARTS:
        with tempfile.TemporaryDirectory() as folder, served(program, part, pathlib.Path(folder)) as port:
            bench = pathlib.Path(folder) / "bench.toml"
            bench.write_text(BENCH.format(port=port, rate=part[1] + ".0"))

            def check():
                done = subprocess.run([arguments.abcal, "check", str(bench)], capture_output=True, text=True, timeout=60)
                return done.stdout + done.stderr

            # The part lies still while the simulated stage turns: a problem that `check` finds later.
            checks.step(f"{part[0]}: streams without loss", check,
                        lambda text: part[0] in text and re.search(r"good\s+losses: 0 of \d{3,}", text) is not None
                        and re.search(r"readings' norm is 9\.[78]", text) is not None)
    return "(checkout)"


emulated.main("iio-emu", "our driver iio", run)
