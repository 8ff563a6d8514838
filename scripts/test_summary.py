"""Counts what the test programs did, from the JSON that each wrote, and names what was skipped, with the reason.

    test_summary.py FOLDER
"""

import json
import pathlib
import sys


def main(folder):
    done = failed = 0
    skipped = []
    for path in sorted(pathlib.Path(folder).glob("*.json")):
        for suite in json.loads(path.read_text(encoding="utf-8"))["testsuites"]:
            for test in suite["testsuite"]:
                if test.get("result") == "SUPPRESSED" or test.get("status") == "NOTRUN":
                    continue  # another process of the same program runs it
                if test.get("result") == "SKIPPED":
                    reasons = [each.get("message", "").strip() for each in test.get("skipped", [])]
                    skipped.append((f"{suite['name']}.{test['name']}", " ".join(reasons)))
                elif test.get("failures"):
                    failed += 1
                else:
                    done += 1
    for name, reason in skipped:
        print(f"skipped: {name}{': ' + reason if reason else ''}")
    print(f"Single tests: {done} passed, {failed} failed, {len(skipped)} skipped")


if __name__ == "__main__":
    main(sys.argv[1])
