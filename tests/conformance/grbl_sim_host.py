#!/usr/bin/env python3
"""Our driver `described` with Grbl itself, compiled for a computer by grbl-sim: a trial of the description `grbl`. Needs grbl_sim.exe, which
is given as the checkout: the folder of grbl-sim within Grbl's sources in which it was built.
"""

import contextlib
import os
import pathlib
import pty
import select
import socket
import subprocess
import tempfile
import threading
import tty

import emulated

# Rates in degrees/min, accelerations in degrees/s2, no search at power-on.
SETTINGS = [b"$110=3600\n", b"$111=3600\n", b"$120=100\n", b"$121=100\n", b"$22=0\n"]


@contextlib.contextmanager
def served(program, folder):
    """Grbl behind a TCP port, as behind an adapter."""
    line, of_grbl = pty.openpty()
    tty.setraw(line)
    tty.setraw(of_grbl)
    process = subprocess.Popen([program, "-n", "-s", "steps", "-b", "blocks"], cwd=folder, stdin=of_grbl, stdout=of_grbl,
                               stderr=subprocess.DEVNULL)
    for setting in SETTINGS:
        os.write(line, setting)
    listener = socket.create_server(("127.0.0.1", 0))
    ends = threading.Event()

    def relay():
        connection = None
        while not ends.is_set():
            ready, _, _ = select.select([connection or listener, line], [], [], 0.02)
            if not ready:
                os.write(line, b" ")  # Grbl drops blanks; grbl-sim answers a line when the next byte comes
            if line in ready:
                sent = os.read(line, 4096)
                if connection:
                    connection.sendall(sent)
            if listener in ready:
                connection, _ = listener.accept()
            elif connection in ready:
                received = connection.recv(4096)
                if received:
                    os.write(line, received)
                else:
                    connection.close()
                    connection = None

    thread = threading.Thread(target=relay, daemon=True)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        ends.set()
        thread.join(5)
        process.terminate()
        process.wait(10)
        listener.close()


def trial(abcal, port, folder):
    """`abcal stage try` with a person who says yes to everything."""
    person, terminal = pty.openpty()
    process = subprocess.Popen(
        [abcal, "stage", "try", "grbl", "--port", f"tcp:127.0.0.1:{port}", "--speed-deg-per-s", "10"], stdin=terminal,
        stdout=terminal, stderr=terminal, env={**os.environ, "XDG_STATE_HOME": folder}, start_new_session=True)
    os.close(terminal)
    shown = ""
    answered = 0
    with contextlib.suppress(OSError):
        while received := os.read(person, 4096):
            shown += received.decode(errors="replace")
            while shown.count("Type yes: ") > answered:
                os.write(person, b"yes\n")
                answered += 1
    process.wait(60)
    return shown


def run(arguments, checks):
    program = pathlib.Path(arguments.host or "") / "grbl_sim.exe"
    if not arguments.host or not program.is_file():
        return None
    with tempfile.TemporaryDirectory() as folder, served(program.resolve(), folder) as port:
        shown = checks.step("identity", lambda: trial(arguments.abcal, port, folder),
                            lambda text: "identity: Grbl 1.1" in text) or ""
        for axis in "XZ":
            checks.step(f"halt of a jog of {axis}", lambda axis=axis: f"axis {axis}: the halt was acknowledged" in shown,
                        True)
        checks.step("moves of both axes",
                    lambda: 'axis X ("X"): passed' in shown and 'axis Z ("Y"): passed' in shown, True)
    return "(checkout)"


emulated.main("Grbl", "our driver described, grbl", run)
