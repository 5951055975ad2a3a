"""Several sensors as one, each with readings at times of its own."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from .. import validate
from .._types import Floats, Seed
from ..errors import ModelError, nearest
from .measurements import PlainSensor, Reading, direct_states, has_gaussian_noise, is_gaussian, wrapped
from .named import Adjustable, shared


class Sensors(PlainSensor, Adjustable, Mapping[str, Any]):
    """Several sensors of one system as one sensor, whose reading is theirs one after the other.

    Where a sensor has no reading, its numbers are NaN: each may have its own rate. Their noises are
    independent of each other.

    Parameters
    ----------
    sensors : mapping of str to sensor
        `GaussianMeasurement` or `LikelihoodMeasurement` with a `dim_z`, by name. Parameters of the same name
        are one parameter.

    Attributes
    ----------
    dim_z : int
        k, of all readings together.
    noise_cov : ndarray, shape (k, k), or None
        None if a sensor has no constant Gaussian noise.
    H : ndarray, shape (k, n), or None
        None if a sensor is not linear.
    angles : tuple of int
    parameters, inputs : mapping of str to float, read-only
    directly_observed : tuple of (ndarray of int (k,), ndarray (k,)), or None
        As that of a `GaussianMeasurement`.

    Raises
    ------
    ModelError
        No sensors, one without `dim_z`, or parameters of one name with different values.

    Examples
    --------
    >>> import sphfilter as sf
    >>> gps = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[4.0]])
    >>> speed = sf.GaussianMeasurement(h=[[0.0, 1.0]], noise_cov=[[0.01]])
    >>> both = sf.Sensors({"gps": gps, "speed": speed})
    >>> times, z = both.merged({"gps": ([0.0, 1.0], [3.0, 4.0]), "speed": ([0.5, 1.0], [1.2, 1.1])})
    >>> print(times, z.tolist())
    [0.  0.5 1. ] [[3.0, nan], [nan, 1.2], [4.0, 1.1]]
    >>> model = sf.LinearSDE([[0.0, 1.0], [0.0, 0.0]], noise=[[0.0], [0.1]])
    >>> flt = sf.SPHFilter(model, both, x0=[3.0, 1.0], P0=[[1.0, 0.0], [0.0, 1.0]])
    >>> result = flt.run(times, z)
    >>> flt.update({"gps": 4.2}).accepted, flt.update(1.1, "speed").accepted
    (True, True)
    """

    _called = "The set of sensors"

    def __init__(self, sensors: Mapping[str, Any]) -> None:
        if not isinstance(sensors, Mapping) or not sensors:
            raise ModelError(
                f'Sensors needs at least one sensor by its name, such as {{"gps": gps}}, got '
                f"{validate.short(sensors)}"
            )
        self._parts, self._rows, self.dim_z = dict(sensors), dict[str, slice](), 0
        for name, sensor in self._parts.items():
            if not isinstance(name, str) or not name:
                raise ModelError(f"names of sensors are texts, got {name!r}")
            unfit = not hasattr(sensor, "log_likelihood") or getattr(sensor, "dim_z", None) is None
            if unfit or isinstance(sensor, Sensors):
                raise ModelError(
                    f"sensor {name!r} must be a GaussianMeasurement, or a LikelihoodMeasurement with dim_z=; "
                    f"got {validate.short(sensor)}"
                )
            begin, self.dim_z = self.dim_z, self.dim_z + int(sensor.dim_z)
            self._rows[name] = slice(begin, self.dim_z)
        own = [*self._parts.values()]
        self._check_widths()
        covs, Hs = [s.noise_cov for s in own], [s.H for s in own]
        self.gaussian_noise = all(has_gaussian_noise(sensor) for sensor in own)
        self.noise_cov = None if any(R is None for R in covs) else block_diag(*covs)
        linear = self.noise_cov is not None and all(H is not None for H in Hs)
        self.H = np.vstack(Hs) if linear else None
        self.angles = tuple(self._rows[name].start + a for name, s in self._parts.items() for a in s.angles)
        self.directly_observed = direct_states(self.H, self.noise_cov, self.angles)
        self.parameters, self.inputs = (shared(kind, self._parts) for kind in ("parameters", "inputs"))

    def _check_widths(self) -> None:
        """All sensors that are matrices read states of one length."""
        widths = {name: s.H.shape[1] for name, s in self._parts.items() if s.H is not None}
        if len(set(widths.values())) > 1:
            raise ModelError(f"the sensors read states of different lengths: {widths}")

    def __getitem__(self, name: str) -> Any:
        if name not in self._parts:
            known = ", ".join(self._parts)
            raise ModelError(f"there is no sensor {name!r}{nearest(name, self._parts)}; there are {known}")
        return self._parts[name]

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def get(self, name: str, default: Any = None) -> Any:
        """Return a sensor by its name, or a default."""
        return self._parts.get(name, default)

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def __hash__(self) -> int:
        return id(self)

    def __eq__(self, other: object) -> bool:
        return self is other

    def __reduce__(self) -> tuple[Any, ...]:
        return Sensors, (self._parts,)

    def __repr__(self) -> str:
        return f"Sensors({self._parts})"

    def came(self, z: Any) -> tuple[Any, Floats]:
        """Return the sensors of which readings came, as a sensor, and their numbers.

        Where all have one constant Gaussian noise, or all or none came, these are the sensors themselves.
        """
        z, seen = self.reading(z)
        names = [name for name, rows in self._rows.items() if seen[rows].any()]
        if is_gaussian(self) or not names or len(names) == len(self):
            return self, z
        parts = {name: self._parts[name] for name in names}
        return (
            parts[names[0]] if len(names) == 1 else type(self)(parts),
            np.concatenate([z[self._rows[name]] for name in names]),
        )

    def rows(self, name: str) -> slice:
        """Place of a sensor's numbers among all."""
        self[name]
        return self._rows[name]

    def merged(self, readings: Mapping[str, tuple[ArrayLike, Any]]) -> tuple[Floats, Floats]:
        """Put records of several sensors into one, which `SPHFilter.run`, fits and the smoother take.

        Parameters
        ----------
        readings : mapping of str to (times, z)
            Times (T_s,) of a sensor, not decreasing, seconds, and its readings (T_s, k_s), or (T_s,) of one
            number.

        Returns
        -------
        times : ndarray, shape (T,)
        z : ndarray, shape (T, k)
            NaN where no reading came.
        """
        found: list[tuple[float, str, Floats]] = []
        for name, record in readings.items():
            found += [(at, name, row) for at, row in zip(*self._record(name, record), strict=True)]
        found.sort(key=lambda row: row[0])
        if not found:
            return np.empty(0), np.empty((0, self.dim_z))
        times = validate.onwards(np.array([at for at, _, _ in found]), found[0][0])
        kept: list[tuple[float, Floats, set[str]]] = []
        for at, (_, name, row) in zip(times, found, strict=True):
            if not kept or at != kept[-1][0] or name in kept[-1][2]:
                kept.append((at, np.full(self.dim_z, np.nan), set()))
            kept[-1][1][self._rows[name]] = row
            kept[-1][2].add(name)
        return np.array([at for at, _, _ in kept]), np.array([z for _, z, _ in kept])

    def _record(self, name: str, record: Any) -> tuple[Floats, list[Floats]]:
        """Times and readings of one sensor."""
        k = self[name].dim_z
        if not isinstance(record, tuple | list) or len(record) != 2:
            raise ModelError(f"records are (times, z) by the sensors' names; of {name!r} got {type(record)}")
        times, z = record
        if np.ndim(times) != 1 or np.ndim(z) == 0:
            raise ModelError(
                f"records are (times, z) by the sensors' names; of {name!r} got {validate.short(record)}"
            )
        if len(times) == 0:
            return np.empty(0), []
        t, rows = validate.times(f"times of {name!r}", times), list(validate.unmasked(z))
        if len(rows) != len(t):
            raise ModelError(f"{name!r} has {len(t)} times, but {len(rows)} readings")
        return t, [np.full(k, np.nan) if row is None else Reading.of(row, k).z for row in rows]

    def vector(self, z: Any) -> Any:
        """The numbers (k,) of readings by the sensors' names; any other reading as it is."""
        if not isinstance(z, Mapping):
            return z
        out = np.full(self.dim_z, np.nan)
        for name, value in z.items():
            out[self.rows(name)] = Reading.of(value, self[name].dim_z, name).z
        return out

    def reading(self, z: Any) -> Reading:
        """Return z, numbers (k,) or a mapping of sensors' names to theirs, as a `Reading`."""
        return Reading.of(self.vector(z), self.dim_z)

    def check_dim(self, n: int) -> None:
        """Raise `ModelError` if a sensor cannot read states of length n."""
        for sensor in self._parts.values():
            if hasattr(sensor, "check_dim"):
                sensor.check_dim(n)

    def log_likelihood(self, z: Any, X: Floats, t: float = 0.0) -> Floats:
        """Return log p(z | x) for each state X (N, n), shape (N,): the sum of the sensors' that came."""
        z, seen = self.reading(z)
        total = np.zeros(len(X))
        for name, sensor in self._parts.items():
            rows = self._rows[name]
            if seen[rows].any():
                total += sensor.log_likelihood(z[rows], X, t)
        return total

    def predict(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return the noise-free readings in each state X (N, n), shape (N, k)."""
        self._check_predicting()
        return np.hstack([sensor.predict(X, t) for sensor in self._parts.values()])

    def covariance(self, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return R in each state X (N, n), shape (N, k, k), block by block."""
        self._check_predicting()
        out = np.zeros((len(np.atleast_2d(X)), self.dim_z, self.dim_z))
        for name, sensor in self._parts.items():
            out[:, self._rows[name], self._rows[name]] = sensor.covariance(X, t)
        return out

    def _check_predicting(self) -> None:
        for name, sensor in self._parts.items():
            if not hasattr(sensor, "predict"):
                raise ModelError(f"the sensor {name!r} has a likelihood and no noise-free reading to predict")

    def residual(self, z: ArrayLike, zhat: ArrayLike) -> Floats:
        """Return z − zhat (..., k), angles wrapped to (−π, π]."""
        return wrapped(np.asarray(z, dtype=float) - np.asarray(zhat, dtype=float), self.angles)

    def jacobian(self, x: ArrayLike, t: float = 0.0) -> Floats:
        """Return ∂h/∂x at one state x (n,), shape (k, n)."""
        self._check_predicting()
        return np.vstack([sensor.jacobian(x, t) for sensor in self._parts.values()])

    def sample(self, x: ArrayLike, t: float = 0.0, rng: Seed = None) -> Floats:
        """Draw readings of one state (n,) → (k,), or of many (N, n) → (N, k)."""
        rng = validate.generator(rng)
        return np.concatenate([sensor.sample(x, t, rng) for sensor in self._parts.values()], axis=-1)

    @property
    def peaks(self) -> Callable[[Floats], Floats] | None:
        """States at which a likelihood may be far higher than around, if a sensor names them."""
        named = {name: s.peaks for name, s in self._parts.items() if getattr(s, "peaks", None) is not None}
        if not named or is_gaussian(self):
            return None

        def states(z: Floats) -> Floats:
            came = [name for name in named if np.isfinite(z[self._rows[name]]).any()]
            found = [np.atleast_2d(np.asarray(named[name](z[self._rows[name]]), float)) for name in came]
            return np.vstack(found) if found else np.empty((0, 0))

        return states

    def _with(self, **changes: dict[str, float]) -> Self:
        ((kind, values),) = changes.items()

        def own(sensor: Any) -> Any:
            known = {name: values[name] for name in getattr(sensor, kind, {})}
            if not known:
                return sensor
            return sensor.with_parameters(**known) if kind == "parameters" else sensor.with_inputs(known)

        return type(self)({name: own(sensor) for name, sensor in self._parts.items()})
