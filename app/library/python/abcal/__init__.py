"""Calibration of triaxial accelerometers with gravity on a two-axis rotation stage.

    record = abcal.load("x.run")
    result = abcal.analyse(record, "joint")
    result.sensitivity_matrix.value, result.sensitivity_matrix.u

Arrays that belong to a record or a result are views of its memory and cannot be written to. Angles are in degrees,
readings in the record's response unit R, sensitivities in R/g_loc. What is wrong with arguments is a ValueError, with a
file or a measurement a RuntimeError (InstrumentError, Stopped), each with what was found and what is required.
"""

import asyncio as _asyncio
import importlib.util as _importlib_util
import os as _os
import pathlib as _pathlib
import sys as _sys
import tempfile as _tempfile
import threading as _threading

if _importlib_util.find_spec("._abcal", __name__) is None:
    raise ImportError(
        f"abcal: {__path__[0]} holds no compiled module _abcal for Python {_sys.version_info.major}.{_sys.version_info.minor}. "
        "Build it with `scripts/build release abcal_python` and use Debian's Python (/usr/bin/python3), "
        "or install the package python3-abcal."
    )

from ._abcal import (  # noqa: F401
    Bench,
    Certificate,
    CheckFinding,
    Comparison,
    CompleteRun,
    Covariance,
    EffectFound,
    InstrumentError,
    MonteCarloStudy,
    PlanAnswer,
    PredictedPlan,
    Published,
    QuantityGroup,
    Record,
    Result,
    SimulatedRecord,
    StageErrors,
    Stopped,
    Values,
    __version__,
    _load_table,
    _read_table,
    accelerometer_drivers,
    analyse,
    analyse_measurement,
    certificate_xml,
    compare,
    demo_bench,
    estimators,
    load,
    load_poses,
    monte_carlo,
    plan,
    predict,
    simulate,
    simulation_set,
    simulation_sets,
    specific_force,
    stage_drivers,
)


def demo(steps=30):
    """Calibrates the emulated instruments of `abcal demo` inside this process, and returns the Result.

    It takes less than a second, needs no files and leaves none. steps: angles of each experiment, a divisor of 360.
    """
    if _os.environ.get("ABCAL_REGISTER"):
        raise ValueError(
            "the demo measures without a person of the register that ABCAL_REGISTER names; "
            "required: that the variable is not set"
        )
    with _tempfile.TemporaryDirectory(prefix="abcal-demo-") as folder:
        bench = _pathlib.Path(folder) / "bench.toml"
        bench.write_text(demo_bench(steps), encoding="utf-8")
        return Bench(bench).run(bench.with_name("demo.run")).result


def _cell(value):
    """A number with all its digits, or the words of a date."""
    try:
        return repr(float(value))
    except (TypeError, ValueError):
        return str(value)


def calibrate(data, unit="", columns="", time_unit="", estimator="", topic=""):
    """The result of a table of readings: the path of a file, an array, or a DataFrame, whose columns have names.

    Columns of an array: u, v, w (poses), or t, u, v, w (a time series), else as `columns` names them, such as
    "t,x,y,z,-". `unit` is that of the readings; a `time_unit` that is not stated is found from the spacing.
    Without angles the estimator is "norm", with them "joint". `topic` names the one to be read of a log with several.
    """
    if isinstance(data, (str, _os.PathLike)):
        return analyse(_load_table(data, columns, unit, time_unit, topic), estimator)
    rows = [[_cell(value) for value in row] for row in getattr(data, "values", data)]
    if hasattr(data, "columns") and not columns:
        rows.insert(0, [str(name).replace(",", " ") for name in data.columns])
    text = "\n".join(",".join(row) for row in rows)
    return analyse(_read_table(text, columns, unit, time_unit), estimator)


def _uncertain(self):
    """The quantities by label with all their correlations, as numbers of the package uncertainties.

    Raises ImportError where that is not installed: `values` and `matrix` hold the same.
    """
    from uncertainties import correlated_values

    numbers = correlated_values(list(self.values), self.matrix, tags=list(self.labels))
    return dict(zip(self.labels, numbers))


def _covariance_to_pandas(self):
    """The matrix as a pandas.DataFrame with the labels on both sides."""
    import pandas

    return pandas.DataFrame(self.matrix, index=list(self.labels), columns=list(self.labels))


def _covariance_to_xarray(self):
    """The matrix as an xarray.DataArray with the dimensions output and output_2."""
    import xarray

    names = list(self.labels)
    return xarray.DataArray(self.matrix, coords={"output": names, "output_2": names}, dims=("output", "output_2"))


def _record_to_pandas(self):
    """One row an angle: experiment, face, alpha_deg, r_u r_v r_w, u_u u_v u_w, time_s, closing."""
    import pandas

    readings, u = self.readings, self.u
    columns = {"experiment": self.experiment, "face": self.face, "alpha_deg": self.alpha_deg}
    columns.update({"r_" + name: readings[:, j] for j, name in enumerate("uvw")})
    columns.update({"u_" + name: u[:, j] for j, name in enumerate("uvw")})
    columns.update({"time_s": self.time_s, "closing": self.closing})
    frame = pandas.DataFrame(columns)
    frame.attrs["response_unit"] = self.response_unit
    return frame


def _record_to_xarray(self):
    """The same as an xarray.Dataset with the dimensions angle and output."""
    import xarray

    return xarray.Dataset(
        {
            "readings": (("angle", "output"), self.readings, {"units": self.response_unit}),
            "u": (("angle", "output"), self.u, {"units": self.response_unit}),
        },
        coords={
            "experiment": ("angle", self.experiment),
            "face": ("angle", self.face),
            "alpha_deg": ("angle", self.alpha_deg, {"units": "degree"}),
            "time_s": ("angle", self.time_s, {"units": "s"}),
            "output": list("uvw"),
        },
    )


async def _dwells(self, run_file=None, *, resume=False):
    """Measures a run (or resumes it) and yields each angle as a dict once it is on the disk.

    `async for dwell in bench.dwells("x.run")`. Leaving the loop, an exception in it and Ctrl-C halt the stage at once;
    the run file can then be resumed. The run is analysed as by run(): read it with load().
    """
    loop = _asyncio.get_running_loop()
    queue = _asyncio.Queue()
    leaving = _threading.Event()

    def pass_on(event):
        if leaving.is_set():
            raise Stopped("the loop over the dwells was left")
        if event["event"] == "dwell_done":
            loop.call_soon_threadsafe(queue.put_nowait, event)

    def measure():
        return self.resume(run_file, callback=pass_on) if resume else self.run(run_file, callback=pass_on)

    run = loop.run_in_executor(None, measure)
    waiting = None
    try:
        while True:
            waiting = _asyncio.ensure_future(queue.get())
            await _asyncio.wait({waiting, run}, return_when=_asyncio.FIRST_COMPLETED)
            if waiting.done():
                yield waiting.result()
                continue
            waiting.cancel()
            while not queue.empty():
                yield queue.get_nowait()
            run.result()
            return
    finally:
        leaving.set()
        if waiting is not None:
            waiting.cancel()
        # The measuring thread cannot be cancelled: halt it, and wait for its end.
        while not run.done():
            self.halt()
            await _asyncio.wait({run}, timeout=0.02)
        run.exception()


Covariance.uncertain = _uncertain
Covariance.to_pandas = _covariance_to_pandas
Covariance.to_xarray = _covariance_to_xarray
Record.to_pandas = _record_to_pandas
Record.to_xarray = _record_to_xarray
Bench.dwells = _dwells
