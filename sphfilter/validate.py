"""One validator per kind of argument; each sentence says what was given, what is allowed, what to do."""

import inspect
import math
import numbers
from collections.abc import Callable, Iterable, Mapping
from datetime import timedelta
from functools import wraps
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ._types import Floats, Seed
from .errors import ModelError, nearest

Word = TypeVar("Word")
Given = ParamSpec("Given")
Returned = TypeVar("Returned")

_ROUNDING = 16 * float(np.finfo(float).eps)  # of a time that is a sum of intervals, relative


def array(name: str, value: object, shape: tuple[int | None, ...], what: str = "") -> Floats:
    """Return `value` as a new C-contiguous float64 array of `shape`, of which None leaves an axis free.

    The argument's name, and what its axes hold, are for the message. Raises `ModelError` if it is not
    numeric, of another shape, NaN or infinite.
    """
    try:
        given = np.asanyarray(value)
        masked = np.ma.isMA(given) and np.ma.is_masked(given)
        if masked or given.dtype.kind in "USMmcV":  # text, dates and what numpy would cut
            raise TypeError
        a = np.array(given, dtype=float, order="C", subok=False)
    except (TypeError, ValueError) as error:
        raise ModelError(
            f"{name} must be numbers in an array of shape {_text(shape)}, got {short(value)}."
        ) from error
    if a.ndim != len(shape) or any(s is not None and s != g for s, g in zip(shape, a.shape, strict=True)):
        needed = f"{_text(shape)} is needed" + (f": {what}." if what else ".")
        raise ModelError(f"{name} has shape {a.shape}, but shape {needed}")
    if not np.isfinite(a).all():
        raise ModelError(f"{name} contains NaN or infinity ({short(value)}); every entry must be finite.")
    return a


