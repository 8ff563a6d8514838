"""Records what terminals show, as animated pictures in docs/images: scripts/docs --recordings.

Each recording is of the program itself, at a terminal of 80 columns, typed here. termtosvg (Debian) draws the pictures. Times are
divided by SPEED, and pauses are at most LONGEST_PAUSE_S.
"""

import json
import os
import pathlib
import pty
import re
import select
import shutil
import signal
import struct
import fcntl
import subprocess
import sys
import tempfile
import termios
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs/images"
COLUMNS, ROWS = 80, 24
SPEED = 4.0
LONGEST_PAUSE_S = 1.5
KEY_S = 0.05
READ_S = 1.2
QUIET_S = 300.0


class Recording:
    """What a terminal showed, with its times, as asciicast v2."""

    def __init__(self):
        self.at = 0.0
        self.lines = [json.dumps({"version": 2, "width": COLUMNS, "height": ROWS})]

    def show(self, text, after_s):
        self.at += min(after_s, LONGEST_PAUSE_S)
        self.lines.append(json.dumps([round(self.at, 3), "o", text]))

    def type_command(self, command):
        self.show("$ ", 0.3)
        for key in command:
            self.show(key, KEY_S)
        self.show("\r\n", 0.4)

    def run(self, command, program, folder, answers=(), stop_at=None):
        """Types the command, and answers in their order, each where a question ends. `stop_at`: presses Ctrl-C where this text is shown."""
        self.type_command(" ".join(command))
        child, terminal = pty.fork()
        if child == 0:
            os.chdir(folder)
            os.environ["TERM"] = "xterm-256color"
            os.execv(program, ["abcal", *command[1:]])
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        answers = list(answers)
        text, answered, before = "", 0, time.monotonic()
        while True:
            ready, _, _ = select.select([terminal], [], [], QUIET_S)
            if not ready:
                os.kill(child, signal.SIGKILL)
                raise SystemExit(f"recordings: {' '.join(command)} shows nothing more, after: {text[-500:]}")
            try:
                shown = os.read(terminal, 65536).decode(errors="replace")
            except OSError:
                break
            if not shown:
                break
            now = time.monotonic()
            self.show(shown, (now - before) / SPEED)
            before = now
            text += shown
            question = re.search(r"(> |: |\? )$", text[answered:])
            if answers and question:
                answered = len(text)
                time.sleep(READ_S * SPEED)
                for key in answers.pop(0):
                    os.write(terminal, key.encode())
                    time.sleep(KEY_S * SPEED)
                os.write(terminal, b"\r")
            if stop_at and re.search(stop_at, text):
                stop_at = None
                os.write(terminal, b"\x03")
        os.close(terminal)
        _, status = os.waitpid(child, 0)
        return os.waitstatus_to_exitcode(status)

    def write(self, name):
        self.show("", 3.0)
        with tempfile.NamedTemporaryFile("w", suffix=".cast") as cast:
            cast.write("\n".join(self.lines) + "\n")
            cast.flush()
            subprocess.run(
                ["termtosvg", "render", cast.name, str(IMAGES / name), "-t", "window_frame", "-m", "150", "-D", "4000"], check=True
            )


def demo(program, folder):
    recording = Recording()
    if recording.run(["abcal", "demo", "--no-browser", "--no-wait"], program, folder) != 0:
        raise SystemExit("recordings: the demo failed")
    recording.write("demo.svg")


def init(program, folder):
    recording = Recording()
    answers = ["-100 365", "52.3 80", "N. N.", "yes"]
    if recording.run(["abcal", "init", "--stage", "emulated"], program, folder, answers) != 0:
        raise SystemExit("recordings: init failed")
    recording.write("init.svg")


def interrupted(program, folder):
    bench = (ROOT / "docs/examples/emulated.toml").read_text()
    bench = bench.replace("steps = 72", "steps = 12", 1).replace("step_deg = 5.0", "step_deg = 30.0", 1)
    (pathlib.Path(folder) / "bench.toml").write_text(bench)
    emulator = subprocess.Popen(
        [program, "emulate", "bench.toml", "--link-dir", "build/emulated"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        while not (pathlib.Path(folder) / "build/emulated/stage").exists():
            if emulator.poll() is not None:
                raise SystemExit("recordings: the emulator ended")
            time.sleep(0.1)
        recording = Recording()
        recording.run(["abcal", "run", "bench.toml", "-o", "first.run"], program, folder, stop_at=r"15/\d+|experiment 2")
        if recording.run(["abcal", "resume", "first.run"], program, folder) != 0:
            raise SystemExit("recordings: the resumed run failed")
        recording.write("interrupted.svg")
    finally:
        emulator.terminate()
        emulator.wait()


def main():
    program = str(pathlib.Path(sys.argv[1]).resolve())
    for make in (demo, init, interrupted):
        if len(sys.argv) > 2 and make.__name__ not in sys.argv[2:]:
            continue
        # The paths of the pictures have this folder in them.
        folder = pathlib.Path(tempfile.gettempdir()) / "first"
        folder.mkdir()
        try:
            make(program, folder)
        finally:
            shutil.rmtree(folder)
        print(f"docs/images/{make.__name__}.svg")


if __name__ == "__main__":
    main()
