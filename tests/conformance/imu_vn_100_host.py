#!/usr/bin/env python3
"""The library inside the ROS driver imu_vn_100 with the emulated VN-100, over a serial line.

Its node needs ROS; a short program of our own calls the same functions in the same order, as the node is shipped:
921600 Bd, binary output on serial port 2 of the device, 100 Hz. Needs a checkout and a C compiler.
"""

import pathlib
import shutil
import subprocess
import tempfile

import emulated

PROGRAM = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "vncpp/vn100.h"

static volatile int readings = 0;
static volatile float z = 0;
static int binary = 0;

/* In binary packets the library takes the acceleration for the rate, which the node corrects. */
static void count(void* sender, VnDeviceCompositeData* data) {
  (void)sender;
  ++readings;
  z = binary ? data->angularRateUncompensated.c2 : data->acceleration.c2;
}
static void must(int error, const char* what) {
  if (error == VNERR_NO_ERROR) return;
  printf("error %s %d\n", what, error);
  exit(1);
}

int main(int argc, char** arguments) {
  Vn100 imu;
  unsigned baud = 0;
  int revision = 0;
  char text[30] = {0};
  (void)argc;
  binary = strcmp(arguments[2], "binary") == 0;
  must(vn100_connect(&imu, arguments[1], 115200), "connect");
  usleep(500000);
  must(vn100_getSerialBaudRate(&imu, &baud), "baud");
  must(vn100_setSerialBaudRate(&imu, 921600, true), "set baud");
  vn100_disconnect(&imu);
  usleep(500000);
  must(vn100_connect(&imu, arguments[1], 921600), "connect again");
  usleep(500000);
  must(vn100_getSerialBaudRate(&imu, &baud), "baud again");
  printf("baud %u\n", baud);
  must(vn100_pauseAsyncOutputs(&imu, true), "pause");
  must(vn100_getModelNumber(&imu, text, 30), "model");
  printf("model %s\n", text);
  must(vn100_getHardwareRevision(&imu, &revision), "revision");
  must(vn100_getSerialNumber(&imu, text, 30), "serial number");
  must(vn100_getFirmwareVersion(&imu, text, 30), "firmware");
  must(vn100_setSynchronizationControl(&imu, SYNCINMODE_COUNT, SYNCINEDGE_RISING, 0, SYNCOUTMODE_IMU_START,
                                       SYNCOUTPOLARITY_POSITIVE, 39, 1000000, true), "synchronization");
  must(vn100_pauseAsyncOutputs(&imu, true), "pause");
  must(vn100_setAsynchronousDataOutputType(&imu, VNASYNC_OFF, true), "output off");
  if (binary) {
    must(vn100_setBinaryOutput1Configuration(&imu, BINARY_ASYNC_MODE_SERIAL_2, 8,
                                             BG1_QTN | BG1_IMU | BG1_MAG_PRES | BG1_SYNC_IN_CNT | BG1_TIME_SYNC_IN,
                                             BG3_NONE, BG5_NONE, true), "binary output");
  } else {
    must(vn100_setAsynchronousDataOutputType(&imu, VNASYNC_VNIMU, true), "ASCII output");
  }
  must(vn100_registerAsyncDataReceivedListener(&imu, &count), "listener");
  must(vn100_setAsynchronousDataOutputFrequency(&imu, 100, true), "frequency");
  must(vn100_resumeAsyncOutputs(&imu, true), "resume");
  sleep(2);
  printf("readings %d\nz %g\n", readings, z);
  vn100_reset(&imu);
  vn100_disconnect(&imu);
  return 0;
}
"""


def run(arguments, checks, kind, model):
    if not arguments.host or shutil.which("gcc") is None:
        return None
    root = pathlib.Path(arguments.host) / "vncpplib"
    sections = emulated.ACCELEROMETER.format(driver="vectornav", port="pty", more="baud = 115200")
    with tempfile.TemporaryDirectory() as folder:
        (pathlib.Path(folder) / "host.c").write_text(PROGRAM)
        subprocess.run(["gcc", "-w", "-O0", "-I", str(root / "include"), "-I", str(root / "include" / "vncpp"), "host.c",
                        str(root / "src" / "vn100.c"), str(root / "src" / "vndevice.c"),
                        str(root / "src" / "arch" / "linux" / "vncp_services.c"), "-lpthread", "-lrt", "-lm", "-o",
                        "host"], cwd=folder, check=True)
        with emulated.bench(arguments.abcal, sections, model=model,
                            simulation=emulated.IN_MPS2) as bench:
            done = subprocess.run([f"{folder}/host", bench.ports["accelerometer"], kind], capture_output=True, text=True,
                                  timeout=60)
            said = dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)
            checks.step("set-up", lambda: said.get("error", "none"), "none")
            checks.step("change to 921600 Bd", lambda: said["baud"], "921600")
            checks.step("readings at 100 Hz", lambda: int(said["readings"]), lambda count: 150 < count < 250)
            checks.step("9.8 m/s2", lambda: abs(float(said["z"])), lambda z: abs(z - 9.8) < 0.01)
            checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
    return "(vncpplib)"


def binary(arguments, checks):
    return run(arguments, checks, "binary", "serial_port = 2")


def ascii_text(arguments, checks):
    return run(arguments, checks, "text", "")


emulated.main("imu_vn_100", "VectorNav VN-100 (vectornav) on its serial port 2, as shipped: binary", binary,
              "VectorNav VN-100 (vectornav) on its serial port 1, ASCII", ascii_text)