def keywords(
    method: Callable[Given, Returned], others: Mapping[str, str] = MappingProxyType({})
) -> Callable[Given, Returned]:
    """Let a method say what may have been meant by a keyword that it has not; and end by Ctrl-C as such.

    `others` are keywords of other libraries, and what to give instead.
    """
    known = inspect.signature(method).parameters

    @wraps(method)
    def checked(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
        for name in (name for name in kwargs if name not in known):
            if name in others:
                raise ModelError(f"{method.__qualname__} takes no {name}=: {others[name]}")
            own = [argument for argument in known if argument != "self"]
            near = nearest(name, own) or f"; it has {', '.join(own)}"
            raise TypeError(f"{method.__qualname__} has no argument {name!r}{near}")
        try:
            return method(*args, **kwargs)
        except SystemError as problem:  # what Python makes of a Ctrl-C while compiled code hands out arrays
            first: BaseException = problem
            while first.__cause__ is not None:
                first = first.__cause__
            if isinstance(first, KeyboardInterrupt):
                raise first from None
            raise

    checked.__signature__ = inspect.signature(method)  # type: ignore[attr-defined]  # else that of `checked`
    return checked


def column(value: Any) -> Any:
    """Return a column (k, 1), as filterpy writes vectors, as a row (k,); anything else as it is."""
    try:
        shape = np.shape(value)
    except ValueError:  # rows of different lengths
        return value
    return np.ravel(value) if len(shape) == 2 and shape[1] == 1 else value


def covariance(name: str, value: object, dim: int | None = None, definite: bool = True) -> Floats:
    """Return a symmetric positive (semi)definite matrix, shape (dim, dim); a number stands for 1 × 1.

    Raises `ModelError` if it is not square, of another size, not symmetric, or has an eigenvalue that is
    negative (zero, if `definite`).
    """
    a = square(name, value, dim)
    scale = np.abs(a).max(initial=0.0)
    if np.abs(a - a.T).max(initial=0.0) > 1e-10 * scale:
        raise ModelError(f"{name} is not symmetric: {short(value)}. A covariance equals its transpose.")
    a = 0.5 * (a + a.T)
    # a matrix is judged in the units of its own diagonal: metres and radians may share it
    d = np.sqrt(np.abs(np.diag(a)))
    d[d == 0] = 1.0
    least = np.linalg.eigvalsh(a / np.outer(d, d)).min(initial=np.inf)
    zero = np.flatnonzero(np.diag(a) == 0.0)
    if definite and zero.size:
        raise ModelError(
            f"{name} is not positive definite: it has a zero on its diagonal, at index {zero[0]}; give a "
            f"standard deviation of 1e-6 of its scale, a variance of 1e-12 for what is around 1"
        )
    if least < (1e-14 if definite else -1e-12):
        kind = "definite" if definite else "semidefinite"
        raise ModelError(
            f"{name} is not positive {kind}: its smallest eigenvalue, scaled to a unit diagonal, "
            f"is {least:.3g}. Check signs and cross terms."
        )
    return a


def square(name: str, value: object, dim: int | None = None) -> Floats:
    """Return a finite square matrix, shape (dim, dim); a number stands for 1 × 1."""
    size = "square, (n, n)" if dim is None else f"of shape ({dim}, {dim})"
    if isinstance(value, list | tuple | np.ndarray) and all(isinstance(v, numbers.Real) for v in value):
        raise ModelError(
            f"{name} has shape {np.shape(value)}, but it must be {size}; np.diag({name}) is a matrix with "
            "these on its diagonal."
        )
    a = array(name, [[value]] if isinstance(value, numbers.Real) else value, (None, None))
    if a.shape[0] != a.shape[1] or len(a) == 0 or (dim is not None and len(a) != dim):
        raise ModelError(f"{name} has shape {a.shape}, but it must be {size}.")
    return a


def positive(name: str, value: object) -> float:
    """Return a finite float > 0."""
    value = real(name, value)
    if value <= 0:
        raise ModelError(f"{name} must be greater than zero, got {value!r}.")
    return value


def real(name: str, value: object) -> float:
    """Return a finite float."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ModelError(f"{name} must be one finite number, got {short(value)}.")
    return float(value)


def seconds(name: str, value: object) -> float:
    """Return a time or an interval as a finite float, seconds; a timedelta, Python's or numpy's, is one."""
    if isinstance(value, timedelta):
        return value.total_seconds()
    if isinstance(value, np.timedelta64):
        value = float(value / np.timedelta64(1, "s"))
    return real(name, value)


def onwards(times: Floats, start: float) -> Floats:
    """Return times (T,) of which those are equal to the one before that differ by rounding alone.

    Times are sums of intervals, as a rule: what differs in the last few bits is the same time.
    """
    out, before = np.array(times, dtype=float), float(start)
    for i, t in enumerate(out):
        if abs(t - before) <= _ROUNDING * max(abs(t), abs(before)):
            out[i] = before
        before = out[i]
    return out


def end_of(start: float, dt: Any, t: float | None) -> float:
    """Return the time at which a prediction from `start` ends: after dt seconds, or at time t."""
    if (dt is None) == (t is None):
        raise ModelError("predict takes either dt or t=, one of them")
    end = start + seconds("dt", dt) if t is None else onwards(np.array([real("t", t)]), start).item()
    if end < start:
        raise ModelError(f"cannot predict back in time: from t = {start:g} to {end:g}")
    return end


def unmasked(z: Any) -> Any:
    """Return a reading with NaN where it is masked; anything that has no mask as it is."""
    if np.ma.isMA(z):
        return np.ma.filled(np.ma.asarray(z, dtype=float), np.nan)
    if isinstance(z, list | tuple):
        return [np.nan if number is np.ma.masked else number for number in z]
    return z


def count(name: str, value: object, least: int = 1) -> int:
    """Return an int that is at least `least`."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
        raise ModelError(f"{name} must be a whole number of at least {least}, got {short(value)}.")
    return int(value)


def choice(name: str, value: Word, allowed: Iterable[Word]) -> Word:
    """Return `value` if it is one of the allowed words."""
    if value not in allowed:
        words = ", ".join(repr(a) for a in allowed)
        raise ModelError(f"{name} must be one of {words}, got {value!r}{nearest(value, allowed)}.")
    return value


def times(name: str, value: ArrayLike) -> Floats:
    """Return a non-empty, finite, non-decreasing array of times, shape (T,); see `onwards`."""
    t = array(name, value, (None,))
    if t.size == 0:
        raise ModelError(f"{name} is empty; give at least one time.")
    t = onwards(t, t[0])
    back = np.flatnonzero(np.diff(t) < 0)
    if back.size:
        i = int(back[0])
        raise ModelError(f"{name} run backwards from {t[i]:g} to {t[i + 1]:g} at index {i + 1}; sort them.")
    return t


def state_rows(name: str, value: ArrayLike, dim: int) -> Floats:
    """Return states as a finite array, shape (N, dim); a single state (dim,) becomes one row."""
    if np.ndim(value) == 1:
        return array(name, value, (dim,))[None, :]
    return array(name, value, (None, dim))


def generator(rng: Seed) -> np.random.Generator:
    """Return a numpy Generator for a Generator, a seed, or None (fresh entropy)."""
    try:
        return np.random.default_rng(rng)
    except (TypeError, ValueError) as error:
        raise ModelError(f"rng must be a numpy Generator or a seed (int >= 0), got {short(rng)}.") from error


def _text(shape: tuple[int | None, ...]) -> str:
    inside = ", ".join("any" if s is None else str(s) for s in shape)
    return f"({inside},)" if len(shape) == 1 else f"({inside})"


def row(values: Iterable[float]) -> str:
    """Return a row of numbers as text, four digits each: [1, 0.3333]."""
    return f"[{', '.join(f'{v:.4g}' for v in values)}]"


def short(value: object) -> str:
    """Return the text of a value on one line, cut to 80 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."
