"""The symbolic functions that expressions use, with derivatives that stay finite and real.

Sympy's own Abs, sign, Max, Min and Piecewise are not used: for unknown signs they bring in complex parts and
delta functions, and they try to simplify, which can take forever.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import sympy as sp


class _Function(sp.Function):
    # never folded by sympy: constants are folded before a tree is built
    is_number = False


class _Flat(_Function):
    """A function with zero derivative wherever it has one."""

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        return sp.S.Zero


class Gt(_Flat):
    """a > b."""


class Ge(_Flat):
    """a >= b."""


class And(_Flat):
    """All conditions."""


class Or(_Flat):
    """Any condition."""


class Not(_Flat):
    """The opposite condition."""


class Sign(_Flat):
    """−1, 0 or 1."""


class Abs(_Function):
    """|a|."""

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        return Sign(self.args[0]) * self.args[0].diff(s)


class Atan2(_Function):
    """Angle of the point (b, a)."""

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        a, b = self.args
        return (b * a.diff(s) - a * b.diff(s)) / (a**2 + b**2)


class Where(_Function):
    """where(condition, a, b)."""

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        condition, a, b = self.args
        return _select(condition, a.diff(s), b.diff(s))


class Max(_Function):
    """The larger of two."""

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        a, b = self.args
        return _select(Ge(a, b), a.diff(s), b.diff(s))


class Min(_Function):
    """The smaller of two."""

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        a, b = self.args
        return _select(Ge(b, a), a.diff(s), b.diff(s))


class Previous(_Flat):
    """Value of a table that stands in p, from a place on, so many arguments and values; each held."""


class Slope(_Flat):
    """Slope of `Linear`."""


class Linear(_Function):
    """As `Previous`, with straight lines between the values."""

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        *where, argument = self.args
        return Slope(*where, argument) * argument.diff(s)


def _select(condition: sp.Expr, a: sp.Expr, b: sp.Expr) -> sp.Expr:
    return a if a == b else Where(condition, a, b)


def _fold(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    return lambda first, *others: functools.reduce(function, others, first)


def _of_one(names: str) -> dict[str, Any]:
    """Functions of one argument, that are called alike everywhere."""
    return {name: (getattr(sp, name), getattr(math, name), 1) for name in names.split()}


#: name: (symbolic form, numerical form, number of arguments or None for any)
FUNCTIONS: dict[str, tuple[Callable[..., Any], Callable[..., Any], int | None]] = {
    **_of_one("sin cos tan asin acos atan"),
    "atan2": (Atan2, math.atan2, 2),
    **_of_one("sinh cosh tanh exp log sqrt"),
    "abs": (Abs, abs, 1),
    "sign": (Sign, lambda a: float(a > 0) - float(a < 0), 1),
    "min": (_fold(Min), min, None),
    "max": (_fold(Max), max, None),
}

_CALLS = {
    sp.sin: "sin", sp.cos: "cos", sp.tan: "tan", sp.asin: "arcsin", sp.acos: "arccos", sp.atan: "arctan",
    Atan2: "arctan2", sp.sinh: "sinh", sp.cosh: "cosh", sp.tanh: "tanh", sp.exp: "exp", sp.log: "log",
    Abs: "abs", Sign: "sign", Max: "maximum", Min: "minimum",
}  # fmt: skip


def source(e: Any) -> str:
    """Return Python source of a symbolic tree; functions are those of numpy, named ``np``.

    Raises `ValueError` for a node without a real finite value, such as 1/(x - x).
    """
    if e.is_Symbol:
        return e.name
    if e.is_number:
        value = complex(e)
        if value.imag != 0 or not math.isfinite(value.real):
            raise ValueError(f"{e} is not a finite real number")
        return f"({value.real!r})"
    if isinstance(e, Linear | Previous | Slope):
        start, count, argument = e.args
        return f"{type(e).__name__.lower()}(p, {start}, {count}, {source(argument)})"
    a = [source(v) for v in e.args] if not e.is_Pow else []
    if e.is_Add:
        return "(" + " + ".join(a) + ")"
    if e.is_Mul:
        return "(" + " * ".join(a) + ")"
    if e.is_Pow:
        return _power(e)
    if e.func in _CALLS:
        return f"np.{_CALLS[e.func]}({', '.join(a)})"
    if isinstance(e, Where):
        return f"({a[1]} if {a[0]} else {a[2]})"
    if isinstance(e, Gt | Ge):
        return f"({a[0]} {'>' if isinstance(e, Gt) else '>='} {a[1]})"
    if isinstance(e, And | Or):
        return "(" + (" and " if isinstance(e, And) else " or ").join(a) + ")"
    if isinstance(e, Not):
        return f"(not {a[0]})"
    raise ValueError(f"{e.func.__name__} has no numerical form")


def _power(e: Any) -> str:
    base, k = source(e.base), e.exp
    if k.is_Integer:
        # small whole powers become products; a negative one divides
        return f"({base} ** {int(k)})" if k > 0 else f"(1.0 / {base} ** {-int(k)})"
    if k == sp.Rational(1, 2):
        return f"np.sqrt({base})"
    return f"({base} ** {source(k)})"
