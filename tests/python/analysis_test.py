"""Results, studies, plans and comparisons against the program and against the truth."""

import ast
import inspect
import json
import pathlib
import re
import shutil
import subprocess
import tempfile
import threading
import unittest
import xml.etree.ElementTree

import numpy as np

import abcal
from support import MATRIX, OFFSET, PROGRAM, SOURCE, circles, simulated, write_bench, write_csv


def program(*arguments):
    return subprocess.run([PROGRAM, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


class Results(unittest.TestCase):
    def test_a_result_is_the_program_s(self):
        with tempfile.TemporaryDirectory() as folder:
            path = write_csv(simulated(steps=12).record, pathlib.Path(folder) / "readings.csv")
            for estimator in abcal.estimators():
                result = abcal.analyse(abcal.load(path), estimator)
                self.assertEqual(result.to_dict(), json.loads(program("analyse", path, "--estimator", estimator, "--json")))

    def test_a_measurement_is_the_program_s(self):
        with tempfile.TemporaryDirectory() as folder:
            bench = write_bench(pathlib.Path(folder) / "bench.toml")
            out = pathlib.Path(folder) / "m"
            program("mountings", bench, "--mountings", "2", "-o", out)
            of_program = json.loads(program("analyse", f"{out}.measurement", "--json"))
            for files in [[f"{out}.measurement"], [f"{out}-1.run", f"{out}-2.run"]]:
                results = abcal.analyse_measurement(files)
                self.assertEqual(len(results), 1)
                self.assertEqual(results[0].to_dict(), of_program)
            with self.assertRaisesRegex(ValueError, "given twice"):
                abcal.analyse_measurement([f"{out}-1.run", f"{out}-1.run"])

    def test_members_are_the_json_s(self):
        result = abcal.analyse(simulated().record, "joint")
        json_of = result.to_dict()
        elements = [[(e["value"], e["standard_uncertainty"]) for e in row] for row in json_of["sensitivity_matrix"]]
        for j in range(3):
            for k in range(3):
                self.assertEqual(elements[j][k], (result.sensitivity_matrix.value[j, k], result.sensitivity_matrix.u[j, k]))
            self.assertEqual(json_of["offset"][j]["value"], result.offset.value[j])
            self.assertEqual(json_of["intrinsic_angle"][j]["value"], result.intrinsic_angle.value[j])
        np.testing.assert_array_equal(result.covariance.matrix, json_of["covariance"])
        np.testing.assert_array_equal(result.covariance_intrinsic.matrix, json_of["covariance_intrinsic"])
        self.assertEqual(result.verdict, json_of["verdict"])
        self.assertEqual(result.sensitivity_matrix.unit, "R/g_loc")

    def test_every_group_of_the_json_is_a_group_here(self):
        result = abcal.analyse(simulated().record, "joint")
        json_of = result.to_dict()
        self.assertEqual([group.key for group in result.quantities], [group["key"] for group in json_of["quantities"]])
        self.assertIn("alignment", [group.key for group in result.quantities])
        for group, about in zip(result.quantities, json_of["quantities"]):
            self.assertEqual((group.kind, group.frame, group.heading, group.meaning, group.symbols),
                             tuple(about[key] for key in ("kind", "frame", "heading", "meaning", "symbols")))
            values = json_of
            for key in about["path"].split("/")[1:]:
                values = values[key]
            found = np.array([q["value"] for q in np.ravel(values)], dtype=float)
            np.testing.assert_array_equal(group.values.value.ravel(), found)

    def test_the_truth_is_within_the_uncertainty(self):
        run = simulated(steps=72)
        result = abcal.analyse(run.record, "joint")
        self.assertEqual(result.verdict, "usable", result.why)
        error = result.sensitivity_matrix.value - run.true_sensitivity_matrix
        self.assertLess(np.abs(error / result.sensitivity_matrix.u).max(), 4.0)
        self.assertLess(np.abs((result.offset.value - run.true_offset) / result.offset.u).max(), 4.0)
        self.assertIn("wobble_urad", [effect.key for effect in result.effects])

    def test_labels(self):
        covariance = abcal.analyse(simulated().record, "abc").covariance
        self.assertEqual(covariance.labels[:3] + covariance.labels[9:], ["s_ux", "s_uy", "s_uz", "O_u", "O_v", "O_w"])
        self.assertEqual(covariance["s_ux", "O_u"], covariance.matrix[0, 9])
        with self.assertRaisesRegex(KeyError, "s_xx"):
            covariance["s_xx", "O_u"]

    def test_a_record_that_is_refused_has_a_reason_and_no_numbers(self):
        alpha, readings, u = circles(simulated().record)
        result = abcal.analyse(abcal.Record(alpha, np.zeros_like(readings), u), "joint")
        self.assertEqual(result.verdict, "not_usable")
        self.assertNotEqual(result.why, "")
        self.assertEqual(len(result.covariance), 0)

    def test_the_published_result_is_the_json_s_and_the_table_s(self):
        record = simulated().record
        published = abcal.analyse(record, "abc").published
        json_of = abcal.analyse(record, "abc").to_dict()["published"]
        names = ["sensitivity_matrix", "offset", "intrinsic_sensitivity", "intrinsic_angle"]
        for name in names:
            values, stated = getattr(published, name), json_of[name]
            quantities = [q for row in stated for q in row] if name == "sensitivity_matrix" else stated
            self.assertEqual([q["value"] for q in quantities], values.value.ravel().tolist(), name)
            self.assertEqual([q["standard_uncertainty"] for q in quantities], values.u.ravel().tolist(), name)
            self.assertEqual(quantities[0]["unit"], values.unit, name)
        np.testing.assert_array_equal(published.covariance.matrix, json_of["covariance"])
        np.testing.assert_array_equal(published.covariance_intrinsic.matrix, json_of["covariance_intrinsic"])
        self.assertEqual(published.covariance.labels, abcal.analyse(record, "abc").covariance.labels)
        # Only "abc" has one, and its uncertainty has no effect but the paper's.
        self.assertIsNone(abcal.analyse(record, "joint").published)
        corrected = abcal.analyse(abcal.simulate(MATRIX, OFFSET, k3=np.full(3, 1e-3), steps=24).record, "abc")
        difference = corrected.published.sensitivity_matrix.value - corrected.sensitivity_matrix.value
        self.assertGreater(np.abs(np.diag(difference)).max(), 1e-4)

    def test_a_result_shows_itself_in_a_notebook(self):
        result = abcal.demo()
        html = result._repr_html_()
        root = xml.etree.ElementTree.fromstring(re.sub("&nbsp;|<br>", " ", html))
        self.assertEqual(root.tag, "div")
        text = " ".join(root.itertext())
        self.assertIn("Usable (joint estimator): " + result.why[:20], text)
        for value in result.sensitivity_matrix.value.ravel():
            # Five digits of each element stand in the table, with a sign of its own.
            self.assertIn(f"{abs(value):.5f}"[:6], text)
        self.assertIn("±", text)
        pictures = root.findall(".//{http://www.w3.org/2000/svg}svg")
        self.assertEqual(len(pictures), 1)
        # Several results stand on one page: no ids.
        self.assertNotIn(" id=", html)
        # What is not usable shows no number.
        alpha, readings, u = circles(simulated().record)
        refused = abcal.analyse(abcal.Record(alpha, np.zeros_like(readings), u), "joint")._repr_html_()
        self.assertIn("Not usable", refused)
        self.assertNotIn("<table", refused)

    def test_an_unknown_estimator(self):
        with self.assertRaisesRegex(ValueError, "abc, joint or norm"):
            abcal.analyse(simulated().record, "best")


class ForwardModel(unittest.TestCase):
    def test_gravity_at_rest(self):
        np.testing.assert_allclose(abcal.specific_force(1, 0.0), [0, 0, 1], atol=1e-15)
        np.testing.assert_allclose(np.linalg.norm(abcal.specific_force(2, 35.0)), 1.0, atol=1e-15)
        with self.assertRaises(ValueError):
            abcal.specific_force(4, 0.0)

    def test_a_simulation_without_errors_is_the_forward_model(self):
        record = abcal.simulate(MATRIX, OFFSET, steps=12, noise=0.0).record
        for experiment, alpha, readings in zip(record.experiment, record.alpha_deg, record.readings):
            expected = MATRIX @ abcal.specific_force(int(experiment), alpha) + OFFSET
            np.testing.assert_allclose(readings, expected, atol=1e-12)

    def test_impossible_worlds(self):
        for wrong in (dict(steps=1), dict(noise=-1.0), dict(noise=np.nan), dict(angle_period_s=0.0), dict(wobble_urad=-1.0)):
            with self.assertRaises(ValueError):
                abcal.simulate(MATRIX, OFFSET, **wrong)
        with self.assertRaises(ValueError):
            abcal.simulate(np.zeros((3, 3)))


class Studies(unittest.TestCase):
    def test_any_number_of_threads_gives_the_same_bits(self):
        record = simulated(steps=12).record
        one = abcal.monte_carlo(record, 20000, threads=1)
        two = abcal.monte_carlo(record, 20000, threads=2)
        self.assertEqual(one.to_json(), two.to_json())
        self.assertEqual((one.covariance.matrix.shape, one.coverage_interval.shape), ((18, 18), (18, 2)))
        ratio = np.sqrt(np.diag(one.covariance.matrix))[:12] / np.sqrt(np.diag(abcal.analyse(record, "abc").covariance.matrix))
        self.assertLess(np.abs(ratio - 1.0).max(), 0.1)

    def test_python_goes_on_meanwhile(self):
        record, counted, done = simulated(steps=12).record, [], threading.Event()

        def count():
            while not done.is_set():
                counted.append(None)
                done.wait(0.001)

        counting = threading.Thread(target=count)
        counting.start()
        abcal.monte_carlo(record, 400000, threads=1)
        done.set()
        counting.join()
        self.assertGreater(len(counted), 3)

    def test_choices_out_of_range(self):
        with self.assertRaises(ValueError):
            abcal.monte_carlo(simulated(steps=12).record, 1)
        with self.assertRaises(ValueError):
            abcal.simulation_set("7")
        self.assertEqual(abcal.simulation_set("abc1", 10)["set"], "abc1")


class Plans(unittest.TestCase):
    def test_a_plan_reaches_what_is_wanted(self):
        with tempfile.TemporaryDirectory() as folder:
            bench = write_bench(pathlib.Path(folder) / "bench.toml")
            answer = abcal.predict(bench, 12, 100, estimator="abc")
            self.assertEqual((answer.steps, answer.estimator, set(answer.u)), (12, "abc", {"s", "off", "O", "phi"}))
            self.assertGreater(answer.duration_s, answer.moving_s)
            with self.assertRaisesRegex(ValueError, "noise"):
                abcal.predict(bench, 12, 100, noise=2.0)
            with self.assertRaises(RuntimeError):
                abcal.plan(pathlib.Path(folder) / "nothing.toml")


class Comparisons(unittest.TestCase):
    def test_two_runs_of_one_item_agree_and_another_item_does_not(self):
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            first = write_csv(simulated(seed=1).record, folder / "1.csv")
            second = write_csv(simulated(seed=2).record, folder / "2.csv")
            other = write_csv(abcal.simulate(1.01 * MATRIX, OFFSET, steps=24).record, folder / "3.csv")
            agreed = abcal.compare([first, second], estimator="abc")
            self.assertTrue(agreed.agree, agreed.why)
            self.assertEqual(agreed.to_dict(), json.loads(program("compare", first, second, "--estimator", "abc", "--json")))
            self.assertFalse(abcal.compare([first, other], estimator="abc").agree)
            with self.assertRaisesRegex(ValueError, "two at least"):
                abcal.compare([first])
            copied = pathlib.Path(shutil.copy(first, folder / "copy.csv"))
            with self.assertRaisesRegex(ValueError, r"1\.csv and .*copy\.csv hold the same measurement"):
                abcal.compare([first, second, copied])
            with self.assertRaisesRegex(ValueError, r"1\.csv is named twice"):
                abcal.compare([first, first])


class Stubs(unittest.TestCase):
    def test_they_name_what_there_is(self):
        tree = ast.parse((SOURCE / "app/library/python/abcal/__init__.pyi").read_text())
        stated = {node.name: node for node in tree.body if isinstance(node, (ast.ClassDef, ast.FunctionDef))}
        there = {name for name, what in vars(abcal).items() if not name.startswith("_") and not inspect.ismodule(what)}
        self.assertEqual(there, set(stated))
        for name, node in stated.items():
            if isinstance(node, ast.ClassDef) and name not in ("InstrumentError", "Stopped"):
                members = {m.name if isinstance(m, ast.FunctionDef) else m.target.id for m in node.body if not isinstance(m, ast.Expr)}
                found = {m for m in dir(getattr(abcal, name)) if not m.startswith("_")}
                self.assertEqual({m for m in members if not m.startswith("_")}, found, name)

    def test_everything_says_what_it_is(self):
        for name, what in vars(abcal).items():
            if not name.startswith("_") and (inspect.isclass(what) or inspect.isbuiltin(what)):
                self.assertTrue(what.__doc__, name)


if __name__ == "__main__":
    unittest.main()
