"""Records: arrays in and out, and everything that can be wrong with arrays."""

import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

import numpy as np

import abcal
from support import MATRIX, OFFSET, circles, simulated, write_csv


class Package(unittest.TestCase):
    def test_without_its_compiled_module_the_package_says_what_to_build(self):
        with tempfile.TemporaryDirectory() as folder:
            package = pathlib.Path(folder) / "abcal"
            package.mkdir()
            shutil.copy(abcal.__file__, package)
            call = subprocess.run(
                [sys.executable, "-c", "import abcal"], env={"PYTHONPATH": folder}, capture_output=True, text=True
            )
            self.assertNotEqual(call.returncode, 0)
            version = f"{sys.version_info.major}.{sys.version_info.minor}"
            found = f"ImportError: abcal: {package} holds no compiled module _abcal for Python {version}. "
            self.assertIn(found + "Build it with `scripts/build release abcal_python`", call.stderr)


class Arrays(unittest.TestCase):
    def setUp(self):
        self.alpha, self.readings, self.u = circles(simulated().record)

    def test_circles_and_rows_are_the_same_record(self):
        whole = abcal.Record(self.alpha, self.readings, self.u)
        flat = abcal.Record(
            np.tile(self.alpha, 3),
            self.readings.reshape(-1, 3),
            self.u.reshape(-1, 3),
            experiment=np.repeat([1, 2, 3], len(self.alpha)),
        )
        self.assertEqual(len(whole), 72)
        np.testing.assert_array_equal(whole.readings, flat.readings)
        self.assertEqual(abcal.analyse(whole, "abc").to_dict(), abcal.analyse(flat, "abc").to_dict())

    def test_any_layout_gives_the_same_numbers(self):
        expected = abcal.Record(self.alpha, self.readings).readings
        every_second = np.repeat(self.readings, 2, axis=1)[:, ::2]
        backwards = self.readings[:, ::-1].copy()[:, ::-1]
        structured = np.zeros(self.readings.shape, dtype=[("pad", "i1"), ("x", "f8")])
        structured["x"] = self.readings
        for layout in (np.asfortranarray(self.readings), every_second, backwards, structured["x"], self.readings.tolist()):
            np.testing.assert_array_equal(abcal.Record(self.alpha, layout).readings, expected)

    def test_arrays_of_a_record_are_views_of_it(self):
        record = abcal.Record(self.alpha, self.readings)
        self.assertTrue(np.shares_memory(record.readings, record.readings))
        self.assertTrue(np.shares_memory(record.alpha_deg, record.alpha_deg))
        self.assertFalse(record.readings.flags.writeable)
        with self.assertRaises(ValueError):
            record.readings[0, 0] = 1.0
        view = record.readings
        del record
        np.testing.assert_array_equal(view, self.readings.reshape(-1, 3))

    def test_arrays_of_a_result_are_views_that_keep_it(self):
        value = abcal.analyse(abcal.Record(self.alpha, self.readings)).sensitivity_matrix.value
        self.assertEqual(value.shape, (3, 3))
        self.assertTrue(np.isfinite(value).all())
        self.assertFalse(value.flags.writeable)

    def test_a_closing_angle_is_found(self):
        alpha = np.append(self.alpha, 360.0)
        readings = np.concatenate([self.readings, self.readings[:, :1]], axis=1)
        record = abcal.Record(alpha, readings)
        self.assertEqual(sum(record.closing), 3)

    def test_two_faces(self):
        first = np.arange(6) * 60.0
        second = first + 30.0
        # What the item sees in face 2, in the angles of face 1 (docs/measurement.md, "Two faces").
        seen = {1: -second, 2: -second, 3: second + 180.0}
        readings, alpha, experiment, face = [], [], [], []
        for of_circle, angles in ((1, first), (2, second)):
            for number in (1, 2, 3):
                for i, angle in enumerate(angles):
                    gravity = abcal.specific_force(number, angle if of_circle == 1 else seen[number][i])
                    readings.append(MATRIX @ gravity + OFFSET)
                    alpha.append(angle)
                    experiment.append(number)
                    face.append(of_circle)
        record = abcal.Record(alpha, readings, experiment=experiment, face=face)
        np.testing.assert_array_equal(record.face, face)
        result = abcal.analyse(record, "abc")
        np.testing.assert_allclose(result.sensitivity_matrix.value, MATRIX, atol=1e-12)
        as_one = abcal.analyse(abcal.Record(alpha, readings, experiment=experiment), "abc")
        self.assertNotEqual(as_one.verdict, "usable", "these readings tell the faces apart")
        again = abcal.Record(alpha, readings, experiment=experiment, face=record.to_pandas().face)
        np.testing.assert_array_equal(again.face, face)

    def test_settings_arrive(self):
        record = abcal.Record(
            self.alpha, self.readings, response_unit="g", g_loc=9.81, u_g_loc=1e-5, estimator="joint", effects={"wobble_urad": 7.0}
        )
        self.assertEqual((record.response_unit, record.g_loc, record.estimator), ("g", 9.81, "joint"))
        self.assertEqual(record.effects["wobble_urad"], 7.0)
        self.assertEqual(len(record.default_effects), len(abcal.Record(self.alpha, self.readings).default_effects) - 1)


