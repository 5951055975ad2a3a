"""The notebooks hold the outputs of the code that stands in them, small, and fit for any reader."""

import json
from pathlib import Path

import nbformat
import pytest
from store_notebooks import FOLDER, is_current, outputs

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST = 60_000  # bytes of a picture


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    assert is_current(notebook), f"python tests/package/store_notebooks.py {path.stem}"
    kept = outputs(notebook)
    pictures = [output.data["image/png"] for output in kept if "image/png" in output.get("data", {})]
    assert pictures and all(len(picture) < 4 / 3 * LARGEST for picture in pictures)
    assert not any(output.output_type == "error" or output.get("name") == "stderr" for output in kept)
    text = json.dumps([output for output in kept if "image/png" not in output.get("data", {})])
    for private in (str(FOLDER.parent), str(Path.home()), "ipykernel", " object at 0x"):
        assert private not in text, private


def test_there_are_some():
    assert len(NOTEBOOKS) > 5 and sum(path.stat().st_size for path in NOTEBOOKS) < 1_500_000


def test_other_code_is_not_current():
    notebook = nbformat.read(NOTEBOOKS[0], as_version=4)
    cell = next(cell for cell in notebook.cells if cell.cell_type == "code")
    cell.source += "\nprint(1)"
    assert not is_current(notebook)
