"""Stochastic differential equations: drift, noise, and what is known about their structure.

dX = f(X, t) dt + g(X, t) dW with E[dW dWᵀ] = Q dt, hence D = g Q gᵀ / 2 (002 (1)–(5) with the errata).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import BatchFunction, Floats
from ..errors import ModelError
from . import derived
from .compile import Data, Maker, StateFunction, compile_rows, shared
from .discretization import transition
from .domain import DomainLike
from .dynamics import Dynamics, Functions, compiled
from .named import Inputs, Values
from .noise import Noise, constant_root, noise_parts, reads_time
from .tables import Tables
from .timing import roots

Interpretation: TypeAlias = Literal["ito", "stratonovich"]
_PART_OF_PERIOD = 1.0 / 8.0  # of a sine, that a step may take: one of order 4 misses (2π/8)⁵ / 5! = 2.5e-3
#: Rows of expressions or numbers.
Texts: TypeAlias = Sequence[Sequence[str | float]] | Floats


class SDE(Dynamics):
    """A stochastic differential equation, compiled once; parameters are data.

    Parameters
    ----------
    drift : callable
        f(x, t), f(x) or f(x, t, p) of one state x (n,), returning a tuple of n numbers; p holds the
        parameter values in the order of `parameters` (``p[0]``, ``p[1]``, ...). With `inputs` also
        f(x, t, u) or f(x, t, p, u). With `vectorized`, of X (N, n) → (N, n).
    dim : int
        n, the length of the state.
    noise : array_like (n, m) or callable, optional
        g, or g(x, t) returning n tuples of m numbers ((N, n, m) with `vectorized`). Without `noise` and
        `diffusion` the equation is deterministic.
    spectral_density : array_like (m, m), optional
        Q, in units of the noise squared per second, positive semidefinite. Identity if `noise` is a matrix
        and nothing is given; needed when `noise` is a function.
    diffusion : array_like (n, n) or callable, optional
        D itself, instead of `noise` and `spectral_density`; then g is a root of 2 D and Q the identity.
    parameters : mapping of str to float, optional
    inputs : sequence of str, or mapping of str to float, optional
        Names of what is held over each interval, such as controls, and their values where a prediction gives
        none (zero by default): ``flt.predict(dt, u=...)``.
    divergence : callable, optional
        ∇·f of the Itô drift, one number per state; else central differences of the drift are used.
    vectorized : bool
        The callables take all states at once, as numpy functions, and are not compiled.
    interpretation : {"ito", "stratonovich"}
    domain : Domain or sequence of its axes, optional
        Periodic axes (angles), and axes that end.
    max_step : float, optional
        Longest step of any scheme, seconds, where the model changes faster with time than it tells.
    events : array_like, shape (E,)
        Times at which the model jumps, seconds: no step goes over one.

    Attributes
    ----------
    dim, n_noise : int
        n and m.
    states : tuple of str
    parameters, inputs : mapping of str to float, read-only
    p : ndarray
        What the compiled functions take as p: values of parameters, then of inputs, then constants of the
        model.
    spectral_density : ndarray, shape (m, m)
    domain : Domain
    drift_batch, noise_batch, diffusion_batch, diffusion_divergence_batch, jacobian_batch, divergence_batch
        Compiled functions ``fill(x, t, p, out)`` with out of n, n·m, n·n, n, n·n and 1 columns. The drift is
        that of Itô, the Stratonovich term included.
    constant_diffusion : bool
        D depends on neither state nor time.
    state_dependent_noise : bool
        g depends on the state. For a callable, False only when its bytecode never reads the state.
    autonomous : bool
        Neither drift nor noise depends on time. For a callable, True only when it never reads t.
    linear : bool
        The drift is affine in the state with constant coefficients, the noise constant (provably), and no
        axis ends.
    max_step : float
        Longest step, seconds: the one given, or an eighth of the period of a text's fastest sine of t;
        infinite without either.
    events : ndarray, shape (E,)
    diffusion_rows : ndarray of bool, shape (n,)
        Rows of D that may differ from zero; exact when D is constant.

    Raises
    ------
    ModelError
        Wrong arity, shapes, NaN, Q not positive semidefinite, or a callable numba cannot compile.

    Examples
    --------
    >>> import sphfilter as sf
    >>> def oscillator(x, t, p):
    ...     return x[1], -p[0] * x[1] - x[0]
    >>> model = sf.SDE(oscillator, dim=2, noise=[[0.0], [1.0]], parameters={"damping": 0.5})
    >>> print(model.drift([[1.0, 0.0], [0.0, 2.0]], t=0.0))
    [[ 0. -1.]
     [ 2. -1.]]
    >>> print(model.with_parameters(damping=1.0).drift([[0.0, 2.0]], t=0.0))
    [[ 2. -2.]]
    """

    @validate.keywords
    def __init__(
        self,
        drift: StateFunction,
        dim: int,
        noise: Noise | None = None,
        spectral_density: ArrayLike | None = None,
        *,
        diffusion: Noise | None = None,
        parameters: Mapping[str, float] | None = None,
        divergence: StateFunction | None = None,
        vectorized: bool = False,
        interpretation: Interpretation = "ito",
        domain: DomainLike = None,
        max_step: float | None = None,
        events: ArrayLike = (),
        inputs: Inputs | None = None,
    ) -> None:
        recipe = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        n = validate.count("dim", dim)
        validate.choice("interpretation", interpretation, ("ito", "stratonovich"))
        values = Values.of(parameters, inputs)
        data = values.data
        parts = makers, Q, _, flags = noise_parts(noise, spectral_density, diffusion, n, data, vectorized)
        f = compile_rows(drift, (n,), "drift", n, data, vectorized)
        makers["drift"] = lambda fs: f
        if interpretation == "stratonovich" and flags["state_dependent_noise"]:
            if diffusion is not None:
                raise ModelError("A Stratonovich equation needs noise= instead of diffusion=.")
            makers["drift"] = lambda fs: derived.stratonovich_drift(f, fs["noise"], Q)
            makers["flow_drift"] = lambda fs: f
        if divergence is not None:
            given = compile_rows(divergence, (), "divergence", n, data, vectorized)
            makers["divergence"] = lambda fs: given
        flags["autonomous"] = flags["autonomous"] and not reads_time(drift, "drift", data)
        names = [f"x{i}" for i in range(n)]
        self._assemble((SDE, recipe), names, values, parts, domain, max_step, events)

    @classmethod
    @validate.keywords
    def from_expressions(
        cls,
        states: Sequence[str],
        drift: Sequence[str | float],
        noise: Texts | None = None,
        spectral_density: ArrayLike | None = None,
        parameters: Mapping[str, float] | None = None,
        interpretation: Interpretation = "ito",
        diffusion: Texts | None = None,
        domain: DomainLike = None,
        max_step: float | None = None,
        events: ArrayLike = (),
        inputs: Inputs | None = None,
        tables: Tables | None = None,
    ) -> "SDE":
        """Build a model from text; derivatives are symbolic.

        Parameters
        ----------
        states : sequence of str
            Names of the n states.
        drift : sequence of str, length n
        noise : nested sequence of str or float, shape (n, m), optional
        spectral_density : array_like (m, m), optional
            Identity if not given.
        parameters : mapping of str to float, optional
        interpretation : {"ito", "stratonovich"}
        diffusion : nested sequence of str or float, shape (n, n), optional
            D itself instead of noise.
        domain : Domain or sequence of its axes, optional
        max_step, events
            As for the constructor. Text knows by itself when conditions on t alone change, and how fast sines
            of t are.
        inputs : sequence of str, or mapping of str to float, optional
            As for the constructor.
        tables : mapping of str to Table or to (arguments, values), optional
            What ``table("name", t)`` calls. No step goes over an argument of a table of t, or of another
            function of time and parameters: those of t times a number are among the `events`.

        Raises
        ------
        ExpressionError
            Unknown name or forbidden syntax.
        ModelError
            Wrong lengths, or Q not positive semidefinite.

        Notes
        -----
        Allowed: states, t, parameters, numbers, pi, ``+ - * / **``, sin cos tan asin acos atan atan2 sinh
        cosh tanh exp log sqrt abs sign min max, where(condition, a, b) with comparisons, ``and``, ``or``, and
        table("name", a). A parameter, input or table that no expression uses is an error.

        Examples
        --------
        >>> import sphfilter as sf
        >>> model = sf.SDE.from_expressions(["x"], ["x - x**3"], noise=[["s"]], parameters={"s": 0.5})
        >>> print(model.drift([[2.0]], t=0.0), model.jacobian([2.0], t=0.0))
        [[-6.]] [[-11.]]
        """
        recipe = {k: v for k, v in locals().items() if k != "cls"}
        from .symbolic import Vocabulary, symbolic_model  # imports sympy, which takes a second

        validate.choice("interpretation", interpretation, ("ito", "stratonovich"))
        values = Values.of(parameters, inputs)
        words = Vocabulary.of(values, tables)
        parts = symbolic_model(states, drift, noise, diffusion, spectral_density, words, interpretation)
        self, made = cls.__new__(cls), (SDE.from_expressions, recipe)
        stops = np.concatenate([validate.array("events", events, (None,)), parts[-1].pop("breakpoints")])
        self._assemble(made, states, values, parts, domain, max_step, stops)
        return self

    def _assemble(
        self,
        recipe: tuple[Callable[..., "SDE"], dict[str, Any]],
        states: Sequence[str],
        values: Values,
        parts: tuple[dict[str, Maker], Floats, Floats, dict[str, Any]],
        domain: DomainLike = None,
        max_step: float | None = None,
        events: ArrayLike = (),
    ) -> None:
        """Set every attribute; the derived functions are compiled when first used.

        `parts` are the makers of the given functions, Q, the end of their data, and what is known of them.
        """
        makers, Q, tail, flags = parts
        self._made(recipe, states, len(Q), tail, domain)
        self._flags, self.spectral_density, self.n_columns = flags, Q, constant_root(0.5 * Q).shape[1]
        Q.setflags(write=False)
        flags["linear"] = flags["linear"] and not self.domain.walled.any()
        self._functions = _functions(makers, self.dim, Q, flags["state_dependent_noise"])
        self._longest = np.inf if max_step is None else validate.positive("max_step", max_step)
        self.events = np.unique(validate.array("events", events, (None,)))
        self.events.setflags(write=False)
        for name in ("constant_diffusion", "state_dependent_noise", "autonomous", "linear"):
            setattr(self, name, bool(flags[name]))
        self._set(values)
        self._functions["drift"]  # what is wrong with a drift should show now, not in a first step

    def _set(self, values: Values) -> None:
        super()._set(values)
        rows = np.array(self._flags.get("diffusion_rows", np.ones(self.dim, dtype=bool)))
        if self.constant_diffusion:
            D = self.diffusion(np.zeros((1, self.dim)), 0.0)[0]
            if np.isfinite(D).all():  # inputs that it divides by may be none yet
                validate.covariance("the diffusion of the noise", D, definite=False)
            rows = np.any(D != 0.0, axis=1)
        rows.setflags(write=False)
        self.diffusion_rows = rows
        fastest = np.abs(self._at("frequencies", 0.0)).max(initial=0.0)
        self.max_step = min(self._longest, _PART_OF_PERIOD * 2.0 * np.pi / fastest if fastest else np.inf)

    def _at(self, name: str, t: float) -> Floats:
        """What text knows about its times: "switches", "frequencies" or "tabled", all that it has of them."""
        k = self._flags.get(name, 0)
        if not k:
            return np.empty(0)
        return self._evaluate(self._functions[name], np.zeros(self.dim), t, k)[0]

    def breaks(self, t0: float, t1: float) -> Floats:
        """Return the times in [t0, t1] at which the model jumps by itself, sorted: events, jumps of text."""
        inside = self.events[(self.events >= t0) & (self.events <= t1)]
        if not (self._flags.get("switches") or self._flags.get("tabled")):
            return inside
        return np.unique([*inside, *roots(self._conditions, t0, t1, self.max_step)])

    def _conditions(self, t: float) -> Floats:
        """Numbers of t that are zero where text switches, or comes to an argument of a table."""
        tabled = zip(self._at("tabled", t), self._flags.get("tables", ()), strict=True)
        return np.concatenate([self._at("switches", t), *(own - at for own, at in tabled)])

    def own_steps(self, t0: float, t1: float) -> int:
        """Return the steps of an interval, where accuracy has no say in them: one, if linear; else 0."""
        return 1 if self.linear else 0

    # --- compiled functions ---

    drift_batch: BatchFunction = compiled("drift", "Itô drift f, (N, n).")
    noise_batch: BatchFunction = compiled("noise", "g, row-major, (N, n m).")
    diffusion_batch: BatchFunction = compiled("diffusion", "D, row-major, (N, n n).")
    diffusion_divergence_batch: BatchFunction = compiled(
        "diffusion_divergence", "∇·D, (N, n); zeros for uniform D."
    )
    diffusion_curvature_batch: BatchFunction = compiled("diffusion_curvature", "∇·∇·D, (N, 1).")
    jacobian_batch: BatchFunction = compiled("jacobian", "∂f_a/∂x_j, row-major, (N, n n).")
    divergence_batch: BatchFunction = compiled("divergence", "∇·f, (N, 1).")
    flow_drift_batch: BatchFunction = compiled(
        "flow_drift",
        "Stratonovich drift, (N, n): what moves states beside the noise, where this is smooth in time.",
    )
    flow_jacobian_batch: BatchFunction = compiled(
        "flow_jacobian", "Jacobian of the Stratonovich drift, row-major, (N, n n)."
    )
    flow_divergence_batch: BatchFunction = compiled(
        "flow_divergence", "Divergence of the Stratonovich drift, (N, 1)."
    )
    noise_columns_batch: BatchFunction = compiled(
        "noise_columns",
        "c = g R, row-major, with Q = R Rᵀ and R (m, r) of full rank; then ∇·c: (N, (n + 1) r).",
    )

    # --- evaluation from Python ---

    def drift(self, X: ArrayLike, t: float) -> Floats:
        """Return the Itô drift at X (N, n), shape (N, n)."""
        return self._evaluate(self.drift_batch, X, t, self.dim)

    def noise(self, X: ArrayLike, t: float) -> Floats:
        """Return g at X (N, n), shape (N, n, m)."""
        return self._evaluate(self.noise_batch, X, t, self.dim, self.n_noise)

    def diffusion(self, X: ArrayLike, t: float) -> Floats:
        """Return D = g Q gᵀ / 2 at X (N, n), shape (N, n, n)."""
        return self._evaluate(self.diffusion_batch, X, t, self.dim, self.dim)

    def diffusion_divergence(self, X: ArrayLike, t: float) -> Floats:
        """Return Σ_j ∂_j D_ij at X (N, n), shape (N, n)."""
        return self._evaluate(self.diffusion_divergence_batch, X, t, self.dim)

    def jacobian(self, x: ArrayLike, t: float) -> Floats:
        """Return ∂f_i/∂x_j of the drift at one state x (n,), shape (n, n)."""
        return self._evaluate(self.jacobian_batch, x, t, self.dim, self.dim)[0]

    def divergence(self, X: ArrayLike, t: float) -> Floats:
        """Return ∇·f of the drift at X (N, n), shape (N,)."""
        return self._evaluate(self.divergence_batch, X, t)

    def to_linear(self) -> "LinearSDE":
        """Return the equal `LinearSDE` of a model whose `linear` is True; raises `ModelError` of another."""
        if not self.linear:
            raise ModelError(f"{self!r} is not known to be linear; write it as LinearSDE(A=..., b=...).")
        origin = np.zeros((1, self.dim))
        A, b, g = self.jacobian(origin[0], 0.0), self.drift(origin, 0.0)[0], self.noise(origin, 0.0)[0]
        return LinearSDE(A=A, b=b, noise=g, spectral_density=self.spectral_density)

    def discretize(self, dt: float) -> tuple[Floats, Floats, Floats]:
        """Return (Phi, offset, Qd) with X(t+dt) = Phi X(t) + offset + N(0, Qd), of a linear model.

        Raises `ModelError` where the model is not known to be linear.
        """
        return self.to_linear().discretize(dt)


class LinearSDE(SDE):
    """dX = (A X + B u + b) dt + g dW with constant A, B, b and g.

    Parameters
    ----------
    A : array_like, shape (n, n)
    b : array_like, shape (n,), optional
    noise : array_like, shape (n, m), optional
    spectral_density : array_like, shape (m, m), optional
        Identity if not given.
    B : array_like, shape (n, k), optional
        What the k inputs u0, u1, ... do, which are held over each interval: ``flt.predict(dt, u=...)``.

    Examples
    --------
    >>> import sphfilter as sf
    >>> model = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.5]], noise=[[0.0], [1.0]])
    >>> print(model.linear, model.drift([[1.0, 0.0]], t=0.0))
    True [[ 0. -1.]]
    """

    @validate.keywords
    def __init__(
        self,
        A: ArrayLike,
        b: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        spectral_density: ArrayLike | None = None,
        B: ArrayLike | None = None,
    ) -> None:
        recipe = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        A = validate.square("A", A)
        n = len(A)
        b = np.zeros(n) if b is None else validate.array("b", b, (n,))
        B = np.zeros((n, 0)) if B is None else validate.array("B", B, (n, None), "a column for each input")
        if callable(noise):
            raise ModelError("The noise of a LinearSDE is a constant matrix; use SDE for a function.")
        parts = makers, _, _, flags = noise_parts(noise, spectral_density, None, n, Data(), False)
        makers["drift"] = lambda fs: shared(derived.linear_drift)
        makers["jacobian"] = lambda fs: shared(derived.linear_jacobian)
        makers["divergence"] = lambda fs: shared(derived.linear_divergence)
        flags["linear"] = True
        self.A, self.b, self.B, self._own_b = A, b, B, b
        values = Values.of(None, [f"u{k}" for k in range(B.shape[1])])
        self._assemble((LinearSDE, recipe), [f"x{i}" for i in range(n)], values, parts)

    def _data(self, data: Data) -> Floats:
        """A, b with what the inputs add to it, and the noise."""
        self.b = self._own_b + self.B @ data.u
        return np.concatenate([self.A.ravel(), self.b, self._tail])

    def to_linear(self) -> "LinearSDE":
        """Return the model itself."""
        return self

    def discretize(self, dt: float) -> tuple[Floats, Floats, Floats]:
        """Return (Phi, offset, Qd) with X(t+dt) = Phi X(t) + offset + N(0, Qd), exactly, dt >= 0 seconds."""
        dt = validate.real("dt", dt)
        if dt < 0:
            raise ModelError(f"dt must not be negative, got {dt!r}.")
        g = self.noise(np.zeros((1, self.dim)), 0.0)[0]
        return transition(self.A, self.b, g @ self.spectral_density @ g.T, dt)


def _functions(makers: dict[str, Maker], n: int, Q: Floats, by_state: bool) -> Functions:
    """Compiled functions of an equation, of which those of the `makers` are given."""
    derive: dict[str, Maker] = {
        "jacobian": lambda fs: derived.jacobian_from(fs["drift"], n),
        "divergence": lambda fs: derived.trace_from(fs["jacobian"]),
        "flow_drift": lambda fs: derived.stratonovich_drift(fs["drift"], fs["noise"], -Q),
        "flow_jacobian": lambda fs: derived.jacobian_from(fs["flow_drift"], n),
        "flow_divergence": lambda fs: derived.trace_from(fs["flow_jacobian"]),
        "diffusion_curvature": lambda fs: derived.trace_from(
            derived.jacobian_from(fs["diffusion_divergence"], n)
        ),
        "noise_columns": lambda fs: derived.noise_columns(fs["noise"], constant_root(0.5 * Q)),
    }
    if not by_state:  # then Stratonovich's drift is Itô's
        derive["flow_drift"] = lambda fs: fs["drift"]
        derive["flow_jacobian"] = lambda fs: fs["jacobian"]
        derive["flow_divergence"] = lambda fs: fs["divergence"]
    return Functions(derive | makers)
