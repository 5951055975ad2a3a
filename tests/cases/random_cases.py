"""Filters that are wrong on purpose, a problem small enough for them, and random cases judged at once."""

import numpy as np

from experiments.stress.random.equations import Equation
from experiments.stress.random.problems import RandomCase, RandomProblem
from experiments.stress.random.records import record_of
from experiments.stress.random.referees import referee
from experiments.stress.random.relations import chosen_relations, related
from experiments.stress.random.sensors import GaussianReader
from experiments.stress.random.verdicts import judge
from reference_filters.grid import GridFilter
from sphfilter.info import UpdateInfo


class PriorFilter(GridFilter):
    """Learns nothing from its readings."""

    def update(self, z, measurement=None):
        return UpdateInfo(
            accepted=True, log_evidence=super()._updated(self._belief, z, measurement)[1]["log_evidence"]
        )


class NarrowFilter(GridFilter):
    """Claims half the variance that it has."""

    def _moments(self, belief):
        x, P = super()._moments(belief)
        return x, 0.5 * P


class WarningFilter(PriorFilter):
    """Learns nothing, and says that something is unusual."""

    def update(self, z, measurement=None):
        return UpdateInfo(**(vars(super().update(z, measurement)) | {"status": "nothing was learnt"}))


def made_with(kind):
    """What makes a filter of a kind, for `record_of`."""

    def make(problem):
        return kind(problem.model, None, problem.x0, problem.P0, problem.t0, size=128)

    return make


def double_well(n_readings=4):
    """A double well that is read twice a second."""
    equation = Equation(states=("x0",), drift=("x0 - x0**3",), noise=(("0.7",),))
    reader = GaussianReader(kind="linear", states=("x0",), R=np.array([[0.3]]), H=np.eye(1))
    times, z = 0.5 * np.arange(1.0, n_readings + 1), np.array([[0.9], [1.3], [0.4], [-0.2]])[:n_readings]
    start = {"x0": np.array([0.3]), "P0": np.array([[0.5]])}
    return RandomProblem(
        kind="double well", equation=equation, readers=(reader,), z=(z,), times=times, truth=z, **start
    )


def oscillator():
    """A linear model with two sensors of matrices, which the Kalman filter is exact on."""
    states = "x0", "x1"
    equation = Equation(states=states, drift=("x1", "-x0 - 0.4*x1"), noise=(("0.1", "0"), ("0", "0.9")))
    rng, start = (
        np.random.default_rng(3),
        {"x0": np.array([1.0, 0.0]), "P0": np.array([[0.2, 0.1], [0.1, 0.4]])},
    )
    readers = (
        GaussianReader(kind="linear", states=states, R=np.array([[0.2]]), H=np.array([[1.0, 0.0]])),
        GaussianReader(
            kind="linear", states=states, R=np.diag([0.3, 0.1]), H=np.array([[0.0, 1.0], [1.0, 1.0]])
        ),
    )
    z = tuple(0.3 * rng.standard_normal((5, len(reader.R))) for reader in readers)
    times = 0.4 * np.arange(1.0, 6.0)
    return RandomProblem(
        kind="oscillator",
        equation=equation,
        readers=readers,
        z=z,
        times=times,
        truth=np.zeros((5, 2)),
        **start,
    )


def verdict_of(seed, number):
    """The verdict on a random case, made in this process."""
    problem = RandomCase(number).problem(seed)
    names = chosen_relations(problem, seed, number)
    partners = {name: record_of(related(problem, name, seed, number)) for name in names}
    return judge(record_of(problem), referee(problem, seed), partners)
