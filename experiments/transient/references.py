"""Reference values of a transient problem's statistics, each with a bound or an interval."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from reference_filters.closed_forms import drifted_uniform, linear_moments
from reference_filters.grid import GridFilter
from reference_filters.monte_carlo import simulate_statistics

#: Points of a quadrature over a Gaussian, and its standard deviations.
_NODES, _FAR = 200_001, 12.0
#: Folder of the paths that are kept from run to run.
_CACHE = Path("results") / "transient" / "references"


@dataclass(frozen=True)
class ReferenceValues:
    """Values of S quantities at T times."""

    name: str  # what they are, for people
    # shape (T, S): NaN where there is none; half widths of 95 % intervals, or bounds of the error
    values: np.ndarray
    half_width: np.ndarray
    sampled: bool = False  # the half widths are those of intervals


def reference_of(problem, progress=None):
    """Return the `ReferenceValues` that a problem's file asks for, or None."""
    kind = problem.settings.reference.kind
    if kind == "none":
        return None
    return _KINDS[kind](problem, progress)


def _linear(problem, progress):
    """Closed form of a linear model: Gaussian at all times."""
    rows = [
        [_of_gaussian(q, t, mean, cov) for q in problem.quantities]
        for t, (mean, cov) in zip(problem.times, gaussians(problem), strict=True)
    ]
    return ReferenceValues("closed form", np.array(rows), np.zeros((len(rows), len(rows[0]))))


def gaussians(problem):
    """Mean (n,) and covariance (n, n) of a linear problem at each of its times."""
    model, start = problem.model, problem.settings.start
    exact, origin = model.to_linear(), np.zeros((1, model.dim))
    intensity = 2.0 * exact.diffusion(origin, 0.0)[0]
    elapsed = problem.times - start.time
    return [linear_moments(exact.A, exact.b, intensity, start.mean, start.cov, t) for t in elapsed]


def _of_gaussian(quantity, t, mean, cov):
    """A quantity of a Gaussian at time t: over the one or two states it reads, NaN where it reads more."""
    n = len(mean)
    read = [d for d in range(n) if _reads(quantity, t, d, mean, cov)]
    if len(read) == 1:
        z = np.linspace(-_FAR, _FAR, _NODES)
        X = np.tile(mean, (_NODES, 1))
        X[:, read[0]] += z * np.sqrt(cov[read[0], read[0]])
        return float(np.trapezoid(quantity.at(X, t) * stats.norm.pdf(z), z))
    if quantity.powers is not None and sum(quantity.powers) == 2:
        i, j = read
        return float(cov[i, j] + mean[i] * mean[j])
    return np.nan


def _reads(quantity, t, axis, mean, cov):
    if quantity.powers is not None:
        return quantity.powers[axis] > 0
    X = mean + np.sqrt(np.diag(cov)) * np.random.default_rng(axis).uniform(-6, 6, (4000, len(mean)))
    Y = X.copy()
    Y[:, axis] = Y[::-1, axis]
    return np.any(quantity.at(X, t) != quantity.at(Y, t))


def _uniform(problem, progress):
    """Closed form of drifted Brownian motion from a uniform start, 000 (58)."""
    drift, D, centre, half = drifted(problem)
    rows = []
    for end in problem.times:
        t = end - problem.settings.start.time
        width = half + _FAR * np.sqrt(2.0 * D * t)
        x = np.linspace(-width, width, _NODES) + drift * t
        p = drifted_uniform(x, t, drift, D, half)
        rows.append([np.trapezoid(q.at(x[:, None] + centre, end) * p, x) for q in problem.quantities])
    return ReferenceValues("closed form", np.array(rows), np.zeros((len(rows), len(rows[0]))))


def drifted(problem):
    """Drift, D, and centre and half width of the start of a drifted Brownian motion."""
    model, box = problem.model, problem.settings.start.sides
    origin = np.zeros((1, 1))
    drift, D = model.drift(origin, 0.0)[0, 0], model.diffusion(origin, 0.0)[0, 0, 0]
    return drift, D, np.mean(box[0]), 0.5 * np.ptp(box[0])


def _grid(problem, progress):
    """A grid, and the difference to half as many nodes as the bound of its error."""
    size = problem.settings.reference.size
    fine, coarse = (_on_grid(problem, s) for s in (size, max(size // 2, 32)))
    return ReferenceValues(f"grid of {size} nodes an axis", fine, np.abs(fine - coarse))


def _on_grid(problem, size):
    rows = []
    for t, density in zip(problem.times, grid_densities(problem, size), strict=True):
        X, p = density.box.nodes(), density.values.ravel()
        rows.append([q.at(X, t) @ p / p.sum() for q in problem.quantities])
    return np.array(rows)


def grid_densities(problem, size):
    """A problem's densities at its times, as a grid of so many nodes an axis has them."""
    start = problem.settings.start
    grid = GridFilter(problem.model, None, start.mean, start.cov, t0=start.time, size=size, tol=1e-4)
    for t in problem.times:
        if t > grid.t:
            grid.predict(t=t)
        yield grid.density


def _monte_carlo(problem, progress):
    """Means over paths with intervals of Student's t."""
    asked, quantities = problem.settings.reference, problem.quantities
    conditions = [q for q in quantities if q.powers is None]
    indicators = {name: f for q in conditions for name, f in _indicators(q, problem.times).items()}
    found = simulate_statistics(
        problem.model,
        problem.distribution,
        problem.times,
        moments=[q.powers for q in quantities if q.powers is not None],
        indicators=indicators,
        n_paths=asked.n_paths,
        t0=problem.settings.start.time,
        rng=1,
        step=asked.step,
        cache=_CACHE / problem.name,
        progress=progress,
    )
    low, high = found.interval(0.95)
    values, half = np.empty((2, len(problem.times), len(quantities)))
    first = len(quantities) - len(conditions)
    values[:, :first], half[:, :first] = found.mean[:, :first], 0.5 * (high - low)[:, :first]
    for j, quantity in enumerate(conditions, start=first):
        for k, name in enumerate(_names(quantity, problem.times)):
            at = found.names.index(name)
            values[k, j], half[k, j] = found.mean[k, at], 0.5 * (high - low)[k, at]
    return ReferenceValues(f"{found.n_paths:,} paths", values, half, sampled=True)


def _names(quantity, times):
    """Name of a condition's indicator at each time: one for all, unless it names the time."""
    return [f"{quantity.name} at t = {t!r}" if quantity.timed else quantity.name for t in times.tolist()]


def _indicators(quantity, times):
    """Indicators of a condition by name; they know no time, so that one that does is many."""
    return {
        name: lambda X, t=t: quantity.at(X, t) for name, t in zip(_names(quantity, times), times, strict=True)
    }


_KINDS = {"linear": _linear, "drifted_uniform": _uniform, "grid": _grid, "monte_carlo": _monte_carlo}
