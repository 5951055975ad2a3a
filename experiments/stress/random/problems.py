"""Random filtering problems, each made alone from a seed and its number."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from zlib import crc32

import numpy as np

import sphfilter as sf
from sphfilter.errors import SphfilterError

from .equations import Equation
from .models import random_equation
from .readers import random_reader
from .sensors import GaussianReader, LikelihoodReader

__all__ = ["RandomCase", "RandomProblem"]

#: Particles a filter may have, by the number of states: a few values about the default of 200.
_PARTICLES = {1: (100, 200), 2: (200, 400), 3: (200, 400, 800), 4: (200, 400, 800)}
#: Simulated states beyond which a problem is drawn again, and paths that tell how large readings are.
_ABSURD, _PATHS = 1e3, 64


@dataclass(frozen=True, kw_only=True)
class RandomProblem:
    """All that a filter is given, as data that can be rewritten.

    Attributes
    ----------
    kind : str
        The drift in words.
    equation : Equation
    readers : tuple of GaussianReader and LikelihoodReader
        Read at each time, one after the other.
    z : tuple of ndarray (T, k)
        Readings of each.
    x0, P0, t0
        Gaussian start, and its time in seconds.
    times : ndarray, shape (T,)
    truth : ndarray, shape (T, n)
    n_particles : int or "auto"
    parts : int
        Predictions from one time to the next.
    T, c : ndarray, shapes (n, n), (n,), optional
        The states are y with x = T y + c, where x are those of the problem it was made from.
    constant : float
        What log p(z) of every epoch is higher by than that of the problem it was made from.
    """

    kind: str
    equation: Equation
    readers: tuple[GaussianReader | LikelihoodReader, ...]
    z: tuple[np.ndarray, ...]
    x0: np.ndarray
    P0: np.ndarray
    times: np.ndarray
    t0: float = 0.0
    truth: np.ndarray = field(repr=False)
    n_particles: int | str = 200
    parts: int = 1
    T: np.ndarray | None = None
    c: np.ndarray | None = None
    constant: float = 0.0

    @property
    def model(self):
        """The compiled model."""
        return self.equation.model

    @cached_property
    def sensors(self):
        """What filters are given."""
        return tuple(reader.sensor for reader in self.readers)

    def __str__(self):
        n, T = len(self.x0), len(self.times)
        std = np.sqrt(np.diag(self.P0))
        correlations = np.round(self.P0 / np.outer(std, std), 4).tolist()
        return (
            f"{n} states ({self.kind}): {self.equation}; x0 = {self.x0.round(4).tolist()}, "
            f"std {np.round(std, 4).tolist()}, correlations {correlations}; "
            f"{T} readings at {self.times.round(4).tolist()} by {' and '.join(map(str, self.readers))}; "
            f"{self.n_particles} particles"
        )


@dataclass(frozen=True)
class RandomCase:
    """One random problem by its number; `unit`, `family` and the like are a cell's, see `Cell`.

    Where it is `auto`, the filter chooses what carries the density by its error.
    """

    number: int
    auto: bool = False

    @property
    def name(self):
        """Name in files."""
        return f"random/{self.number}{'/auto' * self.auto}"

    def problem(self, seed):
        """Make the problem; the same seed and number give the same bits."""
        for attempt in range(100):
            rng = np.random.default_rng([seed, self.number, attempt, crc32(b"random problems")])
            try:
                found = _drawn(rng)
            except SphfilterError:  # a path that the simulator cannot follow
                continue
            if found is not None:
                return replace(found, n_particles="auto") if self.auto else found
        raise RuntimeError(f"no plausible problem of number {self.number}, seed {seed}")


def _drawn(rng):
    """A problem; None if its states or readings are absurd."""
    n = int(rng.choice([1, 2, 3, 4], p=[0.35, 0.35, 0.15, 0.15]))
    interval, n_readings = _between(rng, 0.04, 4.0), int(rng.integers(3, 11))
    gaps = interval * (rng.uniform(0.5, 1.5, n_readings) if rng.random() < 0.3 else np.ones(n_readings))
    times = np.round(np.cumsum(gaps), 6)
    kind, equation = random_equation(rng, n, times[-1], interval)
    x0, P0 = _start(rng, n)
    starts = rng.multivariate_normal(x0, P0, _PATHS, method="cholesky")
    step = equation.shortest / 10.0 if np.isfinite(equation.shortest) else None
    paths, _ = sf.simulate(equation.model, None, starts, np.append(0.0, times), rng, max_step=step)
    if not np.isfinite(paths).all() or np.abs(paths).max() > _ABSURD:
        return None
    truth = paths[0, 1:]
    readers = tuple(random_reader(rng, paths[:, 1:]) for _ in range(1 + (rng.random() < 0.25)))
    z = tuple(np.array([reader.sample(x, rng) for x in truth]) for reader in readers)
    if not all(np.isfinite(values).all() for values in z):
        return None
    if rng.random() < 0.15 and isinstance(readers[0], GaussianReader) and not readers[0].angles:
        sigma = np.sqrt(readers[0].R[0, 0])
        z[0][rng.integers(n_readings), 0] += rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 7.0) * sigma
    return RandomProblem(
        kind=kind, equation=equation, readers=readers, z=z, x0=x0, P0=P0, times=times, truth=truth,
        n_particles=int(rng.choice(_PARTICLES[n])),
    )  # fmt: skip


def _start(rng, n):
    """Means of order one; standard deviations of .003 to 6, correlations up to .999 for some."""
    common = _between(rng, 0.02, 3.0)
    std = np.clip(common * np.exp(0.5 * rng.standard_normal(n)), 0.003, 6.0)
    if rng.random() < 0.15:
        std[rng.integers(n)] = _between(rng, 0.003, 0.02)
    correlation = np.eye(n)
    if n > 1 and rng.random() < 0.4:
        rho = float(rng.choice([0.5, 0.9, 0.99, 0.999]))
        signs = rng.choice([-1.0, 1.0], n)
        correlation = rho * np.outer(signs, signs) + (1.0 - rho) * np.eye(n)
    return rng.normal(0.0, 1.0, n), correlation * np.outer(std, std)


def _between(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
