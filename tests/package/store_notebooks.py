"""Execute the notebooks and keep what they print and draw, for those who read them without running them.

    python tests/package/store_notebooks.py                # those whose code has changed since
    python tests/package/store_notebooks.py duffing        # this one, whatever has changed

Needs the extra `test`. Ends with an error where a cell raises, or writes to the standard error.
"""

import base64
import os
import sys
import tempfile
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
#: Key of a notebook's metadata: fingerprint of the code whose outputs it holds.
OUTPUTS_OF = "outputs_of"


def fingerprint(notebook):
    """Hash of all cells of code."""
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return sha256("\0".join(code).encode()).hexdigest()[:16]


def is_current(notebook):
    """Are the outputs those of the code?"""
    return notebook.metadata.get(OUTPUTS_OF) == fingerprint(notebook)


def outputs(notebook):
    """All outputs, cell by cell."""
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def complaints(notebook):
    """What cells wrote to the standard error: warnings, and that something compiles."""
    return [output.text for output in outputs(notebook) if output.get("name") == "stderr"]


def execute(notebook):
    """Run all cells in a kernel of their own, in the notebook's folder, with outputs put into the cells."""
    kept = notebook.metadata.copy()
    options = {
        "record_timing": False,
        "coalesce_streams": True,
        "resources": {"metadata": {"path": str(FOLDER)}},
    }
    NotebookClient(notebook, timeout=3600, **options).execute()
    notebook.metadata = kept | {OUTPUTS_OF: fingerprint(notebook)}


def shrink(notebook):
    """Give every picture a palette of its own, a third of the size."""
    for output in outputs(notebook):
        if "image/png" in output.get("data", {}):
            picture = Image.open(BytesIO(base64.b64decode(output.data["image/png"]))).convert("RGB")
            small = BytesIO()
            picture.quantize(256, dither=Image.Dither.NONE).save(small, "png", optimize=True)
            output.data["image/png"] = base64.b64encode(small.getvalue()).decode()


def store(path):
    """Execute a notebook and write it with its outputs."""
    notebook = nbformat.read(path, as_version=4)
    execute(notebook)
    if complaints(notebook):  # perhaps that it compiles; then it is compiled by now
        execute(notebook)
    if complaints(notebook):
        raise SystemExit(f"{path.name} writes to the standard error: {complaints(notebook)[0]}")
    shrink(notebook)
    nbformat.write(notebook, path)


def main(names):
    """Execute the notebooks of these names, or those that are not current."""
    known = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
    if unknown := set(names) - set(known):
        raise SystemExit(f"no notebook {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    os.environ.pop("MPLBACKEND", None)  # pictures go into the notebook
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "matplotlibrc"
        settings.write_text("figure.dpi: 75\n", encoding="utf-8")
        os.environ["MATPLOTLIBRC"] = str(settings)
        for path in sorted(FOLDER.glob("*.ipynb")):
            if path.stem in names or (not names and not is_current(nbformat.read(path, as_version=4))):
                print(path.name, flush=True)
                store(path)


if __name__ == "__main__":
    main(sys.argv[1:])
