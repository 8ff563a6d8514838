#!/usr/bin/env python3
"""A host's own calibration, against emulated instruments: six positions, offsets and scale factors.

    six_positions.py STAGE_HOST:PORT ACCELEROMETER_HOST:PORT

The stage speaks PI GCS 2.0 and the accelerometer is a VectorNav; nothing here knows that they are emulated, nor
uses anything of abcal. Prints one line of JSON.
"""

import json
import socket
import sys
import time

STANDARD_GRAVITY = 9.80665
# Angles of X and Z, and which axis of the platter then points up.
POSITIONS = {"+z": (0, 0), "-z": (180, 0), "+y": (90, 0), "-y": (-90, 0), "+x": (90, 90), "-x": (90, -90)}


class Line:
    """Lines of text over TCP."""

    def __init__(self, address):
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)), timeout=10)
        self.reader = self.socket.makefile("r", encoding="latin-1", newline="\n")

    def send(self, text):
        self.socket.sendall(text.encode("latin-1"))

    def ask(self, text):
        self.send(text)
        return self.reader.readline().strip()


class Stage(Line):
    def command(self, text):
        error = self.ask(text + "\nERR?\n")
        if error != "0":
            raise RuntimeError(f"stage: error {error} to {text}")

    def home(self):
        self.command("SVO 1 1 2 1")
        self.command("FRF")
        while "=0" in self.ask("FRF? 1\n") + self.ask("FRF? 2\n"):
            time.sleep(0.02)

    def go(self, x, z):
        self.command(f"MOV 1 {x} 2 {z}")
        while self.ask("\x05") != "0":
            time.sleep(0.01)
        time.sleep(0.1)


class VectorNav(Line):
    def command(self, text):
        checksum = 0
        for character in text:
            checksum ^= ord(character)
        # Asked once: a second request would have a second answer, and each later answer would then be an old one.
        self.send(f"${text}*{checksum:02X}\r\n")
        while True:  # Messages that it streams come in between.
            answer = self.reader.readline().strip()
            if not answer:
                raise RuntimeError(f"accelerometer: no answer to {text}")
            if answer.startswith("$" + text[:5]):
                return answer[1:].split("*")[0].split(",")

    def mean_acceleration(self, readings):
        sums = [0.0, 0.0, 0.0]
        for _ in range(readings):
            values = self.command("VNRRG,18")[2:5]
            sums = [total + float(value) for total, value in zip(sums, values)]
            time.sleep(0.0125)  # Several of its own periods.
        return [total / readings for total in sums]


def main():
    stage, accelerometer = Stage(sys.argv[1]), VectorNav(sys.argv[2])
    accelerometer.command("VNWRG,06,0")
    stage.home()
    means = {}
    for name, (x, z) in POSITIONS.items():
        stage.go(x, z)
        means[name] = accelerometer.mean_acceleration(40)
    offset, scale = [], []
    for n, axis in enumerate("xyz"):
        up, down = means["+" + axis][n], means["-" + axis][n]
        offset.append((up + down) / 2)
        scale.append((up - down) / 2 / STANDARD_GRAVITY)
    print(json.dumps({"offset_mps2": offset, "scale": scale}))


if __name__ == "__main__":
    main()
