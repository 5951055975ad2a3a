"""How many equal steps see a model change in time, where it does not say so itself."""

from collections.abc import Callable

import numpy as np

from .._types import Floats
from ..density.particle_density import ParticleDensity
from ..model.derived import scales
from ..model.sde import SDE

__all__ = ["drift_slices", "noise_samples"]

_SLICES = (17, 37, 79, 167, 347, 709)  # odd and without common factors, so that oscillations hide from none
_FINE = _SLICES[-2]  # a pulse of a hundredth of the interval has 347 / 100 = 3.5 of its times
_ERROR = 1e-3  # of an integral up to any time, by the middles of the steps


def noise_samples(model: SDE, t0: float, t1: float, around: Floats | None = None) -> tuple[Floats, int]:
    """Return D at many times between t0 and t1, shape (S, n, n), and as many equal steps as see it change.

    around: (n,) where noise that depends on the state is asked.
    """
    origin = np.zeros((1, model.dim)) if around is None else around[None]
    if model.constant_diffusion:
        return model.diffusion(origin, t0), _SLICES[0]
    D, slices = _sampled(lambda t: model.diffusion(origin, t)[0], t0, t1, _of_noise)
    return D, slices


def drift_slices(model: SDE, density: ParticleDensity, t1: float) -> int:
    """Return how many equal steps to time t1 see the drift change where the density is."""
    mean, std = density.mean(), np.sqrt(np.diag(density.cov()))
    around = np.concatenate([mean[None], mean + np.diag(std), mean - np.diag(std)])
    span = t1 - density.t

    def moved(f: Floats) -> tuple[Floats, float]:
        f = f * span / std
        return f, 1.0 + float(np.abs(f).mean(axis=0).max())

    return _sampled(lambda t: model.drift(around, t), density.t, t1, moved)[1]


def _of_noise(D: Floats) -> tuple[Floats, float]:
    d = scales(np.abs(D).mean(axis=0))
    scaled = D / np.outer(d, d)
    return scaled, float(np.abs(scaled).mean(axis=0).max())


def _sampled(
    ask: Callable[[float], Floats],
    t0: float,
    t1: float,
    sized: Callable[[Floats], tuple[Floats, float]],
) -> tuple[Floats, int]:
    """Values at the middles of many steps, and the fewest steps whose middles have their running integral."""
    fine = _known(np.array([ask(t0 + (t1 - t0) * s) for s in _middles(_FINE)]))
    values, size = sized(fine)
    whole = _running(values)
    for slices in _SLICES:
        if slices < _FINE:
            coarse = _running(_between(values, _middles(slices) * _FINE - 0.5))
            exact = _between(whole, np.linspace(0.0, _FINE, slices + 1))
            if np.abs(coarse - exact).max() <= _ERROR * size:
                return fine, slices
    return fine, _SLICES[-1]


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
