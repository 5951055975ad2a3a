"""The log-density scheme: from lattice to lattice along backward stochastic characteristics."""

import itertools
import math
from functools import cache

import numpy as np

from ..core import characteristics as core
from ..core._first_class import address_of
from ..core.field import stencils
from ..density import ParticleDensity
from ..errors import PropagationError
from ..info import PredictInfo
from ..level_set import Laid, fewest_particles, gaussian_volume
from .paper import _blow_up, _skipped

__all__ = ["fits", "propagate"]

_PAUSE_AFTER = 200  # steps between two chances to be interrupted
_TIME_SLICES = 16  # steps at least over an interval, where drift or noise change with time


def fits(model, density, n_particles):
    """Can this scheme carry the density? Returns a reason why not, empty if it can."""
    if model.state_dependent_noise:
        return "the noise depends on the state"
    if density.field is None:
        return "the density has no smooth logarithm"
    if n_particles < fewest_particles(model.dim):
        return f"{n_particles} particles are too few for a lattice of {model.dim} states"
    return ""


def propagate(density, model, t1, scheme, n_particles):
    """Carry a density that has a `field` to time t1.

    Returns
    -------
    ParticleDensity, PredictInfo

    Raises
    ------
    PropagationError
        The drift is not finite where particles are, the lattice cannot hold the density, or too much
        probability was lost on the way: says when, where, and what to change.
    """
    start, n = density.t, density.dim
    G = _noise_factor(model, 0.5 * (start + t1))
    noise = core.Noise(G, model.p, not model.constant_diffusion, model.linear)
    depth = 0.5 * scheme.reach**2
    control = core.Control(
        n_particles=n_particles,
        depth=depth,
        tolerance=scheme.tolerance,
        noise_share=scheme.noise_share,
        pause_after=_PAUSE_AFTER,
    )
    counters = np.zeros(len(core.COUNTERS), np.int64)
    volume = density.volume or gaussian_volume(n, depth)
    longest = math.inf if model.autonomous else (t1 - start) / _TIME_SLICES
    state, times = np.array([volume, min(t1 - start, longest), 0.0, longest]), np.array([start, t1])
    functions = (model.drift_batch, model.divergence_batch, model.diffusion_batch)
    addresses = tuple([address_of(function) for function in functions])
    rule = paths(G.shape[1], scheme.quadrature)
    field, status = density.field, "paused"
    while status == "paused":
        if counters[core.STEPS] >= scheme.max_steps:
            raise PropagationError(_given_up(f"{scheme.max_steps} steps were not enough", times[0], start, t1))
        try:
            field, x, mass, mean, cov, code = core.carry(
                addresses, noise, field, stencils(n), rule, control, times, state, counters
            )
        except Exception as problem:  # a black-box drift may raise anything
            raise PropagationError(
                f"the model failed between t = {times[0]:g} and {t1:g} near {density.mean()}: {problem}"
            ) from problem
        status = core.STATUS[code]
    if status == "not finite":
        raise PropagationError(_blow_up(model, _fastest(model, x, times[0]), times[0], start, t1))
    if status != "ok":
        raise PropagationError(_given_up(_REASONS[status].format(n=n_particles), times[0], start, t1))
    if not state[2] < scheme.most_lost:
        raise PropagationError(
            _given_up(f"the lattice lost or gained {100 * state[2]:.2g} % of the probability", t1, start, t1)
        )
    laid = Laid(x, mass, field, 0.0, float(state[0]), mean, cov)
    moved = ParticleDensity.on_lattice(laid, float(t1), density.capacity)
    return moved, _info(model, scheme, counters, float(state[2]))


_REASONS = {
    "stalled": "steps became too small: the drift is too stiff there, or not smooth",
    "too few nodes": "no lattice of at most {n} particles resolves the density; use more particles",
    "outgrown": "the density is spread over more lattice cells than fit into memory",
}


def _noise_factor(model, t):
    """G (n, m) with D = G Gᵀ / 2 and as few columns as D has rank."""
    D = model.diffusion(np.zeros((1, model.dim)), t)[0]
    w, V = np.linalg.eigh(D)
    some = w > 1e-14 * max(w.max(), 1e-300)
    return np.ascontiguousarray((V * np.sqrt(2.0 * np.maximum(w, 0.0)))[:, some][:, ::-1])


@cache
def paths(m, order):
    """Weighted noise paths of `Paths` for m noises.

    Each is straight to a Gauss-Hermite point of dW, and bent so that the covariance of dW and of the area
    under it is right too; from four noises on a symmetric rule of 2 m straight paths.
    """
    if m == 0:
        rule = [(0.0, [], [])]
    elif m <= 3:
        points, weights = np.polynomial.hermite_e.hermegauss(order if m == 1 else 3)
        weights = weights / weights.sum()
        one = [(math.log(w), p) for p, w in zip(points, weights, strict=True)]
        bends = list(itertools.product((-1.0, 1.0), repeat=m)) if m <= 2 else [(0.0,) * m]
        rule = [
            (sum(w for w, _ in chosen) - math.log(len(bends)), [p for _, p in chosen], list(bend))
            for chosen in itertools.product(one, repeat=m)
            for bend in bends
        ]
    else:
        axes = np.concatenate([np.eye(m), -np.eye(m)]) * math.sqrt(m)
        rule = [(-math.log(2 * m), list(p), [0.0] * m) for p in axes]
    weight, dW, bend = zip(*rule, strict=True)
    shape = (len(rule), m)
    return core.Paths(np.array(weight), np.array(dW).reshape(shape), np.array(bend).reshape(shape))


def _fastest(model, x, t):
    """The state whose velocity is largest, or not finite."""
    speed = np.abs(model.drift(x, t)).sum(axis=1)
    return x[np.argmax(np.where(np.isfinite(speed), speed, np.inf))]


def _info(model, scheme, counters, lost):
    steps, rejected, evaluations, relaid = (int(c) for c in counters)
    skipped = ["neighbour search: the lattice knows its neighbours", "gradients: the expectation needs none"]
    skipped += [note for note in _skipped(model, 0) if "evaluation of D" in note]
    if model.linear:
        skipped.append("divergence of the drift along the paths: it is constant")
    return PredictInfo(
        n_steps=steps,
        n_rejected=rejected,
        n_evaluations=evaluations,
        n_regrids=steps + relaid,
        mass_error=lost,
        skipped=tuple(skipped),
        scheme=scheme.name,
    )


def _given_up(reason, t, start, t1):
    return f"prediction from {start:g} to {t1:g} stopped at t = {t:.6g}: {reason}. Or predict over a shorter interval"
