"""Tests compile into a cache of their own."""

import os
import tempfile
from pathlib import Path

import pytest

_user = getattr(os, "getuid", int)()  # zero where there are no such numbers
_folder = Path(tempfile.gettempdir()) / f"sphfilter-test-cache-{_user}"
os.environ.setdefault("NUMBA_CACHE_DIR", str(_folder))
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("MPLBACKEND", "Agg")
# The matrices are small: threads only wait for each other, the longer the busier the machine is.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_TESTS = Path(__file__).parent
_SHORT = {"first_filter"}  # notebooks that run by default: each is a process that compiles anew
#: Marks of all tests in a folder; what compiles are tests that carry densities, of many models.
MARKS = {
    "adapters": ["compiles", "stonesoup"],
    "campaign": ["compiles"],
    "command": ["compiles"],
    "consistency": ["quick"],
    "core": ["quick"],
    "density": ["compiles"],
    "experiments": ["compiles", "experiments"],
    "family": ["compiles"],
    "filter": ["compiles"],
    "inference": ["compiles"],
    "lattice": ["quick"],
    "model": [],
    "package": [],
    "pieces": ["compiles"],
    "prediction": ["compiles"],
    "reference_filters": [],
    "regression": ["compiles"],
}
#: Files of other folders that are quick too: with the folders above under two minutes of one core, warm.
QUICK = {
    "model/test_asking.py",
    "model/test_expressions.py",
    "model/test_inputs_and_tables.py",
    "model/test_measurements.py",
    "package/test_config.py",
    "package/test_house.py",
    "package/test_markers.py",
    "package/test_readme.py",
    "package/test_root_files.py",
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.suffix == ".ipynb" and item.path.stem not in _SHORT:
            item.add_marker("slow")
        for mark in marks_of(item):
            item.add_marker(mark)


def marks_of(item):
    """Marks that a test has by where it stands; what is slow is never quick."""
    if not item.path.is_relative_to(_TESTS):
        return ["compiles"]  # notebooks
    place = item.path.relative_to(_TESTS)
    marks = {*MARKS[place.parts[0]], *(["quick"] if place.as_posix() in QUICK else [])}
    return sorted(marks - {"quick"} if item.get_closest_marker("slow") else marks)


@pytest.fixture
def ctrl_c_after(monkeypatch):
    """Make Ctrl-C come in `propagate` once it has passed a time; returns `propagate` as it was."""
    import sphfilter as sf  # not before the lines above

    propagate = sf.propagate

    def stop(after):
        def stopped(density, model, times, config, callback, **options):
            def until(density, info):
                if density.t > after:
                    raise KeyboardInterrupt
                callback(density, info)

            return propagate(density, model, times, config, callback=until, **options)

        monkeypatch.setattr(sf, "propagate", stopped)
        return propagate

    return stop
