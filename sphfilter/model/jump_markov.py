"""Models that switch between modes at random: an equation or map for each, and the jumps between them."""

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats
from ..core.limits import ROUNDING
from ..errors import ModelError
from .discrete import DiscreteModel
from .discretization import exponential
from .dynamics import Dynamics
from .named import InputValues, input_values, shared
from .sde import SDE


class JumpMarkovModel:
    """A state whose equation switches at random: in mode i, dX = f_i dt + g_i dW (a jump-Markov model).

    The densities of the states, one for each mode, obey ∂p_i/∂t = L_i p_i + Σ_j λ_ji p_j, with the
    Fokker-Planck operator L_i of mode i and the rate λ_ji of jumps from mode j to i. Of models in discrete
    time a step begins with a jump, and goes by the map of the mode that it leads to, as in an interacting
    multiple model filter.

    Parameters
    ----------
    modes : mapping of str to SDE, or of str to DiscreteModel
        The equation of each mode, of the same states in the same domain; or its map, of the same period.
    rates : array_like, shape (M, M), optional
        For equations: jumps a second from the mode of a row to that of a column, in the order of `modes`. The
        diagonal is minus the sum of its row: a mode i lasts 1 / -rates[i][i] seconds on average.
    transitions : array_like, shape (M, M), optional
        For maps: probabilities of the mode of a column in a step, after that of a row in the step before.

    Attributes
    ----------
    modes : mapping of str to SDE or DiscreteModel, read-only
    names : tuple of str, length M
    rates : ndarray, shape (M, M), read-only
        Of maps, jumps a second on average: `transitions` less one on the diagonal, over the period.
    transitions : ndarray, shape (M, M), read-only; None for equations
    inputs : mapping of str to float, read-only
        Those of all modes; inputs of one name are one input.
    dim : int
    states : tuple of str
    domain : Domain

    Raises
    ------
    ModelError
        No mode, modes of different states, or that give an input of one name different values; rates that
        are negative or whose rows do not sum to zero, probabilities whose rows do not sum to one.

    Examples
    --------
    >>> import sphfilter as sf
    >>> turn = lambda omega: sf.LinearSDE([[0.0, -omega], [omega, 0.0]], noise=[[0.1, 0.0], [0.0, 0.1]])
    >>> model = sf.JumpMarkovModel({"straight": turn(0.0), "turning": turn(0.5)}, [[-0.1, 0.1], [0.3, -0.3]])
    >>> print(model.stationary, model.transition(1.0).round(3).tolist())
    [0.75 0.25] [[0.918, 0.082], [0.247, 0.753]]
    >>> walk = lambda Q: sf.DiscreteModel.from_matrices(F=[[1.0]], Q=[[Q]])
    >>> modes = {"calm": walk(0.1), "wild": walk(2.0)}
    >>> steps = sf.JumpMarkovModel(modes, transitions=[[0.9, 0.1], [0.5, 0.5]])
    >>> print(steps.stationary.round(3), steps.transition(2.0).round(3).tolist())
    [0.833 0.167] [[0.86, 0.14], [0.7, 0.3]]
    """

    def __init__(
        self,
        modes: Mapping[str, SDE] | Mapping[str, DiscreteModel],
        rates: ArrayLike | None = None,
        *,
        transitions: ArrayLike | None = None,
    ) -> None:
        if not isinstance(modes, Mapping) or not modes:
            raise ModelError(f"modes must be a mapping of names to models, got {validate.short(modes)}")
        kind = DiscreteModel if isinstance(next(iter(modes.values())), DiscreteModel) else SDE
        for name, mode in modes.items():
            if not isinstance(name, str) or not isinstance(mode, kind):
                raise ModelError(
                    f"modes must be equations (SDE) by their names, or all of them DiscreteModel, got "
                    f"{validate.short(name)}: {validate.short(mode)}"
                )
        self.modes: Mapping[str, Dynamics] = MappingProxyType(dict(modes))
        self.names = tuple(modes)
        first = modes[self.names[0]]
        self.dim, self.domain = first.dim, first.domain
        self.states = _states(self.modes)
        for name, mode in modes.items():
            if mode.dim != self.dim or mode.domain != self.domain:
                raise ModelError(
                    f"modes must be of the same states in the same domain: {self.names[0]!r} has {self.dim} "
                    f"in {self.domain}, {name!r} has {mode.dim} in {mode.domain}"
                )
        self.transitions = None
        if kind is DiscreteModel:
            self.transitions, period = _transitions(rates, transitions, self.modes)
            rates = (self.transitions - np.eye(len(modes))) / period
        elif rates is None or transitions is not None:
            raise ModelError("equations switch at rates=, jumps a second; transitions= are of DiscreteModel")
        self.rates = _rates(rates, self.names)
        self.inputs = shared("inputs", self.modes)

    def with_inputs(self, u: InputValues) -> "JumpMarkovModel":
        """Return the model with these values of its inputs, in their order or by name.

        Raises
        ------
        ModelError
            Unknown name, another number of values, or one that is not finite.
        """
        values = input_values(self.inputs, u)
        own = {
            name: mode.with_inputs({k: v for k, v in values.items() if k in mode.inputs})
            for name, mode in self.modes.items()
        }
        return _made(own, self.rates, self.transitions)

    def __reduce__(self) -> tuple[Any, ...]:
        return _made, (dict(self.modes), self.rates, self.transitions)

    def __repr__(self) -> str:
        jumps = "rates" if self.transitions is None else "transitions"
        told = f"{jumps}={getattr(self, jumps).tolist()}"
        return f"JumpMarkovModel(modes={list(self.names)}, {told}, states={self.states})"

    def starts(self, t0: float, t1: float) -> list[float]:
        """Return the times, seconds, at which the steps of maps from one time to another begin."""
        first: Any = self.modes[self.names[0]]
        return list(first.starts(t0, t1))

    def transition(self, dt: float) -> Floats:
        """Probabilities (M, M) of the mode of a column dt seconds after that of a row."""
        if self.transitions is not None:
            return np.linalg.matrix_power(self.transitions, len(self.starts(0.0, dt)))
        return _transition(self.rates.tobytes(), len(self.names), float(dt)).copy()

    @property
    def stationary(self) -> Floats:
        """Probabilities (M,) of the modes after a long time, from equal ones."""
        return _long_after(self.rates)


