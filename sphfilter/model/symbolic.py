"""From the texts of a model to its batch functions and structure flags, with symbolic derivatives."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike

from .. import validate
from .._types import BatchFunction, Floats
from ..core._views import flat
from ..core.elementary import FAST
from ..core.interpolation import linear, previous, slope
from ..errors import ExpressionError, ModelError, nearest
from . import derived
from .compile import Maker, batch_source, shared
from .expressions import Names, parse
from .kept import kept
from .named import Values
from .noise import check_noise, constant_root, density_of_noises
from .symbols import Abs, Ge, Gt, Linear, Max, Min, Previous, Sign, source
from .tables import Table, Tables, tables_of

#: Derivatives of a short text can be long; beyond this many operations compiling would take minutes.
MAX_OPERATIONS = 20_000


class Vocabulary(NamedTuple):
    """Names that texts may use beside the states'."""

    parameters: Sequence[str] = ()
    inputs: Sequence[str] = ()
    tables: Mapping[str, Table] = MappingProxyType({})

    @classmethod
    def of(cls, values: Values, tables: Tables | None) -> "Vocabulary":
        """The names of values and of tables, as they were given."""
        return cls([*values.parameters], [*values.inputs], tables_of(tables))

    def with_states(self, states: Sequence[str]) -> Names:
        """All names of a model or a sensor."""
        return Names(states, (*self.parameters, *self.inputs), self.tables)

    def check_used(self, names: Names) -> None:
        """Raise `ExpressionError` if a parameter, input or table is used by no text."""
        for kind, own in zip(("parameter", "input", "table"), self, strict=True):
            idle = names.unused([*own])
            if idle is not None:
                near = nearest(idle, [word for word in names.symbols if word != idle])
                raise ExpressionError(f"The {kind} {idle!r} is used by no expression{near}; leave it out.")


def symbolic_model(
    states: Sequence[str],
    drift: Sequence[str | float],
    noise: Any,
    diffusion: Any,
    spectral_density: ArrayLike | None,
    words: Vocabulary,
    interpretation: str,
) -> tuple[dict[str, Maker], Floats, Floats, dict[str, Any]]:
    """Return (makers, Q, tables, flags) of a model in text; arguments as in `SDE.from_expressions`."""
    if isinstance(states, str) or isinstance(drift, str):
        raise ModelError('states and drift are lists of text, one per state, for instance states=["x", "v"].')
    names, n = words.with_states(states), len(states)
    if n == 0 or len(drift) != n:
        raise ModelError(f"drift has {len(drift)} expressions, but there are {n} states; give one for each.")
    f = sp.Matrix([parse(text, names, f"drift[{i}]") for i, text in enumerate(drift)])
    g, D, Q = _noise(noise, diffusion, spectral_density, names, n)
    words.check_used(names)
    noisy = bool((D if g is None else g).free_symbols & set(names.x))
    if interpretation == "stratonovich" and noisy:
        if g is None:
            raise ModelError("A Stratonovich equation needs noise= instead of diffusion=.")
        f = f + _stratonovich_term(g, Q, names)
    J = f.jacobian(names.x)
    entries = {
        "drift": f,
        "jacobian": J,
        "divergence": sp.Matrix([J.trace()]),
        "diffusion": D,
        "diffusion_divergence": sp.Matrix([_divergence(row, names) for row in D.tolist()]),
    }
    if g is not None:
        entries["noise"] = g
    # g with g gᵀ = 2 D, one column per state, where each state has noise of its own
    root = D.applyfunc(lambda v: sp.sqrt(2 * v)) if g is None and D.is_diagonal() else g
    if root is not None and noisy:
        entries |= _flow(f, root, Q, names)
    makers = {name: _maker(name, matrix, names) for name, matrix in entries.items()}
    if g is None:
        makers["noise"] = lambda fs: derived.noise_from_diffusion(fs["diffusion"])
    if all(v.is_zero for v in entries["diffusion_divergence"]):
        makers["diffusion_divergence"] = lambda fs: shared(derived.zeros)
    own = [*f, *(D if g is None else g)]
    times, tabled = _breakpoints(own, names)
    timing = {
        "switches": _switches(own, names),
        "frequencies": _frequencies(own, names),
        "tabled": [argument for argument, _ in tabled],
    }
    makers |= {name: _maker(name, sp.Matrix(found), names) for name, found in timing.items() if found}
    flags = _flags(f, J, D if g is None else g, D, names) | {"breakpoints": times}
    flags["tables"] = [at for _, at in tabled]
    return makers, Q, names.data, flags | {name: len(found) for name, found in timing.items()}


