#!/usr/bin/env python3
"""The library inside the ROS driver imu_3dm_gx4 with three emulated 3DM models, over serial lines of 115200 Bd.

Its main program needs ROS; a short one of our own calls the same functions in the same order. Needs a checkout, a C++
compiler and the headers of Boost.
"""

import pathlib
import shutil
import subprocess
import tempfile

import emulated

PROGRAM = r"""
#include <cstdio>
#include <cstring>
#include <ctime>

#include "imu.hpp"

using imu_3dm_gx4::Imu;

static int readings = 0, solutions = 0;
static float z = 0;
static unsigned fields = 0, filter_fields = 0;

static void count(const Imu::IMUData& data) { ++readings; z = data.accel[2]; fields |= data.fields; }
static void count_filter(const Imu::FilterData& data) { ++solutions; filter_fields |= data.fields; }

int main(int, char** arguments) {
  const bool filter = std::strcmp(arguments[2], "filter") == 0;
  try {
    Imu imu(arguments[1], false);
    imu.connect();
    imu.selectBaudRate(115200);
    Imu::Info info;
    imu.getDeviceInfo(info);
    std::printf("model %s\n", info.modelName.c_str());
    imu.idle();
    uint16_t rate = 0, filter_rate = 0;
    imu.getIMUDataBaseRate(rate);
    imu.getFilterDataBaseRate(filter_rate);
    std::printf("rates %u %u\n", rate, filter_rate);
    imu.setIMUDataRate(rate / 100, Imu::IMUData::Accelerometer | Imu::IMUData::Gyroscope | Imu::IMUData::Barometer |
                                       Imu::IMUData::Magnetometer);
    imu.setFilterDataRate(filter_rate / 100, Imu::FilterData::Quaternion | Imu::FilterData::Bias |
                                                 Imu::FilterData::AngleUnertainty |
                                                 Imu::FilterData::BiasUncertainty);
    imu.enableIMUStream(true);
    imu.enableFilterStream(filter);
    if (filter) {
      imu.enableMeasurements(true, false);
      imu.enableBiasEstimation(true);
      Imu::DiagnosticFields diagnostics;
      imu.getDiagnosticInfo(diagnostics, info);
      std::printf("diagnostics %u\n", diagnostics.selector);
    }
    imu.setIMUDataCallback(count);
    imu.setFilterDataCallback(count_filter);
    imu.resume();
    const std::time_t end = std::time(nullptr) + 3;
    while (std::time(nullptr) < end) imu.runOnce();
    std::printf("readings %d %u\nz %g\nsolutions %d %u\n", readings, fields, z, solutions, filter_fields);
    imu.disconnect();
  } catch (const std::exception& error) {
    std::printf("error %s\n", error.what());
    return 1;
  }
}
"""
# The filter's settings are those of older devices, which the 7 series refuses.
MODELS = [("the default", "", "filter"), ("3DM-GX5-AHRS", 'accelerometer_model = "3DM-GX5-AHRS"', "filter"),
          ("3DM-CV7-AHRS", 'accelerometer_model = "3DM-CV7-AHRS"', "sensors")]


def run(arguments, checks):
    if not arguments.host or shutil.which("g++") is None:
        return None
    source = pathlib.Path(arguments.host) / "src"
    sections = emulated.ACCELEROMETER.format(driver="microstrain_mip", port="pty", more="baud = 115200")
    with tempfile.TemporaryDirectory() as folder:
        (pathlib.Path(folder) / "host.cpp").write_text(PROGRAM)
        subprocess.run(["g++", "-w", "-std=c++17", "-O0", "-I", str(source), "host.cpp", str(source / "imu.cpp"), "-o",
                        "host"], cwd=folder, check=True)
        for name, model, kind in MODELS:
            with emulated.bench(arguments.abcal, sections, model=model) as bench:
                done = subprocess.run([f"{folder}/host", bench.ports["accelerometer"], kind], capture_output=True,
                                      text=True, timeout=60)
                said = dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)
                checks.step(f"{name}: set-up", lambda: said.get("error", "none"), "none")
                checks.step(f"{name}: rates", lambda: said["rates"], "1000 1000")
                checks.step(f"{name}: readings at 100 Hz of all four sensors",
                            lambda: [int(n) for n in said["readings"].split()],
                            lambda counts: counts[0] > 150 and counts[1] == 15)
                checks.step(f"{name}: 1 g", lambda: abs(float(said["z"])), lambda g: abs(g - 1.0) < 0.01)
                if kind == "filter":
                    checks.step(f"{name}: filter at 100 Hz, with its uncertainties",
                                lambda: [int(n) for n in said["solutions"].split()],
                                lambda counts: counts[0] > 150 and counts[1] == 15)
                    checks.step(f"{name}: diagnostics", lambda: said["diagnostics"], "2")
                checks.step(f"{name}: nothing unknown was asked", lambda: bench.status()["unserved"], [])
    return "(imu.cpp)"


emulated.main("imu_3dm_gx4", "microstrain_mip, line of 115200 Bd", run)
