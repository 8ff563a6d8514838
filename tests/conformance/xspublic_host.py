#!/usr/bin/env python3
"""Xsens's own library (xspublic, as its ROS driver has it) with the emulated MTi-30, over a serial line.

Needs the folder xspublic of a checkout of that ROS driver, built there with `make`, and a C++ compiler.
"""

import pathlib
import shutil
import subprocess
import tempfile

import emulated

PROGRAM = r"""
#include <atomic>
#include <chrono>
#include <cstdio>
#include <thread>

#include <xscontroller/xscontrol_def.h>
#include <xscontroller/xsdevice_def.h>
#include <xscontroller/xsscanner.h>
#include <xscontroller/xscallback.h>
#include <xstypes/xsdatapacket.h>
#include <xstypes/xsfilterprofilearray.h>
#include <xstypes/xsoutputconfigurationarray.h>
#include <xstypes/xsportinfo.h>
#include <xstypes/xsvector.h>

Journaller* gJournal = 0;

struct Counter : XsCallback {
  std::atomic<int> packets{0};
  double last = 0.0;
  void onLiveDataAvailable(XsDevice*, const XsDataPacket* packet) override {
    if (!packet->containsCalibratedAcceleration()) return;
    ++packets;
    const XsVector acceleration = packet->calibratedAcceleration();
    last = acceleration[2];
  }
};

int main(int, char** arguments) {
  XsPortInfo port(arguments[1], XBR_Invalid);
  if (!XsScanner::scanPort(port, XBR_Invalid, 100)) return 1;
  std::printf("baud %d\n", XsBaud::rateToNumeric(port.baudrate()));
  XsControl* control = XsControl::construct();
  if (!control->openPort(port)) return 2;
  XsDevice* device = control->device(port.deviceId());
  std::printf("product %s\n", device->productCode().c_str());
  std::printf("firmware %s\n", device->firmwareVersion().toString().c_str());
  Counter counter;
  device->addCallbackHandler(&counter);
  std::printf("config %d\n", device->gotoConfig());
  XsOutputConfigurationArray outputs;
  outputs.push_back(XsOutputConfiguration(XDI_PacketCounter, 0xFFFF));
  outputs.push_back(XsOutputConfiguration(XDI_SampleTimeFine, 0xFFFF));
  outputs.push_back(XsOutputConfiguration(XDI_Quaternion, 100));
  outputs.push_back(XsOutputConfiguration(XDI_Acceleration, 100));
  outputs.push_back(XsOutputConfiguration(XDI_RateOfTurn, 100));
  outputs.push_back(XsOutputConfiguration(XDI_MagneticField, 100));
  outputs.push_back(XsOutputConfiguration(XDI_StatusWord, 0xFFFF));
  std::printf("outputs %d\n", device->setOutputConfiguration(outputs));
  std::printf("profiles %d\n", static_cast<int>(device->availableOnboardFilterProfiles().size()));
  std::printf("measurement %d\n", device->gotoMeasurement());
  std::this_thread::sleep_for(std::chrono::seconds(2));
  std::printf("packets %d\n", counter.packets.load());
  std::printf("acceleration %.3f\n", counter.last);
  std::printf("again %d\n", device->gotoConfig());
  control->closePort(port);
  control->destruct();
}
"""


def run(arguments, checks):
    if not arguments.host or shutil.which("g++") is None:
        return None
    root = pathlib.Path(arguments.host).resolve()
    sections = emulated.ACCELEROMETER.format(driver="xsens_mti", port="pty", more="")
    with tempfile.TemporaryDirectory() as folder:
        (pathlib.Path(folder) / "host.cpp").write_text(PROGRAM)
        subprocess.run(["g++", "-w", "-std=c++11", "-O0", "-I", str(root), "host.cpp", str(root / "xscontroller/libxscontroller.a"),
                        str(root / "xscommon/libxscommon.a"), str(root / "xstypes/libxstypes.a"), "-lpthread", "-ldl", "-o",
                        "host"], cwd=folder, check=True)
        with emulated.bench(arguments.abcal, sections,
                            simulation=emulated.IN_MPS2) as bench:
            done = subprocess.run([f"{folder}/host", bench.ports["accelerometer"]], capture_output=True, text=True,
                                  timeout=60, cwd=folder)
            said = dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)
            checks.step("scan of the port", lambda: said["baud"], "115200")
            checks.step("product code", lambda: said["product"], lambda text: text.startswith("MTi-30"))
            checks.step("firmware", lambda: said["firmware"], lambda text: text[0].isdigit())
            checks.step("configuration mode", lambda: said["config"], "1")
            checks.step("outputs of the ROS driver", lambda: said["outputs"], "1")
            checks.step("filter profiles", lambda: int(said["profiles"]) > 0, True)
            checks.step("measurement", lambda: said["measurement"], "1")
            checks.step("100 packets a second, all parsed", lambda: int(said["packets"]) > 150, True)
            checks.step("acceleration", lambda: said["acceleration"], "9.800")
            checks.step("configuration mode again", lambda: said["again"], "1")
            checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
    return "(XDA)"


emulated.main("Xsens xspublic", "MTi-30 (xsens_mti), line of 115200 Bd", run)
