#!/usr/bin/env python3
"""docs/instruments.md, made of what the program and the other pages say already: its drivers (`abcal instruments --json`), the
connections of each driver's page, the host programs of docs/conformance.md, and the marks [unverified against a device].

    scripts/site/instruments.py ABCAL > docs/instruments.md
"""
import json
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
MARK = re.compile(r"\[?unverified\s+against\s+a\s+device\]?", re.IGNORECASE)
INTRODUCTION = 7  # lines
EVERYTHING = re.compile(r"(All|everything\s+here\s+is)\s+\[unverified\s+against\s+a\s+device\]")
KINDS = (
    ("Stages", "stage_drivers"),
    ("Accelerometers, and voltmeters for analog accelerometers", "accelerometer_drivers"),
    ("Thermal chambers", "chamber_drivers"),
)


def page_of(driver):
    """The page of a driver: its own, or the one that calls it `driver`."""
    own = DOCS / "drivers" / f"{driver}.md"
    if own.exists():
        return own
    naming = [page for page in sorted((DOCS / "drivers").glob("*.md")) if f"`{driver}`" in page.read_text()]
    if not naming:
        sys.exit(f"instruments.py: the driver {driver} has no page; required: docs/drivers/{driver}.md")
    return naming[0]


def connections(page):
    """The first column of the table whose second one is the port."""
    lines = page.read_text().splitlines()
    for number, line in enumerate(lines):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|") or len(cells) < 2 or not cells[1].startswith("`port`"):
            continue
        found = []
        for row in lines[number + 2:]:
            if not row.startswith("|"):
                break
            name, port = [cell.strip() for cell in row.strip("|").split("|")][:2]
            if port != "none":
                found.append(name)
        return "; ".join(found)
    sys.exit(f"instruments.py: {page.relative_to(ROOT)} has no table of connections with a column `port`")


def tried_with():
    """driver -> the host programs that passed with its emulated instrument."""
    programs = {}
    for line in (DOCS / "conformance.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|") or len(cells) < 4:
            continue
        program = re.split(r",| of | over |\(| 0\.| \d", cells[0], maxsplit=1)[0].strip()
        for driver in re.findall(r"`([a-z0-9_]+)`", cells[1]):
            programs.setdefault(driver, []).append(program)
    return programs


def unverified(pages):
    """What the marks of the pages of a driver and its protocol cover."""
    page, *protocols = pages
    if MARK.search("\n".join(page.read_text().splitlines()[:INTRODUCTION])) or any(EVERYTHING.search(each.read_text()) for each in protocols):
        return "everything"
    marks = sum(len(MARK.findall(each.read_text())) for each in pages)
    return f"{marks} fact{'' if marks == 1 else 's'}" if marks else "no fact is marked"


def protocols_of(page):
    text = page.read_text()
    return [page.parent / name for name in re.findall(r"\]\((\.\./protocols/[a-z0-9_]+\.md)", text)]


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: scripts/site/instruments.py ABCAL")
    known = json.loads(subprocess.run([sys.argv[1], "instruments", "--json"], check=True, capture_output=True, text=True).stdout)
    programs = tried_with()
    out = ["# Supported instruments", "",
           "Each row is a driver: the name that a bench file gives as `driver`. `abcal instruments` prints the same list; with `--probe` it finds out which instrument",
           "is on which port. An instrument that is not here may still speak one of these protocols, and any board that prints its readings",
           "as text works with [`text_line`](drivers/text_line.md). How to write a driver: [adding a driver](adding_a_driver.md).", "",
           "**No driver has met a real instrument yet.** Each is tested against simulated firmware that is written independently of the driver.",
           "The column *tried with* names host programs of others that work with that firmware ([which versions](conformance.md)). *Unverified* tells how many",
           "facts on the pages of driver and protocol are marked so, because no public trace or source shows them. Run `abcal check` before the first run with yours.", ""]
    paged = set()
    for title, key in KINDS:
        out += [f"## {title}", "", "| driver | maker and models | interface | tried with | unverified |", "|---|---|---|---|---|"]
        for driver in known[key]:
            name = driver["name"]
            page = page_of(name)
            paged.add(page.name)
            out.append(f"| [`{name}`](drivers/{page.name}) | {driver['description']} | {connections(page)} | "
                       f"{', '.join(programs.get(name, [])) or 'simulated firmware only'} | {unverified([page, *protocols_of(page)])} |")
        out.append("")
    others = [page for page in sorted((DOCS / "drivers").glob("*.md")) if page.name not in paged]
    out += ["## Without a driver of one instrument", "", "| page | about |", "|---|---|"]
    for page in others:
        heading = page.read_text().splitlines()[0].removeprefix("# ")
        out.append(f"| [{page.stem}](drivers/{page.name}) | {heading} |")
    out += ["", "Without instruments: `port = \"simulated\"` with any driver of a stage or an accelerometer, or `abcal emulate` ([emulated instruments](emulate.md)).", ""]
    print("\n".join(out), end="")


main()
