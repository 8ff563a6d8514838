#!/usr/bin/env python3
"""Whether what the pages show is what this program prints.

    scripts/site/check.py ABCAL

A sample is a block of README.md or docs/ whose first line begins with "$ ". The samples of a page run in its order, in one empty
folder, each line by a shell, with those below it that begin with "> "; what a command prints on either stream is compared with the lines below it:
  - "..." alone stands for any number of lines, and at the end of a line for the rest of that line;
  - hashes (64 hexadecimal digits), dates with their times, and the folder of the samples are replaced on both sides.
Everything else must be equal, every digit too. In commands the examples are those of the sources.

A comment "<!-- sample not made again: REASON -->" before a block exempts it, and is listed. Every other block without a language
consists of commands alone; "text" is the language of what is neither. Generated pages and pictures are looked at as well.
"""
import os
import pathlib
import re
import subprocess
import sys
import tempfile

import certificate

ROOT = pathlib.Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
EXEMPT = re.compile(r"<!-- sample not made again: (.+) -->")
# First words of lines that are commands. An indented line continues the one above.
COMMANDS = re.compile(r"( +\S|#|abcal |sudo |cmake |ninja |ctest |scripts/|build/|cp |cd |mkdir |echo |sed |export |unset |openssl |xmlsec1 |xmllint |java "
                      r"|sqlite3 |journalctl |systemctl |GTEST_OUTPUT=|\S*abcal-witness )")
# Pictures are made by scripts, and two browsers or fonts never draw one alike to the bit: no comparison says that one is stale.
PICTURES = {
    "console-*.png": "cmake --build build/release --target console_screenshots",
    "temperature.png": "a page of the PDF of `abcal temperature`",
    "demo.svg": "scripts/docs --recordings",
    "init.svg": "scripts/docs --recordings",
    "interrupted.svg": "scripts/docs --recordings",
}
LONGEST_S = 60
PROGRESS = re.compile(r"\w+: +\d+ %, .+ left")


class Block:
    def __init__(self, line, language, lines, exempt):
        self.line, self.language, self.lines, self.exempt = line, language, lines, exempt

    def is_sample(self):
        return self.language == "" and self.lines and self.lines[0].startswith("$ ")

    def steps(self):
        """(command, lines that it prints)"""
        steps = []
        for line in self.lines:
            if line.startswith("$ "):
                steps.append((line[2:], []))
            elif line.startswith("> ") and not steps[-1][1]:
                steps[-1] = (f"{steps[-1][0]}\n{line[2:]}", [])
            else:
                steps[-1][1].append(line)
        return steps


def blocks_of(text):
    """The blocks of a page, those in items of lists too, without their indentation; and indented ones that begin with "$ "."""
    blocks, exempt = [], None
    lines = text.splitlines()
    at = 0
    while at < len(lines):
        fence = re.match(r"( *)```(\S*)$", lines[at])
        comment = EXEMPT.match(lines[at])
        if comment:
            exempt = comment[1]
        elif fence:
            begin, indent = at, len(fence[1])
            at += 1
            while at < len(lines) and lines[at].strip() != "```":
                at += 1
            blocks.append(Block(begin + 1, fence[2], [line[indent:] for line in lines[begin + 1:at]], exempt))
            exempt = None
        elif re.match(r"    \$ ", lines[at]):
            begin = at
            while at + 1 < len(lines) and lines[at + 1].startswith("    "):
                at += 1
            blocks.append(Block(begin + 1, "indented", [line[4:] for line in lines[begin:at + 1]], exempt))
            exempt = None
        elif lines[at].strip():
            exempt = None
        at += 1
    return blocks


def without_what_varies(line, folder):
    line = line.replace(str(folder), ".").rstrip()
    line = re.sub(r"\b[0-9a-f]{64}\b", "SHA256", line)
    return re.sub(r"\b20\d\d-?\d\d-?\d\d([T ]\d\d:?\d\d(:?\d\d)?(\.\d+)?Z?)?", "DATE", line)


def difference(expected, found):
    """The first expected line that is not there, or the first line that is not expected; None: they agree."""
    at, free = 0, False
    for line in expected:
        if line.strip() == "...":
            free = True
            continue
        prefix = line.removesuffix(" ...") if line.endswith(" ...") else None
        fits = [k for k in range(at, len(found)) if (found[k] == line if prefix is None else found[k].startswith(prefix))]
        if not fits or (not free and fits[0] != at):
            return f'the page has "{line}", the program prints "{found[at] if at < len(found) else "nothing more"}"'
        at, free = fits[0] + 1, False
    if not free and at < len(found):
        return f'the program also prints "{found[at]}"'
    return None