def _made(modes: Any, rates: Floats, transitions: Floats | None) -> JumpMarkovModel:
    """A model again."""
    return JumpMarkovModel(modes, rates if transitions is None else None, transitions=transitions)


@lru_cache(maxsize=256)
def _transition(rates: bytes, M: int, dt: float) -> Floats:
    P = np.maximum(exponential(np.frombuffer(rates).reshape(M, M) * dt), 0.0)
    return np.asarray(P / P.sum(axis=1, keepdims=True), dtype=np.float64)


def _long_after(rates: Floats) -> Floats:
    """Probabilities (M,) long after equal ones: states are eliminated one by one, and nothing subtracted.

    So small rates between groups of modes that exchange fast keep all of their digits (Grassmann, Taksar and
    Heyman 1985).
    """
    M = len(rates)
    off, w = rates - np.diag(rates.diagonal()), np.full(M, 1.0 / M)
    reached = (off > 0.0) | np.eye(M, dtype=bool)
    for _ in range(M.bit_length()):
        reached = reached @ reached
    for_good = np.array([reached[reached[k], k].all() for k in range(M)])
    for k in np.flatnonzero(~for_good):  # where it goes from a mode that it leaves for good
        to = off[k] / off[k].sum()
        w = w + w[k] * to
        off = off + np.outer(off[:, k], to)
        w[k], off[:, k] = 0.0, 0.0
        np.fill_diagonal(off, 0.0)
    for k in np.flatnonzero(for_good):
        own = np.flatnonzero(reached[k])
        if k == own[0]:
            w[own] = w[own].sum() * _balanced(off[np.ix_(own, own)])
    return np.asarray(w, dtype=np.float64)


