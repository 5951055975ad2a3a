"""From a user's function to compiled batch functions: rows of states in, rows of values out.

Every function made here has the signature `BATCH`, so that the loops of the package, compiled once for
that signature, accept every model.
"""

import dis
import functools
import inspect
import itertools
import math
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import njit, objmode
from numba.core import types
from numba.core.errors import NumbaError
from numpy.typing import ArrayLike

from .._types import BatchFunction, Floats
from ..core._jit import BATCH
from ..errors import ModelError
from .asking import noted

#: A user's function of (x), (x, t), (x, t, p) or (x, t, p, u): of one state in numba's types, or of rows of
#: states.
StateFunction: TypeAlias = Callable[..., Any]
#: Makes a batch function from the others of its model, by name.
Maker: TypeAlias = Callable[[Any], BatchFunction]


class Data(NamedTuple):
    """Arguments of a user's functions beside state and time: values of parameters, then of inputs."""

    p: Floats = np.empty(0)
    u: Floats = np.empty(0)

    def seen(self, names: Sequence[str]) -> list[str]:
        """Source of arguments by name, cut out of the one array in which compiled functions get all data."""
        k, m = len(self.p), len(self.u)
        cut = {"x": "x[i]", "p": f"p[:{k}]", "u": f"p[{k}:{k + m}]"}
        return [cut.get(name, name) for name in names]

    def given(self, names: Sequence[str], x: Any, t: float, p: Floats) -> list[Any]:
        """Arguments by name."""
        k, m = len(self.p), len(self.u)
        values = {"x": x, "t": t, "p": p[:k], "u": p[k : k + m]}
        return [values[name] for name in names]


NO_DATA = Data()
#: Vectorised numpy callables by number: compiled code can hold a number, not a Python object.
_BLACK_BOXES: list[BatchFunction] = []
_NUMBERS = itertools.count()  # of functions whose cost is noted
#: What users' functions raised while compiled code ran, the first by thread; 0 for compiled code's threads.
_RAISED: dict[int, BaseException] = {}


class surfacing:
    """Run compiled code: what a user's function raises in it is raised when it returns, as it was raised.

    No exception passes through compiled frames, whose threads it would end together with Python. After the
    first one the user's functions are not called any more, and give NaN.
    """

    def __enter__(self) -> None:
        pass

    def __exit__(self, *raised: object) -> None:
        problem = _RAISED.pop(threading.get_ident(), None) or _RAISED.pop(0, None)
        if problem is not None:
            raise problem


def batch(function: Callable[..., None]) -> BatchFunction:
    """Compile one batch function of the package's own, without a disk cache (closures differ per model)."""
    return njit(BATCH, error_model="numpy")(function)


def filled(fill: BatchFunction, X: Floats, t: float, p: Floats, *shape: int) -> Floats:
    """Values (N, *shape) of a batch function at states X (N, n), of data p."""
    out = np.empty((len(X), math.prod(shape)))
    with surfacing():
        fill(X, float(t), p, out)
    return out.reshape(len(X), *shape)


def arguments_of(function: object, name: str, data: Data = NO_DATA) -> tuple[str, ...]:
    """Return what to pass to a user's function: x; x, t; x, t, p; with inputs also x, t, u or x, t, p, u.

    Raises `ModelError` if it cannot be called, or takes another number of arguments.
    """
    forms: tuple[tuple[str, ...], ...] = (("x",), ("x", "t"), ("x", "t", "p"))
    if data.u.size:
        forms += (("x", "t", "p", "u"),)
    shown = ", ".join(f"({', '.join(form)})" for form in forms)
    if not callable(function):
        raise ModelError(f"{name} must be a function of {shown}, got {function!r}.")
    if isinstance(function, np.ufunc):  # whose second argument is an array to be written
        return forms[0]
    try:
        parameters = inspect.signature(_python(function)).parameters.values()
    except (TypeError, ValueError):
        return forms[1]
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        return forms[-1]
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    needed = sum(p.default is p.empty for p in positional)
    fitting = [form for form in forms if needed <= len(form) <= len(positional)]
    if not fitting:
        raise ModelError(f"{name} takes {len(positional)} arguments; write it as a function of {shown}.")
    if data.u.size and len(fitting[-1]) == 3 and (positional[2].name == "u" or not data.p.size):
        return ("x", "t", "u")
    return fitting[-1]


