"""Text expressions: safe to read from a file, with symbolic derivatives, compiled by numba.

A text is parsed with Python's own `ast` and walked against a short list of what is allowed; nothing in it is
ever evaluated as Python. The symbolic tree is built from that walk, and code is printed from the tree with
names of this module's own choice.
"""

import ast
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy as sp

from ..errors import ExpressionError, nearest, plain
from .symbols import FUNCTIONS, And, Ge, Gt, Linear, Not, Or, Previous, Where
from .tables import Table

#: Limits against texts that are small to write and endless to work out; a sum of sines of 799 terms was
#: measured to be compiled within 2 s.
MAX_NODES = 1_000
MAX_CHARACTERS = 10 * MAX_NODES  # ten a term = 10,000
MAX_EXPONENT = 64

_ALLOWED = (
    "Allowed are the states, t, parameters, inputs, numbers, pi, + - * / **, comparisons, 'and', 'or', "
    f"'not', and the functions {' '.join(FUNCTIONS)} where table."
)
_CONDITIONS = (Ge, Gt, And, Or, Not)
_CALLED = (*FUNCTIONS, "where", "table")
_RESERVED = ("t", "pi", *_CALLED)
_NO_TABLES: Mapping[str, Table] = MappingProxyType({})


class Names:
    """The names a text may use, and the symbols that stand for them.

    States and parameters, inputs among these, and the `tables` that ``table("name", ...)`` may call. Raises
    `ExpressionError` for a name that is no identifier, is reserved, or is given twice.
    """

    def __init__(
        self, states: Sequence[str], parameters: Sequence[str] = (), tables: Mapping[str, Table] = _NO_TABLES
    ) -> None:
        states, parameters = [*map(plain, states)], [*map(plain, parameters)]
        seen = set()
        for name in (*states, *parameters):
            if not isinstance(name, str) or not name.isidentifier():
                raise ExpressionError(f"{name!r} cannot be a name; use letters, digits and underscores.")
            if name in _RESERVED:
                raise ExpressionError(f"{name!r} has a meaning of its own in expressions; choose another.")
            if name in seen:
                raise ExpressionError(f"The name {name!r} is given twice; each needs its own.")
            seen.add(name)
        self.x = [sp.Symbol(f"x_{i}") for i in range(len(states))]
        self.p = [sp.Symbol(f"p_{i}") for i in range(len(parameters))]
        self.t = sp.Symbol("t")
        self.symbols = dict(zip((*states, *parameters, "t"), (*self.x, *self.p, self.t), strict=True))
        self.symbols["pi"] = sp.pi
        self.used: set[str] = set()  # names that a text has used so far
        self.tables = {plain(name): table for name, table in tables.items()}
        # arguments and values of all, as they follow the parameters' values in p
        self.data = np.concatenate([[], *(part for own in tables.values() for part in (own.at, own.values))])
        sizes = [2 * len(table.at) for table in tables.values()]
        starts = len(parameters) + np.cumsum([0, *sizes])[:-1]
        self._starts = dict(zip(self.tables, map(int, starts), strict=True))

    def table(self, name: str, argument: sp.Expr) -> sp.Expr:
        """The symbol that stands for the value of a table."""
        self.used.add(name)
        known, start = self.tables[name], self._starts[name]
        return (Linear if known.kind == "linear" else Previous)(start, len(known.at), argument)

    def unused(self, names: Sequence[str]) -> str | None:
        """The first of these names that no text has used."""
        return next((name for name in names if plain(name) not in self.used), None)


