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
import sys
import numpy as np
from numba import njit
from sphfilter.core._addresses import address_of, function_at
from sphfilter.model.symbolic import symbolic_rows

@njit
def fill(at, x, out):
    function_at(at)(x, 0.0, x[0], out)

x, out = np.full((1, 2), 2.0), np.empty((1, 1))
each = {number: symbolic_rows(["x", "v"], [f"x*v + {number}"], "h") for number in sys.argv[1:]}
for number, rows in each.items():
    fill(address_of(rows), x, out)
    assert out[0, 0] == 4.0 + float(number), (number, out)
    print(*(sum(found.values()) for found in (rows.stats.cache_hits, rows.stats.cache_misses)))
"""


def loaded_and_compiled(numbers, folder):
    """How often a process loads and compiles for texts of these numbers, whose values it checks."""
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *map(str, numbers)],
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [tuple(map(int, line.split())) for line in done.stdout.splitlines()]


def test_a_process_loads_what_another_compiled_and_nothing_else(tmp_path):
    """An address is looked up by name, and a count of each process tells no two names apart."""
    assert loaded_and_compiled([1, 2, 3], tmp_path) == [(0, 1)] * 3
    assert loaded_and_compiled([4, 5, 6, 3, 2, 1], tmp_path) == [(0, 1)] * 3 + [(1, 0)] * 3


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


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_code_that_was_not_written_to_its_end_is_compiled_anew(folder, ending):
    code = Path(scaled_by(6).stats.cache_path)
    for path in code.glob(f"*.{ending}"):
        path.write_bytes(b"")
    assert value_of(scaled_by(6)) == 12.0  # the damaged file goes
    assert value_of(scaled_by(6)) == 12.0
    assert sum(scaled_by(6).stats.cache_hits.values()) == 1


def test_a_text_is_another_one_by_another_core(folder, monkeypatch):
    """Else code of every version that there was would be kept as long as the last one is used."""
    scaled_by(7)
    monkeypatch.setattr(module, "fingerprint", lambda package: "of another core")
    assert value_of(scaled_by(7)) == 14.0
    assert len([*folder.glob("*.txt")]) == 2
