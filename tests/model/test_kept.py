"""Compiled code of printed texts on disk: loaded by the next process, bounded, and never needed."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sphfilter.model import kept as module
from sphfilter.model.kept import kept

_PROGRAM = """
from sphfilter.model.symbolic import symbolic_rows
rows = symbolic_rows(["x", "v"], ["sin(x)*v + {number}"], "h")
print(*(sum(found.values()) for found in (rows.stats.cache_hits, rows.stats.cache_misses)))
"""


def loaded_and_compiled(number, folder):
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM.format(number=number)],
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    return [int(word) for word in done.stdout.split()]


def test_the_next_process_loads_what_one_compiled_and_nothing_else(tmp_path):
    assert loaded_and_compiled(1, tmp_path) == [0, 1]
    assert loaded_and_compiled(1, tmp_path) == [1, 0]
    assert loaded_and_compiled(2, tmp_path) == [0, 1]


def scaled_by(number):
    """A batch function of one state, of a source of its own."""
    return kept(f"def fill(x, t, p, out):\n    out[0, 0] = {number} * x[0, 0]", {})


def value_of(function):
    out = np.empty((1, 1))
    function(np.array([[2.0]]), 0.0, np.empty(0), out)
    return out[0, 0]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    texts = tmp_path / "models"
    monkeypatch.setattr(module, "_folder", lambda: texts)
    return texts


def test_what_was_used_longest_ago_is_deleted_with_its_code(folder, monkeypatch):
    monkeypatch.setattr(module, "_MOST", 3)
    texts, code = {}, {}
    for number in (1, 2, 3, 1, 4):  # the fourth time one is used again, the fifth there is one too many
        before = {*folder.glob("*.txt")}
        function = scaled_by(number)
        assert value_of(function) == 2.0 * number
        texts[number] = {*folder.glob("*.txt")} - before or texts[number]
        code[number] = Path(function.stats.cache_path)
    for number, (path,) in texts.items():
        left = [*code[number].glob(f"{path.stem}.*.nb?")]
        assert path.exists() == (number in (1, 4))
        assert len(left) == (2 if path.exists() else 0)


def test_without_a_folder_that_can_be_written_to_it_is_compiled_all_the_same(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(module, "_folder", lambda: tmp_path / "file" / "models")
    assert value_of(scaled_by(5)) == 10.0
