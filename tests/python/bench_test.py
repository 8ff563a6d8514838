"""Runs from Python: callbacks, halts, Ctrl-C, resuming, the asynchronous iterator, certificates."""

import asyncio
import os
import pathlib
import signal
import subprocess
import tempfile
import tomllib
import unittest

import numpy as np

import abcal
from support import PROGRAM, SOURCE, write_bench


class Runs(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.run_file = self.folder / "a.run"
        self.bench = abcal.Bench(write_bench(self.folder / "bench.toml"))

    def stopped_by(self, action):
        """A run that stands still at its first angle, and what `action` does there."""

        def callback(event):
            if event["event"] == "run_began":
                self.bench.hold()
            if event["event"] == "held":
                action()

        self.bench.run(self.run_file, callback=callback)

    def test_a_run_with_a_callback(self):
        names = []
        run = self.bench.run(self.run_file, callback=lambda event: names.append(event["event"]))
        self.assertEqual(names[0], "run_began")
        self.assertEqual(names[-1], "finished")
        self.assertEqual(names.count("dwell_done"), 3 * 13 + 8)
        self.assertEqual(run.file, self.run_file)
        self.assertEqual([r.estimator for r in run.all_results][0], run.result.estimator)
        self.assertEqual(run.result.to_dict(), abcal.analyse(abcal.load(run.file)).to_dict())
        verified = subprocess.run([PROGRAM, "verify", run.file], capture_output=True)
        self.assertEqual(verified.returncode, 0, verified.stdout)

    def test_the_demo_is_that_of_the_program_without_its_console(self):
        elsewhere = self.folder / "elsewhere"
        elsewhere.mkdir()
        before = os.getcwd()
        self.addCleanup(os.chdir, before)
        os.chdir(elsewhere)
        result = abcal.demo(steps=24)
        self.assertEqual((result.estimator, result.verdict), ("joint", "usable"), result.why)
        self.assertEqual(list(elsewhere.iterdir()), [])
        # The emulator draws non-linearity and alignment; the angles between the outputs are those of the file.
        truth = tomllib.loads((SOURCE / "docs/examples/emulated.toml").read_text())["simulation"]
        def cosines(matrix):
            rows = np.array(matrix) / np.linalg.norm(matrix, axis=1, keepdims=True)
            return rows @ rows.T
        self.assertLess(np.abs(cosines(result.sensitivity_matrix.value) - cosines(truth["sensitivity_matrix"])).max(), 3e-4)
        with self.assertRaisesRegex(ValueError, "found 7; required: a divisor of 360"):
            abcal.demo(steps=7)
        os.environ["ABCAL_REGISTER"] = str(elsewhere / "register.db")
        self.addCleanup(os.environ.pop, "ABCAL_REGISTER", None)
        with self.assertRaisesRegex(ValueError, "register that ABCAL_REGISTER names"):
            abcal.demo()

    def test_an_exception_of_the_callback_halts_and_the_run_resumes(self):
        def fail():
            raise LookupError("as the test wants")

        with self.assertRaisesRegex(LookupError, "as the test wants"):
            self.stopped_by(fail)
        state = subprocess.run([PROGRAM, "analyse", self.run_file], capture_output=True, text=True)
        self.assertIn("This run is interrupted", state.stdout)
        resumed = self.bench.resume(self.run_file)
        whole = abcal.Bench(self.folder / "bench.toml").run(self.folder / "b.run")
        self.assertEqual(len(abcal.load(resumed.file)), len(abcal.load(whole.file)))

    def test_ctrl_c_halts(self):
        with self.assertRaises(KeyboardInterrupt):
            self.stopped_by(lambda: signal.raise_signal(signal.SIGINT))
        self.assertEqual(self.bench.resume(self.run_file).file, self.run_file)

    def test_halt_is_an_exception_of_its_own(self):
        with self.assertRaises(abcal.Stopped):
            self.stopped_by(self.bench.halt)

    def test_a_hold_ends(self):
        self.stopped_by(self.bench.go_on)
        self.assertEqual(abcal.load(self.run_file).response_unit, "g")

    def test_one_run_at_a_time(self):
        problems = []

        def start_another():
            try:
                self.bench.run(self.folder / "b.run")
            except RuntimeError as error:
                problems.append(str(error))
            self.bench.go_on()

        self.stopped_by(start_another)
        self.assertEqual(len(problems), 1)
        self.assertIn("is under way; required: its end, or halt()", problems[0])

    def test_a_file_that_exists_is_refused_and_a_closed_run_is_not_written_to(self):
        self.bench.run(self.run_file)
        before = self.run_file.read_bytes()
        with self.assertRaisesRegex(RuntimeError, "exists"):
            self.bench.run(self.run_file)
        try:
            self.bench.resume(self.run_file)
        except RuntimeError as error:
            self.assertIn("complete", str(error))
        self.assertEqual(self.run_file.read_bytes(), before)

    def test_dwells_one_by_one(self):
        async def measure():
            return [dwell async for dwell in self.bench.dwells(self.run_file)]

        dwells = asyncio.run(measure())
        self.assertEqual(len(dwells), 3 * 13 + 8)
        self.assertEqual([dwell["position"] for dwell in dwells], list(range(len(dwells))))

    def test_leaving_the_loop_halts(self):
        async def measure():
            dwells = self.bench.dwells(self.run_file)
            async for dwell in dwells:
                self.bench.hold()
                break
            await dwells.aclose()

        asyncio.run(measure())
        self.bench.halt()  # Nothing runs any more.
        state = subprocess.run([PROGRAM, "analyse", self.run_file], capture_output=True, text=True)
        if "This run is interrupted" in state.stdout:  # A fast machine may have measured all of it before.
            self.bench.resume(self.run_file)
        self.assertEqual(len(abcal.load(self.run_file)), 3 * 13)

    def test_an_error_comes_out_of_the_loop(self):
        async def measure():
            async for _ in self.bench.dwells("/nowhere/at/all.run"):
                pass

        with self.assertRaises(RuntimeError):
            asyncio.run(measure())

    def test_check(self):
        findings = self.bench.check()
        self.assertIn("stage", [finding.what for finding in findings])
        self.assertNotIn("problem", [finding.grade for finding in findings], [f.found for f in findings])

    def test_a_draft_certificate_is_read_again(self):
        run = self.bench.run(self.run_file)
        path = self.folder / "draft.xml"
        path.write_text(abcal.certificate_xml(run.file, SOURCE / "docs/examples/laboratory.toml"))
        certificate = abcal.Certificate(path)
        self.assertEqual(certificate.serial_number, "6284.123456")
        self.assertTrue(certificate.number.startswith("DRAFT"), certificate.number)
        self.assertEqual(certificate.intrinsic.labels, run.result.covariance_intrinsic.labels)
        self.assertTrue(abcal.compare([run.file, path]).agree)
        with self.assertRaisesRegex(RuntimeError, "laboratory.toml: line 1: "):
            abcal.Certificate(SOURCE / "docs/examples/laboratory.toml")


class WrongBenches(unittest.TestCase):
    def test_every_problem_is_told(self):
        with tempfile.TemporaryDirectory() as folder:
            path = write_bench(pathlib.Path(folder) / "bench.toml")
            path.write_text(path.read_text().replace('driver = "pi_gcs"', 'driver = "pi_gsc"').replace("steps = 12", "steps = 0"))
            with self.assertRaises(RuntimeError) as raised:
                abcal.Bench(path)
        self.assertIn("pi_gsc", str(raised.exception))
        self.assertIn("steps", str(raised.exception))

    def test_an_instrument_that_cannot_be_opened(self):
        with tempfile.TemporaryDirectory() as folder:
            path = write_bench(pathlib.Path(folder) / "bench.toml")
            path.write_text(path.read_text().replace('port = "simulated"', f'port = "{folder}/no_port"', 1))
            with self.assertRaisesRegex(abcal.InstrumentError, "no_port"):
                abcal.Bench(path).run(pathlib.Path(folder) / "a.run")

    def test_drivers(self):
        self.assertIn("pi_gcs", abcal.stage_drivers())
        self.assertIn("microstrain_mip", abcal.accelerometer_drivers())


if __name__ == "__main__":
    unittest.main()
