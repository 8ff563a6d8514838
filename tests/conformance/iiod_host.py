#!/usr/bin/env python3
"""A calibration through Debian's iiod: its kernel's files (/sys/bus/iio, /dev/iio:device0) are made up in a mount
namespace, and what the made-up accelerometer measures comes from an emulated one on an emulated stage.

Needs the right to make a mount namespace: as root, or as a user where the system permits it; skipped elsewhere.
"""

import contextlib
import os
import pathlib
import re
import shutil
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time

import emulated

SECTIONS = """
[item]
sensitivity_tolerance = 0.05
[stage]
driver = "pi_gcs"
port = "{stage}"
[accelerometer]
driver = "iio"
port = "{accelerometer}"
rate_hz = 200.0
[protocol]
check_poses = false
steps = 12
step_deg = 30.0
settle_s = 0.05
dwell_readings = 10
"""

TRUTH = """
sensitivity_matrix = [[9.91, 0.2, -0.1], [-0.3, 9.7, 0.2], [0.1, -0.2, 9.8]]
offset = [0.1, -0.2, 0.3]
noise = 1e-3
zx = 5e-5
zy = -1e-4
xz = 1e-4
"""


def namespace_words():
    """How a command is run in a mount namespace; None if this machine does not permit it."""
    for words in (["unshare", "-m"], ["unshare", "-rm"]):
        attempt = "mount -t tmpfs none /mnt && mkdir /mnt/x && mount --bind /mnt/x /sys/bus && mount --rbind /mnt/x /dev"
        if shutil.which("unshare") and subprocess.run([*words, "sh", "-c", attempt],
                                                      capture_output=True).returncode == 0:
            return words
    return None


class MadeUpDevice:
    """Files as the kernel has them for one accelerometer with a buffer."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self.sysfs = self.folder / "bus" / "iio" / "devices" / "iio:device0"
        self.values = {
            "name": "madeup355", "sampling_frequency": "100", "in_accel_scale": "0.000000037409",
            "in_timestamp_type": "le:s64/64>>0", "buffer/enable": "0", "buffer/length": "2", "buffer/watermark": "1",
            "trigger/current_trigger": "", "scan_elements/in_timestamp_en": "0", "scan_elements/in_timestamp_index": "3",
            "scan_elements/in_timestamp_type": "le:s64/64>>0"}
        del self.values["in_timestamp_type"]
        for n, axis in enumerate("xyz"):
            self.values[f"in_accel_{axis}_raw"] = "0"
            self.values[f"in_accel_{axis}_calibbias"] = str(7 * n)
            self.values[f"scan_elements/in_accel_{axis}_en"] = "0"
            self.values[f"scan_elements/in_accel_{axis}_index"] = str(n)
            self.values[f"scan_elements/in_accel_{axis}_type"] = "be:s32/32>>0"
        for name, value in self.values.items():
            path = self.sysfs / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(value + "\n")
        trigger = self.sysfs.parent / "trigger0"
        trigger.mkdir()
        (trigger / "name").write_text("madeup355-dev0\n")
        devices = self.folder / "dev"
        devices.mkdir()
        os.mkfifo(devices / "iio:device0")
        for name in ("null", "zero", "random", "urandom"):
            (devices / name).touch()

    def mount_words(self):
        """A shell's words that put them in the place of the kernel's."""
        dev = self.folder / "dev"
        binds = "".join(f"mount --bind /dev/{name} {dev}/{name} && " for name in ("null", "zero", "random", "urandom"))
        return f"{binds}mount --rbind {dev} /dev && mount --bind {self.folder}/bus /sys/bus && "

    def enabled(self):
        return (self.sysfs / "buffer" / "enable").read_text().strip("\0\n") == "1"

    def feed(self, source, stop):
        """Passes the scans of an emulated iiod on to the buffer while it is enabled."""
        with socket.create_connection(source, timeout=10) as connection:
            stream = connection.makefile("rwb")

            def ask(line):
                stream.write(line.encode() + b"\r\n")
                stream.flush()
                return int(stream.readline())

            while not stop.is_set():
                if not self.enabled():
                    time.sleep(0.002)
                    continue
                rate = (self.sysfs / "sampling_frequency").read_text().strip("\0\n").encode()
                stream.write(b"WRITE iio:device0 sampling_frequency %d\r\n" % len(rate) + rate)
                stream.flush()
                stream.readline()
                ask("SET iio:device0 BUFFERS_COUNT 64")  # 0.3 s: as much as the feeder on a busy machine may leave unread
                assert ask("OPEN iio:device0 1 00000078") == 0  # accelerations and time
                while self.enabled() and not stop.is_set():
                    size = ask("READBUF iio:device0 24")
                    stream.readline()
                    self.put(stream.read(size))
                ask("CLOSE iio:device0")

    def put(self, scan):
        """Opened for each scan: what iiod leaves unread is lost when it closes, as in the kernel's buffer."""
        # OSError: nobody reads; BlockingIOError: full, as the kernel's buffer may be.
        with contextlib.suppress(OSError):
            pipe = os.open(self.folder / "dev" / "iio:device0", os.O_WRONLY | os.O_NONBLOCK)
            try:
                os.write(pipe, scan)
            finally:
                os.close(pipe)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until_it_listens(process, port):
    for _ in range(200):
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return
        except OSError:
            if process.poll() is not None:
                raise RuntimeError("iiod ended: " + process.stderr.read().decode()) from None
            time.sleep(0.05)
    raise RuntimeError("iiod does not listen")


