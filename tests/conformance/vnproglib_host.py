#!/usr/bin/env python3
"""VectorNav's own library (vnproglib, as its ROS driver has it) with the emulated VN-100, over a serial line.

Needs a checkout of that ROS driver and a C++ compiler.
"""

import pathlib
import shutil
import subprocess
import tempfile

import emulated

SOURCES = ("attitude compositedata conversions criticalsection error_detection event packet packetfinder port position "
           "rtcmlistener rtcmmessage searcher sensors serialport thread types util utilities vntime").split()

PROGRAM = r"""
#include <cstdio>

#include "vn/searcher.h"
#include "vn/sensors.h"
#include "vn/thread.h"

using namespace vn::sensors;
using namespace vn::protocol::uart;

static int good = 0, bad = 0;

static void count(void*, Packet& packet, size_t) {
  if (packet.type() == Packet::TYPE_BINARY) ++(packet.isValid() ? good : bad);
}

int main(int, char** arguments) {
  int baud = 0;
  if (!Searcher::search(arguments[1], &baud)) return 1;
  std::printf("baud %d\n", baud);
  VnSensor sensor;
  sensor.connect(arguments[1], baud);
  std::printf("model %s\n", sensor.readModelNumber().c_str());
  sensor.writeAsyncDataOutputType(VNOFF);
  BinaryOutputRegister output(ASYNCMODE_PORT1, 20,
                              COMMONGROUP_QUATERNION | COMMONGROUP_YAWPITCHROLL | COMMONGROUP_ANGULARRATE |
                                  COMMONGROUP_POSITION | COMMONGROUP_ACCEL | COMMONGROUP_MAGPRES,
                              TIMEGROUP_NONE, IMUGROUP_NONE, GPSGROUP_NONE, ATTITUDEGROUP_YPRU,
                              INSGROUP_INSSTATUS, GPSGROUP_NONE);
  sensor.writeBinaryOutput1(output);
  sensor.registerAsyncPacketReceivedHandler(0, count);
  vn::xplat::Thread::sleepSec(2);
  sensor.unregisterAsyncPacketReceivedHandler();
  std::printf("packets %d %d\n", good, bad);
  std::printf("corrections %g %g\n", sensor.readAccelerationCompensation().c.e00, sensor.readReferenceFrameRotation().e00);
  std::printf("filter %d\n", static_cast<int>(sensor.readVpeBasicControl().enable));
  std::printf("acceleration %g\n", sensor.readImuMeasurements().accel.z);
  sensor.tare();
  sensor.setGyroBias();
  sensor.magneticDisturbancePresent(true);
  sensor.accelerationDisturbancePresent(false);
  std::puts("commands ok");
  sensor.changeBaudRate(921600);
  std::printf("speed %d\n", sensor.verifySensorConnectivity());
  sensor.reset();
  std::puts("reset ok");
  sensor.disconnect();
}
"""


def run(arguments, checks):
    if not arguments.host or shutil.which("g++") is None:
        return None
    root = pathlib.Path(arguments.host) / "vnproglib-1.2.0.0" / "cpp"
    sections = emulated.ACCELEROMETER.format(driver="vectornav", port="pty", more="")
    with tempfile.TemporaryDirectory() as folder:
        (pathlib.Path(folder) / "host.cpp").write_text(PROGRAM)
        subprocess.run(["g++", "-w", "-std=c++11", "-O0", "-I", str(root / "include"), "host.cpp",
                        *(str(root / "src" / f"{name}.cpp") for name in SOURCES), "-lpthread", "-o", "host"], cwd=folder,
                       check=True)
        with emulated.bench(arguments.abcal, sections,
                            simulation=emulated.IN_MPS2) as bench:
            done = subprocess.run([f"{folder}/host", bench.ports["accelerometer"]], capture_output=True, text=True,
                                  timeout=60)
            said = dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)
            checks.step("search of the baud rate", lambda: said["baud"], "115200")
            checks.step("identity", lambda: said["model"], lambda model: model.startswith("VN-100"))
            checks.step("outputs of the ROS driver, all parsed", lambda: [int(n) for n in said["packets"].split()],
                        lambda counts: counts[0] > 60 and counts[1] == 0)
            checks.step("registers 25, 26", lambda: said["corrections"], "1 1")
            checks.step("register 35", lambda: said["filter"], "1")
            checks.step("register 54", lambda: float(said["acceleration"]), 9.8)
            checks.step("tare, gyro bias, disturbances", lambda: said["commands"], "ok")
            checks.step("change to 921600 Bd", lambda: said["speed"], "1")
            checks.step("reset", lambda: said["reset"], "ok")
            checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
    return "1.2.0.0"


emulated.main("vnproglib", "VectorNav VN-100 (vectornav), line of 115200 and 921600 Bd", run)
