#!/usr/bin/env python3
"""The physics of a flight controller's simulator, from emulated or real instruments on a stage.

    ardupilot_json.py ACCELEROMETER_HOST:PORT [UDP_PORT]

ArduPilot's simulator (SITL, model "JSON") sends packets with the outputs of its motors by UDP and expects lines of
JSON with the state of its vehicle. Here this state is what a VectorNav on the stage measures: acceleration, rates
and attitude. The vehicle stands where it is; its motors have no effect. Ends when nobody has asked for 5 s.
"""

import json
import math
import socket
import struct
import sys
import threading

MAGIC = 18458  # of a packet with 16 outputs; 29569: 32


class VectorNav(threading.Thread):
    """Reads yaw, pitch, roll, field, acceleration and rates (VNYMR) for ever; keeps the last."""

    def __init__(self, address):
        super().__init__(daemon=True)
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)), timeout=10)
        self.last = None
        self.first = threading.Event()
        self.socket.sendall(b"$VNWRG,06,14*XX\r\n$VNWRG,07,50*XX\r\n")

    def run(self):
        for line in self.socket.makefile("r", encoding="latin-1"):
            words = line.split("*")[0].split(",")
            if words[0] == "$VNYMR" and len(words) == 13:
                self.last = [float(word) for word in words[1:]]
                self.first.set()


def state(values, time_s):
    yaw, pitch, roll = (math.radians(angle) for angle in values[0:3])
    return {"timestamp": time_s,
            "imu": {"gyro": values[9:12], "accel_body": values[6:9]},
            "position": [0.0, 0.0, 0.0], "velocity": [0.0, 0.0, 0.0],
            "attitude": [roll, pitch, yaw]}


def main():
    sensor = VectorNav(sys.argv[1])
    sensor.start()
    if not sensor.first.wait(10):
        sys.exit("no VNYMR line for 10 s")
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.bind(("127.0.0.1", int(sys.argv[2]) if len(sys.argv) > 2 else 9002))
    server.settimeout(5)
    print(f"udp:{server.getsockname()[1]}", flush=True)
    while True:
        try:
            packet, client = server.recvfrom(1024)
        except TimeoutError:
            return
        if len(packet) < 8:
            continue
        magic, rate_hz, frame = struct.unpack("<HHI", packet[:8])
        if magic == MAGIC and rate_hz > 0:
            line = "\n" + json.dumps(state(sensor.last, frame / rate_hz)) + "\n"
            server.sendto(line.encode(), client)


if __name__ == "__main__":
    main()
