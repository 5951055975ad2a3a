"""Models as text that can be written in other coordinates and with another clock."""

import re
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

import sphfilter as sf


@dataclass(frozen=True, kw_only=True)
class Equation:
    """dX = f(X, t) dt + g(X, t) dW with E[dW dWᵀ] = dt, in the words of `SDE.from_expressions`.

    Attributes
    ----------
    states : tuple of str, length n
    drift : tuple of str, length n
    noise : tuple of n tuples of m str
        m = 0 without noise.
    parameters : tuple of (str, float)
        Numbers by the names that the texts have for them.
    matrix : bool
        A linear model is given to the filter as a `LinearSDE`, else as text.
    shortest : float
        Shortest time in which drift or noise changes with the clock, seconds; infinite where neither does.
    busy : tuple of float
        First and last time of such changes.
    """

    states: tuple[str, ...]
    drift: tuple[str, ...]
    noise: tuple[tuple[str, ...], ...]
    parameters: tuple[tuple[str, float], ...] = ()
    matrix: bool = False
    shortest: float = np.inf
    busy: tuple[float, float] = (-np.inf, np.inf)

    @cached_property
    def model(self):
        """The compiled model."""
        names = tuple(name for name, _ in self.parameters)
        model = _compiled(self.states, self.drift, self.noise, names).with_parameters(**dict(self.parameters))
        return model.to_linear() if self.matrix and model.linear else model

    def moved(self, T, c, lag=0.0):
        """The same equation for y, where x = T y + c (T (n, n), c (n,)), by a clock that shows t + lag."""
        words = in_words(self.states, T, c)
        back = np.linalg.inv(T)

        def rewritten(text):
            return replaced(text, words | ({"t": f"(t - {lag!r})"} if lag else {}))

        drift = [rewritten(f) for f in self.drift]
        columns = [[rewritten(g) for g in column] for column in zip(*self.noise, strict=True)]
        noise = [[weighted(row, column) for column in columns] for row in back]
        return replace(
            self, drift=tuple(weighted(row, drift) for row in back), noise=tuple(map(tuple, noise)),
            busy=(self.busy[0] + lag, self.busy[1] + lag),
        )  # fmt: skip

    def stops(self, t0, t1, parts=1):
        """Times up to t1 at which to stop so that no change is overlooked."""
        stops = np.linspace(t0, t1, parts + 1)[1:]
        first, last = max(t0, self.busy[0]), min(t1, self.busy[1])
        if last <= first or np.isinf(self.shortest):
            return stops
        between = np.linspace(first, last, int(np.ceil((last - first) / self.shortest)) + 1)
        return np.unique(np.append(stops, between[between > t0]))

    def __str__(self):
        drift = ", ".join(f"d{x} = {f}" for x, f in zip(self.states, self.drift, strict=True))
        where = "".join(f", {name} = {value:.6g}" for name, value in self.parameters)
        return f"{drift}; noise {[list(row) for row in self.noise]}{where}"


@lru_cache(maxsize=64)
def _compiled(states, drift, noise, names):
    """The model of some texts, every parameter one: what differs in their values alone is compiled once."""
    given = dict.fromkeys(names, 1.0)
    return sf.SDE.from_expressions(list(states), list(drift), noise if noise[0] else None, parameters=given)


def in_words(states, T, c):
    """What stands for each state once x = T y + c and y has the names that x had."""
    return {
        x: f"({weighted(row, states)}{f' + {float(shift)!r}' if shift else ''})"
        for x, row, shift in zip(states, T, c, strict=True)
    }


def weighted(factors, texts):
    """Sum of expressions, each with a factor, as an expression."""
    parts = [
        f"({text})" if factor == 1.0 else f"{float(factor)!r}*({text})"
        for factor, text in zip(factors, texts, strict=True)
        if factor != 0.0 and text != "0"
    ]
    return " + ".join(parts) or "0"


def replaced(text, words):
    """The expression with other words for states and the time."""
    return re.sub(r"\b(x\d|t)\b", lambda found: words.get(found[0], found[0]), text)