def registers(path):
    with contextlib.closing(sqlite3.connect(path)) as database:
        return dict(database.execute("select name, value from item_register"))


def run(arguments, checks):
    if shutil.which("iiod") is None:
        return None
    words = namespace_words()
    if words is None:
        print("iiod: skipped, as no mount namespace can be made here (unshare -m, unshare -rm)", file=sys.stderr)
        sys.exit(emulated.SKIPPED)
    abcal = str(pathlib.Path(arguments.abcal).resolve())
    version = re.search(r"[0-9]+\.[0-9]+", subprocess.run(["iiod", "-V"], capture_output=True, text=True).stdout).group()
    emulated_sections = SECTIONS.format(stage="tcp:127.0.0.1:0", accelerometer="tcp:127.0.0.1:0")
    with emulated.bench(arguments.abcal, emulated_sections, simulation=TRUTH) as bench, \
            tempfile.TemporaryDirectory() as folder:
        device = MadeUpDevice(folder)
        port = free_port()
        process = subprocess.Popen([*words, "sh", "-c", device.mount_words() + f"exec iiod -p {port}"],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        stop = threading.Event()
        feeder = threading.Thread(target=device.feed, args=(bench.tcp("accelerometer"), stop))
        feeder.start()
        try:
            wait_until_it_listens(process, port)
            real = f"tcp:127.0.0.1:{port}"

            def call(*more):
                done = subprocess.run([abcal, *more], capture_output=True, text=True, timeout=300, cwd=folder)
                if done.returncode != 0:
                    raise RuntimeError(f"abcal {more[0]} ended with {done.returncode}: {done.stderr.strip()} {done.stdout[:300]}")
                return done.stdout

            checks.step("recognised", lambda: call("instruments", "--probe", "--port", real),
                        lambda text: "madeup355" in text and "iio" in text)
            path = pathlib.Path(folder) / "bench.toml"
            path.write_text(emulated.BENCH.format(
                sections=SECTIONS.format(stage=bench.ports["stage"], accelerometer=real), simulation=TRUTH))
            checks.step("calibration", lambda: call("run", "bench.toml", "-o", "a.run"), lambda text: True)
            checks.step("agrees with the truth",
                        lambda: call("analyse", "a.run", "--estimator", "abc", "--truth", "bench.toml"),
                        lambda text: "agrees" in text)
            checks.step("correction registers kept", lambda: registers(pathlib.Path(folder) / "a.run"),
                        {"accel_x calibbias": "0", "accel_y calibbias": "7", "accel_z calibbias": "14"})
            checks.step("buffer closed", lambda: device.enabled(), False)
        finally:
            stop.set()
            process.kill()  # it waits for its clients otherwise
            process.wait(10)
            feeder.join(10)
    return version + " (Debian 12)"


emulated.main("iiod", "made-up accelerometer of Linux, by our driver iio, TCP", run)