def symbolic_step(
    states: Sequence[str],
    transition: Sequence[str | float],
    noise: Any,
    m: int,
    noises: Sequence[str] | None,
    words: Vocabulary,
) -> tuple[dict[str, Maker], Floats, dict[str, bool]]:
    """Return (makers, tables, flags) of a step in text, of m noises; arguments as in `DiscreteModel`."""
    if isinstance(states, str) or isinstance(transition, str):
        raise ModelError('states and transition are lists of text, one per state: states=["x", "v"].')
    n, own = len(states), words.with_states([*states, *(noises or ())])
    if n == 0 or len(transition) != n:
        raise ModelError(f"transition has {len(transition)} expressions for {n} states; give one for each.")
    step = sp.Matrix([parse(text, own, f"transition[{i}]") for i, text in enumerate(transition)])
    g = None if noises else _matrix(noise, own, "noise", n)
    words.check_used(own)
    if g is not None:  # noises without names, which no text can use
        names = words.with_states([*states, *(f"_noise_{k}" for k in range(m))])
        step += g * sp.Matrix(names.x[n:])
        own = names
    J = step.jacobian(own.x)
    makers = {"step": _maker("transition", step, own), "jacobian": _maker("jacobian", J, own)}
    flags = {"linear": _is_affine(step, J, own), "autonomous": own.t not in step.free_symbols}
    flags["gaussian_noise"] = not J[:, n:].free_symbols & set(own.x[n:])
    return makers, own.data, flags


def symbolic_rows(
    states: Sequence[str], texts: Sequence[str | float], name: str | Sequence[str], words: Names | None = None
) -> BatchFunction:
    """Return the batch function of k expressions of the states and t: rows of states in, k columns out.

    `name`, or k of them, says what the expressions are, for messages; the function takes the values of
    `words`.
    """
    if isinstance(states, str) or isinstance(texts, str):
        raise ModelError(f'states and {name} are lists of text, for instance {name}=["x**2"].')
    names = words or Names(states)
    each = [f"{name}[{i}]" for i in range(len(texts))] if isinstance(name, str) else name
    rows = sp.Matrix([parse(text, names, where) for text, where in zip(texts, each, strict=True)])
    return _maker(name if isinstance(name, str) else name[0], rows, names)(None)


def degree_of(texts: Sequence[str | float], names: Names) -> int | None:
    """Return the proven degree of texts: 0 without states and t, 1 of sums of states alone; else None."""
    rows = sp.Matrix([parse(text, names) for text in texts])
    if not rows.free_symbols & {*names.x, names.t}:
        return 0
    rest = _beside_linear(rows, rows.jacobian(names.x), names)
    return 1 if rest is not None and rest.is_zero_matrix else None


def _noise(
    noise: Any, diffusion: Any, spectral_density: ArrayLike | None, names: Names, n: int
) -> tuple[Any, sp.Matrix, Floats]:
    """Return g (None when D is given), D and Q."""
    check_noise(noise, spectral_density, diffusion)
    if diffusion is not None:
        D = _matrix(diffusion, names, "diffusion", n)
        if D.shape != (n, n) or any(sp.expand(v) != 0 for v in D - D.T):
            raise ModelError(f"diffusion must be a symmetric {n} × {n} matrix of expressions.")
        if all(v.is_number for v in D):
            validate.covariance("diffusion", np.array(D.tolist(), dtype=float), n, definite=False)
        return None, D, np.eye(n)
    g = sp.zeros(n, 1) if noise is None else _matrix(noise, names, "noise", n)
    Q = density_of_noises(spectral_density, g.shape[1])
    return g, g * _numbers(Q, names) * g.T * sp.Rational(1, 2), Q


