"""Look at the installation: versions, compiled code, threads, and whether a small filter is right."""

import os
import platform
from argparse import ArgumentParser, Namespace
from importlib.metadata import PackageNotFoundError, version
from time import perf_counter

import numba
from numba.core import event

from .._version import __version__
from ..core._compiling import code_folder
from ..errors import SphfilterError
from ..filter.sph_filter import SPHFilter
from ..model.measurements import GaussianMeasurement
from ..model.sde import SDE
from .progress import Say

_NEEDED = ("numpy", "numba", "scipy", "sympy", "pydantic", "joblib", "tomli-w")
_EXTRAS = ("matplotlib", "stonesoup", "dask")
#: Mean of the filter that is tried, measured by grids of 512 and 1024 nodes (`reference_filters.grid`), which
#: agree to 1e-7; and by how much it may be off: the target error, 0.01 of a standard deviation √0.0674.
_MEAN, _ALLOWED = 0.873082, 0.0026


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``doctor``, which are none."""


def main(args: Namespace, say: Say) -> str:
    """Run the command, and return what it found; raises `SphfilterError` if something is wrong."""
    folder = code_folder()
    told = {"sphfilter": __version__, "python": f"{platform.python_version()} on {platform.platform()}"}
    told |= {name: _version(name) for name in (*_NEEDED, *_EXTRAS)}
    writable = os.access(folder if folder.exists() else folder.parent, os.W_OK)
    told["compiled code"] = f"in {folder}" + ("" if writable else ", which cannot be written to")
    told["threads"] = f"{numba.config.NUMBA_NUM_THREADS} of numba, {os.cpu_count()} processors"
    told["a filter"], right = _tried(say)
    lines = "\n".join(f"{name:14}{text}" for name, text in told.items())
    if writable and right:
        return lines
    say("")
    print(lines)
    if right:
        raise SphfilterError("compiled code cannot be kept: set NUMBA_CACHE_DIR to a folder that lasts")
    raise SphfilterError("the filter that was tried is wrong on this machine")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed (optional)" if name in _EXTRAS else "not installed"


def _tried(say: Say) -> tuple[str, bool]:
    """What a small filter took, and whether it is right."""
    say("trying a filter; the first time compiles, a minute or so")
    begin = perf_counter()
    with event.install_recorder("numba:compile") as seen:
        well = SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
        flt = SPHFilter(well, GaussianMeasurement([[1.0]], [[0.1]]), x0=[0.0], P0=[[0.5]])
        flt.predict(1.0)
        flt.update(0.9)
    n = sum(1 for _, one in seen.buffer if one.is_start)
    off = abs(float(flt.x[0]) - _MEAN)
    state = f"{n} functions compiled now" if n else "all was compiled before"
    return f"right to {off:.1g}, {perf_counter() - begin:.1f} s: {state}", off < _ALLOWED
