"""Tests compile into a cache of their own."""

import os
import tempfile
from pathlib import Path

import pytest

_folder = Path(tempfile.gettempdir()) / f"sphfilter-test-cache-{os.getuid()}"
os.environ.setdefault("NUMBA_CACHE_DIR", str(_folder))
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("MPLBACKEND", "Agg")
# The matrices are small: threads only wait for each other, the longer the busier the machine is.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_SHORT = {"first_filter", "two_modes"}  # notebooks that run by default: each is a process that compiles anew


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.suffix == ".ipynb" and item.path.stem not in _SHORT:
            item.add_marker("slow")


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
