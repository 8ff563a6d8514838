#!/usr/bin/env python3
"""pylablib's KinesisMotor with the emulated Thorlabs controller, over TCP: it switches RTS, which a pseudo-terminal
does not have. Libraries that its other devices want are replaced by empty ones where they are not installed."""

import importlib.abc
import importlib.machinery
import importlib.util
import sys
import types

import emulated


class Anything(type):
    """A class that has every attribute."""

    def __getattr__(cls, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything(name, (Exception,), {})

    def __getitem__(cls, item):
        return cls

    def __call__(cls, *arguments, **keywords):
        return cls


class EmptyModule(types.ModuleType):
    """A module that has every name."""

    __path__ = []

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything(name, (Exception,), {})


class Replacements(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Empty modules in place of those that are missing."""

    def __init__(self, names):
        self.names = names

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] not in self.names:
            return None
        return importlib.machinery.ModuleSpec(name, self, is_package=True)

    def create_module(self, spec):
        return EmptyModule(spec.name)

    def exec_module(self, module):
        pass


def motor(arguments, checks, model, rack, scale):
    """One axis of a controller."""
    from pylablib.devices.Thorlabs import kinesis

    if model == "K10CR1":
        sections = ('[stage.x]\ndriver = "thorlabs_apt"\nport = "tcp:127.0.0.1:0"\naxis = "1"\n'
                    '[stage.z]\ndriver = "thorlabs_apt"\nport = "tcp:127.0.0.1:0"\naxis = "1"\n'
                    '[accelerometer]\ndriver = "simulated"\n')
    else:
        sections = emulated.STAGE.format(driver="thorlabs_apt", port="tcp:127.0.0.1:0")
    with emulated.bench(arguments.abcal, sections, f'stage_model = "{model}"') as bench:
        host, port = bench.tcp("stage-x" if model == "K10CR1" else "stage")
        stage = kinesis.KinesisMotor(("network", f"{host}:{port}"), scale=scale, is_rack_system=rack)
        checks.step(f"{model}: identify", lambda: stage.get_device_info().model_no, model)
        checks.step("channels", stage.get_number_of_channels, 2 if rack else 1)
        if rack:
            checks.step("bays", stage._find_bays, [0, 1])
        checks.step("home", lambda: stage.home(timeout=10))
        checks.step("homed", stage.is_homed, True)
        checks.step("velocity", lambda: stage.get_velocity_parameters().max_velocity, lambda v: v > 0.0)
        checks.step("set velocity", lambda: stage.setup_velocity(max_velocity=100.0).max_velocity,
                    lambda v: abs(v - 100.0) < 0.1)
        stage.move_to(30.0)
        checks.step("wait", lambda: stage.wait_move(timeout=10))
        checks.step("position", stage.get_position, lambda angle: abs(angle - 30.0) < 1e-2)
        stage.move_by(-10.0)
        stage.wait_move(timeout=10)
        checks.step("relative move", stage.get_position, lambda angle: abs(angle - 20.0) < 1e-2)
        stage.setup_velocity(max_velocity=20.0)
        stage.move_to(300.0)
        checks.step("moving", stage.is_moving, True)
        checks.step("stop", lambda: stage.stop(timeout=5))
        checks.step("stopped", stage.is_moving, False)
        stage.jog("-")
        checks.step("jog", stage.is_moving, True)
        stage.stop(timeout=5)
        checks.step("set position", lambda: stage.set_position_reference(5.0), lambda angle: abs(angle - 5.0) < 1e-2)
        checks.step("status", stage.get_status, lambda flags: "homed" in flags)
        checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
        stage.close()


def run(arguments, checks):
    wanted = ("pandas", "scipy", "numba", "rpyc")
    sys.meta_path.append(Replacements({name for name in wanted if importlib.util.find_spec(name) is None}))
    try:
        import pylablib
    except ImportError:
        return None
    motor(arguments, checks, "BBD202", True, "DDR100")
    motor(arguments, checks, "K10CR1", False, "stage")
    return str(getattr(pylablib, "__version__", None) or "checkout")


emulated.main("pylablib", "Thorlabs BBD202, K10CR1 (thorlabs_apt), TCP", run)
