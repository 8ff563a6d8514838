"""Runs the examples of docs/hardware_in_the_loop.md, each with the program that it is for.

    hardware_in_the_loop.py --abcal PROGRAM
"""

import argparse
import json
import math
import pathlib
import re
import socket
import struct
import subprocess
import sys
import tempfile
import time
import tomllib

EXAMPLES = pathlib.Path(__file__).resolve().parents[2] / "docs/examples/hardware_in_the_loop"
FAILED = []


def check(name, holds, found):
    print(f"{'ok' if holds else 'FAILED'}: {name}: {found}", flush=True)
    if not holds:
        FAILED.append(name)


class Served:
    """A program that prints "name: address" and goes on until it is ended."""

    def __init__(self, command, last):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.ports = {}
        for line in self.process.stdout:
            found = re.match(r"(\S+): (?:\S+ on )?(?:tcp:127\.0\.0\.1:)(\d+)$", line.strip())
            if found:
                self.ports[found.group(1)] = f"127.0.0.1:{found.group(2)}"
            if last in line:
                break

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait(10)

    def control(self, request):
        host, port = self.ports["control"].split(":")
        with socket.create_connection((host, int(port)), timeout=5) as connection:
            connection.sendall((json.dumps(request) + "\n").encode())
            return json.loads(connection.makefile().readline())


def emulated(abcal, folder, *more):
    return Served([abcal, "emulate", EXAMPLES / "bench.toml", "--link-dir", folder, "--control", "0", *more],
                  "Serving")


def six_positions(abcal, folder):
    """A host's own calibration finds the truth of the bench file."""
    truth = tomllib.loads((EXAMPLES / "bench.toml").read_text())["simulation"]
    with emulated(abcal, folder) as bench:
        result = json.loads(subprocess.run(
            [sys.executable, EXAMPLES / "six_positions.py", bench.ports["stage"], bench.ports["accelerometer"]],
            capture_output=True, text=True, timeout=120, check=True).stdout)
        # The mean of 40 readings, and three digits behind the point: 2 mm/s2 at most.
        worst = max(abs(a - b) for a, b in zip(result["offset_mps2"], truth["offset"]))
        check("offsets of six positions", worst < 2e-3, f"{worst:.2e} m/s2 off")
        diagonal = [truth["sensitivity_matrix"][n][n] / 9.80665 for n in range(3)]
        worst = max(abs(a / b - 1) for a, b in zip(result["scale"], diagonal))
        check("scale factors of six positions", worst < 2e-4, f"{worst:.2e} off")
        unserved = bench.control({"do": "status"})["unserved"]
        check("commands that are not emulated", unserved == [], unserved)


def scripted_faults(abcal, folder):
    """A supply that fails for a second: the connection ends, and the axes have no reference afterwards."""
    with emulated(abcal, folder) as bench:
        host, port = bench.ports["stage"].split(":")
        stage = socket.create_connection((host, int(port)), timeout=10)
        stage.sendall(b"SVO 1 1\nFRF 1\n")
        answers = stage.makefile("r", newline="\n")
        answer = ""
        while answer != "1=1":
            stage.sendall(b"FRF? 1\n")
            answer = answers.readline().strip()
        now = bench.control({"do": "status"})["time_s"]
        bench.control({"do": "fault", "kind": "power-cycle", "instrument": "stage", "at_s": now + 0.2, "for_s": 1.0})
        begin = time.monotonic()
        ended = stage.recv(1)
        check("the connection ends when it was scheduled to", ended == b"" and time.monotonic() - begin < 5,
              f"after {time.monotonic() - begin:.2f} s")
        for _ in range(500):
            try:
                again = socket.create_connection((host, int(port)), timeout=10)
                break
            except ConnectionRefusedError:
                time.sleep(0.01)
        again.sendall(b"FRF? 1\n")
        answer = again.makefile("r", newline="\n").readline().strip()
        check("the reference after a power cycle", answer == "1=0", answer)


def flight_controller(abcal, folder):
    """A simulator of a flight controller asks for the state of its vehicle, while the stage turns."""
    with emulated(abcal, folder) as bench:
        bridge = subprocess.Popen(
            [sys.executable, EXAMPLES / "ardupilot_json.py", bench.ports["accelerometer"], "0"],
            stdout=subprocess.PIPE, text=True)
        udp = int(bridge.stdout.readline().strip().split(":")[1])
        controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        controller.settimeout(5)
        frame = 0

        def ask():
            nonlocal frame
            frame += 1
            controller.sendto(struct.pack("<HHI16H", 18458, 400, frame, *[1500] * 16), ("127.0.0.1", udp))
            return json.loads(controller.recv(1024))

        still = ask()
        check("gravity at rest", abs(math.hypot(*still["imu"]["accel_body"]) - 9.9) < 0.4, still["imu"]["accel_body"])
        check("z up is a roll of 180 degrees", abs(abs(math.degrees(still["attitude"][0])) - 180) < 1,
              f"{math.degrees(still['attitude'][0]):.2f} deg")
        host, port = bench.ports["stage"].split(":")
        with socket.create_connection((host, int(port)), timeout=10) as stage:
            answers = stage.makefile("r", newline="\n")
            stage.sendall(b"SVO 1 1\nFRF 1\n")
            answer = ""
            while answer != "1=1":
                stage.sendall(b"FRF? 1\n")
                answer = answers.readline().strip()
            stage.sendall(b"VEL 1 30\nMOV 1 60\n")
            time.sleep(1.0)
            turning = ask()["imu"]["gyro"][0]
            check("rate of the stage", abs(turning - math.radians(30)) < 0.01, f"{math.degrees(turning):.2f} deg/s")
        bridge.terminate()
        bridge.wait(10)


def customers_simulator(abcal, folder):
    """A run against a simulator that was not written here finds the truth of that simulator."""
    truth = [[1.02, 0.01, -0.02], [-0.01, 0.99, 0.015], [0.005, -0.01, 1.01]]
    with Served([sys.executable, EXAMPLES / "customer_simulator.py", "0", "0"], "board") as simulator:
        bench = (EXAMPLES / "customer.toml").read_text()
        bench = bench.replace("127.0.0.1:47011", simulator.ports["stage"])
        bench = bench.replace("127.0.0.1:47012", simulator.ports["board"])
        path = pathlib.Path(folder) / "customer.toml"
        path.write_text(bench)
        run = subprocess.run([abcal, "run", path, "-o", pathlib.Path(folder) / "customer.run"],
                             capture_output=True, text=True, timeout=300)
        check("abcal run against the customer's simulator", run.returncode == 0, run.stderr[-500:].strip() or "done")
        if run.returncode != 0:
            return
        result = json.loads(subprocess.run([abcal, "analyse", "--json", pathlib.Path(folder) / "customer.run"],
                                           capture_output=True, text=True, check=True).stdout)
        found = result["results"][0] if "results" in result else result
        worst = max(abs(found["sensitivity_matrix"][i][j]["value"] - truth[i][j]) for i in range(3) for j in range(3))
        # Noise of 1e-4 in ten readings at 12 angles of each experiment.
        check("its sensitivity matrix", worst < 2e-4, f"{worst:.2e} R/g_loc off")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--abcal", required=True, help="the program abcal")
    arguments = parser.parse_args()
    for example in (six_positions, scripted_faults, flight_controller, customers_simulator):
        with tempfile.TemporaryDirectory() as folder:
            print(example.__doc__, flush=True)
            example(arguments.abcal, folder)
    sys.exit(1 if FAILED else 0)


if __name__ == "__main__":
    main()
