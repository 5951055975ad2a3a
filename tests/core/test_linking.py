"""Functions that compiled code alone calls: linked, not compiled, until Python calls; so from the cache."""

import os
import subprocess
import sys
from threading import Thread

import numpy as np
from numba import cfunc, njit, prange, types, vectorize

from sphfilter.core._addresses import Entry
from sphfilter.core._jit import jit

_VECTOR = types.float64[::1]
#: Two functions that call a third; prints values, what is linked and what came from the cache.
SCRIPT = """
import sys
import numpy as np
from numba import njit
from sphfilter.core._jit import jit

@njit
def user(x):
    return 2.0 * x

@jit
def inner(x):
    if x[0] > 5.0:
        raise ValueError("too far")
    return np.append(user(x), 1.0)

@jit
def total(x):
    return inner(x).sum()

@jit
def largest(x):
    return inner(x).max()

def linked(function):
    return [compiled.library.linked for compiled in function.overloads.values()]

one = np.ones(2)
for name in sys.argv[1:]:
    print(globals()[name](one), end=" ")
print(linked(inner), inner.stats.cache_hits.total(), linked(user), user(3.0), user(one), end=" ")
try:
    total(6.0 * one)
except ValueError as error:
    print(error)
"""


def run(folder, *names):
    """What is printed where functions are called from Python in turn."""
    if not (folder / "script.py").exists():
        (folder / "script.py").write_text(SCRIPT)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "kept")}
    command = [sys.executable, folder / "script.py", *names]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_function_is_linked_until_python_calls_it_also_from_the_cache(tmp_path):
    rest = "6.0 [2. 2.] too far"
    assert run(tmp_path, "total") == f"5.0 [True] 0 [False] {rest}"  # a user's function is numba's own
    assert run(tmp_path, "largest") == f"2.0 [True] 1 [] {rest}"
    assert run(tmp_path, "total", "inner") == f"5.0 [2. 2. 1.] [False] 0 [False] {rest}"
    assert run(tmp_path, "inner", "largest") == f"[2. 2. 1.] 2.0 [False] 1 [] {rest}"


def functions(name):
    """A pair of functions as the package has, of a source that no cache knows."""

    def inner(x):
        return x + 1.0

    inner.__qualname__ = inner.__name__ = f"inner_{name}"
    inner = jit(inner)
    inner._cache = type(njit(lambda: None)._cache)()  # nothing is kept

    def outer(x):
        return inner(x).sum()

    outer.__qualname__ = outer.__name__ = f"outer_{name}"
    outer = jit(outer)
    outer._cache = inner._cache
    return inner, outer


def test_a_linked_function_has_an_address_when_one_is_asked_for():
    inner, outer = functions("address")
    outer(np.ones(3))
    assert inner.overloads[_VECTOR,].library.linked
    entry = Entry(inner, (_VECTOR,))
    assert entry.address != 0
    assert not inner.overloads[_VECTOR,].library.linked
    np.testing.assert_array_equal(inner(np.ones(2)), 2.0)


def test_threads_find_compiled_code():
    inner, outer = functions("threads")
    found = []
    work = [Thread(target=lambda f=f: found.append(f(np.ones(3)))) for f in (outer, inner, outer, inner)]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join()
    assert sorted(np.sum(f) for f in found) == [6.0] * 4


#: What numba compiles for others: loops in Python, what begins before the package is imported, a typed list
#: that is made while a function is compiled.
OTHERS = """
from threading import Event, Thread
import numpy as np
from numba import njit, objmode, vectorize
from numba.extending import overload
from numba.typed import List

begun, imported = Event(), Event()

def slow(x):
    return x

@overload(slow)
def of_slow(x):
    begun.set()
    imported.wait(60)
    return lambda x: x + 1.0

found = []
thread = Thread(target=lambda: found.append(njit(lambda x: np.sort(x)[0] + slow(0.0))(np.ones(2))))
thread.start()
begun.wait(60)
import sphfilter as sf
from sphfilter.core._jit import jit
imported.set()
thread.join()

@njit
def told(x):
    with objmode(y="float64"):
        y = float(str(x))
    return y

def listed(x):
    return x

@overload(listed)
def of_listed(x):
    values = List([1.0])
    return lambda x: x + 1.0

@njit
def through(x):
    return listed(x)

@jit
def ours(x):
    return through(x)

model = sf.SDE(lambda X, t: -X, dim=1, noise=[[1.0]], vectorized=True)
print(*found, told(1.5), ours(1.0), List([2.0])[0], *model.drift([[3.0]], 0.0)[0])
print(vectorize(["float64(float64)"])(lambda x: x + 1)(1.0), njit(lambda x: np.median(x))(np.ones(3)))
"""


def test_the_import_leaves_alone_what_others_compile(tmp_path):
    (tmp_path / "others.py").write_text(OTHERS)
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"HOME": str(tmp_path)}
    command = [sys.executable, tmp_path / "others.py"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["2.0", "1.5", "2.0", "2.0", "-3.0", "2.0", "1.0"], done.stderr


def test_what_numba_compiles_for_others_is_as_ever():
    """Values that go by other ways than a jitted function's."""

    @vectorize(["float64(float64)"])
    def doubled(x):
        return 2.0 * x

    @cfunc("float64(float64)")
    def halved(x):
        return 0.5 * x

    @njit(parallel=True)
    def summed(x):
        total = 0.0
        for i in prange(len(x)):
            total += doubled(x[i])
        return total

    assert doubled(3.0) == 6.0
    assert halved.ctypes(3.0) == 1.5
    assert summed(np.ones(4)) == 8.0
