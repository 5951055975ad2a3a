"""How many equal steps see a model change in time, where it does not say so itself."""

import math

import numpy as np

from .._types import BatchFunction, Floats
from ..core.limits import LITTLE, LOOK, SAID
from ..density.particle_density import ParticleDensity
from ..model.compile import surfacing
from ..model.derived import scales
from ..model.sde import SDE

#: Five of clouds, then primes, each some twice the one before. A sine of k periods hides from K middles, if
#: K divides k: from two of the primes at once not before k = 17 · 37 = 629.
_SLICES = (1, 2, 3, 5, 9, 17, 37, 79, 167, 347, 709)
_FINE = _SLICES[-2]  # a pulse of a hundredth of the interval has 347 / 100 = 3.5 of its times


def noise_samples(model: SDE, t0: float, t1: float, around: Floats | None = None) -> tuple[Floats, int]:
    """Return D at many times between t0 and t1, shape (S, n, n), and as many equal steps as see it change.

    around: (n,) where noise that depends on the state is asked.
    """
    origin = np.zeros((1, model.dim)) if around is None else around[None]
    if model.constant_diffusion:
        return model.diffusion(origin, t0), _SLICES[5]
    D = _over_time(model.diffusion_batch, model, origin, t0, t1, model.dim**2)
    return D.reshape(-1, model.dim, model.dim), _slices(*_of_noise(D), _SLICES[5:])


def drift_slices(model: SDE, density: ParticleDensity, t1: float) -> int:
    """Return how many equal steps to time t1 see the drift change where the density is."""
    mean, std = density.mean(), np.sqrt(np.diag(density.cov()))
    around = np.concatenate([mean[None], mean + np.diag(std), mean - np.diag(std)])
    return _slices(*_of_drift(model, around, density.t, t1, std), _SLICES[5:])


def slices_at(model: SDE, x: Floats, t0: float, t1: float) -> int:
    """Return how many equal steps see drift and noise change with time at some of the states x (N, n)."""
    if model.autonomous:
        return 1
    X = np.ascontiguousarray(x[:: -(-len(x) // LOOK)])
    found = _slices(*_of_drift(model, X, t0, t1, x.std(axis=0)), _SLICES, SAID)
    if model.constant_diffusion:
        return found
    D = _over_time(model.diffusion_batch, model, X, t0, t1, model.dim**2)
    return max(found, _slices(*_of_noise(D), _SLICES, SAID))


def _over_time(batch: BatchFunction, model: SDE, X: Floats, t0: float, t1: float, columns: int) -> Floats:
    """Values (S, N, columns) of a function of a model at states X (N, n), at many times."""
    values = np.empty((_FINE, len(X), columns))
    with surfacing():
        for value, share in zip(values, _middles(_FINE).tolist(), strict=True):
            batch(X, t0 + (t1 - t0) * share, model.p, value)
    return _known(values)


def _of_drift(model: SDE, X: Floats, t0: float, t1: float, std: Floats) -> tuple[Floats, float]:
    """Ways (S, N, n) that the drift would move states X in the interval, in deviations; and their size."""
    per_std = (t1 - t0) / np.where(std > 0.0, std, 1.0)
    f = _over_time(model.drift_batch, model, X, t0, t1, model.dim) * per_std
    return f, 1.0 + float(np.abs(f).mean(axis=0).max())


def _of_noise(D: Floats) -> tuple[Floats, float]:
    """Values (S, N, n²) of D in units of their sizes, and how large they are then."""
    n = math.isqrt(D.shape[-1])
    d = scales(np.abs(D).mean(axis=(0, 1)).reshape(n, n))
    scaled = D / np.outer(d, d).ravel()
    return scaled, float(np.abs(scaled).mean(axis=0).max())


def _slices(values: Floats, size: float, slices: tuple[int, ...], error: float = LITTLE * SAID) -> int:
    """The fewest steps whose middles have the running integral of values (S, ...), as all more of them do."""
    whole, fewest = _running(values), slices[-1]
    for count in (count for count in reversed(slices) if count < _FINE):
        coarse = _running(_between(values, _middles(count) * _FINE - 0.5))
        exact = _between(whole, np.linspace(0.0, _FINE, count + 1))
        if not np.abs(coarse - exact).max() <= error * size:
            break
        fewest = count
    return fewest


def _known(values: Floats) -> Floats:
    """Values (S, ...); where one is no number, which is no change in time, those of the next time."""
    known = np.flatnonzero(np.isfinite(values).all(axis=tuple(range(1, values.ndim))))
    if not len(known):
        return np.zeros_like(values)
    following = np.searchsorted(known, np.arange(len(values)))
    return values[known[np.minimum(following, len(known) - 1)]]


def _middles(slices: int) -> Floats:
    """Middles of equal parts of the unit interval."""
    return (np.arange(slices) + 0.5) / slices


def _running(values: Floats) -> Floats:
    """Integral over the unit interval up to the borders of equal steps, shape (S + 1, ...)."""
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)]) / len(values)


def _between(rows: Floats, at: Floats) -> Floats:
    """Linear interpolation of rows (S, ...) at places (M,), counted in rows."""
    k = np.clip(at.astype(int), 0, len(rows) - 2)
    part = (at - k).reshape(-1, *[1] * (rows.ndim - 1))
    between: Floats = rows[k] * (1.0 - part) + rows[k + 1] * part
    return between
