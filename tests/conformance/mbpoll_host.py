#!/usr/bin/env python3
"""mbpoll, a Modbus master, with the emulated chamber controllers F4T (TCP) and F4 (serial line)."""

import re
import shutil
import subprocess

import emulated


class Master:
    """mbpoll with its options for one controller."""

    def __init__(self, target, *options):
        self.target = target
        self.options = options

    def ask(self, register, kind="4", write=()):
        """What it says when it has read one value of this register, or written one."""
        done = subprocess.run(
            [shutil.which("mbpoll"), *self.options, "-a", "1", "-0", "-1", "-q", "-t", kind, "-r", str(register),
             self.target, *write], capture_output=True, text=True, timeout=30)
        return done.stdout + done.stderr

    def value(self, register, kind="4"):
        found = re.search(rf"\[{register}\]:\s*(\S+)", self.ask(register, kind))
        return float(found.group(1)) if found else None


def version():
    if shutil.which("mbpoll") is None:
        return None
    return subprocess.run(["mbpoll", "-V"], capture_output=True, text=True).stdout.strip() + " (Debian 12)"


def run_f4t(arguments, checks):
    if version() is None:
        return None
    with emulated.bench(arguments.abcal, emulated.CHAMBER.format(port="tcp:127.0.0.1:0", model="F4T")) as bench:
        host, port = bench.tcp("chamber")
        f4t = Master(host, "-m", "tcp", "-p", str(port))
        checks.step("air", lambda: f4t.value(2820, "4:float"), lambda air: abs(air - 23.0) < 0.1)
        checks.step("limits", lambda: (f4t.value(2774, "4:float"), f4t.value(2776, "4:float")), (-70.0, 180.0))
        checks.step("unit", lambda: f4t.value(1328), 15)
        checks.step("writes", lambda: f4t.ask(2794, write=["85"]), lambda text: "Written 1 references" in text)
        checks.step("reads what was written", lambda: f4t.value(2794), 85)
        checks.step("exception", lambda: f4t.ask(3), lambda text: "Illegal data address" in text)
    return version()


def run_f4(arguments, checks):
    if version() is None:
        return None
    with emulated.bench(arguments.abcal, emulated.CHAMBER.format(port="chamber", model="F4")) as bench:
        f4 = Master(bench.ports["chamber"], "-m", "rtu", "-b", "19200", "-P", "none")
        checks.step("air", lambda: f4.value(100), 230)
        checks.step("decimals", lambda: f4.value(606), 1)
        checks.step("writes a set point", lambda: f4.ask(300, write=["451"]), lambda text: "Written 1 references" in text)
        checks.step("reads what was written", lambda: f4.value(300), 451)
        checks.step("exception", lambda: f4.ask(300, write=["9999"]), lambda text: "Illegal data value" in text)
        at_9600 = Master(bench.ports["chamber"], "-m", "rtu", "-b", "9600", "-P", "none")
        checks.step("silence at another speed", lambda: at_9600.value(100), lambda value: value is None)
    return version()


emulated.main("mbpoll", "F4T (watlow_f4), TCP", run_f4t, "F4 (watlow_f4), line of 19200 Bd", run_f4)
