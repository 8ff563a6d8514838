"""Counts what the tests did, and names what was skipped, with the reason. In CI (the variable CI is "true") a test that was skipped
for a reason that tests/allowed_skips does not list is a failure: exit code 1.

    test_summary.py FOLDER    with the XML that each test program wrote; in FOLDER/ctest that of ctest
"""

import os
import pathlib
import re
import sys
import xml.etree.ElementTree as ElementTree

ALLOWED = pathlib.Path(__file__).resolve().parents[1] / "tests/allowed_skips"
SKIPPED_BY_UNITTEST = re.compile(r"\.\.\. skipped '(.*)'$", re.M)


def tests_of_programs(folder):
    """(name, whether it passed, reason of a skip or None) of each single test."""
    for path in sorted(folder.glob("*.xml")):
        for test in ElementTree.parse(path).iter("testcase"):
            if test.get("result") == "suppressed" or test.get("status") == "notrun":
                continue  # another process of the same program runs it
            # The first line of a reason is the place in the source.
            reasons = [" ".join(each.get("message", "").split("\n")[1:]).strip() for each in test.findall("skipped")]
            yield f"{test.get('classname')}.{test.get('name')}", test.find("failure") is None, " ".join(reasons) if reasons else None


def skips_of_ctest(folder):
    """(name, reason) of each test of ctest that was skipped: Python's reasons, or the last line that it printed."""
    for path in sorted(folder.glob("*.xml")):
        for test in ElementTree.parse(path).iter("testcase"):
            if test.find("skipped") is None:
                continue
            printed = test.findtext("system-out") or ""
            lines = [line.strip() for line in printed.splitlines() if line.strip()]
            for reason in SKIPPED_BY_UNITTEST.findall(printed) or lines[-1:] or [test.find("skipped").get("message", "")]:
                yield test.get("name"), reason


def is_allowed(reason, allowed):
    return any(re.fullmatch(".*".join(map(re.escape, line.split("*"))), reason) for line in allowed)


def main(folder):
    folder = pathlib.Path(folder)
    tests = list(tests_of_programs(folder))
    skips = [(name, reason) for name, _, reason in tests if reason is not None]
    of_ctest = list(skips_of_ctest(folder / "ctest"))
    allowed = [line for line in ALLOWED.read_text().splitlines() if line and not line.startswith("#")]
    required = 0
    for name, reason in skips + of_ctest:
        listed = is_allowed(reason, allowed)
        required += not listed
        print(f"skipped: {name}: {reason or 'no reason'}{'' if listed else ' (tests/allowed_skips does not list this reason)'}")
    ran = [passed for _, passed, reason in tests if reason is None]
    print(f"Single tests: {sum(ran)} passed, {len(ran) - sum(ran)} failed, {len(skips)} skipped; skipped tests of ctest: {len(of_ctest)}")
    if required > 0 and os.environ.get("CI") == "true":
        sys.exit(f"test_summary.py: {required} tests did not run that must run in CI")


if __name__ == "__main__":
    main(sys.argv[1])