def run_samples(page, samples, abcal):
    problems = []
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name).resolve()
        (folder / "bin").mkdir()
        (folder / "bin/abcal").symlink_to(abcal)
        (folder / "work").mkdir()
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("ABCAL_", "DISPLAY", "WAYLAND"))}
        environment = {**kept, "PATH": f"{folder}/bin:{os.environ['PATH']}", "HOME": name, "XDG_STATE_HOME": f"{name}/state", "LC_ALL": "C.UTF-8"}
        for block in samples:
            for command, printed in block.steps():
                told = command.replace("/usr/share/doc/abcal/examples", str(DOCS / "examples"))
                try:
                    result = subprocess.run(["sh", "-c", f"{told}"], cwd=folder / "work", env=environment, timeout=LONGEST_S,
                                            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
                except subprocess.TimeoutExpired:
                    problems.append(f"{page}:{block.line}: $ {command}: takes more than {LONGEST_S} s")
                    continue
                expected = [without_what_varies(line, folder / "work") for line in printed]
                # How long a command takes is no part of a sample.
                found = [without_what_varies(line, folder / "work") for line in result.stdout.splitlines() if not PROGRESS.fullmatch(line)]
                problem = difference(expected, found)
                if result.returncode not in (0, 1) or problem:
                    problems.append(f"{page}:{block.line}: $ {command}: {problem or f'exit code {result.returncode}: ' + ' '.join(found[-3:])}")
    return problems


def check_samples(abcal):
    problems, exempt, count = [], [], 0
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]:
        page = path.relative_to(ROOT)
        samples = []
        for block in blocks_of(path.read_text()):
            if block.exempt:
                exempt.append(f"{page}:{block.line}: {block.exempt}")
            elif block.language == "indented":
                if any(not line.startswith(("$ ", "  ")) for line in block.lines):
                    problems.append(f"{page}:{block.line}: shows output in an indented block; required: a fenced one")
            elif block.is_sample():
                samples.append(block)
            elif block.language == "" and page.name == "README.md" and block.lines[0].startswith("Result:"):
                exempt.append(f"{page}:{block.line}: a demo measures in real time, and its noise differs each time; DemoTest runs it")
            elif block.language == "" and not all(COMMANDS.match(line) for line in block.lines if line):
                problems.append(f"{page}:{block.line}: a block without a language that is neither commands nor a sample; required: a first line "
                                'that begins with "$ ", or the language "text"')
        count += sum(len(block.steps()) for block in samples)
        problems += run_samples(page, samples, abcal)
    for line in exempt:
        print(f"not made again: {line}")
    print(f"{count} commands of samples made again")
    return problems


def without_rounding_errors(text):
    """Numbers below 1e-12 of the paper's tables are rounding errors of the processor."""
    return re.sub(r"[+-]?\b\d\.\d+e-(1[2-9]|[2-9]\d)", "ROUNDING", text)


def check_generated(abcal):
    problems = []
    made = subprocess.run([sys.executable, ROOT / "scripts/site/instruments.py", abcal], check=True, capture_output=True, text=True).stdout
    if made != (DOCS / "instruments.md").read_text():
        problems.append("docs/instruments.md: is not what its script makes; required: scripts/site/instruments.py ABCAL > docs/instruments.md")
    with tempfile.TemporaryDirectory() as folder:
        page = pathlib.Path(folder) / "reproduction.md"
        subprocess.run([ROOT / "scripts/reproduction", abcal, page], check=True, stdout=subprocess.DEVNULL)
        if without_rounding_errors(page.read_text()) != without_rounding_errors((DOCS / "reproduction.md").read_text()):
            problems.append("docs/reproduction.md: is not what its script makes; required: scripts/reproduction ABCAL")
    print("2 generated pages made again (docs/bench_file.md and docs/validation.md: key_reference_test, self_test_test)")
    return problems


def check_pictures(abcal):
    problems = []
    if certificate.missing():
        print(f"not compared: docs/images/certificate.png: {', '.join(certificate.missing())} not installed")
    else:
        problems += certificate.problems(abcal)
    shown = "".join(path.read_text() for path in [ROOT / "README.md", *DOCS.rglob("*.md")])
    for picture in sorted((DOCS / "images").iterdir()):
        if f"images/{picture.name})" not in shown:
            problems.append(f"docs/images/{picture.name}: no page shows it")
        made_by = [command for pattern, command in PICTURES.items() if picture.match(pattern)]
        if not made_by and picture != certificate.PICTURE:
            problems.append(f"docs/images/{picture.name}: nothing is known to make it; required: a line of PICTURES in scripts/site/check.py")
        for command in made_by:
            print(f"not compared: docs/images/{picture.name}: made by {command}")
    return problems


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: scripts/site/check.py ABCAL")
    abcal = pathlib.Path(sys.argv[1]).resolve()
    if not abcal.exists():
        sys.exit(f"check.py: {abcal} does not exist; required: a built abcal (scripts/build)")
    problems = check_samples(abcal) + check_generated(abcal) + check_pictures(abcal)
    for problem in problems:
        print(problem, file=sys.stderr)
    sys.exit(1 if problems else 0)


main()