def reads_argument(function: object, index: int) -> bool:
    """Tell whether a function may depend on its positional argument `index`.

    The bytecode is searched for the argument's name: False is a proof, True may only mean "unknown".
    """
    code = getattr(_python(function), "__code__", None)
    if code is None:
        return True
    if index >= code.co_argcount:
        return bool(code.co_flags & inspect.CO_VARARGS)
    name = code.co_varnames[index]
    values = (instruction.argval for instruction in dis.get_instructions(code))
    return any(name == v or (isinstance(v, tuple) and name in v) for v in values)


def probe_states(dim: int) -> Floats:
    """Return fixed, unremarkable states at which a function is tried once, shape (3, dim)."""
    return np.random.default_rng(20220).uniform(0.1, 0.9, (3, dim))


def compile_rows(
    function: Callable[..., Any],
    shape: tuple[int, ...],
    name: str,
    dim: int | None,
    data: Data = NO_DATA,
    vectorized: bool = False,
) -> BatchFunction:
    """Compile a user's function into a batch function, whose out has one column per number, row-major.

    The function is f(x), f(x, t), f(x, t, p) or f(x, t, p, u) of one state x (dim,) that returns numbers in
    nested tuples of `shape`: () is one number, (k,) a tuple of numbers, (k, m) a tuple of k tuples of m
    numbers; with `vectorized`, of states X (N, dim), returning an array (N, *shape). Its name is for
    messages. `dim` is None when not known yet (nothing is tried then); of p it sees as many as the data have.

    Raises `ModelError` for wrong arguments, a wrong number of values, an index beyond the state, or where
    numba cannot compile it.
    """
    arguments = arguments_of(function, name, data)
    if dim is not None:
        probe(function, shape, name, dim, data, vectorized)
    if vectorized:
        return _compile_vectorized(function, arguments, shape, name, data)
    core, returned = _compile_one(function, arguments, name)
    _check_shape(returned, shape, name)
    scalar = not isinstance(returned, types.BaseTuple | types.Array)
    lines = [f"r = f({', '.join(data.seen(arguments))})"]
    for column, index in enumerate(np.ndindex(*shape)):
        lines.append(f"out[i, {column}] = r" + ("" if scalar else "".join(f"[{j}]" for j in index)))
    if not _may_raise(core):
        return compile_source([], lines, f=core)
    lines = ["try:", *(f"    {line}" for line in lines)]
    lines += ["except Exception:", "    again(x[i : i + 1], t, p, out[i : i + 1])"]
    return compile_source([], lines, f=core, again=_raised_again(core, arguments, data))


def compile_with_noise(
    function: Callable[..., Any], n: int, m: int, name: str, data: Data, vectorized: bool
) -> BatchFunction:
    """Compile a user's function of state and noise into a batch function of rows (x, w), n and m columns."""
    try:
        names = [*inspect.signature(_python(function)).parameters]
    except (TypeError, ValueError) as problem:
        raise ModelError(f"{name} must be a function of (x, w), (x, w, t) or (x, w, t, p).") from problem
    if len(names) < 2:
        raise ModelError(f"{name} takes {len(names)} arguments; write it as a function of (x, w, ...).")
    rest, cut = ", ".join(names[2:]), ":, " if vectorized else ""
    source = f"lambda x{', ' * bool(rest)}{rest}: f(x[{cut}:{n}], x[{cut}{n}:]{', ' * bool(rest)}{rest})"
    arguments: Any = (n,), name, n + m, data, vectorized
    whole = eval(source, {"f": _python(function)})
    probe(whole, *arguments)
    if not vectorized:
        own = function if hasattr(function, "py_func") else njit(function, error_model="numpy")
        whole, arguments = eval(source, {"f": own}), ((n,), name, None, data, False)
    return compile_rows(whole, *arguments)


def compile_source(before: Sequence[str], per_row: Sequence[str], **names: Any) -> BatchFunction:
    """Compile a batch function from lines of source written by this package (never a user's text)."""
    namespace = dict(names)
    exec(batch_source(before, per_row), namespace)
    return batch(namespace["fill"])


