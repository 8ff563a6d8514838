"""Executes the notebooks of docs/notebooks as a reader would, and compares what they print with the outputs that stand in them.

run_notebooks.py [--keep | FOLDER]
--keep: writes the outputs into the notebooks. FOLDER: where the executed notebooks and their pictures go, to be looked at.
"""

import base64
import os
import pathlib
import re
import sys

try:
    import ipykernel  # noqa: F401
    import matplotlib  # noqa: F401
    import nbclient
    import nbformat
except ImportError as missing:
    print(f"skipped: {missing.name} is not installed (python3-nbclient, python3-ipykernel, python3-matplotlib)")
    sys.exit(77)

os.environ.setdefault("MPLBACKEND", "module://matplotlib_inline.backend_inline")
folder = pathlib.Path(os.environ["ABCAL_SOURCE"]) / "docs/notebooks"


def without_particulars(notebook):
    """Without times, and without metadata that differ from one Jupyter to the next."""
    for cell in notebook.cells:
        cell.metadata.clear()
        for output in cell.get("outputs", []):
            output.pop("metadata", None)
            if "data" in output:
                output["metadata"] = {}
    notebook.metadata["language_info"] = {"name": "python"}
    return notebook


def shown(cell):
    """The outputs of a cell, but for pictures: matplotlib of another release draws other ones."""
    parts, streamed = [], False
    for output in cell.get("outputs", []):
        if output.output_type == "stream":
            parts.append("".join([parts.pop() if streamed else "", output.text]))
        elif output.output_type == "error":
            parts.append("\n".join(output.traceback))
        else:
            data = output.data
            parts.append("picture" if "image/png" in data else data.get("text/plain", ""))
            parts.append(re.sub(r"(?s)<figure>.*</figure>", "", data.get("text/html", "")))
        streamed = output.output_type == "stream"
    return [part for part in parts if part]


def pictures(notebook):
    return [
        output.data["image/png"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]


keep = sys.argv[1:] == ["--keep"]
kept = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 and not keep else None
stale = []
for path in sorted(folder.glob("*.ipynb")):
    stands = nbformat.read(path, as_version=4)
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(folder)}}).execute()
    without_particulars(notebook)
    drawn = pictures(notebook)
    print(f"{path.name}: {len(notebook.cells)} cells, {len(drawn)} pictures")
    if not drawn:
        sys.exit(f"{path.name} draws no picture")
    if keep:
        nbformat.write(notebook, path)
    for number, (now, before) in enumerate(zip(notebook.cells, stands.cells), start=1):
        if not keep and shown(now) != shown(before):
            stale.append(f"{path.name}, cell {number}: found {shown(before)}; required: {shown(now)}")
    if kept:
        kept.mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, kept / path.name)
        for number, picture in enumerate(drawn):
            (kept / f"{path.stem}-{number}.png").write_bytes(base64.b64decode(picture))
if stale:
    sys.exit("\n".join(stale) + "\nOutputs are stale; tests/python/run_notebooks.py --keep writes those of today.")
