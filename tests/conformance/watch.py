#!/usr/bin/env python3
"""What `abcal emulate --watch` prints of commands that an instrument does not carry out, and what its control port
says of them."""

import argparse
import json
import pathlib
import re
import socket
import subprocess
import sys
import tempfile

import emulated

# A message format with the data field 99, which no model has: field 0C,0A of set 82.
FRAME = bytes.fromhex("75650C07070A010199000A")


def checksum(frame):
    first = second = 0
    for byte in frame:
        first = (first + byte) % 256
        second = (second + first) % 256
    return bytes([first, second])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--abcal", required=True)
    abcal = parser.parse_args().abcal
    sent = FRAME + checksum(FRAME)
    with tempfile.TemporaryDirectory() as folder:
        bench = pathlib.Path(folder) / "bench.toml"
        bench.write_text(emulated.BENCH.format(
            sections=emulated.ACCELEROMETER.format(driver="microstrain_mip", port="tcp:0", more=""), simulation=""))
        process = subprocess.Popen([abcal, "emulate", str(bench), "--link-dir", folder, "--control", "0", "--watch"],
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            ports = {}
            for line in process.stdout:
                found = re.match(r"(\S+): (?:\S+ on )?tcp:(\S+):(\d+)$", line.strip())
                if found:
                    ports[found.group(1)] = (found.group(2), int(found.group(3)))
                if line.startswith("Serving"):
                    break
            printed = []
            with socket.create_connection(ports["accelerometer"], timeout=5) as connection:
                for _ in range(2):
                    connection.sendall(sent)
                    connection.recv(100)
                    printed.append(process.stdout.readline())
            with socket.create_connection(ports["control"], timeout=5) as connection:
                connection.sendall(b'{"do": "status"}\n')
                listed = json.loads(connection.makefile().readline())["unserved"]
        finally:
            process.terminate()
            process.wait(10)
    in_hex = sent.hex(" ").upper()
    expected = re.compile(r'\d+\.\d{3} s accelerometer: "0C,0A 01 01 99 00 0A": no data field 99: NACK 03; bytes '
                          + in_hex + "\n")
    wrong = [line for line in printed if not expected.fullmatch(line)]
    entry = {"instrument": "accelerometer", "command": "0C,0A 01 01 99 00 0A", "bytes": in_hex,
             "reaction": "no data field 99: NACK 03", "count": 2}
    if wrong or listed != [entry]:
        print("printed:", printed, "listed:", listed)
        return 1
    return 0


sys.exit(main())