def _numbers(M: Floats, names: Names) -> sp.Matrix:
    """A matrix of numbers; small whole ones are exact."""
    return sp.Matrix(*M.shape, [parse(v, names) for v in M.ravel().tolist()])


def _matrix(rows: Any, names: Names, what: str, n: int) -> sp.Matrix:
    """Return a nested sequence of texts or numbers as a sympy matrix of n rows."""
    rows = rows.tolist() if isinstance(rows, np.ndarray) else rows
    nested = isinstance(rows, list | tuple) and all(isinstance(r, list | tuple) for r in rows)
    if not nested or len(rows) != n or len({len(r) for r in rows}) != 1 or not rows[0]:
        raise ModelError(f'{what} must be {n} equally long rows, such as [["0"], ["1"]]; got {rows!r}.')
    flat = [parse(v, names, f"{what}[{i}][{j}]") for i, row in enumerate(rows) for j, v in enumerate(row)]
    return sp.Matrix(n, len(rows[0]), flat)


def _stratonovich_term(g: sp.Matrix, Q: Floats, names: Names) -> sp.Matrix:
    """Return ½ Σ_jkl g_jk Q_kl ∂_j g_il (002 (4), erratum)."""
    n, m = g.shape
    gq = g * _numbers(Q, names) * sp.Rational(1, 2)
    return sp.Matrix(
        [
            sum(gq[j, r] * g[i, r].diff(names.x[j]) for j in range(n) for r in range(m))
            for i in range(n)
        ]
    )  # fmt: skip


def _flow(f: sp.Matrix, g: sp.Matrix, Q: Floats, names: Names) -> dict[str, sp.Matrix]:
    """Entries of the Stratonovich equation: its drift, the divergence of that, and noise with its own."""
    flow = f - _stratonovich_term(g, Q, names)
    c = g * _numbers(constant_root(0.5 * Q), names)
    columns = c.col_join(sp.Matrix([[_divergence(c.col(k), names) for k in range(c.shape[1])]]))
    divergence = sp.Matrix([_divergence(flow, names)])
    return {"flow_drift": flow, "flow_divergence": divergence, "noise_columns": columns}


def _divergence(v: Iterable[sp.Expr], names: Names) -> sp.Expr:
    return sum(entry.diff(x) for entry, x in zip(v, names.x, strict=True))


def _flags(f: sp.Matrix, J: sp.Matrix, g: sp.Matrix, D: sp.Matrix, names: Names) -> dict[str, Any]:
    x, t = set(names.x), names.t
    noise_symbols = g.free_symbols
    constant = not (D.free_symbols & (x | {t}))
    return {
        "state_dependent_noise": bool(noise_symbols & x),
        "constant_diffusion": constant,
        "autonomous": t not in f.free_symbols | noise_symbols,
        "linear": not (noise_symbols & (x | {t})) and _is_affine(f, J, names),
        "diffusion_rows": [any(not v.is_zero for v in D.row(i)) for i in range(len(f))],
    }


def _switches(entries: Sequence[sp.Expr], names: Names) -> list[sp.Expr]:
    """Functions of t and parameters alone at whose zeros an entry of the model jumps or has a kink."""
    found: set[sp.Expr] = set()
    for entry in entries:
        for atom in entry.atoms(Gt, Ge, Sign, Abs, Max, Min):
            switch = atom.args[0] - (atom.args[1] if len(atom.args) > 1 else 0)
            if names.t in switch.free_symbols and not switch.free_symbols & set(names.x):
                found.add(switch)
    return sorted(found, key=str)


