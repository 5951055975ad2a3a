"""The compiler decorators: serial, parallel and signed code of one function do not share a cache file."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import FunctionType
from uuid import uuid4

import numpy as np
import pytest
from numba import prange, types

import sphfilter as sf
from sphfilter.core._jit import jit, jit_for, parallel_jit
from sphfilter.core.characteristics.march import march
from sphfilter.core.cloud.pace import chosen

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


ROOT = Path(__file__).resolve().parents[2]


def told(program, folder):
    """What a program prints in a process that finds packages in a folder and compiles into it."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]),
    }
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, env=environment, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


_CALLER = """
import numpy as np
from numba import prange
from sphfilter.core._jit import jit, parallel_jit, start_threads


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
    serial = "start_threads(); serial(np.zeros(3))"
    for line in ("threaded(np.zeros(3))", serial, serial):
        told(f"from caller import *; {line}", tmp_path)


# --- a function that is edited is not run as it was, wherever its callers are ---


def name_in_the_cache(module, function, folder):
    return told(f"from {module} import {function} as f; print(f._cache._cache_file._index_name)", folder)


def copied(folder, to):
    shutil.copytree(ROOT / folder, to, ignore=shutil.ignore_patterns("__pycache__"))
    return to


@pytest.mark.parametrize("edited", ["field/cells.py"])
def test_names_in_the_cache_change_with_any_file_of_the_core(tmp_path, edited):
    """Also with one in another folder of the core than the function's; files elsewhere do not matter."""
    core = copied("sphfilter/core", tmp_path / "package" / "core")
    other, edited = core.parent / "other.py", core / edited
    function = "package.core.sph.summation", "sample_gradient"
    (core.parent / "__init__.py").write_text("")
    other.write_text("")
    name = name_in_the_cache(*function, tmp_path)
    other.write_text("edited = True")
    assert name_in_the_cache(*function, tmp_path) == name
    edited.write_text(edited.read_text() + "\n# edited\n")
    assert name_in_the_cache(*function, tmp_path) != name


def test_names_in_the_cache_change_with_any_file_of_the_references(tmp_path):
    package = copied("reference_filters", tmp_path / "reference_filters")
    function = "reference_filters._cumulant_rates", "fill_rates"
    name = name_in_the_cache(*function, tmp_path)
    edited = package / "_monomials.py"
    edited.write_text(edited.read_text() + "\n# edited\n")
    assert name_in_the_cache(*function, tmp_path) != name


def test_a_function_edited_in_a_folder_below_its_caller_is_not_run_as_it_was(tmp_path):
    """In a package of one's own, such as the references are: values, not names."""
    package = tmp_path / "owned"
    (package / "deep").mkdir(parents=True)
    for folder in (package, package / "deep"):
        (folder / "__init__.py").write_text("")
    jitted = "from sphfilter.core._jit import jit\n\n\n@jit\ndef "
    (package / "deep" / "callee.py").write_text(f"{jitted}told():\n    return 1\n")
    (package / "caller.py").write_text(
        f"from .deep.callee import told\n{jitted}asked():\n    return told()\n"
    )
    program = "from owned.caller import asked; print(asked())"
    assert told(program, tmp_path) == "1"
    callee = package / "deep" / "callee.py"
    callee.write_text(callee.read_text().replace("return 1", "return 2"))
    assert told(program, tmp_path) == "2"


def test_what_takes_long_returns_no_named_tuple_among_other_values():
    """Numba calls Python to make one; an interrupt that comes out there leaves nothing in its place."""
    model = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]])
    start = sf.initialize(sf.Gaussian([0.0], [[0.1]]), n_particles=60)
    for scheme in ("log_density", "cloud"):
        sf.predict(start, model, 0.1, sf.SolverConfig(scheme=scheme))
    for function in (march, chosen):
        for known in function.overloads.values():
            assert not any(isinstance(value, types.BaseNamedTuple) for value in known.signature.return_type)
