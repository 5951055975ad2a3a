"""Random filtering problems, each made alone from a seed and its number."""

from dataclasses import dataclass
from zlib import crc32

import numpy as np

import sphfilter as sf
from sphfilter.errors import SphfilterError

from .problem import Problem
from .random_models import random_equation
from .random_sensors import random_reader
from .sensors import GaussianReader

#: Particles a filter may have, by the number of states: a few values about the default of 200.
_PARTICLES = {1: (100, 200), 2: (200, 400), 3: (200, 400, 800), 4: (200, 400, 800)}
#: Simulated states beyond which a problem is drawn again, and paths that tell how large readings are.
_ABSURD, _PATHS = 1e3, 64


@dataclass(frozen=True)
class RandomCase:
    """One random problem, by its seed and number; attributes as those of a `HardCase`."""

    seed: int
    number: int
    #: More relations find more, and cost a run each.
    n_relations = 2
    patience = 1.0

    @property
    def name(self):
        """As --random-case takes it."""
        return f"{self.seed}:{self.number}"

    @property
    def again(self):
        """Options of the command that run this case alone."""
        return f"--random-case {self.name}"

    @property
    def key(self):
        """Whole numbers that all random about the case is drawn from."""
        return self.seed, self.number

    def place(self, problem):
        """Family, system and level of the case, and the unit of levels."""
        return {"family": f"{len(problem.x0)}-D", "system": problem.kind, "level": self.number, "unit": ""}

    @staticmethod
    def examples():
        """Cases that make a filter compile what it needs."""
        return [RandomCase(0, number) for number in range(12)]

    def problem(self):
        """Make the problem; the same seed and number give the same bits."""
        for attempt in range(100):
            rng = np.random.default_rng([*self.key, attempt, crc32(b"random problems")])
            try:
                found = _drawn(rng)
            except SphfilterError:  # a path that the simulator cannot follow
                continue
            if found is not None:
                return found
        raise RuntimeError(f"no plausible problem of number {self.number}, seed {self.seed}")

    def __str__(self):
        return f"{self.name} {self.problem()}"


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
    # without a truth: some readings are not drawn from it
    return Problem(kind=kind, equation=equation, readers=readers, z=z, x0=x0, P0=P0, times=times,
                   n_particles=int(rng.choice(_PARTICLES[n])))  # fmt: skip


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