def batch_source(before: Sequence[str], per_row: Sequence[str]) -> str:
    """Source of a batch function ``fill``, of lines that run once and lines that run for each row i."""
    body = ["def fill(x, t, p, out):", *(f"    {line}" for line in before), "    for i in range(x.shape[0]):"]
    return "\n".join([*body, *(f"        {line}" for line in per_row)])


def _python(function: Any) -> Any:
    return getattr(function, "py_func", function)


def _compile_one(function: Any, arguments: Sequence[str], name: str) -> tuple[Any, Any]:
    """Return the compiled function of one state and the numba type it returns."""
    signature = tuple(types.float64 if argument == "t" else types.float64[::1] for argument in arguments)
    own: Any = (lambda x: function(x)) if isinstance(function, np.ufunc) else function
    if not (inspect.isfunction(own) or hasattr(own, "py_func")):
        raise ModelError(
            f"{name} is a {type(own).__name__}, which numba does not compile: give a function of one state, "
            "whose data are parameters=, or one of many states (rows) with vectorized=True."
        )
    try:
        core = own if hasattr(own, "py_func") else njit(own, error_model="numpy")
        core.compile(signature)
        return core, core.overloads[signature].signature.return_type
    except (NumbaError, NotImplementedError, TypeError, AttributeError, AssertionError) as error:
        # numba's own text runs over pages; its first line that says something names the culprit
        lines = [line.strip() for line in str(error).splitlines()]
        told = [line for line in lines if len(line) > 20 and not line.startswith("Failed in nopython")]
        reason = told[0] if told else repr(error)
        raise ModelError(
            f"{name} could not be compiled by numba ({reason[:200]}). Use plain arithmetic and math "
            "functions of one state, or pass a numpy function of many states (rows) with vectorized=True."
        ) from error


def _may_raise(core: Any) -> bool:
    """Whether compiled code of one state contains an exception, which it keeps in pickled form."""
    try:
        return any("picklebuf" in code for code in core.inspect_llvm().values())
    except RuntimeError:  # code from a cache on disk shows nothing
        return True


def _raised_again(core: Any, arguments: Sequence[str], data: Data) -> BatchFunction:
    """Batch function that asks a compiled function of one state once more, from Python, for its exception."""

    def call(x: Floats, t: float, p: Floats, out: Floats) -> None:
        out[0] = np.nan
        core(*data.given(arguments, x[0], t, p))

    return _through_python(call)


def _check_shape(returned: Any, shape: tuple[int, ...], name: str) -> None:
    """Compare a numba return type with the shape that is needed."""
    if isinstance(returned, types.BaseTuple):
        got: tuple[int, ...] = (len(returned),)
        if len(shape) == 2:
            rows = {len(row) if isinstance(row, types.BaseTuple) else 1 for row in returned}
            nested = all(isinstance(row, types.BaseTuple) for row in returned)
            got = (len(returned), *rows) if nested else got
        flat = [v for row in returned for v in (row if isinstance(row, types.BaseTuple) else [row])]
        if got == shape and all(isinstance(v, types.Number | types.Boolean) for v in flat):
            return
        raise ModelError(_arity(name, got, shape) if got != shape else f"{name} must return plain numbers.")
    if isinstance(returned, types.Array) and returned.ndim == len(shape):
        return
    if isinstance(returned, types.Number | types.Boolean):
        if np.prod(shape, dtype=int) == 1:
            return
        raise ModelError(_arity(name, (1,), shape))
    if isinstance(returned, types.NoneType):
        raise ModelError(
            f"{name} returns nothing: it raises an exception or has no return statement; "
            f"it must return {_wanted(shape)}."
        )
    raise ModelError(f"{name} returns a {type(returned).__name__}; it must return {_wanted(shape)}.")


def _wanted(shape: tuple[int, ...]) -> str:
    if len(shape) == 2:
        return f"a tuple of {shape[0]} tuples of {shape[1]} numbers"
    return f"a tuple of {shape[0]} numbers" if shape else "one number"