class WrongArrays(unittest.TestCase):
    def setUp(self):
        self.alpha, self.readings, self.u = circles(simulated().record)

    def refused(self, *words, **changes):
        arguments = {"alpha_deg": self.alpha, "readings": self.readings}
        arguments.update(changes)
        with self.assertRaises(ValueError) as raised:
            abcal.Record(**arguments)
        for word in words:
            self.assertIn(word, str(raised.exception))

    def test_shapes(self):
        self.refused("readings: found shape (2, 24, 3)", "(3, N, 3) or (M, 3)", readings=self.readings[:2])
        self.refused("alpha_deg: found shape (5,)", "N = 24", alpha_deg=self.alpha[:5])
        self.refused("u: found shape (3, 23, 3)", "(3, 24, 3)", u=self.u[:, 1:])
        self.refused("time_s: found shape (1,)", time_s=[1.0])
        self.refused("experiment: found none", alpha_deg=np.tile(self.alpha, 3), readings=self.readings.reshape(-1, 3))
        self.refused("experiment: found one", experiment=[1, 2, 3])
        self.refused("readings: found shape ()", readings=1.0)
        self.refused("face: found shape (2,)", face=[1, 2])
        self.refused("face, row 1: found 0; required: 1 or 2", face=[1, 3] + [1] * 22)

    def test_numbers(self):
        self.readings[1, 2, 0] = np.nan
        self.refused("readings, row 26: found (nan", "finite numbers")
        self.readings[1, 2, 0] = 0.0
        self.refused("u, row 0", ">= 0", u=-self.u)
        self.refused("alpha_deg, row 0: found inf", alpha_deg=np.full(24, np.inf))
        self.refused("at least 3", alpha_deg=np.zeros(24))
        self.refused(
            "experiment, row 0: found 0", alpha_deg=np.tile(self.alpha, 3), readings=self.readings.reshape(-1, 3), experiment=np.full(72, 1.5)
        )

    def test_kinds(self):
        self.refused("readings: found str", "an array of numbers", readings="readings")
        self.refused("readings: found list", readings=[[1, 2], [3]])
        self.refused("alpha_deg: found dict", alpha_deg={})
        self.refused("readings: found object", readings=object())
        with self.assertRaises(TypeError):
            abcal.Record()
        with self.assertRaises(TypeError):
            abcal.analyse(None)

    def test_settings(self):
        self.refused('effects: found "wobbel"', "wobble_urad", effects={"wobbel": 1.0})
        self.refused("effects, wobble_urad: found -1", effects={"wobble_urad": -1.0})
        self.refused("g_loc: found 98.1", g_loc=98.1)
        self.refused("standard uncertainty of g_loc: found nan", g_loc=9.81, u_g_loc=np.nan)
        self.refused("boring", "abc, joint or norm", estimator="boring")


class Files(unittest.TestCase):
    def test_a_csv_is_the_record_that_was_written(self):
        record = simulated().record
        with tempfile.TemporaryDirectory() as folder:
            loaded = abcal.load(write_csv(record, pathlib.Path(folder) / "readings.csv"))
        np.testing.assert_array_equal(loaded.readings, record.readings)
        np.testing.assert_array_equal(loaded.u, record.u)
        self.assertEqual(loaded.closing, record.closing)

    def test_messages_of_files_are_those_of_the_program(self):
        with self.assertRaisesRegex(RuntimeError, "no such file"):
            abcal.load("nothing.run")
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "bad.csv"
            path.write_text("experiment,n,alpha_deg,r_u,r_v,r_w\n1,1,0,one,2,3\n")
            with self.assertRaisesRegex(RuntimeError, 'line 2, r_u: found "one"; required: a number'):
                abcal.load(path)


