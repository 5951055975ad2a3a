"""Measurement models: what a sensor reads in a state, and how likely a reading is."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TypeGuard

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from .. import validate
from .._types import BatchFunction, Bools, Floats, Ints, Seed
from ..core._addresses import address_of
from ..core.limits import DIFFERENCE, LOG_2_PI
from ..errors import ModelError
from .compile import StateFunction, compile_rows, filled, probe
from .named import Adjustable, Inputs, Values
from .tables import Tables

_DIFFERENT = (
    "The sensor's h is of {} states, but the state has {}: h has a column, or a name, for each state."
)
#: What of a sensor stays as it is made: likelihoods keep what follows from it.
_STAYS = "noise_cov", "H", "angles", "dim_z", "directly_observed"


class Reading(NamedTuple):
    """A reading of a sensor: its numbers z (k,), NaN where none came, and which did, bool (k,)."""

    z: Floats
    seen: Bools

    @classmethod
    def of(cls, z: ArrayLike | None, k: int | None = None, name: str = "") -> "Reading":
        """Return a measurement, of a sensor of that name, as a reading of k numbers; None: nothing came.

        Raises `ModelError` if it is not k numbers or NaN, or infinite.
        """
        if z is None:
            return cls(np.full(k or 1, np.nan), np.zeros(k or 1, dtype=bool))
        try:
            z = np.array(z if type(z) is np.ndarray else validate.unmasked(z), dtype=float, ndmin=1)
        except (TypeError, ValueError) as error:
            raise ModelError(f"A measurement must be {k or 'k'} numbers or NaN, got {z!r}.") from error
        z = z[:, 0] if z.ndim == 2 and z.shape[1] == 1 else z
        if z.ndim != 1 or (k is not None and len(z) != k):
            sensor = f"the sensor {name!r}" if name else "the sensor"
            raise ModelError(f"The measurement has shape {z.shape}, but {sensor} gives ({k or 'k'},).")
        seen = np.isfinite(z)
        if np.count_nonzero(seen) < len(z) and np.isinf(z).any():
            raise ModelError(f"The measurement {z} is infinite; use NaN for a missing component.")
        return cls(z, seen)


class Sensor(Protocol):
    """The interface of a sensor that an update asks: of the two classes here, or of a user's own."""

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