def _arity(name: str, got: tuple[int, ...], shape: tuple[int, ...]) -> str:
    values = " × ".join(map(str, got))
    needed = " × ".join(map(str, shape or (1,)))
    return f"{name} returns {values} value(s), but {needed} are needed: return {_wanted(shape)}."


def probe(
    function: Callable[..., Any],
    shape: tuple[int, ...],
    name: str,
    dim: int,
    data: Data = NO_DATA,
    vectorized: bool = False,
) -> None:
    """Try a function once, uncompiled, for what compiled code would not notice: sizes and indices.

    Raises `ModelError` if it reads beyond the state or the parameters, or returns the wrong number of values.
    """
    states, names = probe_states(dim), arguments_of(function, name, data)
    arguments = data.given(names, states if vectorized else states[0], 0.0, np.concatenate(data))
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            values = _python(function)(*arguments)
    except ModelError:
        raise
    except IndexError as error:
        if "too many indices" in str(error):
            raise ModelError(
                f"{name} indexes one state (dim={dim}) as if it were many rows of states: {error}. Write "
                "x[0], x[1] and so on, or pass vectorized=True for a numpy function of all states at once."
            ) from error
        raise ModelError(
            f"{name} reads beyond the state (dim={dim}), the parameters ({data.p.size} given) or the inputs "
            f"({data.u.size} given): {error}. Check dim, parameters, inputs and the indices of x, p and u."
        ) from error
    except Exception:
        # a function may be undefined at the probe; what it is for the compiler is checked elsewhere
        return
    if vectorized:
        _rows_of(values, len(states), shape, name)
    elif isinstance(values, np.ndarray) and values.shape != shape:
        raise ModelError(_arity(name, values.shape, shape))


def _rows_of(values: ArrayLike, n_rows: int, shape: tuple[int, ...], name: str) -> Floats:
    """Return what a vectorised function gave as an array (n_rows, k)."""
    values = np.asarray(values, dtype=float)
    k = int(np.prod(shape, dtype=int))
    if values.shape not in ((n_rows, *shape), (n_rows, k)):
        given = " × ".join(map(str, values.shape))
        needed = " × ".join(map(str, (n_rows, *shape)))
        raise ModelError(f"{name} returned an array {given} for {n_rows} states, but {needed} is needed.")
    return values.reshape(n_rows, k)


def _compile_vectorized(
    function: Callable[..., Any], arguments: Sequence[str], shape: tuple[int, ...], name: str, data: Data
) -> BatchFunction:
    """Wrap a numpy function of many states; compiled loops reach it through the interpreter."""

    number, called = next(_NUMBERS), getattr(function, "__name__", name)

    def call(x: Floats, t: float, p: Floats, out: Floats) -> None:
        with noted(number, called, len(x)):  # a copy: who keeps the states must own them
            out[:] = _rows_of(function(*data.given(arguments, x.copy(), t, p)), len(x), shape, name)

    return _through_python(call)


def _through_python(call: Callable[..., None]) -> BatchFunction:
    """Batch function that enters the interpreter."""
    index, ask = len(_BLACK_BOXES), _asking()
    _BLACK_BOXES.append(call)

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        ask(index, x, t, p, out)

    return batch(fill)


@functools.cache
def _asking() -> Any:
    """Compiled code's way to the functions of Python; with no rows there is nothing to ask."""

    def ask(index: int, x: Floats, t: float, p: Floats, out: Floats) -> None:
        if x.shape[0] > 0:
            with objmode():
                _call_black_box(index, x, t, p, out)

    return njit(types.void(types.int64, *BATCH.args), error_model="numpy")(ask)


def _call_black_box(index: int, x: Floats, t: float, p: Floats, out: Floats) -> None:
    """Call a user's function, and keep what it raises for `surfacing`."""
    own = threading.get_ident()
    thread = own if any(own == known.ident for known in threading.enumerate()) else 0
    if thread in _RAISED:
        out[:] = np.nan
        return
    try:
        _BLACK_BOXES[index](x, t, p, out)
    except BaseException as problem:
        _RAISED[thread] = problem
        out[:] = np.nan


@functools.cache
def shared(function: Callable[..., None]) -> BatchFunction:
    """Compile a batch function that all models share, cached on disk."""
    return njit(BATCH, cache=True, error_model="numpy")(function)
