"""Executes the notebooks of docs/notebooks as a reader would; each asserts what it shows.   run_notebooks.py [FOLDER]

FOLDER: where the executed notebooks and their pictures are kept, to be looked at.
"""

import base64
import os
import pathlib
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
kept = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else None
for path in sorted(folder.glob("*.ipynb")):
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(folder)}}).execute()
    pictures = [
        output.data["image/png"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    print(f"{path.name}: {len(notebook.cells)} cells, {len(pictures)} pictures")
    if not pictures:
        sys.exit(f"{path.name} draws no picture")
    if kept:
        kept.mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, kept / path.name)
        for number, picture in enumerate(pictures):
            (kept / f"{path.stem}-{number}.png").write_bytes(base64.b64decode(picture))
