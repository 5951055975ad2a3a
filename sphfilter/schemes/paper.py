"""The scheme of 002: explicit steps of SPH particles, on the paper's lattice, masses and re-gridding."""

import math
from dataclasses import replace

import numpy as np

from ..config import BUFFER_NEIGHBORS
from ..core import march as core
from ..core._jit import call
from ..core.neighbors import METHODS, choose_method
from ..core.smoothing import SMOOTHING
from ..errors import PropagationError
from ..info import PredictInfo
from ..resample import regrid

__all__ = ["propagate"]

#: Particles from which kernel sums are spread over threads; by their number alone, so that the thread
#: count never changes a bit of the result.
PARALLEL_FROM = 2000
_MOST_REGRIDS = 20
_RUN_AWAY = 1e3  # extents of the cloud


def propagate(density, model, t1, scheme):
    """Carry a density to time t1 with v = f - div D - D grad p / p.

    Steps that have become too small or too many mean that particles have run together (002 section 5.1): they
    are put on a new lattice, the paper's own remedy, and the march goes on.

    Returns
    -------
    ParticleDensity, PredictInfo

    Raises
    ------
    PropagationError
        The state or its velocity is no longer finite, or re-gridding did not help; says when and where.
    """
    start, counters, n_regrids = density.t, np.zeros(len(core.COUNTERS), np.int64), 0
    while density.t < t1:
        density, status, culprit = _march(density, model, t1, scheme, counters)
        if status == "not finite" or (status == "stalled" and _runs_away(model, density, culprit, t1)):
            raise PropagationError(_blow_up(model, culprit, density.t, start, t1))
        if status != "ok":
            n_regrids += 1
            if n_regrids > _MOST_REGRIDS:
                raise PropagationError(_given_up(status, density.t, start, t1, scheme))
            density, _ = regrid(density, density.n_particles, scheme)
    steps, evaluations, searches, bypassed, failed, _ = (int(c) for c in counters)
    info = PredictInfo(
        n_steps=steps,
        n_evaluations=evaluations,
        n_searches=searches,
        n_bypassed=bypassed,
        n_regrids=n_regrids,
        n_smoothing_failed=failed,
        skipped=_skipped(model, bypassed),
        scheme=scheme.name,
    )
    return density, info


def _march(density, model, t1, scheme, counters):
    """One call of the compiled loop; returns the density as far as it came."""
    cloud = core.Cloud(
        *(a.copy() for a in (density.x, density.mass, density.h)),
        *(np.empty(density.n_particles) for _ in range(3)),
    )
    cloud.h0[:] = density.h
    times = np.array([density.t, t1])
    functions = (model.drift_batch, model.diffusion_batch, model.diffusion_divergence_batch)
    try:
        code = call(
            core.march, *functions, _coefficients(model), cloud, _options(scheme, density), times, counters
        )
    except (ArithmeticError, ValueError) as problem:
        raise PropagationError(
            f"the model failed between t = {density.t:g} and {t1:g} near {density.mean()}: {problem}"
        ) from problem
    status, culprit = core.STATUS[code], cloud.x[counters[-1]]
    if status == "ok" and not (np.isfinite(cloud.x).all() and np.isfinite(cloud.h).all()):
        status, culprit = "not finite", cloud.x[~np.isfinite(cloud.x).all(axis=1)][0]
    if status == "not finite":
        return replace(density, t=times[0]), status, culprit
    return replace(density, x=cloud.x, h=cloud.h, t=times[0], _index=[]), status, culprit


def _runs_away(model, density, state, t1):
    """Would the drift at a state carry it out of all proportion to the cloud in the time that is left?"""
    extent = np.ptp(density.x, axis=0).max()
    return np.linalg.norm(model.drift(state, density.t)) * (t1 - density.t) > _RUN_AWAY * extent


def _coefficients(model):
    constant = model.constant_diffusion
    D = model.diffusion(np.zeros((1, model.dim)), 0.0)[0] if constant else np.zeros((model.dim, model.dim))
    return core.Coefficients(
        p=model.p,
        D=np.ascontiguousarray(D),
        rows=np.flatnonzero(model.diffusion_rows),
        time_dependent=not constant and not model.state_dependent_noise,
        state_dependent=bool(model.state_dependent_noise),
    )


def _options(scheme, density):
    kind, constant = density.kernel_code
    n, N = density.dim, density.n_particles
    buffer = scheme.buffer_neighbors or BUFFER_NEIGHBORS.get(n, 110)
    buffer = min(buffer, N - 1) if scheme.bypass else 0
    search = choose_method(N, n) if scheme.search == "auto" else METHODS.index(scheme.search)
    return core.Options(
        kernel=kind,
        normalisation=constant,
        kernel_variance=density.kernel_variance,
        smoothing=SMOOTHING.index(scheme.smoothing),
        smoothing_tolerance=scheme.smoothing_tolerance,
        integrator=core.INTEGRATORS.index(scheme.integrator),
        relative_cfl=scheme.cfl == "relative",
        c_cfl=scheme.c_cfl,
        dt_max=math.inf if scheme.dt_max is None else scheme.dt_max,
        c_diffusion=scheme.c_diffusion,
        search=search,
        bypass=scheme.bypass,
        c_nns=scheme.c_nns,
        k_bypass_max=scheme.bypass_max,
        buffer=buffer,
        buffer_min=buffer // 2,
        parallel=N >= PARALLEL_FROM,
        max_steps=scheme.max_steps,
    )


def _skipped(model, bypassed):
    zero = np.flatnonzero(~model.diffusion_rows)
    notes = []
    if zero.size:
        notes.append(f"diffusion velocity of states {', '.join(map(str, zero))}: no noise there")
    if not model.state_dependent_noise:
        notes.append("divergence of D: noise does not depend on the state")
    if model.constant_diffusion:
        notes.append("evaluation of D: it is constant")
    if bypassed:
        notes.append(f"{bypassed} neighbour searches: lists still valid")
    return tuple(notes)


def _blow_up(model, state, t, start, t1):
    values = ", ".join(f"{name} = {value:.4g}" for name, value in zip(model.states, state, strict=True))
    return (
        f"the model blew up at t = {t:.6g} (prediction from {start:g} to {t1:g}), at the particle {values}: "
        f"its velocity grows without bound. Check the drift there, predict over a shorter interval, or use "
        f"a smaller represented_mass so that particles stay out of the far tail"
    )


def _given_up(status, t, start, t1, scheme):
    return (
        f"prediction from {start:g} to {t1:g} stopped at t = {t:.6g}: {status} even after {_MOST_REGRIDS} "
        f"re-griddings. Use fewer particles, a larger c_cfl (now {scheme.c_cfl:g}) or max_steps (now "
        f"{scheme.max_steps}), or a shorter interval"
    )
