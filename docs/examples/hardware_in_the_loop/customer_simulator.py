#!/usr/bin/env python3
"""A simulator that was not written here, for `abcal run`: a stage (PI GCS 2.0) and a board that prints lines.

    customer_simulator.py STAGE_PORT BOARD_PORT        TCP ports of the loopback interface; 0: any free one

One world: the board prints what an accelerometer with these errors feels at the angles of the stage. It has only the
commands that abcal cannot do without, so it also shows how little a simulator has to know. Prints its ports.
"""

import math
import random
import socketserver
import sys
import threading
import time

SENSITIVITY = [[1.02, 0.01, -0.02], [-0.01, 0.99, 0.015], [0.005, -0.01, 1.01]]  # rows u, v, w; 1/g_loc
OFFSET = [0.03, -0.02, 0.01]
NOISE = 1e-4
SPEED = 720.0  # deg/s
RATE_HZ = 200.0


class World:
    """Angles of X and Z, each on its way at constant speed."""

    def __init__(self):
        self.axes = {"1": (0.0, 0.0, 0.0), "2": (0.0, 0.0, 0.0)}  # from, to, since

    def angle(self, axis):
        start, target, since = self.axes[axis]
        way = SPEED * (time.monotonic() - since)
        distance = target - start
        return target if way >= abs(distance) else start + math.copysign(way, distance)

    def moving(self, axis):
        return self.angle(axis) != self.axes[axis][1]

    def move(self, axis, target):
        self.axes[axis] = (self.angle(axis), target, time.monotonic())

    def stop(self):
        for axis in self.axes:
            here = self.angle(axis)
            self.axes[axis] = (here, here, time.monotonic())

    def outputs(self):
        x, z = (math.radians(self.angle(axis)) for axis in "12")
        # Up, in the frame of the platter: turned back about X, then about Z.
        up = [math.sin(z) * math.sin(x), math.cos(z) * math.sin(x), math.cos(x)]
        return [sum(s * f for s, f in zip(row, up)) + offset + random.gauss(0.0, NOISE)
                for row, offset in zip(SENSITIVITY, OFFSET)]


class Stage(socketserver.StreamRequestHandler):
    error = 0
    servo = {"1": 0, "2": 0}
    referenced = {"1": 0, "2": 0}

    def handle(self):
        line = b""
        while byte := self.rfile.read(1):
            if byte == b"\x18":  # #24: stop all axes
                self.server.world.stop()
                Stage.error = 10
            elif byte == b"\x05":  # #5: which axes move
                mask = sum(self.server.world.moving(axis) << n for n, axis in enumerate("12"))
                self.wfile.write(f"{mask:X}\n".encode())
            elif byte == b"\n":
                answer = self.answer(line.decode("latin-1").split())
                line = b""
                if answer is not None:
                    self.wfile.write((answer + "\n").encode())
            else:
                line += byte

    def answer(self, words):
        if not words:
            return None
        name, arguments = words[0], words[1:]
        axes = [word for word in arguments if word in ("1", "2")] or ["1", "2"]
        world = self.server.world
        values = {"POS?": lambda a: f"{world.angle(a):.6f}", "TMN?": lambda a: "-720", "TMX?": lambda a: "720",
                  "SVO?": lambda a: self.servo[a], "FRF?": lambda a: self.referenced[a], "TRS?": lambda a: 1,
                  "VEL?": lambda a: SPEED, "PUN?": lambda a: "deg", "ONT?": lambda a: int(not world.moving(a))}
        if name in values:
            return " \n".join(f"{axis}={values[name](axis)}" for axis in axes)
        if name == "*IDN?":
            return "(c)2026 Physik Instrumente (PI) GmbH & Co. KG, CUSTOMER-SIM, 1, 1.0"
        if name == "SAI?":
            return "1 \n2"
        if name == "ERR?":
            code, Stage.error = Stage.error, 0
            return str(code)
        if name == "SVO":
            self.servo[arguments[0]] = int(arguments[1])
        elif name == "FRF":
            for axis in axes:
                world.move(axis, 0.0)
                self.referenced[axis] = 1
        elif name == "MOV":
            world.move(arguments[0], float(arguments[1]))
        else:
            Stage.error = 2
        return None


class Board(socketserver.StreamRequestHandler):
    def handle(self):
        begin, count = time.monotonic(), 0
        try:
            while True:
                count += 1
                time.sleep(max(0.0, begin + count / RATE_HZ - time.monotonic()))
                self.wfile.write("{:.6f},{:.6f},{:.6f}\r\n".format(*self.server.world.outputs()).encode())
        except OSError:
            return


class Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True


def main():
    random.seed(1)
    world = World()
    for name, port, handler in (("stage", sys.argv[1], Stage), ("board", sys.argv[2], Board)):
        server = Server(("127.0.0.1", int(port)), handler)
        server.world = world
        threading.Thread(target=server.serve_forever, daemon=True).start()
        print(f"{name}: tcp:127.0.0.1:{server.server_address[1]}", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()
