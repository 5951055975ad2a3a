"""The exact density of a transient problem, or a grid's, as a `Truth`."""

import numpy as np
from scipy.stats import multivariate_normal, qmc

from experiments.transient.references import drifted, gaussians, grid_densities, reference_of
from experiments.transient.tables import moments
from reference_filters.closed_forms import drifted_uniform
from sphfilter.errors import ConfigError

from .errors import Truth, errors_of

_NODES = 121  # an axis of a quadrature, in one and two dimensions
_REACH = 6.5  # standard deviations it spans
_DRAWS = 2**13  # quasi-random nodes beyond two dimensions
_WIDER = 1.3  # times the exact density's width: the density compared may be wider


def truth_of(problem, progress=None):
    """The `Truth` that a problem's solution is compared with, as its file asks for.

    `progress(n_done, n_all)` is told of references that take long. Raises `ConfigError` if the problem has no
    reference.
    """
    kind = problem.settings.reference.kind
    if kind == "none":
        raise ConfigError(
            f'{problem.name} has reference.kind = "none": an accuracy study needs one, "linear" for a linear '
            f'model, "grid" for one or two states, "monte_carlo" for the moments alone'
        )
    if kind == "monte_carlo":
        return _paths(problem, progress)
    return {"linear": _linear, "drifted_uniform": _uniform, "grid": _grid}[kind](problem)


def _linear(problem):
    """Closed form: a Gaussian at all times."""
    means, covs = zip(*gaussians(problem), strict=True)
    parts = []
    for mean, cov in zip(means, covs, strict=True):
        X, w = quadrature(mean, cov)
        parts.append((X, multivariate_normal(mean, cov).pdf(X), w))
    return Truth("closed form", np.array(means), np.array(covs), *zip(*parts, strict=True))


def quadrature(mean, cov):
    """Nodes (M, n) and weights (M,) for integrals of what lives where N(mean, cov) does."""
    n, L = len(mean), np.linalg.cholesky(cov)
    if n <= 2:
        axis = np.linspace(-_REACH, _REACH, _NODES)
        z = np.stack(np.meshgrid(*n * [axis], indexing="ij"), axis=-1).reshape(-1, n)
        cell = (axis[1] - axis[0]) ** n * np.prod(np.diag(L))
        return mean + z @ L.T, np.full(len(z), cell)
    z = _WIDER * qmc.MultivariateNormalQMC(np.zeros(n), seed=1).random(_DRAWS)
    density = multivariate_normal(np.zeros(n), _WIDER**2 * np.eye(n)).pdf(z) / np.prod(np.diag(L))
    return mean + z @ L.T, 1.0 / (density * _DRAWS)


def _uniform(problem):
    """Closed form of drifted Brownian motion from a uniform start, 000 (58)."""
    drift, D, centre, half = drifted(problem)
    times = problem.times - problem.settings.start.time
    means = centre + drift * times[:, None]
    covs = (half**2 / 3.0 + 2.0 * D * times)[:, None, None]
    parts = []
    for t, mean in zip(times, means, strict=True):
        width = half + _REACH * np.sqrt(2.0 * D * t)
        x, step = np.linspace(-width, width, 40 * _NODES, retstep=True)
        p = drifted_uniform(x, t, 0.0, D, half)
        parts.append((mean + x[:, None], p, np.full(len(x), step)))
    return Truth("closed form", means, covs, *zip(*parts, strict=True))


def _grid(problem):
    """A grid, and its distance from half as many nodes an axis as the bound of its error."""
    size = problem.settings.reference.size
    fine, coarse = (list(grid_densities(problem, s)) for s in (size, max(size // 2, 32)))
    parts = [
        (d.box.nodes(), np.maximum(d.values.ravel(), 0.0), np.full(d.values.size, d.box.cell)) for d in fine
    ]
    means, covs = zip(*(density.moments() for density in fine), strict=True)
    truth = Truth(f"grid of {size} nodes an axis", np.array(means), np.array(covs), *zip(*parts, strict=True))
    doubt = errors_of([_Gridded(density) for density in coarse], truth)
    return Truth(truth.name, truth.mean, truth.cov, truth.nodes, truth.values, truth.weights, doubt)


class _Gridded:
    """A grid's density under the names of a particle density's."""

    def __init__(self, density):
        self.pdf = density.pdf
        self._mean, self._cov = density.moments()

    def mean(self):
        return self._mean

    def cov(self):
        return self._cov


def _paths(problem, progress):
    """Moments over many paths; their density is not known."""
    found = reference_of(problem, progress)
    return Truth(found.name, *moments(found.values, problem.model.dim))
