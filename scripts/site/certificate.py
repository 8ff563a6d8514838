"""The first page of an example certificate, docs/images/certificate.png, of a simulated run and a training register.

  scripts/docs --certificate ABCAL   makes the picture, and scripts/site/certificate.words beside it: the words of the page, each number as
                                     "#", and the SHA-256 of the picture
check.py compares the words with those of the program's page today, and the picture with its SHA-256.
"""

import hashlib
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs/images/certificate.png"
WORDS = ROOT / "scripts/site/certificate.words"
PROGRAMS = ["weasyprint", "pdftotext", "pdftoppm"]


def missing():
    return [program for program in PROGRAMS if shutil.which(program) is None]


def make_page(abcal, folder):
    """Issues the certificate below `folder`; its PDF."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("ABCAL_")}
    environment = plain | {"ABCAL_REGISTER": str(folder / "training.db"), "XDG_STATE_HOME": str(folder / "state")}
    (folder / "password").write_text("correct horse 7\n")
    (folder / "password").chmod(0o600)
    password = ["--password-file", "password"]
    example = ["run", ROOT / "docs/examples/simulated.toml", "-o", "example.run"]  # before there is a register
    for words in [
        example,
        ["lab", "init", "--training", "--laboratory", "Example laboratory", "--administrator", "Approver N. N.", *password],
        ["lab", "login", "Approver N. N.", *password],
        ["lab", "add", "person", "Operator N. N.", "--role", "technician", "--may", "measure", *password],
        ["issue", "example.run", "--laboratory", ROOT / "docs/examples/laboratory.toml", "--pdf", "example.pdf"],
    ]:
        subprocess.run([abcal, *words], cwd=folder, env=plain if words is example else environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    return folder / "example.pdf"


def words_of(pdf):
    text = subprocess.run(["pdftotext", "-l", "1", pdf, "-"], check=True, capture_output=True, text=True).stdout
    # Dates, hashes and what the trials of a certificate give differ from run to run.
    text = re.sub(r"\b[0-9a-f]{8,}\b", "#", text)
    return " ".join(re.sub(r"[−-]?[0-9]+([.,:][0-9]+)*", "#", text).split())


def digest():
    return hashlib.sha256(PICTURE.read_bytes()).hexdigest()


def problems(abcal):
    """Why the picture is not this program's; empty: it is."""
    kept, of_picture = WORDS.read_text().splitlines()
    found = [] if of_picture == digest() else ["docs/images/certificate.png: is not the picture that its script made"]
    with tempfile.TemporaryDirectory() as folder:
        if words_of(make_page(abcal, pathlib.Path(folder))) != kept:
            found.append("docs/images/certificate.png: the program's page has other words")
    return [f"{problem}; required: scripts/docs --certificate ABCAL" for problem in found]


def main():
    if len(sys.argv) != 2 or missing():
        sys.exit(f"usage: scripts/docs --certificate ABCAL; required: {', '.join(PROGRAMS)}")
    with tempfile.TemporaryDirectory() as folder:
        pdf = make_page(pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(folder))
        subprocess.run(["pdftoppm", "-r", "80", "-png", "-singlefile", "-l", "1", pdf, PICTURE.with_suffix("")], check=True)
        WORDS.write_text(f"{words_of(pdf)}\n{digest()}\n")


if __name__ == "__main__":
    main()
