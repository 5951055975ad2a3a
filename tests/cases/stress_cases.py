"""Filters that are wrong on purpose, problems small enough for them, and cases judged at once."""

import numpy as np

from experiments.show.comparison import moment_errors
from experiments.stress.hard_systems import equation, line, position
from experiments.stress.problem import Problem
from experiments.stress.records import default_filter, record_of
from experiments.stress.referees import referee
from experiments.stress.relations import chosen_relations, related
from experiments.stress.sensors import GaussianReader
from experiments.stress.verdicts import judge
from reference_filters.grid import GridFilter
from sphfilter.errors import PropagationError
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


class BreakingFilter(GridFilter):
    """Spoils its state before it refuses."""

    def predict(self, dt=None, *, t=None):
        self.x = self.x + 1.0
        raise PropagationError("no further")


class WarningFilter(PriorFilter):
    """Learns nothing, and says that something is unusual."""

    def update(self, z, measurement=None):
        return UpdateInfo(**(vars(super().update(z, measurement)) | {"status": "nothing was learnt"}))


def made_with(kind):
    """What makes a filter of a kind, for `record_of`."""
    return lambda problem: kind(*problem.start, size=128)


def double_well():
    """A double well that is read twice a second."""
    z, start = np.array([[0.9], [1.3], [0.4], [-0.2]]), {"x0": np.array([0.3]), "P0": np.array([[0.5]])}
    model, readers = line("double well", 0.49), (position(1, 0.3),)
    return Problem(equation=model, readers=readers, z=(z,), times=0.5 * np.arange(1.0, 5.0), **start)


def oscillator():
    """A linear model with two sensors of matrices, which the Kalman filter is exact on."""
    model = equation(("x1", "-x0 - 0.4*x1"), np.diag([0.1, 0.9]))
    H, R = np.array([[0.0, 1.0], [1.0, 1.0]]), np.diag([0.3, 0.1])
    readers = position(2, 0.2), GaussianReader(kind="linear", states=model.states, R=R, H=H)
    rng, times = np.random.default_rng(3), 0.4 * np.arange(1.0, 6.0)
    z = tuple(0.3 * rng.standard_normal((5, len(reader.R))) for reader in readers)
    start = {"x0": np.array([1.0, 0.0]), "P0": np.array([[0.2, 0.1], [0.1, 0.4]])}
    return Problem(equation=model, readers=readers, z=z, times=times, **start)


def verdict_of(case, make=default_filter):
    """The verdict on a case, made in this process."""
    problem = case.problem()
    names = chosen_relations(problem, case)
    partners = {name: record_of(related(problem, name, case.key), make) for name in names}
    return judge(record_of(problem, make), referee(problem, case.seed), partners, problem.truth)


def check_right(problem, record, reference):
    """A filter is right to the end, or to where it refuses to go on, or openly refuses a reading."""
    found = judge(record, reference, truth=problem.truth)
    if found.verdict != "wrong, flagged" or "not used" not in record.said:
        assert found.verdict in ("right", "right, flagged", "refused", "no answer"), found
        check_moments(record, reference)


def check_moments(record, reference):
    """Means and whole covariances agree in the mean of the epochs: a verdict looks at variances alone."""
    k = min(len(record.x), reference.n_trusted)
    mean, cov = moment_errors(record.x[:k], record.P[:k], reference.x[:k], reference.P[:k])
    assert not k or (np.sqrt(np.mean(mean**2)) < 0.1 and np.sqrt(np.mean(cov**2)) < 0.25)
