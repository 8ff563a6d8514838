"""Random calls of everything, with arguments that fit, nearly fit, or are nonsense: Python exceptions, never a crash.

random_calls.py CALLS [SEED]
"""

import collections
import pathlib
import random
import sys
import tempfile

import numpy as np

import abcal
from support import MATRIX, OFFSET, circles, simulated, write_bench, write_csv

#: Exceptions that bad arguments may raise.
EXPECTED = (ValueError, TypeError, RuntimeError, KeyError, IndexError, OverflowError, AttributeError, UnicodeError)


class Caller:
    def __init__(self, seed, folder):
        self.random = random.Random(seed)
        self.folder = folder
        self.records = [simulated(steps=5, seed=1).record, simulated(steps=12, seed=2).record]
        self.arrays = circles(self.records[0])
        write_csv(self.records[0], folder / "good.csv")
        (folder / "bad.csv").write_text("experiment,n,alpha_deg\n1,2\n")
        (folder / "noise.bin").write_bytes(bytes(self.random.randrange(256) for _ in range(300)))
        write_bench(folder / "bench.toml")
        self.files = ["good.csv", "bad.csv", "noise.bin", "bench.toml", "nothing", ".", "a\0b", "\udcff", ""]
        self.results = [abcal.analyse(record, "abc") for record in self.records]

    def nonsense(self):
        return self.random.choice(
            [None, 0, -1, 2**70, 1.5, float("nan"), float("inf"), "", "abc", b"abc", [], {}, (), object(), self.records[0],
             [1, 2, 3], [[1, 2, 3]], {"wobble_urad": 1.0}, {"wobble_urad": "x"}, {1: 2}, np.zeros(3), np.zeros((0, 3)),
             np.zeros((3, 0, 3)), np.ones((3, 3), complex), np.array(["a", "b"]), np.array([None, 1]), abcal.StageErrors, lambda: 0])

    def array(self, good):
        """The array, or one that is nearly it."""
        good = np.array(good, dtype=float)
        way = self.random.randrange(12)
        if way == 0:
            return good[..., :-1]
        if way == 1:
            good.flat[self.random.randrange(good.size)] = self.random.choice([np.nan, np.inf, -1e308, 1e308, 0.0])
            return good
        if way == 2:
            return good.astype(self.random.choice(["f4", "i8", "O", "c16", "U8"]))
        if way == 3:
            return np.asfortranarray(good)[::-1]
        if way == 4:
            return good * self.random.choice([0.0, 1e-300, 1e300, -1.0])
        if way == 5:
            return good.reshape(-1)
        if way == 6:
            return self.nonsense()
        return good

    def pick(self, *good):
        return self.nonsense() if self.random.random() < 0.1 else self.random.choice(good)

    def file(self):
        return self.pick(*[self.folder / name if "\0" not in name else name for name in self.files])

    def settings(self, **choices):
        return {name: self.pick(*values) for name, values in choices.items() if self.random.random() < 0.3}

    def record(self):
        alpha, readings, u = self.arrays
        extra = self.settings(response_unit=["g", "V", ""], estimator=["abc", "joint", ""], g_loc=[9.81, 0.0, -1.0, 5.0],
                              effects=[{"wobble_urad": 10.0}, {"step_deg": 1e9}, {"no": 1.0}], time_s=[np.arange(5.0), np.zeros(5)],
                              experiment=[[1] * 15, [1, 2, 3] * 5, np.repeat([1, 2, 3], 5)])
        if self.random.random() < 0.5:
            return abcal.Record(self.array(alpha), self.array(readings), self.array(u), **extra)
        extra.setdefault("experiment", np.repeat([1, 2, 3], 5))
        return abcal.Record(self.array(np.tile(alpha, 3)), self.array(readings.reshape(-1, 3)), **extra)

    def analyse(self):
        record = self.record() if self.random.random() < 0.3 else self.pick(*self.records)
        result = abcal.analyse(record, self.pick("abc", "abc", "norm", ""))
        self.results = [*self.results[-4:], result]

    def read_result(self):
        result = self.random.choice(self.results)
        name = self.random.choice([n for n in dir(result) if not n.startswith("_")])
        found = getattr(result, name)
        if callable(found):
            found = found(*([self.nonsense()] if self.random.random() < 0.2 else []))
        if isinstance(found, abcal.Values):
            float(np.nansum(found.value) + np.nansum(found.u))
        if isinstance(found, abcal.Covariance):
            found[self.pick(("s_ux", "O_u"), ("a", "b"))]

    def read_record(self):
        record = self.random.choice(self.records)
        getattr(record, self.random.choice([n for n in dir(record) if not n.startswith("_") and not n.startswith("to_")]))

    def write_into(self):
        record = self.random.choice(self.records)
        array = self.random.choice([record.readings, record.alpha_deg, self.results[0].offset.value])
        array.flat[0] = 1.0
        raise AssertionError("an array of a record could be written to")

    def simulate(self):
        abcal.simulate(self.array(MATRIX), self.array(OFFSET),
                       **self.settings(steps=[3, 5, 0, -3], noise=[0.0, 1e-3, -1.0], seed=[0, 1, 2**64 - 1], k2=[OFFSET, MATRIX],
                                       wobble_urad=[10.0, -1.0, np.inf], stage=[abcal.StageErrors(zx=self.pick(0.0, np.nan, 3.0))],
                                       angle_period_s=[1.0, 1e300, 0.0], effects=[{"k2": 0.0}, {"k2": np.nan}]))

    def specific_force(self):
        abcal.specific_force(self.pick(1, 2, 3, 4, -1), self.pick(0.0, 1e300, np.nan))

    def load(self):
        self.random.choice([abcal.load, abcal.load_poses, abcal.Certificate])(self.file())

    def bench(self):
        bench = abcal.Bench(self.file())
        self.random.choice([bench.hold, bench.go_on, bench.halt])()
        if self.random.random() < 0.2:
            bench.resume(self.file(), callback=self.pick(None, print))

    def compare(self):
        abcal.compare(self.pick([self.file(), self.file()], [], [self.file()]), **self.settings(group_by=["day", "x"], estimator=["abc"]))

    def plan(self):
        # Only invalid requests: a valid plan takes a minute.
        abcal.plan(self.folder / "bench.toml", self.pick("s=0", "phi=1e-3", "x=2 deg", "s=-1") or "nothing", **self.settings(within_s=[-1.0, np.nan]))

    def study(self):
        abcal.monte_carlo(self.pick(self.records[0], None), self.pick(1, -1), **self.settings(digits=[0, 3], threads=[1, -1]))

    def call(self):
        common = [self.record, self.read_result, self.read_record, self.simulate, self.specific_force, self.load]
        # Each other call is made some 300 times in a hundred thousand: under the sanitizer an analysis takes seconds.
        kinds = common * 60 + [self.analyse, self.write_into, self.bench, self.compare, self.plan, self.study]
        kind = self.random.choice(kinds)
        kind()
        return kind


def main():
    calls = int(sys.argv[1])
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 19
    outcomes = collections.Counter()
    with tempfile.TemporaryDirectory() as folder:
        caller = Caller(seed, pathlib.Path(folder))
        for number in range(calls):
            try:
                caller.call()
                outcomes["done"] += 1
            except EXPECTED as error:
                if not str(error):
                    raise AssertionError(f"call {number}: {type(error).__name__} without a message") from error
                outcomes[type(error).__name__] += 1
    print(f"{calls} calls, seed {seed}: {dict(outcomes)}")
    # Both outcomes must occur, or the calls test nothing.
    if outcomes["done"] < calls // 10 or outcomes["ValueError"] < calls // 50:
        sys.exit("too few calls succeed, or too few are refused")


if __name__ == "__main__":
    main()