def _frequencies(entries: Sequence[sp.Expr], names: Names) -> list[sp.Expr]:
    """Angular frequencies, of parameters alone, at which an entry of the model oscillates in t."""
    found: set[sp.Expr] = set()
    for entry in entries:
        for atom in entry.atoms(sp.sin, sp.cos, sp.tan):
            rate = atom.args[0].diff(names.t)
            if not rate.is_zero and not rate.free_symbols & {names.t, *names.x}:
                found.add(rate)
    return sorted(found, key=str)


def _breakpoints(entries: Sequence[sp.Expr], names: Names) -> tuple[Floats, list[tuple[sp.Expr, Floats]]]:
    """Times at which tables of t, or of a number of times t, come to one of their arguments.

    Of other functions of time and parameters the function itself, and the table's arguments.
    """
    found, others = [np.empty(0)], []
    calls = {atom for entry in entries for atom in entry.atoms(Linear, Previous)}
    for call in sorted(calls, key=str):
        start, count, argument = call.args
        rate, offset = argument.diff(names.t), argument.subs(names.t, 0)
        first = int(start) - len(names.p)
        at = names.data[first : first + int(count)]
        if rate.is_Number and rate != 0 and offset.is_Number:
            found.append((at - float(offset)) / float(rate))
        elif rate != 0 and not argument.free_symbols & set(names.x):
            others.append((argument, at))
    return np.concatenate(found), others


def _is_affine(f: sp.Matrix, J: sp.Matrix, names: Names) -> bool:
    """Tell whether f = A x + b is proven, with A and b free of state and time."""
    rest = _beside_linear(f, J, names)
    return rest is not None and not rest.free_symbols & {*names.x, names.t}


def _beside_linear(f: sp.Matrix, J: sp.Matrix, names: Names) -> sp.Matrix | None:
    """Return f - A x, where the derivative J of f is a matrix A free of state and time; else None."""
    A = J.applyfunc(sp.expand)
    if A.free_symbols & {*names.x, names.t}:
        return None
    return (f - A * sp.Matrix(names.x)).applyfunc(sp.expand)


def _maker(name: str, matrix: sp.Matrix, names: Names) -> Maker:
    """Return the maker of one batch function: its code is printed and compiled when first asked for."""

    def make(functions: Any) -> BatchFunction:
        entries = [sp.powsimp(v) if _has_symbolic_power(v) else v for v in matrix]
        common, reduced = sp.cse(entries, symbols=sp.numbered_symbols("c_"))
        size = sum(int(sp.count_ops(v)) for _, v in common) + sum(int(sp.count_ops(v)) for v in reduced)
        if size > MAX_OPERATIONS:
            raise ExpressionError(
                f"The {name} has {size} operations; beyond {MAX_OPERATIONS}, write the model as a function."
            )
        n, k = len(names.x), len(matrix)  # rows at numbers known when it is compiled become vector code
        before = [f"{s} = p[{j}]" for j, s in enumerate(names.p)]
        before += ["X, O = flat(x), flat(out)"]
        lines = [f"{s} = X[{n}*i + {j}]" for j, s in enumerate(names.x)]
        try:
            lines += [f"{s} = {source(v)}" for s, v in common]
            lines += [f"O[{k}*i + {j}] = {source(v)}" for j, v in enumerate(reduced)]
        except ValueError as error:
            raise ExpressionError(f"The {name} cannot be worked out: {error}.") from error
        return _compiled(tuple(before), tuple(lines))

    return make


@cache
def _compiled(before: tuple[str, ...], per_row: tuple[str, ...]) -> BatchFunction:
    """Compile a batch function of printed code; models whose code is the same share it."""
    words = {"np": FAST, "flat": flat, "linear": linear, "previous": previous, "slope": slope}
    return kept(batch_source(before, per_row), words)


def _has_symbolic_power(v: sp.Expr) -> bool:
    """Tell whether a tree has x**a with a symbol a, whose derivative a x**a / x is 0/0 at zero."""
    return any(not power.exp.is_number for power in v.atoms(sp.Pow))
