"""Drift and diffusion that are polynomials of the state: terms and coefficients, from a model's text."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sphfilter.core.monomials import up_to
from sphfilter.errors import ModelError
from sphfilter.model.compile import compile_source
from sphfilter.model.sde import SDE

_TEXT = (
    "moment equations need a drift and a noise that are polynomials of the states, in text "
    "(SDE.from_expressions), or a linear model"
)


@dataclass(frozen=True)
class Polynomials:
    """Drift f_i and diffusion D_ij of a model as polynomials; which terms there are does not change with t.

    Attributes
    ----------
    drift, diffusion : list of n, and of n² (row-major), lists of powers
    coefficients : callable
        t -> (R,), of all terms in this order.
    """

    drift: list
    diffusion: list
    coefficients: Callable


def polynomials_of(model):
    """Return the drift and diffusion of a model as `Polynomials`.

    Raises
    ------
    ModelError
        They are no polynomials of the states, or not known as text; or an axis is periodic or ends.
    """
    if not model.domain.unbounded:
        raise ModelError(f"moment equations hold without walls and angles only; the domain is {model.domain}")
    _, (constructor, text, _) = model.__reduce__()  # what a model is pickled as, with its present parameters
    if constructor != SDE.from_expressions:
        if model.linear:
            return _linear(model.to_linear())
        raise ModelError(f"{_TEXT}; {model!r} is neither.")
    if text["interpretation"] == "stratonovich" and model.state_dependent_noise:
        raise ModelError("moment equations need Itô's interpretation of noise that depends on the state.")
    if text["tables"]:
        raise ModelError(f"{_TEXT}; a table, {min(text['tables'])!r}, is no polynomial.")
    names, drift, diffusion = _trees(text, model)
    told = [f"the drift of {s}, {v!r}," for s, v in zip(model.states, text["drift"], strict=True)]
    f = [_terms(*each, names.x) for each in zip(told, drift, strict=True)]
    D = [_terms("the diffusion", v, names.x) for v in diffusion]
    coefficients = _compiled([c for terms in (*f, *D) for c in terms.values()], names.t)
    return Polynomials([list(terms) for terms in f], [list(terms) for terms in D], coefficients)


def _linear(model):
    """Polynomials of a `LinearSDE`: powers of order one and zero."""
    n = model.dim
    axes = [tuple(row) for row in np.eye(n, dtype=int).tolist()]
    values = np.concatenate(
        [np.column_stack([model.A, model.b]).ravel(), model.diffusion(np.zeros((1, n)), 0.0).ravel()]
    )
    return Polynomials([[*axes, (0,) * n]] * n, [up_to(0, n)] * n**2, lambda t: values)


def _trees(text, model):
    """Return the names, and f (n) and D = g Q gᵀ/2 (n², row-major) as expressions of the states and t."""
    import sympy as sp  # takes a second

    from sphfilter.model.expressions import Names, parse

    named = {**model.parameters, **model.inputs}
    names, n = Names(text["states"], [*named]), model.dim
    numbers = [sp.Integer(v) if v == int(v) else sp.Float(v) for v in map(float, named.values())]
    values = dict(zip(names.p, numbers, strict=True))

    def read(rows):
        rows = rows.tolist() if isinstance(rows, np.ndarray) else rows
        return sp.Matrix([[parse(v, names).subs(values) for v in row] for row in rows])

    if text["diffusion"] is not None:
        D = read(text["diffusion"])
    else:
        g = sp.zeros(n, 1) if text["noise"] is None else read(text["noise"])
        D = g * sp.Matrix(model.spectral_density.tolist()) * g.T / 2
    return names, list(read([[v] for v in text["drift"]])), list(D)


def _terms(what, expression, states):
    """Coefficients of an expression by powers of the states."""
    import sympy as sp

    try:
        terms = sp.Poly(expression, *states).terms()
    except sp.PolynomialError as error:
        raise ModelError(f"{_TEXT}; {what} is no polynomial.") from error
    return {tuple(map(int, a)): c for a, c in terms if not c.is_zero}


def _compiled(expressions, t):
    """Function of time of expressions that depend on nothing else."""
    from sphfilter.model.symbols import source

    if not any(t in c.free_symbols for c in expressions):
        values = np.array([float(c) for c in expressions])
        return lambda s: values
    fill = compile_source([], [f"out[i, {k}] = {source(c)}" for k, c in enumerate(expressions)], np=np)

    def coefficients(s):
        out = np.empty((1, len(expressions)))
        fill(np.empty((1, 0)), float(s), np.empty(0), out)
        return out[0]

    return coefficients
