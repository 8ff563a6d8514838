#!/usr/bin/env python3
"""pymeasure with the emulated voltmeters 34401A, Keithley 2000 and Keithley 2700, through pyvisa-py."""

import emulated

SECTIONS = """
[stage]
driver = "simulated"
[accelerometer]
driver = "{driver}"
port = "tcp:0"
channels = [101, 102, 103]
"""
SINGLES = """
[stage]
driver = "simulated"
[accelerometer]
driver = "scpi_single"
port = "tcp:0 tcp:0 tcp:0"
"""


def run(arguments, checks, sections, model, use):
    try:
        import pymeasure
        from pymeasure.instruments import keithley
        from pymeasure.instruments.hp import HP34401A
    except ImportError:
        return None

    with emulated.bench(arguments.abcal, sections, f'accelerometer_model = "{model}"') as bench:
        name = "accelerometer" if "accelerometer" in bench.ports else "accelerometer-u"
        resource = "TCPIP::{}::{}::SOCKET".format(*bench.tcp(name))
        kind = {"34401A": HP34401A, "2000": keithley.Keithley2000, "2700": keithley.Keithley2700}[model]
        meter = checks.step("open", lambda: kind(resource, visa_library="@py", timeout=5000, write_termination="\n",
                                                 read_termination="\n"))
        if meter is not None:
            checks.step("identity", lambda: meter.id, lambda text: model in text)
            use(meter, checks)
        checks.step("no unserved query", lambda: bench.status()["unserved"], [])
    return "(checkout)"


def kept(checks, meter, **values):
    """Settings are written and read back."""
    for name, value in values.items():
        def write_and_read():
            setattr(meter, name, value)
            return getattr(meter, name)

        checks.step(name, write_and_read, value)


def use_34401a(meter, checks):
    checks.step("SYST:REM", lambda: meter.write("SYST:REM"))
    checks.step("function", lambda: meter.function_, "DCV")
    kept(checks, meter, range_=10.0, trigger_delay=0.5, trigger_auto_delay_enabled=True, nplc=10, display_enabled=False,
         displayed_text="HELLO", autozero_enabled=True, auto_input_impedance_enabled=True, detector_bandwidth=20,
         sample_count=2, beeper_enabled=False)
    checks.step("resolution", lambda: meter.resolution, lambda volts: 0.0 < volts < 1e-3)
    checks.step("terminals", lambda: meter.terminals_used, "FRONT")
    checks.step("SCPI version", lambda: meter.scpi_version, lambda version: float(version) > 1990)
    checks.step("self test", lambda: meter.self_test_result, 0)
    checks.step("readings", lambda: len(meter.reading), 2)
    checks.step("stored readings", lambda: meter.stored_readings_count, 2)


def use_2000(meter, checks):
    checks.step("mode", lambda: meter.mode, "voltage")
    kept(checks, meter, voltage_range=10.0, voltage_nplc=1.0, voltage_digits=6, voltage_reference=0.25,
         trigger_delay=0.5, trigger_count=3, beep_state="enabled")
    checks.step("beep", lambda: meter.beep(1000.0, 0.1))
    checks.step("no error", meter.check_errors, [])


def use_2700(meter, checks):
    checks.step("text of the display", lambda: setattr(meter, "display_text", "HELLO"))
    # It closes channels only of a matrix card, which is not emulated.
    checks.step("a channel is closed", lambda: meter.write("ROUT:MULT:CLOS (@101)"))
    checks.step("closed channels", lambda: meter.closed_channels, [101])
    checks.step("channels are opened", lambda: meter.open_all_channels())
    checks.step("no error", meter.check_errors, [])


def hp34401a(arguments, checks):
    return run(arguments, checks, SINGLES, "34401A", use_34401a)


def keithley_2000(arguments, checks):
    return run(arguments, checks, SECTIONS.format(driver="scpi_voltmeter"), "2000", use_2000)


def keithley_2700(arguments, checks):
    return run(arguments, checks, SECTIONS.format(driver="scpi_voltmeter"), "2700", use_2700)


emulated.main("pymeasure", "34401A (scpi_single), TCP", hp34401a, "Keithley 2000 (scpi_voltmeter), TCP", keithley_2000,
              "Keithley 2700 (scpi_voltmeter), TCP", keithley_2700)