class Predicting(Sensor, Protocol):
    """A sensor of which readings can be predicted."""

    def predict(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return the noise-free reading in each state X (N, n), shape (N, k)."""

    def residual(self, z: ArrayLike, zhat: ArrayLike) -> Floats:
        """Return z − zhat (..., k), angles wrapped to (−π, π]."""


class GaussianSensor(Predicting, Protocol):
    """A sensor with Gaussian noise, the same in all states."""

    @property
    def noise_cov(self) -> Floats:
        """R, shape (k, k)."""


class NoisySensor(Predicting, Protocol):
    """A sensor with Gaussian noise, which may be another in each state."""

    dim_z: int

    def reading(self, z: ArrayLike | None) -> Reading:
        """Return z as a `Reading` of k numbers."""

    def covariance(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return R in each state X (N, n), shape (N, k, k)."""


def is_gaussian(sensor: Sensor) -> TypeGuard[GaussianSensor]:
    """Whether a sensor has one noise covariance for all states."""
    return sensor.noise_cov is not None


def has_gaussian_noise(sensor: object) -> TypeGuard[NoisySensor]:
    """Whether the readings of a sensor in a state are Gaussian, in every state."""
    return getattr(sensor, "gaussian_noise", False) is True


def has_own_likelihood(sensor: object) -> bool:
    """Whether a sensor reads, and its likelihood is, as `GaussianMeasurement` says, whatever its class."""
    kind, names = type(sensor), ("predict", "residual", "reading", "covariance", "log_likelihood")
    return all(getattr(kind, name, None) is getattr(GaussianMeasurement, name) for name in names)


class PlainSensor:
    """What most sensors are, or have: no known matrix or noise, and readings of `dim_z` numbers."""

    H: Floats | None = None
    directly_observed: tuple[Ints, Floats] | None = None
    noise_cov: Floats | None = None
    angles: tuple[int, ...] = ()
    dim_z: Any = None  # length of z; not checked when None

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


class GaussianMeasurement(PlainSensor, Adjustable):
    """z = h(x, t) + v with v ~ N(0, R) (002 (2)); R may depend on state and time too.

    Parameters
    ----------
    h : array_like (k, n) or callable
        Matrix H, or h(x), h(x, t) or h(x, t, p) of one state returning a tuple of k numbers; with
        `vectorized`, of X (N, n) returning (N, k). With `inputs` also h(x, t, u) or h(x, t, p, u).
    noise_cov : array_like, shape (k, k), or callable
        R, the covariance of one reading, positive definite, in squared units of z; or a function of the same
        arguments as `h`, returning k tuples of k numbers ((N, k, k) with `vectorized`).
    angles : sequence of int
        Components of z that are angles in radians: their differences are wrapped to (−π, π]. The density then
        counts the nearest turn only, which is exact as long as the standard deviation is well below π.
    vectorized : bool
        `h`, and `noise_cov` if it is a function, take all states at once and are not compiled.
    parameters : mapping of str to float, optional
        Values that the functions get as p, in this order; `fit_parameters` can fit them.
    inputs : sequence of str, or mapping of str to float, optional
        Inputs that the functions get as u. A filter's sensor has the values that the model's inputs of the
        same names had in the prediction before.
    dim_z : int, optional
        k, where both `h` and `noise_cov` are functions.

    Attributes
    ----------
    dim_z : int
        k.
    noise_cov : ndarray, shape (k, k), or None
        None when R is a function, or a text that names states or t; see `covariance`.
    H : ndarray, shape (k, n), or None
        None when h or R is a function, or a text that is no matrix times the states.
    angles : tuple of int
    parameters, inputs : mapping of str to float, read-only
    directly_observed : tuple of (ndarray of int (k,), ndarray (k,)), or None
        State indices and scales when each row of H has one non-zero entry, in distinct columns, and R is
        diagonal; else None.

    Raises
    ------
    ModelError
        Shapes that do not fit, R not positive definite, or a function that cannot be compiled.

    Examples
    --------
    >>> import sphfilter as sf
    >>> position = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
    >>> print(position.predict([[3.0, 1.0], [4.0, 0.0]]).ravel())
    [3. 4.]
    >>> distance = sf.GaussianMeasurement(h=lambda x: (x[0] ** 2 + x[1] ** 2,), noise_cov=[[0.1]])
    >>> print(distance.log_likelihood([25.0], [[3.0, 4.0]]).round(4))
    [0.2324]
    >>> radar = sf.GaussianMeasurement.from_expressions(
    ...     ["x", "y"], ["sqrt(x**2 + y**2) + b"], [["s*(1 + x**2 + y**2)"]], parameters={"b": 0.5, "s": 0.01}
    ... )
    >>> print(radar.predict([3.0, 4.0]), radar.with_parameters(b=0.0).covariance([3.0, 4.0]))
    [[5.5]] [[[0.26]]]
    """

    _called = "The sensor"
    gaussian_noise = True
    dim_z: int
    _matrix: Floats | None  # h, whatever R is
    _fill: BatchFunction | None
    _noise: BatchFunction | None
    _linear = _constant = False  # whether the text of h is linear, and that of R the same everywhere
    _n: int | None  # states, where known

    @validate.keywords
    def __init__(
        self,
        h: ArrayLike | StateFunction,
        noise_cov: ArrayLike | StateFunction,
        angles: Iterable[int] = (),
        vectorized: bool = False,
        *,
        parameters: Mapping[str, float] | None = None,
        inputs: Inputs | None = None,
        dim_z: int | None = None,
    ) -> None:
        recipe = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        values = Values.of(parameters, inputs)
        self._begin(GaussianMeasurement, recipe | {"angles": tuple(_listed(angles))}, values)
        self._set_noise(noise_cov, vectorized, h, dim_z)
        if callable(h):
            self._fill = compile_rows(h, (self.dim_z,), "h", None, values.data, vectorized)
        else:
            self._set_matrix(h)
        self._finish(angles)

    @classmethod
    @validate.keywords
    def from_expressions(
        cls,
        states: Sequence[str],
        h: Sequence[str],
        noise_cov: ArrayLike | Sequence[Sequence[str | float]],
        angles: Iterable[int] = (),
        *,
        parameters: Mapping[str, float] | None = None,
        inputs: Inputs | None = None,
        tables: Tables | None = None,
    ) -> "GaussianMeasurement":
        """Build a sensor from text, as `SDE.from_expressions` builds a model.

        Parameters
        ----------
        states : sequence of str
            Names of the n states.
        h : sequence of str, length k
            Readings as expressions of the states, t, parameters, inputs and tables; linear ones have `H`.
        noise_cov : array_like, shape (k, k), or nested sequence of str or float
            Numbers, or expressions; where these name neither states nor t, `noise_cov` are their values.
        angles, parameters, inputs
            As for the constructor.
        tables : mapping of str to Table or to (arguments, values), optional
            What ``table("name", ...)`` calls.

        Raises
        ------
        ExpressionError
            Unknown name or forbidden syntax.
        """
        recipe = {k: v for k, v in locals().items() if k != "cls"}
        from .symbolic import Vocabulary, degree_of, symbolic_rows  # imports sympy, which takes a second

        values, self = Values.of(parameters, inputs), cls.__new__(cls)
        words = Vocabulary.of(values, tables)
        names = words.with_states(states)
        self._begin(GaussianMeasurement.from_expressions, recipe | {"angles": tuple(_listed(angles))}, values)
        self._n = len(states)
        self._fill = symbolic_rows(states, h, "h", names)
        self._linear = degree_of(h, names) == 1
        texts = _texts(noise_cov)
        if texts is None:
            self._set_noise(noise_cov, False, h, None)
        else:
            self.dim_z = len(texts)
            if [len(row) for row in texts] != [len(h)] * len(h):
                raise ModelError(f"noise_cov must be {len(h)} rows of {len(h)}, one for each of h")
            where = [f"noise_cov[{i}][{j}]" for i, row in enumerate(texts) for j in range(len(row))]
            entries = [text for row in texts for text in row]
            self._noise = symbolic_rows(states, entries, where, names)
            self._constant = degree_of(entries, names) == 0
        words.check_used(names)
        self._tail = names.data
        self._finish(angles, len(h))
        return self

    def __setattr__(self, name: str, value: object) -> None:
        if name in _STAYS and "directly_observed" in vars(self):  # the last that a sensor is given
            raise ModelError(
                f"{name} of a sensor stays as it is: sensor.changed(noise_cov=..., h=...) makes another, "
                "and update(z, R=...) takes another R for one reading"
            )
        object.__setattr__(self, name, value)

    def _begin(self, made: Callable[..., Any], recipe: dict[str, Any], values: Values) -> None:
        self._made, self._recipe = made, recipe
        self._factors: dict[bytes, tuple[Floats, Floats, float]] = {}
        self._tried: set[int] = set()
        self._tail = np.empty(0)
        self.noise_cov = self.H = self._matrix = self._n = None
        self._fill = self._noise = None
        self._set(values)

    def _set(self, values: Values) -> None:
        super()._set(values)
        self._p = np.concatenate([*values.data, self._tail])
        if self._linear or self._constant:
            vars(self).update(self._matrices())

    def _matrices(self) -> dict[str, Any]:
        """The attributes of a sensor whose text says matrices: what it reads in states of one and zeros.

        Where the values of parameters make R no covariance, it stays a function, which says so when asked.
        """
        k, R, matrix = self.dim_z, self.noise_cov, self._matrix
        assert self._n and self._fill
        X = np.eye(self._n)
        if self._constant:
            assert self._noise is not None
            try:
                R = validate.covariance("noise_cov", filled(self._noise, X[:1], 0.0, self._p, k, k)[0])
                R.setflags(write=False)
            except ModelError:
                R = None
        if self._linear:
            matrix = filled(self._fill, X, 0.0, self._p, k).T.copy()
            matrix.setflags(write=False)
        H = None if R is None else matrix
        direct = direct_states(H, R, self.angles)
        return {"noise_cov": R, "_matrix": matrix, "H": H, "directly_observed": direct, "_factors": {}}

    def _set_noise(self, noise_cov: Any, vectorized: bool, h: Any, dim_z: int | None) -> None:
        """Take R, a matrix or a function of a known number of readings."""
        if not callable(noise_cov):
            self.noise_cov = validate.covariance("noise_cov", noise_cov)
            self.noise_cov.setflags(write=False)
            self.dim_z = len(self.noise_cov)
            return
        if dim_z is None and callable(h):
            raise ModelError("h and noise_cov are functions: give dim_z= too, the number of readings")
        self.dim_z = validate.count("dim_z", np.shape(h)[0] if dim_z is None else dim_z)
        shape, data = (self.dim_z, self.dim_z), self._values.data
        self._noise = compile_rows(noise_cov, shape, "noise_cov", None, data, vectorized)

    def _set_matrix(self, h: ArrayLike) -> None:
        """Take H."""
        H = validate.array("h", h, (None, None), "(k, n), a row for each reading, as in [[1.0, 0.0]]")
        if len(H) != self.dim_z:
            raise ModelError(
                f"h of shape {H.shape} and noise_cov of shape {(self.dim_z, self.dim_z)} do not fit: "
                "both need a row for each component of z."
            )
        H.setflags(write=False)
        self._matrix, self._n = H, H.shape[1]
        self.H = None if self._noise else H

    def _finish(self, angles: Iterable[int], readings: int | None = None) -> None:
        if readings not in (None, self.dim_z):
            raise ModelError(
                f"noise_cov of shape {(self.dim_z, self.dim_z)} and {readings} readings of h do not fit: "
                "both need a row for each component of z."
            )
        self.angles = tuple(sorted({validate.count("angles", a, least=0) for a in _listed(angles)}))
        if self.angles and self.angles[-1] >= self.dim_z:
            raise ModelError(f"angles names component {self.angles[-1]}, but z has {self.dim_z} (from 0).")
        self._set(self._values)
        vars(self)["directly_observed"] = direct_states(self.H, self.noise_cov, self.angles)

    def changed(
        self, noise_cov: ArrayLike | None = None, h: ArrayLike | StateFunction | None = None
    ) -> "GaussianMeasurement":
        """The same sensor with another noise covariance, a number r for R = r I, or another h."""
        if noise_cov is not None and np.ndim(noise_cov) == 0:
            noise_cov = validate.positive("noise_cov", noise_cov) * np.eye(self.dim_z)
        if h is not None:
            own = self._recipe["noise_cov"] if self.noise_cov is None else self.noise_cov
            cov: Any = own if noise_cov is None else noise_cov
            return GaussianMeasurement(h, cov, self.angles, **self._values._asdict())
        new = self._copied()
        if noise_cov is not None:
            del new.directly_observed
            new._recipe, new._factors = self._recipe | {"noise_cov": noise_cov}, {}
            new._noise, new._constant = None, False
            new._set_noise(noise_cov, False, None, None)
            new.H = new._matrix
            new._finish(self.angles, self.dim_z)
        return new

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self._made, self._recipe | self._values._asdict())

    def __repr__(self) -> str:
        h = _shown(self._recipe["h"])
        R = _shown(self._recipe["noise_cov"] if self._noise else self.noise_cov)
        more = (("angles", list(self.angles)), ("parameters", dict(self.parameters)))
        shown = "".join(f", {name}={value}" for name, value in more if value)
        return f"GaussianMeasurement(h={h}, noise_cov={R}{shown})"

    def predict(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return the noise-free reading in each state X (N, n), shape (N, k)."""
        X = np.array(X, dtype=float, order="C", ndmin=2)
        self.check_dim(X.shape[1])
        if self._matrix is not None:
            return X @ self._matrix.T
        assert self._fill is not None
        return filled(self._fill, X, t, self._p, self.dim_z)

    def covariance(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return R in each state X (N, n), shape (N, k, k)."""
        X = np.array(X, dtype=float, order="C", ndmin=2)
        self.check_dim(X.shape[1])
        if self.noise_cov is not None:
            return np.broadcast_to(self.noise_cov, (len(X), self.dim_z, self.dim_z))
        assert self._noise is not None
        return filled(self._noise, X, t, self._p, self.dim_z, self.dim_z)

    def check_dim(self, n: int) -> None:
        """Raise `ModelError` if the sensor cannot read states of length n."""
        if self._n not in (None, n):
            raise ModelError(_DIFFERENT.format(self._n, n))
        if n in self._tried:
            return
        for name, shape in (("h", (self.dim_z,)), ("noise_cov", (self.dim_z, self.dim_z))):
            if callable(self._recipe[name]):
                probe(self._recipe[name], shape, name, n, self._values.data, self._recipe["vectorized"])
        self._tried.add(n)

    def residual(self, z: ArrayLike, zhat: ArrayLike) -> Floats:
        """Return z − zhat (..., k), angles wrapped to (−π, π]."""
        return wrapped(np.asarray(z, dtype=float) - np.asarray(zhat, dtype=float), self.angles)

    def jacobian(self, x: ArrayLike, t: float = 0.0) -> Floats:
        """Return ∂h/∂x at one state x (n,), shape (k, n): H, or central differences."""
        if self._matrix is not None:
            return self._matrix.copy()
        x = np.asarray(x, dtype=float)
        steps = np.diag(DIFFERENCE * np.maximum(1.0, np.abs(x)))
        above, below = x + steps, x - steps
        rise = self.residual(self.predict(above, t), self.predict(below, t))
        return (rise / np.diag(above - below)[:, None]).T

    def log_likelihood(self, z: ArrayLike | None, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return log p(z | x) for each state X (N, n), shape (N,), with its normalising constant.

        Missing components are left out, with their rows and columns of R; all missing gives zeros.
        """
        z, seen = self.reading(z)
        came = np.count_nonzero(seen)
        if not came:
            return np.zeros(np.shape(X)[0])
        # a state where h is undefined gives NaN here, for the caller to judge
        off = self.residual(z, self.predict(X, t))
        off = off if came == len(seen) else off[:, seen]
        if self.noise_cov is None:
            L = self._roots(X, t, seen)
            y = np.linalg.solve(L, off[:, :, None])[:, :, 0]
            constant = -np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1) - came * (0.5 * LOG_2_PI)
        else:
            _, whiten, constant = self._factor(seen)
            y = off @ whiten
        return constant - 0.5 * np.einsum("ik,ik->i", y, y)

    def sample(self, x: ArrayLike, t: float = 0.0, rng: Seed = None) -> Floats:
        """Draw readings of one state (n,) → (k,), or of many (N, n) → (N, k); angles in (−π, π]."""
        zhat = self.predict(x, t)
        drawn = validate.generator(rng).standard_normal(zhat.shape)
        if self.noise_cov is None:
            L = self._roots(x, t, np.ones(self.dim_z, dtype=bool))
            noise = np.einsum("ijk,ik->ij", L, drawn)
        else:
            noise = drawn @ np.linalg.cholesky(self.noise_cov).T
        z = self.residual(zhat + noise, 0.0)
        return z[0] if np.ndim(x) == 1 else z

    def _roots(self, X: ArrayLike, t: float, seen: Bools) -> Floats:
        """L with R = L Lᵀ in each state, observed block, shape (N, s, s)."""
        R = self.covariance(X, t)[:, seen][:, :, seen]
        try:
            return np.asarray(np.linalg.cholesky(R))
        except np.linalg.LinAlgError:
            least = np.linalg.eigvalsh(np.nan_to_num(R, nan=-1.0, posinf=-1.0, neginf=-1.0))[:, 0]
            worst = int(np.argmin(least))
            x = np.atleast_2d(X)[worst]
            raise ModelError(
                f"noise_cov is not positive definite at the state {validate.row(x)}: {R[worst].tolist()}. "
                "It must be, wherever the density is."
            ) from None

    @property
    def compiled(self) -> tuple[Any, Floats]:
        """Address of h, as compiled code calls it, and its data."""
        assert self._fill is not None
        return address_of(self._fill), self._p

    def root(self, seen: Bools) -> Floats:
        """Return the lower factor L of R = L Lᵀ, observed block, of noise that is the same in all states."""
        return self._factor(seen)[0]

    def _factor(self, seen: Bools) -> tuple[Floats, Floats, float]:
        """Return L and L^-T for R = L Lᵀ, observed block, and the log of the normalising constant.

        Residuals are multiplied by it: on tall, narrow arrays a triangular solve costs a hundred times more.
        """
        assert self.noise_cov is not None
        key = seen.tobytes()
        if key not in self._factors:
            L = np.asarray(np.linalg.cholesky(block(self.noise_cov, seen)))
            constant = -np.log(np.diag(L)).sum() - len(L) * (0.5 * LOG_2_PI)
            self._factors[key] = L, solve_triangular(L, np.eye(len(L)), lower=True).T, constant
        return self._factors[key]


def block(matrix: Floats, seen: Bools) -> Floats:
    """Rows and columns of a matrix (k, k) that belong to what came."""
    return matrix if np.count_nonzero(seen) == len(seen) else matrix[np.ix_(seen, seen)]


def wrapped(r: Floats, angles: Iterable[int]) -> Floats:
    """Return differences (..., k), changed in place, with components that are angles in (−π, π]."""
    for a in angles:
        r[..., a] -= 2 * np.pi * np.ceil((r[..., a] - np.pi) / (2 * np.pi))
    return r


def direct_states(H: Floats | None, R: Floats | None, angles: Sequence[int]) -> tuple[Ints, Floats] | None:
    """State indices and scales (k,), where each reading is of a state of its own, with noise of its own."""
    if H is None or R is None or angles or not np.all((H != 0).sum(axis=1) == 1):
        return None
    columns = np.argmax(H != 0, axis=1)
    if len(set(columns)) < len(H) or np.count_nonzero(R - np.diag(np.diag(R))):
        return None
    return columns, H[np.arange(len(H)), columns]


def _rebuild(made: Callable[..., GaussianMeasurement], recipe: dict[str, Any]) -> GaussianMeasurement:
    return made(**recipe)


def _listed(angles: Iterable[int]) -> list[int]:
    if isinstance(angles, str) or not isinstance(angles, Iterable):
        raise ModelError(f"angles must list components of z, such as angles=[0], got {angles!r}.")
    return list(angles)


def _texts(noise_cov: Any) -> list[list[str | float]] | None:
    """Rows of expressions, if there is a text among them."""
    nested = isinstance(noise_cov, list | tuple) and all(isinstance(row, list | tuple) for row in noise_cov)
    if not nested or not any(isinstance(entry, str) for row in noise_cov for entry in row):
        return None
    return [list(row) for row in noise_cov]


def _shown(given: Any) -> str:
    """Name of a function, or the text of anything else."""
    if callable(given):
        return getattr(given, "__name__", None) or repr(given)
    return validate.short(np.asarray(given).tolist())
