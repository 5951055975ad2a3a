"""The compiler decorators: serial, parallel and signed code of one function do not share a cache file."""

import os
import subprocess
import sys
from pathlib import Path
from types import FunctionType
from uuid import uuid4

import numpy as np
import pytest
from numba import prange, types

from sphfilter.core._jit import jit, jit_for, parallel_jit

_VECTOR = types.float64[::1]


def doubled(x, out):
    """Twice x."""
    for i in prange(x.size):
        out[i] = 2.0 * x[i]


COMPILED = {
    "serial": jit(doubled),
    "parallel": parallel_jit(doubled),
    "signed": jit_for(types.void(_VECTOR, _VECTOR), doubled),
}


def index_of(dispatcher):
    """Name of the file that lists a function's cached code."""
    return Path(dispatcher._cache._cache_file._index_name).name


def test_each_kind_of_code_has_a_cache_of_its_own():
    assert len({index_of(f) for f in COMPILED.values()}) == 3


def test_private_functions_are_cached_within_their_callers_only():
    def _private(x):
        return x

    assert jit(_private).stats.cache_path is None
    assert COMPILED["serial"].stats.cache_path is not None


def unknown_to_the_cache(function):
    """The same function under a name of its own: code that comes from the cache cannot be inspected."""
    copy = FunctionType(function.__code__, function.__globals__, f"{function.__name__}_{uuid4().hex}")
    copy.__qualname__ = copy.__name__
    return copy


def test_serial_and_parallel_code_differ():
    x, code = np.arange(5.0), {}
    for name, compiler in (("serial", jit), ("parallel", parallel_jit)):
        out, compiled = np.empty(5), compiler(unknown_to_the_cache(doubled))
        compiled(x, out)
        np.testing.assert_array_equal(out, 2.0 * x)
        code[name] = next(iter(compiled.inspect_llvm().values()))
    assert "parallel_for" in code["parallel"]
    assert "parallel_for" not in code["serial"]


@pytest.mark.parametrize("kind", ["parallel", "signed"])
def test_copies_keep_their_docstring(kind):
    assert COMPILED[kind].__doc__ == "Twice x."


_CALLER = """
import numpy as np
from numba import prange
from sphfilter.core._jit import call, jit, parallel_jit


@parallel_jit
def threaded(x):
    for i in prange(x.size):
        x[i] += 1.0


@jit
def serial(x):
    if x.size > 1000:
        threaded(x)
    x[0] += 1.0
"""


@pytest.mark.slow
def test_serial_code_linked_with_cached_threaded_code_can_be_loaded(tmp_path):
    """Compiled, linked and loaded in three processes; without the threads the third one crashed."""
    (tmp_path / "caller.py").write_text(_CALLER)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    for line in ("threaded(np.zeros(3))", "call(serial, np.zeros(3))", "call(serial, np.zeros(3))"):
        words = [sys.executable, "-c", f"from caller import *; {line}"]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
