"""A word while the library compiles, and a folder for compiled code where nothing else can be written to."""

import logging
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from sphfilter.core import _compiling

#: Numba finds no folder of its own, as where neither the installation nor the home can be written to.
READ_ONLY = """
from numba import config
from numba.core import caching
config.CACHE_DIR, found = "", caching.CacheImpl._locator_classes
caching.CacheImpl._locator_classes = [cls for cls in found if "UserProvided" in cls.__name__]
import sphfilter
print(config.CACHE_DIR)
"""


def run(code, **environment):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")} | environment
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )


def test_where_nothing_can_be_written_to_code_is_kept_in_a_temporary_folder(tmp_path):
    first, second = (run(READ_ONLY, TMPDIR=str(tmp_path)) for _ in range(2))
    assert first.returncode == 0, first.stderr
    assert "set NUMBA_CACHE_DIR to a folder that lasts" in first.stderr
    (folder,) = tmp_path.iterdir()
    assert first.stdout.strip() == second.stdout.strip() == str(folder)
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_others_may_write_to_is_not_run_from(tmp_path):
    open_to_all = tmp_path / f"sphfilter-{os.getuid()}"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    done = run(READ_ONLY, TMPDIR=str(tmp_path))
    assert done.stdout.strip() not in ("", str(open_to_all))
    assert not any(open_to_all.iterdir())


def test_without_a_compiler_one_sentence_is_said():
    done = run("import sphfilter", NUMBA_DISABLE_JIT="1")
    assert done.returncode and done.stderr.splitlines()[-1] == (
        "ImportError: sphfilter runs compiled code only: unset NUMBA_DISABLE_JIT"
    )


def event_of(module):
    def function():
        pass

    function.__module__ = module
    stats = SimpleNamespace(cache_path="/somewhere")
    return SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=function, stats=stats)})


@pytest.mark.parametrize(("module", "records"), [("sphfilter.core.field.field", 1), ("mine", 0)])
def test_compiling_that_takes_long_is_said_once_and_only_of_the_library(monkeypatch, caplog, module, records):
    clock = iter(range(1000))
    monkeypatch.setattr(_compiling, "monotonic", lambda: float(next(clock)))
    listener, outer, inner = _compiling._Listener(), event_of(module), event_of("sphfilter.core.field.cells")
    with caplog.at_level(logging.WARNING, logger="sphfilter"):
        for _ in range(3):
            listener.on_start(outer)
            for _ in range(4):  # functions that it calls
                listener.on_start(inner)
                listener.on_end(inner)
            listener.on_end(outer)
    assert len(caplog.records) == records
    assert all(record.getMessage().startswith("compiling: ") for record in caplog.records)
