"""Functions of states that a transient file gives as text: the density at the start, and conditions."""

import ast
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from sphfilter.errors import ExpressionError, ModelError
from sphfilter.model.symbolic import Vocabulary, symbolic_rows

_CANDIDATES = 4096  # drawn at a time
_ROUNDS = 10_000


def expression(model, text, name, tables=MappingProxyType({})):
    """A function (X (M, n), t) -> (M,) of a text of states, t, parameters, inputs and tables.

    `name` is its key in errors.
    """
    names = Vocabulary([*model.parameters], [*model.inputs], tables).with_states(model.states)
    fill = symbolic_rows(model.states, (text,), (name,), names)
    values = np.array([*model.parameters.values(), *model.inputs.values(), *names.data], dtype=float)

    def function(X, t=0.0):
        X = np.ascontiguousarray(X, dtype=float)
        out = np.empty((len(X), 1))
        fill(X, t, values, out)
        return out[:, 0]

    return function


def condition(model, text, name, tables=MappingProxyType({})):
    """A function (X (M, n), t) -> bool (M,) of a condition such as ``abs(q) > 0.5 and v < 1``."""
    wrapped = f"where({text}, 1, 0)"
    try:
        value = expression(model, wrapped, name, tables)
    except ExpressionError as problem:
        raise ExpressionError(str(problem).replace(wrapped, text)) from problem
    return lambda X, t=0.0: value(X, t) > 0.5


def reads_time(text):
    """Does a text that `expression` took name the time?"""
    return any(isinstance(node, ast.Name) and node.id == "t" for node in ast.walk(ast.parse(text.strip())))


@dataclass(frozen=True)
class Pdf:
    """A density as a text: a pdf with its box, which can be drawn from."""

    function: object  # of states X (M, n), values (M,); need not be normalised
    box: np.ndarray  # shape (n, 2): zero outside

    def __call__(self, X):
        """Values at states X (M, n), shape (M,)."""
        return self.function(X)

    def draw(self, rng, size):
        """Draw states, shape (size, n), by rejection under the largest value that was seen."""
        drawn, found, ceiling = [], 0, 0.0
        for _ in range(_ROUNDS):
            X = rng.uniform(*self.box.T, (max(_CANDIDATES, 2 * size), len(self.box)))
            value = self(X)
            if value.max() > ceiling:  # what was drawn under a lower one is worth nothing
                drawn, found, ceiling = [], 0, 1.05 * value.max()
            drawn.append(X[rng.random(len(X)) * ceiling < value])
            found += len(drawn[-1])
            if found >= size:
                return np.concatenate(drawn)[:size]
        raise ModelError("the density at the start is zero nearly everywhere in its box: make that smaller")
