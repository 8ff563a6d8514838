#!/usr/bin/env python3
"""What the EPICS module motorPIGCS2 sends to a controller, in its order, and how it reads the answers.

EPICS is not in Debian: these are its bytes, not the module. It waits 5 s for an answer, so that one that does not come
delays all that follows, also a stop.
"""

import socket
import statistics
import sys
import time

import emulated

TIMEOUT_S = 5.0


class Module:
    """Exchanges as the module's PIInterface makes them."""

    def __init__(self, address):
        self.connection = socket.create_connection(address, timeout=TIMEOUT_S)
        self.stream = self.connection.makefile("rb")
        self.waited_s = []

    def tell(self, command):
        self.connection.sendall(command.encode() + b"\n")

    def ask(self, query):
        """Single bytes go without a line's end; a line that ends in a space is followed by another."""
        start = time.monotonic()
        self.connection.sendall(query.encode() + (b"" if len(query) == 1 else b"\n"))
        answer = line = self.stream.readline()
        while line.endswith(b" \n"):
            line = self.stream.readline()
            answer += line
        self.waited_s.append(time.monotonic() - start)
        return answer.decode("latin-1")

    def value(self, query):
        """What stands behind the first '='."""
        return self.ask(query).split("=", 1)[1].strip()

    def error(self):
        return int(self.ask("ERR?"))

    def set(self, command):
        self.tell(command)
        return self.error()

    def status(self, axis):
        """Moving, referencing and servo of an axis, counted from 0, by #4."""
        text = self.ask("\x04")
        mask = int(text[2 + 4 * axis:6 + 4 * axis], 16)
        return bool(mask & 0x2000), bool(mask & 0x4000), bool(mask & 0x1000)

    def poll(self, axis):
        self.status(axis)
        return float(self.value("POS? 1"))

    def wait_until_done(self):
        for _ in range(400):
            moving, referencing, _ = self.status(0)
            if not moving and not referencing:
                return True
            time.sleep(0.02)
        return False


def start(module):
    if "C-884" not in module.ask("*IDN?").upper():
        return False
    module.ask("VEL?")
    axes = module.ask("SAI?").split()
    for axis in axes:
        for query in ("LIM?", "HAR?", "TRS?", "CST?"):
            module.value(f"{query} {axis}")
        if module.set(f"SVO {axis} 1") != 0:
            return False
        for query in ("SPA? {} 14", "SPA? {} 15", "VEL? {}", "POS? {}", "TMN? {}", "TMX? {}", "FRF? {}"):
            float(module.value(query.format(axis)))
    return axes == ["1", "2"]


def reference(module):
    return (module.set("SPA 1 0x50 5.000000"), module.set("SVO 1 1"), module.set("FRF 1"),
            module.wait_until_done(), module.value("FRF? 1"))


def set_up_move(module, target):
    """As its move(): the velocity, the acceleration within what the controller has, the target."""
    errors = [module.set("VEL 1 20.000000")]
    most = min(float(module.value("SPA? 1 74")), float(module.value("SPA? 1 75")))
    errors += [module.set(f"SPA 1 {number} {min(most, 200.0):.12g}") for number in (11, 12)]
    return errors + [module.set(f"MOV 1 {target:f}")]


def stop_on_the_way(module):
    begin = time.monotonic()
    set_up_move(module, 300.0)
    module.poll(0)
    error = module.set("HLT 1")
    needed_s = time.monotonic() - begin
    return error, needed_s < TIMEOUT_S, module.wait_until_done(), module.poll(0) < 200.0


def run(arguments, checks):
    with emulated.bench(arguments.abcal, emulated.STAGE.format(driver="pi_gcs", port="tcp:0")) as bench:
        module = Module(bench.tcp("stage"))
        checks.step("start", lambda: start(module), True)
        checks.step("reference", lambda: reference(module), (0, 0, 0, True, "1"))
        checks.step("before a move: SPA? 1 74, 75, SPA 1 11, 12", lambda: set_up_move(module, 10.0), [0, 0, 0, 0])
        checks.step("its parameters", lambda: [module.value(f"SPA? 1 {n}") for n in ("11", "12", "0xB", "0xC")],
                    ["200"] * 4)
        checks.step("done", module.wait_until_done, True)
        checks.step("position", lambda: round(module.poll(0), 3), 10.0)
        checks.step("stop on the way, error 10", lambda: stop_on_the_way(module), (10, True, True, True))
        checks.step("set position", lambda: [module.set("RON 1 0"), module.set("POS 1 0.000000"), module.set("RON 1 1")],
                    [0, 0, 0])
        checks.step("no answer is missing", lambda: max(module.waited_s) < TIMEOUT_S, True)
        checks.step("half of them within 50 ms", lambda: statistics.median(module.waited_s) < 0.05, True)
        checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
        print(f"{len(module.waited_s)} answers: median {1e3 * statistics.median(module.waited_s):.1f} ms, latest "
              f"{1e3 * max(module.waited_s):.1f} ms", file=sys.stderr)
    return "a0bdeae, its bytes"


emulated.main("EPICS motorPIGCS2", "PI C-884 (pi_gcs), TCP", run)
