"""The scheme of 002: explicit steps of SPH particles, on the paper's lattice, masses and re-gridding."""

import math
from dataclasses import replace

import numpy as np

from .._types import Floats
from ..config import BUFFER_NEIGHBORS, PaperScheme
from ..core._addresses import address_of
from ..core._jit import start_threads
from ..core._records import packed
from ..core.limits import ROUNDS, TINY
from ..core.sph import march as core
from ..core.sph.neighbors import METHODS, choose_method
from ..core.sph.smoothing import SMOOTHING
from ..core.sph.state import INTEGRATORS, Cloud, Equations, Options, Progress
from ..density.initialize import on_equal_lattice
from ..density.particle_density import ParticleDensity
from ..density.resample import regrid
from ..errors import PropagationError
from ..info import PredictInfo
from ..model.compile import surfacing
from ..model.domain import Domain
from ..model.sde import SDE
from ._shared import Predicted, blow_up, skip_notes

#: Particles from which kernel sums are spread over threads; by their number alone, so that the thread
#: count never changes a bit of the result.
PARALLEL_FROM = 2000
_PAUSE_AFTER = 2000  # steps between two chances to be interrupted
_TIME_SLICES = 100  # steps at least, where drift or noise change with time: a sine turns by 2π/100 = .06
_RUN_AWAY = 1e3  # extents of the cloud


def propagate(
    density: ParticleDensity, model: SDE, t1: float, scheme: PaperScheme, n_particles: int
) -> Predicted:
    """Carry a density to time t1 with v = f - div D - D grad p / p.

    Steps that have become too small mean that particles have run together (002 section 5.1): they are put on
    a new lattice of at most `n_particles`, the paper's own remedy, and the march goes on. Raises
    `PropagationError` if a state or its velocity is no longer finite, or re-gridding did not help; it says
    when and where.
    """
    start, progress, n_regrids = density.t, packed(Progress(density.t, t1)), 0
    n_discarded, share_kept, status = 0, 1.0, ""
    if density.form.smooth:
        density = on_equal_lattice(density, n_particles, scheme)
    # A step is chosen by what it sees at its start: it must not stride over a change in time.
    dt_max = min(model.max_step, math.inf if model.autonomous else (t1 - start) / _TIME_SLICES)
    while density.t < t1:
        up_to_date = status == "unsettled"  # a step discards once, however few iterations it may take
        density, status, about = _march(density, model, scheme, progress, dt_max, up_to_date)
        if status == "not finite" or (status == "stalled" and _runs_away(model, density, about, t1)):
            raise PropagationError(blow_up(model, about, density.t, start, t1, "paper"))
        if status == "paused" and progress.steps >= scheme.max_steps:
            raise PropagationError(_given_up("too many steps", density.t, start, t1, scheme))
        if status == "unsettled":
            density, n, share = _without_unsettled(density, about, scheme)
            n_discarded, share_kept = n_discarded + n, share_kept * (1.0 - share)
        if status == "stalled":
            n_regrids += 1
            if n_regrids > ROUNDS:
                reason = f"steps fell to zero even after {ROUNDS} re-griddings"
                raise PropagationError(_given_up(reason, density.t, start, t1, scheme))
            density, _ = regrid(density, n_particles, scheme)
    info = PredictInfo(
        n_steps=int(progress.steps),
        n_evaluations=int(progress.evaluations),
        n_searches=int(progress.searches),
        n_bypassed=int(progress.bypassed),
        n_regrids=n_regrids,
        n_smoothing_failed=int(progress.smoothing_failed),
        n_discarded=n_discarded,
        mass_discarded=1.0 - share_kept,
        skipped=skip_notes(model, int(progress.bypassed)),
        scheme=scheme.name,
        error=math.nan,  # nothing estimates it
    )
    return density, info


def _march(
    density: ParticleDensity,
    model: SDE,
    scheme: PaperScheme,
    progress: np.record,
    dt_max: float,
    up_to_date: bool,
) -> tuple[ParticleDensity, str, Floats]:
    """One call of the compiled loop, to progress.t1.

    Returns the density as far as it came, a status, and what that is about: a state, or the masses left.
    """
    invariant = np.zeros(density.n_particles) if density.invariant is None else density.invariant
    arrays = (density.x, density.mass, density.h, invariant, np.empty(density.n_particles))
    cloud = Cloud(*(a.copy() for a in arrays))
    options = _options(scheme, density, dt_max, up_to_date, scheme.max_steps - int(progress.steps))
    progress.culprit = 0  # the one of the last call may be gone
    start_threads()
    equations = _equations_of(model)
    with surfacing():
        code = core.march(core.parts(), equations, cloud, model.domain.codes, packed(options), progress)
    status, culprit, t = core.STATUS[code], cloud.x[progress.culprit], np.float64(progress.t)
    finite = np.isfinite(cloud.x).all(axis=1) & np.isfinite(cloud.h)
    if not finite.all():
        status, culprit = "not finite", cloud.x[~finite][0]
    if status == "left":
        raise PropagationError(_left(model.domain, culprit, t))
    if status == "not finite":
        return replace(density, t=t), status, culprit
    moved = replace(density, x=cloud.x, h=cloud.h, t=t, invariant=cloud.invariant)
    return moved, status, cloud.m if status == "unsettled" else culprit


