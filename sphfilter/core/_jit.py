"""The one compiler decorator of the package, and the type of a model's compiled functions.

No blanket ``fastmath``: it lets the compiler assume that NaN and infinity never occur, so that
``isfinite`` lies, and it makes sums depend on how a loop was vectorised. Rows are summed in list
order instead, and results are the same bits whatever the number of threads.
"""

import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType

from numba import get_num_threads, njit, types

from ._compiling import find_folder, listen
from ._linking import Jitted, install

find_folder()
listen()
install()

#: Signature of every compiled model function: ``fill(x, t, p, out)`` writes one row of ``out`` (N, k)
#: for each row of ``x`` (N, n) at time ``t`` with parameters ``p``.
BATCH = types.void(types.float64[:, ::1], types.float64, types.float64[::1], types.float64[:, ::1])

#: A first-class function of that signature. Loops compiled for it accept every model without being
#: compiled again; a jitted function passed as a dispatcher would specialise the whole loop per model.
BATCH_FUNCTION = types.FunctionType(BATCH)

#: Arrays of numbers as compiled functions take them.
VECTOR, MATRIX = types.float64[::1], types.float64[:, ::1]


@cache
def fingerprint(package):
    """Short hash of the sources that a function of a package may call: the core's, and the package's own."""
    core, own = Path(__file__).parent, getattr(sys.modules.get(package), "__path__", ())
    folders = [core, *(Path(folder) for folder in own if Path(folder) != core.parent)]
    sources = (path.read_bytes() for folder in folders for path in sorted(folder.rglob("*.py")))
    return sha256(b"".join(sources)).hexdigest()[:10]


def _copy(function, suffix):
    """A copy of a function under another name; numba's cache knows functions by `__qualname__` and line."""
    copy = FunctionType(function.__code__, function.__globals__, function.__name__ + suffix)
    copy.__qualname__, copy.__doc__ = copy.__name__, function.__doc__  # or it keeps the original's
    return copy


def _named_for_the_cache(function):
    """Make the sources part of the name under which a compiled function is cached.

    Numba notices when the file of a function changes, not when a file it calls into does: after an update
    of the package it would run old code, and crash where the layout of the arguments has changed.
    """
    function.__qualname__ += f"_{fingerprint(function.__module__.partition('.')[0])}"
    return function


def _jitted(function, cached, **options):
    options = {"nopython": True, "boundscheck": None, "error_model": "numpy"} | options
    made = Jitted(_named_for_the_cache(function), targetoptions=options)
    if cached:
        made.enable_caching()
    return made


def jit(function):
    """Compile lazily, in nopython mode; division by zero gives inf, as in numpy.

    Cached on disk, but for private functions: their code is part of those that call them. Functions may call
    themselves, and not each other in turn: linked ones would not find the way back.
    """
    private = function.__name__.startswith("_")
    return _jitted(function, not private, no_cfunc_wrapper=True)  # C does not call them


def parallel_jit(function):
    """As `jit`, with ``prange`` loops spread over threads. Each iteration must write only its own row.

    The function is copied under another name: numba's cache would hand the serial code of a function that is
    compiled both ways to both.
    """
    copy = _named_for_the_cache(_copy(function, "_parallel"))
    return njit(copy, cache=True, error_model="numpy", parallel=True, nogil=True)


def jit_for(signature, function):
    """Compile for one signature, now (or load): calls convert jitted functions and look nothing up."""
    made = _jitted(_copy(function, "_signed"), True, nogil=True)
    made.compile(signature)
    made.disable_compile()
    return made


def start_threads():
    """Start numba's threads; needed before serial code that calls threaded code is loaded from the cache.

    Threaded code starts them as it is loaded. Serial code does not, if the threaded code it was linked with
    was in the cache already, and crashes at its first call.
    """
    get_num_threads()