def _balanced(off: Floats) -> Floats:
    """Stationary probabilities (M,) of a chain that goes from every mode to every other."""
    off, w = off.copy(), np.ones(len(off))
    for k in range(len(off) - 1, 0, -1):
        off[:k, k] /= off[k, :k].sum()
        off[:k, :k] += np.outer(off[:k, k], off[k, :k])
    for k in range(1, len(off)):
        w[k] = w[:k] @ off[:k, k]
    return np.asarray(w / w.sum(), dtype=np.float64)


def _transitions(
    rates: ArrayLike | None, transitions: ArrayLike | None, modes: Mapping[str, Any]
) -> tuple[Floats, float]:
    """Probabilities (M, M) of modes after a step, checked, and the period of their maps, seconds."""
    M, periods = len(modes), {mode.period for mode in modes.values()}
    if transitions is None or rates is not None:
        raise ModelError(
            "models in discrete time switch at transitions=, probabilities of a step; not at rates"
        )
    if len(periods) > 1:
        raise ModelError(f"modes must step together, and have the periods {sorted(periods)} s")
    P = validate.array("transitions", transitions, (M, M), f"from each of {M} modes to each")
    sums = P.sum(axis=1)
    if P.min() < 0.0 or np.abs(sums - 1.0).max() > 1e-6:
        i = int(np.argmax(np.maximum(np.abs(sums - 1.0), -P.min(axis=1))))
        raise ModelError(
            f"the rows of transitions must be probabilities of sum one, that of {list(modes)[i]!r} is "
            f"{validate.row(P[i])}"
        )
    P = P / sums[:, None]
    P.flags.writeable = False
    return P, periods.pop()


def _rates(rates: ArrayLike, names: tuple[str, ...]) -> Floats:
    """Rates (M, M), checked."""
    M = len(names)
    found = validate.array("rates", rates, (M, M), f"from each of {M} modes to each")
    off = found - np.diag(found.diagonal())
    if off.min() < 0.0:
        i, j = np.unravel_index(off.argmin(), off.shape)
        raise ModelError(
            f"rates must not be negative off the diagonal, got {off[i, j]:g} a second from {names[i]!r} to "
            f"{names[j]!r}"
        )
    sums = found.sum(axis=1)
    wrong = np.flatnonzero(np.abs(sums) > ROUNDING * np.abs(found).max(axis=1))
    if wrong.size:
        i = wrong[0]
        raise ModelError(
            f"the rows of rates must sum to zero, that of {names[i]!r} sums to {sums[i]:g}: its diagonal "
            f"must be minus the rates of leaving, {-off[i].sum():g}"
        )
    np.fill_diagonal(off, -off.sum(axis=1))
    off.flags.writeable = False
    return off


def _states(modes: Mapping[str, Dynamics]) -> tuple[str, ...]:
    """Names of the states: those that a mode gives them, rather than numbers."""
    given = {
        mode.states: name
        for name, mode in modes.items()
        if mode.states != tuple(f"x{i}" for i in range(mode.dim))
    }
    if len(given) > 1:
        (states, name), (others, other) = list(given.items())[:2]
        raise ModelError(
            f"modes must be of the same states in the same order: those of {name!r} are {states}, those of "
            f"{other!r} {others}"
        )
    return next(iter(given), next(iter(modes.values())).states)


def mode_probabilities(given: ArrayLike | Mapping[str, float] | None, model: JumpMarkovModel) -> Floats:
    """Probabilities (M,) of the modes, checked; the stationary ones if none are given.

    Raises `ModelError` for another number of them, an unknown name, negative ones, or a sum that is not one.
    """
    if given is None:
        return model.stationary
    if isinstance(given, Mapping):
        for name in given:
            validate.choice("a name in mode_probabilities", name, model.names)
        given = [given.get(name, 0.0) for name in model.names]
    w = validate.array("mode_probabilities", given, (len(model.names),), f"of the modes {list(model.names)}")
    if w.min() < 0.0 or abs(w.sum() - 1.0) > 1e-6:
        raise ModelError(f"mode_probabilities must not be negative, and sum to one; got {validate.row(w)}")
    return w / w.sum()
