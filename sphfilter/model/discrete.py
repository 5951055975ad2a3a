"""Models in discrete time: x' = F(x, t) + g(x, t) w, or x' = F(x, w, t), a step every period."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import BatchFunction, Floats
from ..core.limits import LITTLE, SAID
from ..errors import ModelError, PropagationError
from . import derived
from .compile import Maker, StateFunction, compile_rows, compile_with_noise, filled, reads_argument
from .domain import DomainLike
from .dynamics import Dynamics, Functions, compiled
from .named import Inputs, Values
from .noise import Noise, noise_parts, reads_time
from .tables import Tables


class DiscreteModel(Dynamics):
    """A model in discrete time: x' = F(x, t) + g(x, t) w with w ~ N(0, Q), or x' = F(x, w, t).

    A step takes `period` seconds, each with noise of its own. Predictions go over whole steps: by sums over a
    lattice in one and two states, as points in more, in closed form where state and noise are linear.

    Parameters
    ----------
    transition : callable
        F(x, t), F(x) or F(x, t, p) of one state x (n,), returning a tuple of n numbers; p holds the parameter
        values in the order of `parameters`, t is the time at which the step begins. With `inputs` also
        F(x, t, u) or F(x, t, p, u). With `noises` the noise w (m,) of the step comes second: F(x, w, t).
        With `vectorized`, of X (N, n), and W (N, m), → (N, n).
    dim : int
        n, the length of the state.
    noise : array_like (n, m) or callable, optional
        g, or g(x, t) returning n tuples of m numbers. The identity where only a `covariance` is given;
        without either the model is deterministic.
    covariance : array_like (m, m), optional
        Q, positive semidefinite. Identity if not given.
    noises : int, optional
        m, where `transition` itself takes the noise: then no `noise` is given.
    parameters : mapping of str to float, optional
    inputs : sequence of str, or mapping of str to float, optional
        Names of what is held over each interval, or their values where a prediction gives none.
    vectorized : bool
        The callables take all states at once, as numpy functions, and are not compiled.
    domain : Domain or sequence of its axes, optional
        Periodic axes (angles); a map knows no walls.
    period : float
        Seconds that a step takes.

    Attributes
    ----------
    n_noise : int
        m.
    covariance : ndarray, shape (m, m)
    linear, gaussian_noise, autonomous : bool
        Provably: the step is affine in state and noise with constant coefficients; it is affine in the noise;
        it does not depend on time.

    Raises `ModelError` for wrong arity, shapes, NaN, Q not semidefinite, or what numba cannot compile.

    Examples
    --------
    >>> import math
    >>> import sphfilter as sf
    >>> def growth(x, t):
    ...     return (0.5 * x[0] + 25.0 * x[0] / (1.0 + x[0] ** 2) + 8.0 * math.cos(1.2 * t),)
    >>> model = sf.DiscreteModel(growth, dim=1, covariance=[[10.0]])
    >>> sensor = sf.GaussianMeasurement.from_expressions(["x"], ["x**2 / 20"], [[1.0]])
    >>> flt = sf.SPHFilter(model, sensor, x0=[0.1], P0=[[2.0]], dt=1.0)
    >>> for z in (4.0, 12.0):
    ...     predicted, updated = flt.predict(), flt.update(z)
    >>> print(f"P(x > 0) = {flt.density.probability(lambda X: X[:, 0] > 0):.2f}")
    P(x > 0) = 0.99
    """

    gaussian_noise: bool

    @validate.keywords
    def __init__(
        self,
        transition: StateFunction,
        dim: int,
        noise: Noise | None = None,
        covariance: ArrayLike | None = None,
        *,
        noises: int | None = None,
        parameters: Mapping[str, float] | None = None,
        inputs: Inputs | None = None,
        vectorized: bool = False,
        domain: DomainLike = None,
        period: float = 1.0,
    ) -> None:
        recipe = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        n, values = validate.count("dim", dim), Values.of(parameters, inputs)
        tail = np.empty(0)
        if noises is None:
            noise, given = _noise_of(noise, covariance, n)
            about = n, values.data, vectorized
            F = compile_rows(transition, (n,), "transition", *about)
            makers, Q, tail, known = noise_parts(noise, given, None, *about)
            timed = not known["autonomous"] or reads_time(transition, "transition", values.data)
            makers["step"] = lambda fs: derived.noisy_map(F, fs["noise"], n, len(Q))
        else:
            Q = _own_noise(noise, covariance, validate.count("noises", noises))
            whole = compile_with_noise(transition, n, len(Q), "transition", values.data, vectorized)
            makers, timed = {"step": lambda fs: whole}, reads_argument(transition, 2)
        names = [f"x{i}" for i in range(n)]
        parts = makers, tail, {"linear": False, "gaussian_noise": noises is None, "autonomous": not timed}
        self._assemble((DiscreteModel, recipe), names, values, Q, parts, domain, period)

    @classmethod
    @validate.keywords
    def from_expressions(
        cls,
        states: Sequence[str],
        transition: Sequence[str | float],
        noise: Sequence[Sequence[str | float]] | Floats | None = None,
        covariance: ArrayLike | None = None,
        *,
        noises: Sequence[str] | None = None,
        parameters: Mapping[str, float] | None = None,
        inputs: Inputs | None = None,
        tables: Tables | None = None,
        domain: DomainLike = None,
        period: float = 1.0,
    ) -> "DiscreteModel":
        """Build a model from text; derivatives are symbolic.

        Each of n `transition` expressions is a state after a step, of the `states`, t, parameters, inputs
        and, where `noises` names any, the noise of the step; `noise` is a nested sequence (n, m) of text or
        numbers, and `tables` are what ``table("name", t)`` calls. The rest is as for the constructor. Raises
        `ExpressionError` for an unknown name or forbidden syntax, `ModelError` for wrong lengths.

        Examples
        --------
        >>> import sphfilter as sf
        >>> decay = sf.DiscreteModel.from_expressions(["h"], ["a*h"], [["0.3"]], parameters={"a": 0.9})
        >>> print(decay.linear, decay.discretize(2.0)[0].round(2))
        True [[0.81]]
        >>> price = sf.DiscreteModel.from_expressions(["s"], ["s*exp(w)"], noises=["w"], covariance=[[0.01]])
        >>> print(price.transition([[2.0]], t=0.0, W=[[0.5]]).round(2))
        [[3.3]]
        """
        recipe = {k: v for k, v in locals().items() if k != "cls"}
        from .symbolic import Vocabulary, symbolic_step  # imports sympy, which takes a second

        values = Values.of(parameters, inputs)
        words = Vocabulary.of(values, tables)
        if noises is None:
            noise, Q = _noise_of(noise, covariance, len(states))
            Q = np.eye(np.shape(noise)[-1]) if Q is None else Q
        elif isinstance(noises, str | int):
            raise ModelError(f'noises lists names, such as noises=["w"], got {noises!r}')
        else:
            Q = _own_noise(noise, covariance, len(noises))
        makers, tail, flags = symbolic_step(states, transition, noise, len(Q), noises, words)
        self, made = cls.__new__(cls), (DiscreteModel.from_expressions, recipe)
        self._assemble(made, states, values, Q, (makers, tail, flags), domain, period)
        return self

    @classmethod
    @validate.keywords
    def from_matrices(
        cls,
        F: ArrayLike,
        Q: ArrayLike,
        B: ArrayLike | None = None,
        b: ArrayLike | None = None,
        *,
        period: float = 1.0,
    ) -> "DiscreteModel":
        """Build x' = F x + B u + b + w, w ~ N(0, Q), from the matrices of a Kalman filter.

        F and Q are (n, n), b is (n,), and B (n, k) says what the k inputs u0, u1, ... do, which are held over
        each interval: ``flt.predict(dt, u=...)``.

        Examples
        --------
        >>> import sphfilter as sf
        >>> model = sf.DiscreteModel.from_matrices(F=[[1.0, 1.0], [0.0, 1.0]], Q=[[0.0, 0.0], [0.0, 0.1]])
        >>> print(model.linear, model.transition([[1.0, 2.0]], t=0.0))
        True [[3. 2.]]
        """
        F = validate.square("F", F)
        n = len(F)
        B = np.zeros((n, 0)) if B is None else validate.array("B", B, (n, None), "a column for each input")
        b = np.zeros(n) if b is None else validate.array("b", b, (n,))
        states, inputs = [f"x{i}" for i in range(n)], [f"u{k}" for k in range(B.shape[1])]
        rows = np.column_stack([F, B, b]).tolist()
        text = [" + ".join(map("({!r})*{}".format, row, [*states, *inputs, "1"])) for row in rows]
        return cls.from_expressions(states, text, covariance=Q, inputs=inputs, period=period)

    def _assemble(
        self,
        recipe: Any,
        states: Sequence[str],
        values: Values,
        Q: Floats,
        parts: tuple[dict[str, Maker], Floats, dict[str, bool]],
        domain: DomainLike,
        period: float,
    ) -> None:
        """Set every attribute; what follows from the step is compiled when first used."""
        makers, tail, flags = parts
        self._made(recipe, states, len(Q), tail, domain)
        if self.domain.walled.any():
            raise ModelError(
                f"the domain of a model in discrete time may have periodic axes only, got {self.domain}: "
                f"write what happens at an end into the transition, such as max(x, 0)"
            )
        self.covariance, self.period = Q, validate.positive("period", period)
        for name in ("linear", "gaussian_noise", "autonomous"):
            setattr(self, name, flags[name])
        Q.setflags(write=False)
        n = self.dim
        self._functions = Functions({"jacobian": lambda fs: derived.jacobian_from(fs["step"], n), **makers})
        self.events, self.max_step = np.empty(0), np.inf
        self._set(values)
        self._functions["step"]  # what is wrong with a transition should show now, not in a first step

    step_batch: BatchFunction = compiled("step", "x', of rows (x, w): (N, n + m) → (N, n).")
    jacobian_batch: BatchFunction = compiled("jacobian", "∂x'/∂(x, w), row-major, (N, n (n + m)).")

    def transition(self, X: ArrayLike, t: float, W: ArrayLike | None = None) -> Floats:
        """Return where states X (N, n) are after a step from time t, with noise W (N, m) or none, (N, n)."""
        X = validate.state_rows("X", X, self.dim)
        shape = len(X), self.n_noise
        W = np.zeros(shape) if W is None else validate.array("W", W, shape, "a row for each state")
        return filled(self.step_batch, np.hstack([X, W]), t, self.p, self.dim)

    def jacobian(self, X: ArrayLike, t: float) -> Floats:
        """Return ∂x'/∂(x, w) without noise at X (N, n), shape (N, n, n + m)."""
        X = validate.state_rows("X", X, self.dim)
        shape = self.dim, self.dim + self.n_noise
        return filled(self.jacobian_batch, np.pad(X, ((0, 0), (0, self.n_noise))), t, self.p, *shape)

    def breaks(self, t0: float, t1: float) -> Floats:
        """Return an empty array: between steps there is nothing to see."""
        return self.events

    def own_steps(self, t0: float, t1: float) -> int:
        """Return the number of steps from one time to another, seconds; raises `ModelError` if not whole."""
        steps = (t1 - t0) / self.period
        off = abs(steps - (round(steps) or t1 > t0))  # times of 1e9 s are known to 1e-7, and errors add up
        if off > LITTLE * SAID:
            raise ModelError(
                f"the model moves in steps of {self.period:g} s, but from t = {t0:.12g} to {t1:.12g} there "
                f"are {steps:.6g} of them: predict over whole steps, or give the model another period="
            )
        return round(steps)

    def starts(self, t0: float, t1: float) -> list[float]:
        """Return the times, seconds, at which the steps from one time to another begin."""
        return [t0 + k * self.period for k in range(self.own_steps(t0, t1))]

    def discretize(self, dt: float) -> tuple[Floats, Floats, Floats]:
        """Return (Phi, offset, Qd) with X(t+dt) = Phi X(t) + offset + N(0, Qd), exactly.

        Over dt seconds, whole steps; raises `ModelError` where the model is not known to be linear.
        """
        if not self.linear:
            raise ModelError(f"{self!r} is not known to be linear; write it as DiscreteModel.from_matrices")
        n, zero = self.dim, np.zeros((1, self.dim))
        J, b = self.jacobian(zero, 0.0)[0], self.transition(zero, 0.0)[0]
        F, G = J[:, :n], J[:, n:]
        Phi, offset, Qd, Q = np.eye(n), np.zeros(n), np.zeros((n, n)), G @ self.covariance @ G.T
        for _ in range(self.own_steps(0.0, validate.real("dt", dt))):
            Phi, offset, Qd = F @ Phi, F @ offset + b, F @ Qd @ F.T + Q
        return Phi, offset, 0.5 * (Qd + Qd.T)

    def drawn(self, x: Floats, t0: float, t1: float, root: Floats, rng: np.random.Generator) -> Floats:
        """Return states x (N, n) of time t0 moved to t1, with noise of their own, whose root L is (m, m).

        Raises `PropagationError` for a state that leaves the finite numbers.
        """
        for t in self.starts(t0, t1):
            moved = self.transition(x, t, rng.standard_normal((len(x), self.n_noise)) @ root.T)
            lost = np.flatnonzero(~np.isfinite(moved).all(axis=1))
            if lost.size:
                raise PropagationError(
                    f"the model blew up in the step at t = {t:g}: from {x[lost[0]]} to {moved[lost[0]]}. "
                    f"Check the transition and its parameters"
                )
            x = self.domain.wrap(moved)
        return x


def _noise_of(noise: Any, covariance: ArrayLike | None, n: int) -> tuple[Any, Floats | None]:
    """Noise g as it is given, the identity where only its covariance is; and that covariance, if given."""
    if noise is not None and not callable(noise):
        shape, m = np.shape(noise), None if covariance is None else len(np.atleast_2d(covariance))
        if len(shape) != 2 or shape[0] != n or m not in (None, shape[1]):
            raise ModelError(
                f"noise has shape {shape}, but it must be ({n}, {m or 'm'}): a column for each noise"
            )
    if covariance is None:
        if callable(noise):
            raise ModelError("noise= is a function: give covariance= of shape (m, m) too, it tells m")
        return (np.zeros((n, 1)) if noise is None else noise), None
    Q = validate.covariance("covariance", covariance, n if noise is None else None, definite=False)
    return (np.eye(n) if noise is None else noise), Q


def _own_noise(noise: Any, covariance: ArrayLike | None, m: int) -> Floats:
    """Covariance of the noise that a transition takes itself."""
    if noise is not None:
        raise ModelError("give noise=, or noises= that the transition itself takes, not both")
    given = np.eye(m) if covariance is None else covariance
    return validate.covariance("covariance", given, m, definite=False)
