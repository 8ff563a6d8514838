"""Verifies by coverage that the tests of each requirement execute the code that fulfils it.

    requirements_coverage.py BUILD [-j N] [--quick] [--only WORD]

BUILD was made with the preset coverage. Requirements, code and tests are those of docs/validation.md. Each test is
run alone, with all of its instances, and the programs that it starts are counted too. Required: each test executes
one of the functions or files of its requirement, and each of these is executed by one of the tests. Whether a test
passes is the subject of scripts/test; a test that fails or is skipped here is listed.

    --quick      leaves out the tests whose names begin with Long
    --only WORD  the requirements whose words, code or tests contain WORD
"""

import argparse
import collections
import concurrent.futures
import gzip
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
Requirement = collections.namedtuple("Requirement", "words code tests")


def requirements():
    """The rows of docs/validation.md that name code."""
    rows = []
    for line in (ROOT / "docs/validation.md").read_text().splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 4 and "`" in cells[3]:
            row = Requirement(cells[0], re.findall("`([^`]+)`", cells[2]), re.findall("`([^`]+)`", cells[3]))
            if row.code:
                rows.append(row)
    return rows


def sources():
    """All sources but those of the library for other programs, whose functions have the names of what they call."""
    return {str(path.relative_to(ROOT)): path.read_text()
            for top in ("app", "drivers", "protocol", "sim") for path in (ROOT / top).rglob("*.cc")
            if "app/library" not in str(path)}


def files_of(code, texts):
    """The source files of an entry: those that match a path, or that define a function on a line that is not
    indented."""
    if "/" in code:
        return [str(path.relative_to(ROOT)) for path in sorted(ROOT.glob(code))]
    definition = re.compile(rf"^(?=\w)(?:[^\n]*[^\w:\n])?{re.escape(code)}\((?![^\n]*;$)", re.MULTILINE)
    return [name for name, text in texts.items() if definition.search(text)]


def is_function(demangled, code):
    """Whether the name of a function, with its arguments, is that of an entry ("analyse_joint", "RunFile::load")."""
    name = demangled.replace("(anonymous namespace)::", "").replace("[abi:cxx11]", "")
    return re.search(rf"(?:^|[\s:*&]){re.escape(code)}(?:<[^()]*>)?\(", name) is not None


def instances(build):
    """The programs of the tests and the full names of their instances, by "Suite.Name"."""
    found = collections.defaultdict(lambda: collections.defaultdict(list))
    for program in sorted(build.glob("tests/**/*_test")):
        if not program.is_file() or not os.access(program, os.X_OK):
            continue
        listed = subprocess.run([program, "--gtest_list_tests"], capture_output=True, text=True, cwd=program.parent)
        suite = ""
        for line in listed.stdout.splitlines():
            line = line.split("#")[0].rstrip()
            if line.endswith(".") and not line.startswith(" "):
                suite = line
            elif line.startswith("  ") and suite:
                name = line.strip()
                plain_suite = suite[:-1].split("/")
                # "Instance/Suite/3." has an instance before and a type or a number behind its suite.
                plain = plain_suite[0] if len(plain_suite) == 1 else plain_suite[1]
                found[f"{plain}.{name.split('/')[0]}"][program].append(suite + name)
    return found


