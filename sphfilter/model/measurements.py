"""Measurement models: what a sensor reads in a state, and how likely a reading is."""

import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeGuard

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from .. import validate
from .._types import Bools, Floats, Ints, Seed
from ..errors import ModelError
from .compile import StateFunction, compile_rows, probe, surfacing

__all__ = ["GaussianMeasurement", "GaussianSensor", "LikelihoodMeasurement", "Reading", "Sensor",
           "is_gaussian"]  # fmt: skip

#: loglik(z, X, t) → (N,), and sample(X, t, rng) → (N, k).
LogLikelihood: TypeAlias = Callable[[Floats, Floats, float], ArrayLike]
Sampler: TypeAlias = Callable[[Floats, float, np.random.Generator], ArrayLike]
#: peaks(z) → (M, n), states.
Peaks: TypeAlias = Callable[[Floats], ArrayLike]

_NO_PARAMETERS = np.empty(0)
_DIFFERENT = (
    "The sensor's h is of {} states, but the state has {}: h has a column, or a name, for each state."
)


class Reading(NamedTuple):
    """What a sensor said: its numbers z (k,), NaN where none came, and which did, bool (k,)."""

    z: Floats
    seen: Bools

    @classmethod
    def of(cls, z: ArrayLike | None, k: int | None = None) -> "Reading":
        """Return a measurement as a reading of k numbers; None is one of which nothing came.

        Raises
        ------
        ModelError
            It is not k numbers or NaN, or infinite.
        """
        if z is None:
            return cls(np.full(k or 1, np.nan), np.zeros(k or 1, dtype=bool))
        try:
            z = np.array(validate.column(validate.unmasked(z)), dtype=float, ndmin=1)
        except (TypeError, ValueError) as error:
            raise ModelError(f"A measurement must be {k or 'k'} numbers or NaN, got {z!r}.") from error
        if z.ndim != 1 or (k is not None and len(z) != k):
            raise ModelError(f"The measurement has shape {z.shape}, but the sensor gives ({k or 'k'},).")
        if np.isinf(z).any():
            raise ModelError(f"The measurement {z} is infinite; use NaN for a missing component.")
        return cls(z, np.isfinite(z))


class Sensor(Protocol):
    """What the update of a density asks of any sensor, the two classes here or one of a user's own."""

    @property
    def noise_cov(self) -> Floats | None:
        """R, shape (k, k); None for a sensor without Gaussian noise."""

    @property
    def H(self) -> Floats | None:
        """The matrix of a linear sensor, shape (k, n); None for any other."""

    @property
    def angles(self) -> tuple[int, ...]:
        """Components of z that are angles in radians."""

    @property
    def directly_observed(self) -> tuple[Ints, Floats] | None:
        """State indices and scales (k,), where every component of z reads one state of its own."""

    def observed(self, z: ArrayLike | None) -> Bools:
        """Return which components of z came, shape (k,)."""

    def log_likelihood(self, z: ArrayLike | None, X: Floats, t: float = 0.0) -> Floats:
        """Return log p(z | x) for each state X (N, n), shape (N,)."""