def parse(text: str | float, names: Names, where: str = "expression") -> sp.Expr:
    """Return the sympy tree of a text (or of a number); `where` says what it is, for messages.

    Raises `ExpressionError` for an unknown name, forbidden syntax, a constant that is not finite, or a text
    beyond the limits.
    """
    if isinstance(text, int | float) and not isinstance(text, bool):
        return _number(text, where)
    if not isinstance(text, str):
        raise ExpressionError(f"{where} must be text or a number, got {text!r}.")
    if len(text) > MAX_CHARACTERS:
        raise ExpressionError(f"{where} has {len(text)} characters; at most {MAX_CHARACTERS} are allowed.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)
            tree = ast.parse(text.strip(), mode="eval").body
        n_nodes = sum(isinstance(node, ast.expr) for node in ast.walk(tree))
        if n_nodes > MAX_NODES:
            raise ExpressionError(f"{where} has {n_nodes} terms; at most {MAX_NODES} are allowed.")
        found = _Walk(names, text, where).visit(tree)
    except SyntaxError as error:
        raise ExpressionError(f"{where} {text[:80]!r} cannot be read: {error.msg}. {_ALLOWED}") from error
    except (RecursionError, MemoryError, ValueError) as error:
        if isinstance(error, ExpressionError):
            raise
        raise ExpressionError(f"{where} {text[:80]!r} is nested too deeply; break it up.") from error
    if isinstance(found, _CONDITIONS):
        raise ExpressionError(f"{where} {text[:80]!r} is a condition; write where(condition, a, b).")
    return found


class _Walk:
    """Turns one parsed text into a symbolic tree, node by node."""

    def __init__(self, names: Names, text: str, where: str) -> None:
        self.names, self.text, self.where = names, text, where

    def visit(self, node: ast.AST) -> Any:
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self._error(f"{ast.unparse(node)[:60]!r} is not allowed. {_ALLOWED}")
        return method(node)

    def _error(self, reason: str) -> ExpressionError:
        return ExpressionError(f"{self.where} {self.text[:80]!r}: {reason}")

    def _value(self, node: ast.expr) -> Any:
        value = self.visit(node)
        if isinstance(value, _CONDITIONS):
            raise self._error(f"{ast.unparse(node)[:60]!r} is a condition, where a number is needed.")
        return value

    def _condition(self, node: ast.expr) -> Any:
        value = self.visit(node)
        if not isinstance(value, _CONDITIONS):
            raise self._error(f"{ast.unparse(node)[:60]!r} is a number, where a condition is needed.")
        return value

    def _constant(self, node: ast.Constant) -> sp.Expr:
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            raise self._error(f"{node.value!r} is not allowed. {_ALLOWED}")
        return _number(node.value, self.where)

    def _name(self, node: ast.Name) -> sp.Expr:
        if node.id in self.names.symbols:
            self.names.used.add(node.id)
            return self.names.symbols[node.id]
        if node.id in _CALLED:
            raise self._error(f"{node.id!r} is a function; write {node.id}(...).")
        near = nearest(node.id, self.names.symbols) or nearest(node.id, _CALLED)
        raise self._error(
            f"unknown name {node.id!r}{near}. The names here are "
            f"{', '.join(self.names.symbols)}, and the functions {' '.join(FUNCTIONS)} where table."
        )

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        if isinstance(node.op, ast.Not):
            return Not(self._condition(node.operand))
        if isinstance(node.op, ast.Invert):
            raise self._error(f"'~' is not allowed. {_ALLOWED}")
        value = self._value(node.operand)
        return -value if isinstance(node.op, ast.USub) else value

    def _binop(self, node: ast.BinOp) -> sp.Expr:
        a, b = self._value(node.left), self._value(node.right)
        kind = type(node.op)
        if kind not in _OPERATIONS:
            hint = " (use ** for powers)" if kind is ast.BitXor else ""
            raise self._error(f"the operator in {ast.unparse(node)[:60]!r} is not allowed{hint}. {_ALLOWED}")
        if kind is ast.Pow and b.is_number:
            self._check_exponent(a, b)
        if a.is_number and b.is_number:
            return self._fold(lambda: _OPERATIONS[kind](float(a), float(b)))
        if kind is ast.Div and b.is_zero:
            raise self._error("division by zero.")
        return _OPERATIONS[kind](a, b)

    def _check_exponent(self, base: Any, exponent: Any) -> None:
        """Refuse powers of powers whose integer coefficients would fill the memory."""
        inner = max((abs(float(q.exp)) for q in base.atoms(sp.Pow) if q.exp.is_number), default=1.0)
        if not base.is_number and abs(float(exponent)) * max(inner, 1.0) > MAX_EXPONENT:
            raise self._error(f"a power above {MAX_EXPONENT} is not allowed.")

    def _fold(self, compute: Callable[[], Any]) -> sp.Expr:
        """Work out a constant in floating point, where no number grows beyond eight bytes."""
        try:
            value = compute()
        except (OverflowError, ZeroDivisionError, ValueError) as error:
            raise self._error(f"a constant cannot be worked out ({error}).") from error
        if isinstance(value, complex):
            raise self._error("a constant is not a real number.")
        return _number(value, self.where)

    def _call(self, node: ast.Call) -> Any:
        name = node.func.id if isinstance(node.func, ast.Name) else None
        if name is None or node.keywords or any(isinstance(a, ast.Starred) for a in node.args):
            raise self._error(f"the call {ast.unparse(node)[:60]!r} is not allowed. {_ALLOWED}")
        if name == "where":
            if len(node.args) != 3:
                raise self._error("where takes (condition, value if true, value if false).")
            return Where(self._condition(node.args[0]), self._value(node.args[1]), self._value(node.args[2]))
        if name == "table":
            return self._table(node.args)
        if name not in FUNCTIONS:
            raise self._error(f"unknown function {name!r}{nearest(name, _CALLED)}. {_ALLOWED}")
        build, compute, n_args = FUNCTIONS[name]
        arguments = [self._value(a) for a in node.args]
        if len(arguments) != n_args and not (n_args is None and arguments):
            raise self._error(f"{name} takes {n_args or 'one or more'} argument(s), got {len(arguments)}.")
        if all(a.is_number for a in arguments):
            return self._fold(lambda: compute(*map(float, arguments)))
        return build(*arguments)

    def _table(self, arguments: Sequence[ast.expr]) -> sp.Expr:
        known = self.names.tables
        match arguments:
            case [ast.Constant(value=str(name)), argument] if plain(name) in known:
                return self.names.table(plain(name), self._value(argument))
            case [ast.Constant(value=str(name)), _]:
                listed = f"; the tables here are {', '.join(known)}" if known else ""
                raise self._error(f"there is no table {name!r}{nearest(name, known)}{listed}; give tables=.")
        raise self._error('table takes a name in quotes and an argument, such as table("current", t).')

    def _compare(self, node: ast.Compare) -> Any:
        values = [self._value(v) for v in (node.left, *node.comparators)]
        parts = []
        for op, a, b in zip(node.ops, values[:-1], values[1:], strict=True):
            kind = type(op)
            if kind not in _COMPARISONS:
                raise self._error(f"the comparison {ast.unparse(node)[:60]!r} is not one of < <= > >= == !=.")
            parts.append(_COMPARISONS[kind](a, b))
        return parts[0] if len(parts) == 1 else And(*parts)

    def _boolop(self, node: ast.BoolOp) -> Any:
        parts = [self._condition(v) for v in node.values]
        return And(*parts) if isinstance(node.op, ast.And) else Or(*parts)


_OPERATIONS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Gt: Gt,
    ast.GtE: Ge,
    ast.Lt: lambda a, b: Gt(b, a),
    ast.LtE: lambda a, b: Ge(b, a),
    ast.Eq: lambda a, b: And(Ge(a, b), Ge(b, a)),
    ast.NotEq: lambda a, b: Or(Gt(a, b), Gt(b, a)),
}


def _number(value: float, where: str) -> sp.Expr:
    try:
        finite = math.isfinite(float(value))
    except OverflowError:
        finite = False
    if not finite:
        raise ExpressionError(f"{where} contains a constant that is not finite ({str(value)[:40]}).")
    # small whole numbers stay exact, so that exponents and coefficients of 0 and 1 simplify
    if float(value).is_integer() and abs(value) < 2**31:
        return sp.Integer(int(value))
    return sp.Float(float(value))
