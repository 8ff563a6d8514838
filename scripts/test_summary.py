"""Counts what the test programs did, from the XML that each wrote, and names what was skipped, with the reason.

    test_summary.py FOLDER
"""

import pathlib
import sys
import xml.etree.ElementTree as ElementTree


def main(folder):
    done = failed = 0
    skipped = []
    for path in sorted(pathlib.Path(folder).glob("*.xml")):
        for test in ElementTree.parse(path).iter("testcase"):
            if test.get("result") == "suppressed" or test.get("status") == "notrun":
                continue  # another process of the same program runs it
            skips = test.findall("skipped")
            if skips:
                # The first line of a reason is the place in the source.
                reasons = [" ".join(each.get("message", "").split("\n")[1:]).strip() for each in skips]
                skipped.append((f"{test.get('classname')}.{test.get('name')}", " ".join(reasons)))
            elif test.find("failure") is not None:
                failed += 1
            else:
                done += 1
    for name, reason in skipped:
        print(f"skipped: {name}{': ' + reason if reason else ''}")
    print(f"Single tests: {done} passed, {failed} failed, {len(skipped)} skipped")


if __name__ == "__main__":
    main(sys.argv[1])
