"""A step of a model in discrete time on a lattice, by the equation of Chapman and Kolmogorov.

p'(x') = ∫ N(x'; F(x), S(x)) p(x) dx is a sum over the nodes of p: so many Gaussians, which a new lattice then
stands for. A sum over a lattice is an integral but for what has the lattice's own frequencies: of a Gaussian
of covariance S about F, nodes that are the columns of A apart, the part Σ_k exp(-2 π² |M^-T k|²) over whole
numbers k, where M = L⁻¹ F' A is the spacing after the step in units of the noise, S = L Lᵀ (Poisson).
"""

import itertools
import math
from typing import Any

import numpy as np
from scipy.special import logsumexp

from .._types import Floats, OfStates
from ..config import LogDensityScheme
from ..core._views import as_compiled
from ..core.cloud.kernels import log_sum
from ..core.field.field import Field
from ..core.field.walls import NO_WALLS
from ..core.limits import LOG_2_PI, NOTHING, ROUNDING
from ..density.particle_density import ParticleDensity
from ..density.quasi_random import net
from ..density.resample import no_weight, on_lattice, times_likelihood
from ..errors import PropagationError
from ..info import DOUBTFUL, PredictInfo
from ..lattice.check import misfit
from ..lattice.field import log_p_at, nodes
from ..lattice.level_set import lattice_depth, root_of
from ..lattice.posterior import posterior
from ..lattice.resolved import TIMES
from ..model.discrete import DiscreteModel
from ..model.paths import noise_root
from ._shared import Predicted, kept

#: Points up to which a cloud is taken, by states; of three K nodes at K others are more work. Measured by
#: tests/filter/discrete_beside.py: of two sums take as long as 2^13 points, for a thirtieth of the error.
AS_SUMS = {1: 0, 2: 2**11}
_MOST = 8_000  # nodes of a sum: times 3,000 states some .05 s, mostly once, from a wide start; usual are 300
_GRAIN = 1e-4  # of a density, that a sum over nodes may be uneven by
_SCHEME = LogDensityScheme()
_TOO_LITTLE = (
    "the noise of a step is too small for a sum over the nodes of a lattice, or its map jumps: points carry "
    "it, with the default or scheme='cloud'; smoothing goes without these"
)


def why_not(model: DiscreteModel) -> str:
    """Can sums over a lattice carry densities? Returns a reason why not, empty if they can."""
    if model.dim not in AS_SUMS:
        return f"sums over lattices are too much work in {model.dim} states"
    if not model.domain.unbounded:
        return "sums of Gaussians know no domain"
    if not model.gaussian_noise:
        return "the noise of a step is not Gaussian"
    return ""


def propagate(density: ParticleDensity, model: DiscreteModel, t1: float, n_particles: int) -> Predicted:
    """Carry a density to time t1, seconds, on lattices of about so many nodes.

    Raises `PropagationError` where noise is too small for sums over nodes, or no lattice holds the density.
    """
    starts, moved, asked = model.starts(density.t, t1), on_lattice(density, n_particles), 0
    finer = n_particles > moved.n_particles * 1.5  # a target has asked for more than the density has
    if not moved.form.smooth:
        raise PropagationError("the density has no smooth logarithm")
    for t in starts:
        moved, evaluations = _stepped(moved, model, t, n_particles, finer)
        asked += evaluations
    skipped = ("everything but sums: a step is the integral over the last density",)
    info = PredictInfo(
        n_steps=len(starts), n_evaluations=asked, error=moved.error, skipped=skipped, scheme="log_density"
    )
    return moved.noted(t=float(t1)), info


def _stepped(
    density: ParticleDensity, model: DiscreteModel, t: float, n_particles: int, finer: bool
) -> tuple[ParticleDensity, int]:
    """The density after a step, and how often the model was asked at each node."""
    mean, L, waves = _spread(density, model, t)
    many, asked = max(_enough(waves, density), n_particles if finer else 0), 1
    if many > density.n_particles:
        known = {"error": density.error, "lost": density.lost}
        density = times_likelihood(density, no_weight, many, _SCHEME)[0].noted(**known)
        (mean, L, waves), asked = _spread(density, model, t), 2
    grain = _grain(waves, density.mass)
    depth = lattice_depth(_SCHEME, model.dim)
    log_p = _log_sum(np.log(density.mass), mean, L)
    about = mean + np.einsum("kab,kb->ka", L, net(len(mean), model.dim)), density.mass, log_p, no_weight
    for times in TIMES:
        laid = posterior(*about, times * n_particles, depth, None, NO_WALLS)
        off = misfit(laid, log_p)
        if off.residual <= DOUBTFUL:
            break
    jump = _of_jumps(density, model, t, mean, laid.cov)
    if max(grain, off.residual, jump) > DOUBTFUL:
        raise PropagationError(_TOO_LITTLE)
    new = ParticleDensity.on_lattice(laid, density.t, n_particles, residual=off.residual, lost=density.lost)
    left = density.error * kept(density.x, mean, density.mass, new.cov())
    asked *= 1 + 2 * model.dim + model.n_noise
    return new.noted(error=math.hypot(left, off.mean, grain, jump), needs=density.needs), asked