class Coverage:
    """The functions that one run of a test executed, in the source files that matter."""

    def __init__(self, build, names):
        # Object files are found by the name of their source, which gcov confirms.
        self.notes = collections.defaultdict(list)
        wanted = {pathlib.Path(name).name for name in names}
        for note in build.glob("**/*.gcno"):
            source = note.name.removesuffix(".gcno").removesuffix(".o")
            if source in wanted:
                self.notes[source].append(note)

    def executed(self, counters, name):
        """The functions of a source file that were executed, by their names with arguments."""
        functions = set()
        for note in self.notes[pathlib.Path(name).name]:
            data = counters / note.relative_to("/").with_suffix(".gcda")
            if not data.exists():
                continue
            beside = data.with_suffix(".gcno")
            if not beside.exists():
                beside.symlink_to(note)
            with tempfile.TemporaryDirectory() as folder:
                subprocess.run(["gcov", "--json-format", "--demangled-names", str(data)], cwd=folder, check=True,
                               capture_output=True)
                for report in pathlib.Path(folder).glob("*.gcov.json.gz"):
                    with gzip.open(report, "rt") as text:
                        functions |= self.functions_of(json.load(text), name)
        return functions

    @staticmethod
    def functions_of(report, name):
        here = pathlib.Path(report["current_working_directory"])
        wanted = ROOT / name
        return {function["demangled_name"] for file in report["files"]
                if pathlib.Path(os.path.normpath(here / file["file"])).resolve() == wanted
                for function in file["functions"] if function["execution_count"] > 0}


def run_test(test, programs, folder):
    """Runs a test with its counters in a folder. Returns what is to be said about its outcome."""
    environment = dict(os.environ, GCOV_PREFIX=str(folder))
    said = []
    for program, names in programs.items():
        result = folder / "result.json"
        run = subprocess.run([program, "--gtest_filter=" + ":".join(names), f"--gtest_output=json:{result}"],
                             capture_output=True, env=environment, cwd=program.parent)
        if run.returncode != 0:
            said.append(f"{test}: fails here")
        elif result.exists():
            outcomes = {one.get("result") for suite in json.loads(result.read_text()).get("testsuites", [])
                        for one in suite.get("testsuite", [])}
            if outcomes == {"SKIPPED"}:
                said.append(f"{test}: skipped")
    return said


def examine(test, programs, entries, coverage):
    """Returns the entries that a test executes, and what is to be said about its outcome."""
    with tempfile.TemporaryDirectory(prefix="abcal-coverage-") as folder:
        counters = pathlib.Path(folder)
        said = run_test(test, programs, counters)
        executed = set()
        for code, names in entries.items():
            for name in names:
                functions = coverage.executed(counters, name)
                if any("/" in code or is_function(function, code) for function in functions):
                    executed.add((code, name))
        return executed, said


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("-j", type=int, default=os.cpu_count())
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    build = asked.build.resolve()
    texts = sources()
    rows = [row for row in requirements() if asked.only in " ".join([row.words, *row.code, *row.tests])]
    entries = {code: files_of(code, texts) for row in rows for code in row.code}
    problems = [f"{code}: no source file defines it" for code, names in entries.items() if not names]
    found = instances(build)
    coverage = Coverage(build, {name for names in entries.values() for name in names})
    tests = {test: {} for row in rows for test in row.tests if not (asked.quick and test.startswith("Long"))}
    for row in rows:
        for test in row.tests:
            if test in tests:
                tests[test].update({code: entries[code] for code in row.code})
    for test in [test for test in tests if test not in found]:
        problems.append(f"{test}: no program of {build} has it")
        del tests[test]
    executed = {}
    with concurrent.futures.ThreadPoolExecutor(asked.j) as pool:
        running = {pool.submit(examine, test, found[test], code, coverage): test for test, code in tests.items()}
        for done in concurrent.futures.as_completed(running):
            test = running[done]
            executed[test], said = done.result()
            for words in said:
                print(words, flush=True)
            print(f"{test}: {', '.join(sorted({code for code, _ in executed[test]})) or 'none of its code'}", flush=True)
    for row in rows:
        of_row = {place for test in row.tests for place in executed.get(test, set()) if place[0] in row.code}
        for test in row.tests:
            if test in executed and not any(code in row.code for code, _ in executed[test]):
                problems.append(f"{row.words}: {test} executes none of {', '.join(row.code)}")
        for code in row.code:
            problems += [f"{row.words}: no test executes {code}" + (f" ({name})" if "/" in code else "")
                         for name in entries[code] if (code, name) not in of_row]
    for problem in problems:
        print(f"PROBLEM {problem}")
    print(f"{len(rows)} requirements, {len(executed)} tests: {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
