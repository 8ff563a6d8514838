#!/usr/bin/env python3
"""A terminal program's library at the right and at the wrong speed of the emulated VectorNav."""

import time

import emulated


def run(arguments, checks):
    try:
        import serial
    except ImportError:
        return None

    def answer(port, baud):
        with serial.Serial(port, baud, timeout=0.5) as line:
            line.write(b"$VNASY,0*4F\r\n")
            time.sleep(0.2)
            line.reset_input_buffer()
            line.write(b"$VNRRG,01*72\r\n")
            return line.read(200)

    sections = emulated.ACCELEROMETER.format(driver="vectornav", port="pty", more="")
    with emulated.bench(arguments.abcal, sections,
                        simulation=emulated.IN_MPS2) as bench:
        port = bench.ports["accelerometer"]
        checks.step("wrong speed", lambda: b"VNRRG" in answer(port, 9600), False)
        checks.step("right speed", lambda: answer(port, 115200), lambda text: text.startswith(b"$VNRRG,01,VN-100"))

        def ros_outputs():
            with serial.Serial(port, 115200, timeout=1) as line:
                line.write(b"$VNWRG,06,0*XX\r\n$VNWRG,75,1,20,33,578,4C,100,69D*XX\r\n$VNASY,1*XX\r\n")
                return b"\xFA\x33\x78\x05" in line.read(1000)

        checks.step("outputs of the ROS driver", ros_outputs, True)
    return serial.__version__


emulated.main("pyserial", "VectorNav VN-100 (vectornav), pseudo-terminal", run)
