"""An emulated bench for the program of somebody else, and the row that a conformance script prints.

A script gets `--abcal PROGRAM` and, for a host program that is not installed, `--host CHECKOUT`. It prints one row
of the matrix (docs/conformance.md) and ends with 1 if a check failed, with 77 if the host program is not there.
"""

import argparse
import contextlib
import json
import pathlib
import re
import socket
import subprocess
import sys
import tempfile
import time
import traceback

SKIPPED = 77

BENCH = """
schema = "abcal.bench/2"
[bench]
g_loc_mps2 = 9.80101
{sections}
[simulation]
seed = 1
{simulation}
[simulation.x]
speed_deg_per_s = 400.0
acceleration_deg_per_s2 = 4000.0
[simulation.z]
speed_deg_per_s = 400.0
acceleration_deg_per_s2 = 4000.0
"""

STAGE = """
[stage]
driver = "{driver}"
port = "{port}"
[accelerometer]
driver = "simulated"
"""

ACCELEROMETER = """
[stage]
driver = "simulated"
[accelerometer]
driver = "{driver}"
port = "{port}"
{more}
"""

CHAMBER = """
[stage]
driver = "simulated"
[accelerometer]
driver = "simulated"
[chamber]
driver = "watlow_f4"
port = "{port}"
model = "{model}"
dry_gas = true
[temperature]
set_points_degc = [23, 85]
"""

# The truth of an item that outputs m/s2, its axes along those of the platter.
IN_MPS2 = "sensitivity_matrix = [[9.8, 0.0, 0.0], [0.0, 9.8, 0.0], [0.0, 0.0, 9.8]]"


class Bench:
    """`abcal emulate`, and where its instruments are."""

    def __init__(self, process, folder, ports):
        self.process = process
        self.folder = folder
        self.ports = ports

    def tcp(self, name):
        """Host and port of an instrument that is on TCP."""
        _, host, port = self.ports[name].split(":")
        return host, int(port)

    def status(self):
        """What the emulator says of itself."""
        _, host, port = self.ports["control"].split(":")
        with socket.create_connection((host, int(port)), timeout=5) as connection:
            connection.sendall(b'{"do": "status"}\n')
            return json.loads(connection.makefile().readline())


@contextlib.contextmanager
def bench(abcal, sections, model="", simulation=""):
    """Serves a bench with these sections; `model` is the key of [emulator] and its value."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "bench.toml"
        emulator = f"\n[emulator]\n{model}\n" if model else ""
        path.write_text(BENCH.format(sections=sections + emulator, simulation=simulation))
        process = subprocess.Popen(
            [abcal, "emulate", str(path), "--link-dir", folder, "--control", "0"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            ports = {}
            for line in process.stdout:
                found = re.match(r"(\S+): (?:\S+ on )?(\S+)$", line.strip())
                if found:
                    ports[found.group(1)] = found.group(2)
                if line.startswith("Serving"):
                    break
            if not ports:
                raise RuntimeError(f"{abcal} emulate: " + process.stderr.read())
            yield Bench(process, folder, ports)
        finally:
            process.terminate()
            process.wait(10)


class Checks:
    """Steps of a host program, each of which passes or does not."""

    def __init__(self):
        self.passed = []
        self.failed = []

    def step(self, name, call, expected=None):
        """Runs `call`; its result must be `expected`, a value or a predicate, if that is given."""
        start = time.monotonic()
        try:
            result = call()
            holds = expected(result) if callable(expected) else expected is None or result == expected
            if holds:
                self.passed.append(name)
                return result
            self.failed.append(f"{name}: found {result!r}")
        except Exception as error:  # any exception of the host program is its verdict
            self.failed.append(f"{name}: {type(error).__name__}: {error}")
            traceback.print_exc(file=sys.stderr)
        print(f"{name}: failed after {time.monotonic() - start:.1f} s", file=sys.stderr)
        return None


def main(host, instrument, run, *more):
    """`run(arguments, checks)` returns the version of the host program, or None if it is not there. `more`: further
    instruments, or other ways to them, each followed by its own `run`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--abcal", required=True, help="the program abcal")
    parser.add_argument("--host", help="checkout of the host program, if it is not installed")
    arguments = parser.parse_args()
    if arguments.host:
        sys.path.insert(0, arguments.host)
    failed = False
    rows = [instrument, run, *more]
    for name, run_one in zip(rows[::2], rows[1::2]):
        checks = Checks()
        version = run_one(arguments, checks)
        if version is None:
            print(f"{host}: not installed, and no --host given", file=sys.stderr)
            sys.exit(SKIPPED)
        verdict = "-" if not checks.failed else "; ".join(checks.failed)
        print(f"| {host} {version} | {name} | {', '.join(checks.passed)} | {verdict} | {time.strftime('%Y-%m-%d')} |",
              flush=True)
        failed = failed or bool(checks.failed)
    sys.exit(1 if failed else 0)
