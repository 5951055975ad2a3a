"""A transient problem: model, start, output times and the statistics that are asked of the densities."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

import sphfilter as sf
from experiments.scene.scenario import Scene

from .checks import check, named
from .settings import TransientSettings, problem_names, read_problem
from .texts import Pdf, condition, expression, reads_time

__all__ = ["Problem", "Quantity", "load_problem", "problem_names"]

_N_PARTICLES = 400


class Quantity(NamedTuple):
    """A number asked of a density: a raw moment with its powers, or the probability of a condition."""

    name: str
    powers: tuple | None
    condition: object  # (X (M, n), t) -> bool (M,), or None
    timed: bool = False  # does the condition name the time?

    def of(self, density):
        """Its value for a `ParticleDensity`."""
        if self.powers is not None:
            return density.moment(self.powers)
        return density.probability(lambda X: self.condition(X, density.t))

    def at(self, X, t=0.0):
        """What its mean is taken of, at states X (M, n) and time t, shape (M,)."""
        if self.powers is not None:
            return np.prod(X ** np.array(self.powers), axis=1)
        return self.condition(X, t).astype(float)


@dataclass(frozen=True)
class Problem(Scene):
    """A transient scenario."""

    name: str
    settings: TransientSettings

    @property
    def title(self):
        """Name, and description if there is one."""
        return ": ".join(filter(None, (self.name, self.settings.description)))

    @property
    def n_particles(self):
        """Upper bound of the number of particles; None for that of the start's lattice."""
        given, lattice = self.settings.solver.n_particles, self.settings.start.lattice
        return _N_PARTICLES if given is None and lattice is None else given

    @cached_property
    def times(self):
        """Times of output, shape (T,)."""
        return self.settings.times.times(self.settings.start.time)

    @cached_property
    def kept(self):
        """Numbers of the times whose densities are kept."""
        return self.settings.output.kept(self.times, self.settings.start.time)

    @cached_property
    def distribution(self):
        """The density at the start: `Gaussian`, `Uniform` or a callable."""
        start = self.settings.start
        if start.kind == "gaussian":
            return sf.Gaussian(start.mean, start.cov)
        if start.kind == "uniform":
            return sf.Uniform(start.sides)
        pdf = expression(self.model, start.pdf, "start.pdf", self.tables)
        return Pdf(lambda X: pdf(X, start.time), np.array(start.sides))

    def begin(self):
        """The density at the start on particles."""
        start, config = self.settings.start, self.settings.solver.config
        options = {"box": start.sides, "t": start.time, "domain": self.model.domain}
        if start.lattice is not None:
            options["spacing"] = start.lattice.spacing
        if start.reach is not None and start.kind == "gaussian":
            config = replace(config, scheme=sf.LogDensityScheme(reach=start.reach))
        with named("start", "pdf", "box", "lattice.spacing"):
            return sf.initialize(self.distribution, self.n_particles, config, **options)

    @cached_property
    def quantities(self):
        """First and second moments, then what the file asks for."""
        n, asked = self.model.dim, self.settings.statistics
        first = [tuple(row) for row in np.eye(n, dtype=int).tolist()]
        second = [tuple(np.add(first[i], first[j]).tolist()) for i in range(n) for j in range(i, n)]
        powers = dict.fromkeys(
            [*first, *second, *asked.moments, *(row.powers for row in self.settings.steady)]
        )
        moments = [Quantity(_moment_name(p, self.settings.model.states), p, None) for p in powers]
        return moments + [
            Quantity(
                f"P({text})",
                None,
                condition(self.model, text, f"statistics.exceedance[{k}]", self.tables),
                reads_time(text),
            )
            for k, text in enumerate(asked.exceedance)
        ]


def _moment_name(powers, states):
    factors = [s if k == 1 else f"{s}^{k}" for s, k in zip(states, powers, strict=True) if k]
    return f"E[{' '.join(factors)}]"


def load_problem(name, changes=None):
    """Read a transient scenario by name, or from the path of a TOML file; `changes` by dotted key.

    Raises `ConfigError`, `ExpressionError` or `ModelError`; each names the key.
    """
    path, settings = read_problem(name, changes)
    problem = Problem(path.stem, settings)
    with named(path):
        check(problem)
    return problem