class Tables(unittest.TestCase):
    """Readings without angles: an array, or a file of others."""

    def setUp(self):
        random = np.random.default_rng(3)
        directions = random.normal(size=(30, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        self.poses = directions * [1.002, 0.998, 1.0] + [0.01, -0.02, 0.03] + 1e-4 * random.normal(size=(30, 3))

    def test_an_array_and_a_file_of_it_give_the_same(self):
        result = abcal.calibrate(self.poses, unit="g")
        self.assertEqual((result.estimator, result.response_unit, result.verdict), ("norm", "g", "usable"))
        np.testing.assert_allclose(result.intrinsic_sensitivity.value, [1.002, 0.998, 1.0], atol=1e-3)
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "poses.txt"
            np.savetxt(path, np.column_stack([range(30), self.poses]), header="id x y z", fmt="%.17g")
            again = abcal.calibrate(path, unit="g")
        np.testing.assert_array_equal(again.offset.value, result.offset.value)
        class Frame:  # As a DataFrame has it: names, and values of any kind.
            columns = ["note, in words", "az", "ax", "ay"]
            values = [["by hand", float(z), float(x), float(y)] for x, y, z in self.poses]

        framed = abcal.calibrate(Frame(), unit="g")
        np.testing.assert_array_equal(framed.offset.value, result.offset.value)
        other = abcal.calibrate(self.poses[:, ::-1], unit="g", columns="z,y,x")
        np.testing.assert_array_equal(other.offset.value, result.offset.value)

    def test_what_is_wrong_with_a_table_is_said(self):
        with self.assertRaisesRegex(RuntimeError, "array: line 1, header: found 2 columns without a header"):
            abcal.calibrate(self.poses[:, :2])
        with self.assertRaisesRegex(ValueError, "--estimator norm"):
            abcal.calibrate(self.poses, estimator="joint")


class OtherPackages(unittest.TestCase):
    def test_pandas(self):
        try:
            import pandas  # noqa: F401
        except ImportError:
            self.skipTest("python3-pandas is not installed")
        record = simulated().record
        frame = record.to_pandas()
        self.assertEqual(list(frame.columns)[:5], ["experiment", "face", "alpha_deg", "r_u", "r_v"])
        np.testing.assert_array_equal(frame[["r_u", "r_v", "r_w"]].to_numpy(), record.readings)
        again = abcal.Record(frame.alpha_deg, frame[["r_u", "r_v", "r_w"]], experiment=frame.experiment)
        np.testing.assert_array_equal(again.readings, record.readings)
        covariance = abcal.analyse(record, "abc").covariance
        self.assertEqual(covariance.to_pandas().loc["s_ux", "O_u"], covariance["s_ux", "O_u"])

    def test_xarray(self):
        try:
            import xarray  # noqa: F401
        except ImportError:
            self.skipTest("python3-xarray is not installed")
        record = simulated().record
        data = record.to_xarray()
        np.testing.assert_array_equal(data.readings.sel(output="v"), record.readings[:, 1])
        covariance = abcal.analyse(record, "abc").covariance
        self.assertEqual(float(covariance.to_xarray().sel(output="s_ux", output_2="O_u")), covariance["s_ux", "O_u"])

    def test_uncertainties(self):
        try:
            import uncertainties
        except ImportError:
            self.skipTest("python3-uncertainties is not installed")
        covariance = abcal.analyse(simulated().record, "joint").covariance
        numbers = covariance.uncertain()
        self.assertAlmostEqual(numbers["s_ux"].n, covariance.values[0], places=12)
        found = uncertainties.covariance_matrix([numbers["s_ux"], numbers["s_vy"] - numbers["s_ux"]])
        expected = covariance["s_vy", "s_vy"] + covariance["s_ux", "s_ux"] - 2 * covariance["s_ux", "s_vy"]
        self.assertAlmostEqual(found[1][1] / expected, 1.0, places=6)


if __name__ == "__main__":
    unittest.main()