class GaussianSensor(Sensor, Protocol):
    """A sensor with Gaussian noise, of which readings can be predicted."""

    @property
    def noise_cov(self) -> Floats:
        """R, shape (k, k)."""

    def predict(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return the noise-free reading in each state X (N, n), shape (N, k)."""

    def residual(self, z: ArrayLike, zhat: ArrayLike) -> Floats:
        """Return z − zhat (..., k), angles wrapped to (−π, π]."""


def is_gaussian(sensor: Sensor) -> TypeGuard[GaussianSensor]:
    """Whether a sensor has a noise covariance."""
    return sensor.noise_cov is not None


class GaussianMeasurement:
    """z = h(x, t) + v with v ~ N(0, R) (002 (2)).

    Parameters
    ----------
    h : array_like (k, n) or callable
        Matrix H, or h(x) or h(x, t) of one state returning a tuple of k numbers; with `vectorized`, of
        X (N, n) returning (N, k).
    noise_cov : array_like, shape (k, k)
        R, the covariance of one reading, positive definite, in squared units of z.
    angles : sequence of int
        Components of z that are angles in radians: their differences are wrapped to (−π, π]. The density then
        counts the nearest turn only, which is exact as long as the standard deviation is well below π.
    vectorized : bool
        `h` takes all states at once and is not compiled.

    Attributes
    ----------
    dim_z : int
        k.
    noise_cov : ndarray, shape (k, k)
    H : ndarray, shape (k, n), or None
        None when h is a function.
    angles : tuple of int
    directly_observed : tuple of (ndarray of int (k,), ndarray (k,)), or None
        State indices and scales when each row of H has one non-zero entry, in distinct columns, and R is
        diagonal; else None.

    Raises
    ------
    ModelError
        Shapes that do not fit, R not positive definite, or an `h` that cannot be compiled.

    Examples
    --------
    >>> import sphfilter as sf
    >>> position = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
    >>> print(position.predict([[3.0, 1.0], [4.0, 0.0]]).ravel())
    [3. 4.]
    >>> distance = sf.GaussianMeasurement(h=lambda x: (x[0] ** 2 + x[1] ** 2,), noise_cov=[[0.1]])
    >>> print(distance.log_likelihood([25.0], [[3.0, 4.0]]).round(4))
    [0.2324]
    """

    def __init__(
        self,
        h: ArrayLike | StateFunction,
        noise_cov: ArrayLike,
        angles: Iterable[int] = (),
        vectorized: bool = False,
    ) -> None:
        self.noise_cov = validate.covariance("noise_cov", noise_cov)
        self.noise_cov.setflags(write=False)
        self.dim_z = len(self.noise_cov)
        if isinstance(angles, str) or not isinstance(angles, Iterable):
            raise ModelError(f"angles must list components of z, such as angles=[0], got {angles!r}.")
        angles = tuple(angles)
        self.angles = tuple(sorted({validate.count("angles", a, least=0) for a in angles}))
        if self.angles and self.angles[-1] >= self.dim_z:
            raise ModelError(f"angles names component {self.angles[-1]}, but z has {self.dim_z} (from 0).")
        self._recipe: tuple[Any, Any, tuple[int, ...], bool] = (h, noise_cov, angles, vectorized)
        self._factors: dict[bytes, tuple[Floats, float]] = {}
        self._tried: set[int] = set()
        self.H: Floats | None = None
        if callable(h):
            self._fill = compile_rows(h, (self.dim_z,), "h", None, _NO_PARAMETERS, vectorized)
        else:
            self.H = validate.array("h", h, (None, None))
            if len(self.H) != self.dim_z:
                raise ModelError(
                    f"h of shape {self.H.shape} and noise_cov of shape {self.noise_cov.shape} do not fit: "
                    "both need a row for each component of z."
                )
            self.H.setflags(write=False)
        self.directly_observed = self._direct()

    @classmethod
    def from_expressions(
        cls, states: Sequence[str], h: Sequence[str], noise_cov: ArrayLike, angles: Iterable[int] = ()
    ) -> "GaussianMeasurement":
        """Build a sensor from text, as `SDE.from_expressions` builds a model.

        Parameters
        ----------
        states : sequence of str
            Names of the n states.
        h : sequence of str, length k
            Readings as expressions of the states and t.
        noise_cov, angles
            As for the constructor.

        Raises
        ------
        ExpressionError
            Unknown name or forbidden syntax.
        """
        return cls(_Expressions(states, h), noise_cov, angles, vectorized=True)

    def changed(
        self, noise_cov: ArrayLike | None = None, h: ArrayLike | StateFunction | None = None
    ) -> "GaussianMeasurement":
        """The same sensor with another noise covariance, a number r for R = r I, or another h."""
        own_h, own_cov, angles, vectorized = self._recipe
        if noise_cov is None:
            noise_cov = own_cov
        elif np.ndim(noise_cov) == 0:
            noise_cov = validate.positive("noise_cov", noise_cov) * np.eye(self.dim_z)
        if h is None:
            return GaussianMeasurement(own_h, noise_cov, angles, vectorized)
        return GaussianMeasurement(h, noise_cov, angles)

    def __reduce__(self) -> tuple[Any, ...]:
        return GaussianMeasurement, self._recipe

    def __repr__(self) -> str:
        h = _name(self._recipe[0]) if self.H is None else validate.short(self.H.tolist())
        angles = f", angles={list(self.angles)}" if self.angles else ""
        return f"GaussianMeasurement(h={h}, noise_cov={validate.short(self.noise_cov.tolist())}{angles})"

    def predict(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return the noise-free reading in each state X (N, n), shape (N, k)."""
        X = np.array(X, dtype=float, order="C", ndmin=2)
        self.check_dim(X.shape[1])
        if self.H is not None:
            return X @ self.H.T
        out = np.empty((len(X), self.dim_z))
        with surfacing():
            self._fill(X, float(t), _NO_PARAMETERS, out)
        return out

    def check_dim(self, n: int) -> None:
        """Raise `ModelError` if the sensor cannot read states of length n."""
        if self.H is not None:
            if n != self.H.shape[1]:
                raise ModelError(_DIFFERENT.format(self.H.shape[1], n))
        elif n not in self._tried:
            h, _, _, vectorized = self._recipe
            probe(h, (self.dim_z,), "h", n, _NO_PARAMETERS, vectorized)
            self._tried.add(n)

    def residual(self, z: ArrayLike, zhat: ArrayLike) -> Floats:
        """Return z − zhat (..., k), angles wrapped to (−π, π]."""
        r = np.asarray(z, dtype=float) - np.asarray(zhat, dtype=float)
        for a in self.angles:
            r[..., a] -= 2 * np.pi * np.ceil((r[..., a] - np.pi) / (2 * np.pi))
        return r

    def jacobian(self, x: ArrayLike, t: float = 0.0) -> Floats:
        """Return ∂h/∂x at one state x (n,), shape (k, n): H, or central differences."""
        if self.H is not None:
            return self.H.copy()
        x = np.asarray(x, dtype=float)
        steps = np.diag(np.finfo(float).eps ** (1 / 3) * np.maximum(1.0, np.abs(x)))
        above, below = x + steps, x - steps
        rise = self.residual(self.predict(above, t), self.predict(below, t))
        return (rise / np.diag(above - below)[:, None]).T

    def observed(self, z: ArrayLike | None) -> Bools:
        """Return which components of z were measured, bool (k,): NaN (or None for all) means missing.

        Raises
        ------
        ModelError
            z of the wrong length, or infinite.
        """
        return self.reading(z).seen

    def reading(self, z: ArrayLike | None) -> Reading:
        """Return z as a `Reading`; see `observed`."""
        return Reading.of(z, self.dim_z)

    def log_likelihood(self, z: ArrayLike | None, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return log p(z | x) for each state X (N, n), shape (N,), with its normalising constant.

        Missing components are left out, with their rows and columns of R; all missing gives zeros.
        """
        z, seen = self.reading(z)
        if not seen.any():
            return np.zeros(np.shape(X)[0])
        whiten, constant = self._factor(seen)
        # a state where h is undefined gives NaN here, for the caller to judge
        y = self.residual(z, self.predict(X, t))[:, seen] @ whiten
        return constant - 0.5 * np.einsum("ik,ik->i", y, y)

    def sample(self, x: ArrayLike, t: float = 0.0, rng: Seed = None) -> Floats:
        """Draw readings of one state (n,) → (k,), or of many (N, n) → (N, k); angles in (−π, π]."""
        zhat = self.predict(x, t)
        noise = validate.generator(rng).standard_normal(zhat.shape) @ np.linalg.cholesky(self.noise_cov).T
        z = self.residual(zhat + noise, 0.0)
        return z[0] if np.ndim(x) == 1 else z

    def _factor(self, seen: Bools) -> tuple[Floats, float]:
        """Return L^-T for R = L Lᵀ, observed block, and the log of the normalising constant.

        Residuals are multiplied by it: on tall, narrow arrays a triangular solve costs a hundred times more.
        """
        key = seen.tobytes()
        if key not in self._factors:
            L = np.linalg.cholesky(self.noise_cov[np.ix_(seen, seen)])
            constant = -np.log(np.diag(L)).sum() - 0.5 * len(L) * np.log(2 * np.pi)
            self._factors[key] = solve_triangular(L, np.eye(len(L)), lower=True).T, constant
        return self._factors[key]

    def _direct(self) -> tuple[Ints, Floats] | None:
        if self.H is None or self.angles or not np.all((self.H != 0).sum(axis=1) == 1):
            return None
        columns = np.argmax(self.H != 0, axis=1)
        diagonal = np.count_nonzero(self.noise_cov - np.diag(np.diag(self.noise_cov))) == 0
        if len(set(columns)) < self.dim_z or not diagonal:
            return None
        return columns, self.H[np.arange(self.dim_z), columns]


class _Expressions:
    """h(X, t) of a sensor given as text; copies are made from the text."""

    def __init__(self, states: Sequence[str], texts: Sequence[str]) -> None:
        from .symbolic import symbolic_rows  # imports sympy, which takes a second

        self.states, self.expressions = tuple(states), tuple(texts)
        self._fill = symbolic_rows(states, texts, "h")

    def __reduce__(self) -> tuple[Any, ...]:
        return _Expressions, (self.states, self.expressions)

    def __repr__(self) -> str:
        return validate.short(list(self.expressions))

    def __call__(self, X: Floats, t: float) -> Floats:
        """Return the readings (N, k) in the states X (N, n)."""
        if X.shape[1] != len(self.states):
            raise ModelError(_DIFFERENT.format(len(self.states), X.shape[1]))
        out = np.empty((len(X), len(self.expressions)))
        self._fill(X, t, _NO_PARAMETERS, out)
        return out


class LikelihoodMeasurement:
    """Any sensor whose likelihood can be computed.

    Parameters
    ----------
    loglik : callable
        loglik(z, X, t) → (N,): log p(z | x) of every state X (N, n); −inf where z is impossible. It should
        contain its normalising constant, or the evidence lacks it.
    dim_z : int, optional
        Length of z; not checked when None.
    sample : callable, optional
        sample(X, t, rng) → (N, k), for simulation.
    peaks : callable, optional
        peaks(z) → (M, n): states at which the likelihood of z may be far higher than around, so that a
        lattice would overlook them.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> counter = sf.LikelihoodMeasurement(lambda z, X, t: z[0] * X[:, 0] - np.exp(X[:, 0]))  # a Poisson rate
    >>> print(counter.log_likelihood([3.0], np.log([[1.0], [3.0]])).round(3))
    [-1.     0.296]
    """

    H: None = None
    directly_observed: None = None
    noise_cov: None = None
    angles: tuple[int, ...] = ()

    def __init__(
        self,
        loglik: LogLikelihood,
        dim_z: int | None = None,
        sample: Sampler | None = None,
        peaks: Peaks | None = None,
    ) -> None:
        if not callable(loglik):
            raise ModelError(f"loglik must be a function (z, X, t) -> (N,), got {loglik!r}.")
        _check_arguments(loglik)
        self.dim_z = None if dim_z is None else validate.count("dim_z", dim_z)
        self._loglik, self._sample, self.peaks = loglik, sample, peaks

    def __repr__(self) -> str:
        return f"LikelihoodMeasurement(loglik={_name(self._loglik)}, dim_z={self.dim_z})"

    def observed(self, z: ArrayLike | None) -> Bools:
        """Return which components of z were measured, bool (k,); all False for None."""
        return self.reading(z).seen

    def reading(self, z: ArrayLike | None) -> Reading:
        """Return z as a `Reading`."""
        return Reading.of(z, self.dim_z)

    def log_likelihood(self, z: ArrayLike | None, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return log p(z | x) for each state X (N, n), shape (N,); zeros when all of z is missing."""
        X = np.asarray(X, dtype=float)
        z, seen = self.reading(z)
        if not seen.any():
            return np.zeros(len(X))
        value = np.array(self._loglik(z, X, t) if len(X) else [], dtype=float)
        if value.shape != (len(X),):
            raise ModelError(f"loglik returned shape {value.shape}; ({len(X)},) is needed, one per state.")
        wrong = np.flatnonzero(np.isnan(value) | (value == np.inf))
        if wrong.size:
            raise ModelError(
                f"loglik returned {value[wrong[0]]} at state {X[wrong[0]]}; "
                "it must be finite, or -inf where z is impossible."
            )
        return value

    def sample(self, x: ArrayLike, t: float = 0.0, rng: Seed = None) -> Floats:
        """Draw readings of one state (n,) → (k,), or of many (N, n) → (N, k)."""
        if self._sample is None:
            raise ModelError("This LikelihoodMeasurement cannot be simulated; give it sample=f(X, t, rng).")
        X = np.array(x, dtype=float, ndmin=2)
        z = np.array(self._sample(X, t, validate.generator(rng)), dtype=float).reshape(len(X), -1)
        return z[0] if np.ndim(x) == 1 else z


def _check_arguments(loglik: Callable[..., object]) -> None:
    """Refuse a likelihood that cannot be called with (z, X, t), where its signature is known."""
    try:
        signature = inspect.signature(loglik)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None, None, None)
    except TypeError:
        raise ModelError(
            f"loglik must be a function of (z, X, t), but its arguments are {signature}."
        ) from None


def _name(function: object) -> str:
    """Name of a function, or the text of what has none."""
    return getattr(function, "__name__", None) or repr(function)