def _equations_of(model: SDE) -> Equations:
    """A model as the compiled march takes it; it must outlive its use."""
    constant = model.constant_diffusion
    D = model.diffusion(np.zeros((1, model.dim)), 0.0)[0] if constant else np.zeros((model.dim, model.dim))
    return Equations(
        drift=address_of(model.drift_batch),
        diffusion=address_of(model.diffusion_batch),
        divergence=address_of(model.diffusion_divergence_batch),
        p=model.p,
        D=np.ascontiguousarray(D),
        rows=np.flatnonzero(model.diffusion_rows),
        time_dependent=not constant and not model.state_dependent_noise,
        state_dependent=bool(model.state_dependent_noise),
    )


def _without_unsettled(
    density: ParticleDensity, mass: Floats, scheme: PaperScheme
) -> tuple[ParticleDensity, int, float]:
    """A density without the particles that have no `mass` left (N,): the others share it (000 Algorithm 3).

    Returns it with the number and the probability of those that were.
    """
    kept = mass > 0.0
    share = float(density.mass[~kept].sum())
    if kept.sum() <= density.dim:
        raise PropagationError(
            f"the smoothing lengths of {(~kept).sum()} of {len(kept)} particles did not converge at t = "
            f"{density.t:.6g}, and none is left: raise smoothing_iterations (now "
            f"{scheme.smoothing_iterations}) or smoothing_tolerance (now {scheme.smoothing_tolerance:g}), or "
            f"leave discard_unconverged off"
        )
    # Lengths keep rho h^n: where all masses grow alike, they must not change.
    invariant = None if density.invariant is None else density.invariant / (1.0 - share)
    return replace(density, mass=mass, invariant=invariant), int((~kept).sum()), share


def _runs_away(model: SDE, density: ParticleDensity, state: Floats, t1: float) -> bool:
    """Would the drift at a state carry it out of all proportion to the cloud in the time that is left?"""
    extent = np.ptp(density.x, axis=0).max()
    return np.linalg.norm(model.drift(state, density.t)) * (t1 - density.t) > _RUN_AWAY * extent


def _options(
    scheme: PaperScheme, density: ParticleDensity, dt_max: float, up_to_date: bool, steps_left: int
) -> Options:
    kernel = density.sph_kernel
    n, N = density.dim, density.n_particles
    buffer = scheme.buffer_neighbors or BUFFER_NEIGHBORS.get(n, 110)
    buffer = min(buffer, N - 1) if scheme.bypass else 0
    fixed, no_limit = scheme.cfl == "fixed", 1.0 / TINY
    search = choose_method(N, n) if scheme.search == "auto" else METHODS.index(scheme.search)
    return Options(
        kernel=kernel.kind,
        normalisation=kernel.constant,
        kernel_variance=kernel.variance,
        smoothing=SMOOTHING.index(scheme.smoothing),
        smoothing_tolerance=scheme.smoothing_tolerance,
        smoothing_iterations=scheme.smoothing_iterations,
        discards=scheme.discard_unconverged,
        up_to_date=up_to_date,
        integrator=INTEGRATORS.index(scheme.integrator),
        relative_cfl=scheme.cfl == "relative",
        c_cfl=no_limit if fixed else scheme.c_cfl,
        dt_max=dt_max if scheme.dt_max is None else min(dt_max, scheme.dt_max),
        c_diffusion=no_limit if fixed or scheme.c_diffusion is None else scheme.c_diffusion,
        search=search,
        bypass=scheme.bypass,
        c_nns=scheme.c_nns,
        k_bypass_max=scheme.bypass_max,
        buffer=buffer,
        buffer_min=buffer // 2,
        looks_ahead=scheme.smoothing in ("fixed_point", "newton") or scheme.integrator != "euler",
        parallel=N >= PARALLEL_FROM,
        pause_after=max(min(_PAUSE_AFTER, steps_left), 1),
    )


def _left(domain: Domain, state: Floats, t: float) -> str:
    axis = np.flatnonzero(~domain.fits(state))[0]
    return (
        f"a particle left the domain at t = {t:.6g}, at {state}: axis {axis} is bounded by "
        f"{domain.low[axis]:g} and {domain.high[axis]:g}. Widen it, make it reflecting, or stop earlier"
    )


def _given_up(status: str, t: float, start: float, t1: float, scheme: PaperScheme) -> str:
    return (
        f"prediction from {start:g} to {t1:g} stopped at t = {t:.6g}: {status}. Use fewer particles, a "
        f"larger c_cfl (now {scheme.c_cfl:g}) or max_steps (now {scheme.max_steps}), or a shorter interval"
    )
