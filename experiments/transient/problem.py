"""A transient problem: model, start, output times and the statistics that are asked of the densities."""

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

import sphfilter as sf
from experiments.files import change, file_names, find_file, read_toml
from experiments.scenario import model_of
from sphfilter._symbolic import symbolic_rows
from sphfilter.config import from_table
from sphfilter.errors import ConfigError, ModelError

from .settings import TransientSettings

__all__ = ["Problem", "Quantity", "load_problem", "problem_names"]

_FOLDER = Path(__file__).parents[1] / "scenarios" / "transient"


class Quantity(NamedTuple):
    """A number asked of a density: a raw moment with its powers, or the probability of a condition."""

    name: str
    powers: tuple | None
    condition: object  # X (M, n) -> bool (M,), or None

    def of(self, density):
        """Its value for a `ParticleDensity`."""
        if self.powers is not None:
            return density.moment(self.powers)
        return density.probability(self.condition)

    def at(self, X):
        """What its mean is taken of, at states X (M, n), shape (M,)."""
        if self.powers is not None:
            return np.prod(X ** np.array(self.powers), axis=1)
        return self.condition(X).astype(float)


@dataclass(frozen=True)
class Problem:
    """A transient scenario.

    Attributes
    ----------
    name : str
    settings : TransientSettings
    """

    name: str
    settings: TransientSettings

    @cached_property
    def model(self):
        """The `SDE`."""
        return model_of(json.dumps(asdict(self.settings.model), sort_keys=True))

    @property
    def labels(self):
        """Names of the states for people, length n."""
        return self.settings.model.labels or self.settings.model.states

    @cached_property
    def times(self):
        """Times of output, shape (T,)."""
        return self.settings.times.times(self.settings.start.time)

    @cached_property
    def distribution(self):
        """The density at the start: `Gaussian`, `Uniform` or a callable."""
        start = self.settings.start
        if start.kind == "gaussian":
            return sf.Gaussian(start.mean, start.cov)
        if start.kind == "uniform":
            return sf.Uniform(start.box)
        return _expression(self.settings.model.states, start.pdf, "start.pdf")

    def begin(self):
        """The density at the start on particles."""
        start, solver = self.settings.start, self.settings.solver
        config = solver.config
        if start.reach is not None and start.kind == "gaussian":
            config = replace(config, scheme=sf.LogDensityScheme(reach=start.reach))
        options = {"box": start.box if start.kind == "expression" else None, "t": start.time}
        return sf.initialize(
            self.distribution, solver.n_particles, config, domain=self.model.domain, **options
        )

    @cached_property
    def quantities(self):
        """First and second moments, then what the file asks for."""
        n, asked = self.model.dim, self.settings.statistics
        first = [tuple(row) for row in np.eye(n, dtype=int).tolist()]
        second = [tuple(np.add(first[i], first[j]).tolist()) for i in range(n) for j in range(i, n)]
        powers = dict.fromkeys(
            [*first, *second, *asked.moments, *(row.powers for row in self.settings.steady)]
        )
        wrong = [p for p in powers if len(p) != n]
        if wrong:
            raise ModelError(f"a moment needs {n} powers, one a state, not {list(wrong[0])}")
        states = self.settings.model.states
        moments = [Quantity(_moment_name(p, states), p, None) for p in powers]
        return moments + [
            Quantity(f"P({text})", None, _condition(states, text, f"statistics.exceedance[{k}]"))
            for k, text in enumerate(asked.exceedance)
        ]


def _moment_name(powers, states):
    factors = [s if k == 1 else f"{s}^{k}" for s, k in zip(states, powers, strict=True) if k]
    return f"E[{' '.join(factors)}]"


def _condition(states, text, name):
    value = _expression(states, f"where({text}, 1, 0)", name)
    return lambda X: value(X) > 0.5


def _expression(states, text, name):
    """A function of states X (M, n) -> (M,) from text."""
    fill = symbolic_rows(states, (text,), name)

    def function(X):
        X = np.ascontiguousarray(X, dtype=float)
        out = np.empty((len(X), 1))
        fill(X, 0.0, np.empty(0), out)
        return out[:, 0]

    return function


def problem_names():
    """Names of the transient scenarios that come with the project."""
    return file_names(_FOLDER)


def load_problem(name, changes=None):
    """Read a transient scenario by name, or from the path of a TOML file; `changes` by dotted key.

    Raises
    ------
    ConfigError, ExpressionError, ModelError
        Each names the key.
    """
    path = find_file(name, _FOLDER, "transient scenario")
    tree = read_toml(path)
    for key, value in (changes or {}).items():
        change(tree, key, value)
    problem = Problem(path.stem, from_table(TransientSettings, tree, path))
    n, start = problem.model.dim, problem.settings.start
    given = start.mean if start.kind == "gaussian" else start.box
    if len(given) != n:
        raise ModelError(
            f"the model has {n} states, but start.{'mean' if start.mean else 'box'} {len(given)} rows"
        )
    if not len(problem.times):
        raise ConfigError("times: no time of output after the start")
    if any(not 0 <= axis < n for axis in problem.settings.axes):
        raise ConfigError(f"axes = {list(problem.settings.axes)}: the states are numbered 0 to {n - 1}")
    _ = problem.quantities, problem.distribution  # what is wrong with them shows now
    _check_reference(problem)
    return problem


def _check_reference(problem):
    """Refuse a reference that does not know the problem."""
    kind, model, begins = problem.settings.reference.kind, problem.model, problem.settings.start.kind
    if kind == "linear" and not (model.linear and begins == "gaussian"):
        raise ConfigError('reference.kind = "linear" needs a linear model and a Gaussian start')
    if kind == "grid" and (model.dim > 2 or model.state_dependent_noise or begins != "gaussian"):
        needs = "one or two states, noise that does not depend on them, and a Gaussian start"
        raise ConfigError(f'reference.kind = "grid" needs {needs}')
    if kind == "drifted_uniform" and not (model.dim == 1 and begins == "uniform"):
        raise ConfigError('reference.kind = "drifted_uniform" needs one state that starts uniform on a box')
