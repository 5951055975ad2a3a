"""The thesis' rival on polynomial models: cumulant equations closed at several orders (000 4.1.3)."""

import time
from dataclasses import dataclass

import numpy as np

from reference_filters.cumulant import cumulant_moments


@dataclass(frozen=True)
class Rival:
    """Cumulant equations of one order."""

    name: str
    # shape (T, S): NaN for quantities the equations do not have, and once they have diverged
    values: np.ndarray
    seconds: float
    diverged: str  # what happened and when; empty if nothing did


def rivals_of(problem):
    """Solve the cumulant equations of all orders that a problem's file asks for."""
    return [_rival(problem, order) for order in problem.settings.statistics.cumulants]


def _rival(problem, order):
    began = time.perf_counter()
    start = problem.settings.start.time
    found = cumulant_moments(problem.model, problem.distribution, problem.times, order, t0=start)
    seconds = time.perf_counter() - began
    known = [q.powers is not None and sum(q.powers) <= order for q in problem.quantities]
    values = np.full((len(problem.times), len(known)), np.nan)
    for j in np.flatnonzero(known):
        values[:, j] = found.moment(problem.quantities[j].powers)
    return Rival(f"cumulants to order {order}", values, seconds, found.diverged)
