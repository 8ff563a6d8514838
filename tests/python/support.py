"""What the tests share: small records and benches."""

import os
import pathlib
import re

import numpy as np

import abcal

# A sanitizer's runtime that came first into this Python stays out of the programs that it starts: they hold their own.
os.environ.pop("LD_PRELOAD", None)
SOURCE = pathlib.Path(os.environ["ABCAL_SOURCE"])
PROGRAM = os.environ["ABCAL_PROGRAM"]
MATRIX = np.array([[1.01, 0.002, -0.003], [0.004, 0.99, 0.001], [-0.002, 0.003, 1.02]])
OFFSET = np.array([0.01, -0.02, 0.03])


def simulated(**changes):
    """A run on a bench with the published errors and a little wobble."""
    settings = dict(
        stage=abcal.StageErrors(zx=1e-4, zy=-5e-5, xz=8e-5, initial_turn_z_deg=0.005, mean_step_x_deg=-0.004),
        steps=24,
        wobble_urad=20.0,
        step_deg=0.005,
        noise=1e-5,
        seed=4,
    )
    settings.update(changes)
    return abcal.simulate(MATRIX, OFFSET, **settings)


def circles(record):
    """The arrays of a record without closing angles: alpha (N,), readings and u (3, N, 3)."""
    use = ~np.array(record.closing)
    shape = (3, -1, 3)
    return record.alpha_deg[use].reshape(3, -1)[0], record.readings[use].reshape(shape), record.u[use].reshape(shape)


def write_csv(record, path):
    """A CSV of averaged readings with all digits."""
    rows = ["experiment,n,alpha_deg,r_u,r_v,r_w,u_u,u_v,u_w,time_s,closing"]
    count = {1: 0, 2: 0, 3: 0}
    u, time_s = record.u, record.time_s
    for i, experiment in enumerate(record.experiment):
        count[experiment] += 1
        numbers = [record.alpha_deg[i], *record.readings[i], *u[i], time_s[i]]
        rows.append(
            f"{experiment},{count[experiment]}," + ",".join(repr(float(x)) for x in numbers) + f",{int(record.closing[i])}"
        )
    pathlib.Path(path).write_text("\n".join(rows) + "\n")
    return path


def write_bench(path, steps=12, readings=20):
    """The simulated bench of the examples, made small."""
    text = (SOURCE / "docs/examples/simulated.toml").read_text()
    text = re.sub(r"(?m)^steps = .*$", f"steps = {steps}", text, count=1)
    text = re.sub(r"(?m)^step_deg = 5\.0$", f"step_deg = {360.0 / steps}", text, count=1)
    text = re.sub(r"(?m)^dwell_readings = .*$", f"dwell_readings = {readings}", text, count=1)
    pathlib.Path(path).write_text(text)
    return path