def _log_sum(log_w: Floats, mean: Floats, L: Floats) -> OfStates:
    """Logarithm of a sum of Gaussians, by weights (K,), means (K, n) and lower roots (K, n, n), to 1e-7."""
    back = np.linalg.inv(L)
    peak = log_w + np.linalg.slogdet(back)[1] - 0.5 * mean.shape[1] * LOG_2_PI
    parts = peak, np.einsum("kab,kb->ak", back, mean).copy(), np.moveaxis(back, 0, -1).copy()

    def log_p(X: Floats) -> Floats:
        out = np.empty(len(X))
        log_sum(as_compiled(X), *parts, out)
        return out

    return log_p


def integrated_back(model: DiscreteModel, found: Field, prior: ParticleDensity) -> OfStates:
    """Return λ a step earlier, at the time of a prior, as a function of states (M, n).

    exp λ(x) is the integral of N(x'; F(x), S(x)) exp λ'(x'), a sum over the nodes of `found`, which is λ'
    after the step, as `backward.likelihood_field` makes it.
    """
    at, t = nodes(found), prior.t
    values = found.log_p + np.linalg.slogdet(found.A)[1] - 0.5 * model.dim * LOG_2_PI
    apart = np.linalg.solve(_noisy(model, prior.x, t)[1], found.A)
    if _grain(_exponents(apart), prior.mass) > DOUBTFUL:
        raise PropagationError(_TOO_LITTLE)

    def log_expected(X: Floats) -> Floats:
        mean, L = _noisy(model, X, t)
        off = at - mean[:, None]
        square = (np.linalg.solve(L, off.swapaxes(1, 2)) ** 2).sum(axis=1)
        peak = np.linalg.slogdet(L)[1][:, None]
        return np.asarray(logsumexp(values - 0.5 * square - peak, axis=1))

    return log_expected


def _spread(density: ParticleDensity, model: DiscreteModel, t: float) -> tuple[Floats, Floats, Floats]:
    """Where nodes go, (K, n), lower roots of the noise there, (K, n, n), and the exponents of what is missed.

    How far nodes part is told by secants from border to border of their cells, which see jumps.
    """
    field: Any = density.field
    mean, L = _noisy(model, density.x, t)
    ends = [[model.transition(density.x + s * a, t) for s in (-0.5, 0.5)] for a in field.A.T]
    apart = np.stack([high - low for low, high in ends], axis=2)
    if not (np.isfinite(mean).all() and np.isfinite(apart).all()):
        raise PropagationError("the transition leads to no finite numbers")
    return mean, L, _exponents(np.linalg.solve(L, apart))


def _of_jumps(density: ParticleDensity, model: DiscreteModel, t: float, mean: Floats, cov: Floats) -> float:
    """By how much a sum over nodes half a cell beside those of a density finds another mean, in deviations.

    Of what is smooth both are alike; where a map jumps they are half a cell's share of the jump apart.
    """
    field: Any = density.field
    beside = density.x + 0.5 * field.A.sum(axis=1)
    p = np.exp(log_p_at(field, beside))
    off = p @ model.transition(beside, t) / p.sum() - density.mass @ mean
    return float(np.linalg.norm(np.linalg.solve(np.linalg.cholesky(cov), off))) / math.sqrt(density.dim)


def _noisy(model: DiscreteModel, X: Floats, t: float) -> tuple[Floats, Floats]:
    """Where states (M, n) go without noise, and lower roots L (M, n, n) of the noise there."""
    mean, root = model.transition(X, t), noise_root(model.covariance)
    each = [model.transition(X, t, np.tile(w, (len(X), 1))) - mean for w in root.T]  # affine in the noise
    G = np.stack(each, axis=2)
    return mean, root_of(G @ G.swapaxes(1, 2), _TOO_LITTLE)


def _exponents(M: Any) -> Floats:
    """The exponents 2 π² |M^-T k|² of spacings M (K, n, n), for whole numbers k next to zero, a row each."""
    whole = np.array([k for k in itertools.product((-1.0, 0.0, 1.0), repeat=M.shape[1]) if any(k)])
    _, width, axes = np.linalg.svd(M)
    along = (axes @ whole.T) / np.maximum(width, ROUNDING)[..., None]
    return np.asarray(2.0 * np.pi**2 * np.minimum((along**2).sum(axis=1), NOTHING))


def _grain(waves: Floats, mass: Floats, finer: float = 1.0) -> float:
    """By which part a sum over nodes, so many times finer along each axis, is uneven on average."""
    return float(mass @ np.exp(-(finer**2) * waves).sum(axis=1))


def _enough(waves: Floats, density: ParticleDensity) -> int:
    """Nodes whose sum is even enough; raises `PropagationError` where they are too many."""
    many = density.n_particles
    while _grain(waves, density.mass, (many / density.n_particles) ** (1.0 / density.dim)) > _GRAIN:
        many = math.ceil(1.2 * many)
        if many > _MOST:
            raise PropagationError(_TOO_LITTLE)
    return many
