#!/usr/bin/env python3
"""PyVISA with the emulated voltmeters: the status model of IEEE 488.2."""

import time

import emulated


def run(arguments, checks):
    try:
        import pyvisa
        import pyvisa_py
    except ImportError:
        return None

    sections = emulated.ACCELEROMETER.format(driver="scpi_voltmeter", port="tcp:0", more="")
    with emulated.bench(arguments.abcal, sections) as bench:
        host, port = bench.tcp("accelerometer")
        meter = pyvisa.ResourceManager("@py").open_resource(
            f"TCPIP::{host}::{port}::SOCKET", timeout=5000, write_termination="\n", read_termination="\n")
        checks.step("identify", lambda: meter.query("*IDN?"), lambda text: "34970A" in text)
        checks.step("reset", lambda: meter.query("*RST;*CLS;*OPC?"), lambda text: int(text) == 1)
        meter.write("CONF:VOLT:DC 10,DEF,(@101:103)")

        def poll_completion():
            meter.write("*ESE 1")
            meter.write("INIT;*OPC")
            end = time.monotonic() + 5.0
            while not int(meter.query("*STB?")) & 32:
                if time.monotonic() > end:
                    raise TimeoutError("*OPC was never told")
            return int(meter.query("*ESR?")) & 1

        checks.step("*OPC polling", poll_completion, 1)
        checks.step("readings", lambda: len(meter.query_ascii_values("FETC?")), 3)
        checks.step("errors", lambda: meter.query("SYST:ERR?"), '+0,"No error"')
        meter.close()

    with emulated.bench(arguments.abcal, sections.replace("[accelerometer]", "[accelerometer]\nchannels = [1, 2, 3]"),
                        model='accelerometer_model = "2001"') as bench:
        host, port = bench.tcp("accelerometer")
        meter = pyvisa.ResourceManager("@py").open_resource(
            f"TCPIP::{host}::{port}::SOCKET", timeout=5000, write_termination="\n", read_termination="\n")
        checks.step("Keithley 2001", lambda: meter.query("*IDN?"), lambda text: "MODEL 2001" in text)
        meter.close()
    return f"{pyvisa.__version__}, pyvisa-py {pyvisa_py.__version__}"


emulated.main("PyVISA", "34970A, Keithley 2001 (scpi_voltmeter), TCP", run)
