"""Moment-corrected SPH in whitened coordinates: the robust scheme, for any dimension."""

import math
from dataclasses import replace

import numpy as np

from .._types import Floats, Ints
from ..config import CorrectedScheme
from ..core._jit import start_threads
from ..core._records import packed
from ..core.corrected import march as core
from ..core.corrected.moment_correction import exponents
from ..core.sph.kernels import Kernel
from ..density.affine import uncut
from ..density.particle_density import ParticleDensity
from ..errors import PropagationError
from ..info import Code, PredictInfo
from ..model.compile import surfacing
from ..model.sde import SDE
from ._shared import blow_up, equations_of, skip_notes

__all__ = ["propagate"]

_PAUSE_AFTER = 200  # steps between two chances to be interrupted
_TIME_SLICES = 32  # steps at least over an interval, where drift or noise change with time
_PARTICLES_A_FUNCTION = 10
_MIXED = 0.35  # nats: where the two read-outs differ by more, root mean square, the kernels' is better
_TOLERANCE = 1e-5  # of the smoothing lengths that the log-density is computed from


def propagate(
    density: ParticleDensity, model: SDE, t1: float, scheme: CorrectedScheme, n_particles: int | None = None
) -> tuple[ParticleDensity, PredictInfo]:
    """Carry a density to time t1 with v = f + u, u corrected so that the moment equations hold.

    The density comes back with its log-density at the particles, L = L0 - log(V / V0) with V the volume of
    a particle, (h/eta)^n. Mass over volume involves no kernel that smooths the density: nothing has to be
    de-convolved, and what the rim of the cloud does to V cancels in the ratio.

    Parameters
    ----------
    density : ParticleDensity
        Particles of any masses, regular in the coordinates that whiten them. L0 is its `log_density`, mass
        over volume where it has none.
    model : SDE
    t1 : float
        Seconds.
    scheme : CorrectedScheme
    n_particles : int, optional
        Not used: particles are not put on a new lattice.

    Returns
    -------
    ParticleDensity, PredictInfo

    Raises
    ------
    PropagationError
        The state or its velocity is no longer finite, the steps fell to zero, or the particles span no
        volume; says when and where.
    """
    if density.domain is not None:
        raise PropagationError(
            'moment-corrected SPH knows no periodic axes and no walls: use scheme = "paper"'
        )
    density = uncut(density)
    options = _options(density, model, t1, scheme)
    powers = exponents(density.dim, max(options.degree, 1))[: None if options.degree else 0]
    cloud = core.Cloud(density.x.copy(), density.mass.copy(), density.h.copy())
    start_threads()
    before = _log_volumes(cloud, options, density.t)
    progress = _march(cloud, model, options, powers, scheme, (density.t, t1))
    after = _log_volumes(cloud, options, t1)
    known = np.log(cloud.m) - before if density.log_density is None else density.log_density
    moved = replace(
        density,
        x=cloud.x,
        h=cloud.h,
        t=float(t1),
        kernel=scheme.kernel,
        read_out="shrunk",
        invariant=None,
        log_density=known + before - after,
    )
    log_density, mixed = _unmixed(known + before - after, moved)
    moved = replace(moved, log_density=log_density)
    return moved, _info(model, scheme, progress, len(powers), mixed)


def _march(
    cloud: core.Cloud,
    model: SDE,
    options: np.record,
    powers: Ints,
    scheme: CorrectedScheme,
    interval: tuple[float, float],
) -> np.record:
    """Run the compiled loop to the end; returns its `Progress`."""
    progress, equations, status = packed(core.Progress(*interval)), equations_of(model), "paused"
    parts = core.parts()
    while status == "paused":
        if progress.steps >= scheme.max_steps:
            raise PropagationError(
                f"prediction from {interval[0]:g} to {interval[1]:g} stopped at t = {progress.t:.6g}: too "
                f"many steps. Use fewer particles, a larger max_steps (now {scheme.max_steps}), or a shorter "
                f"interval"
            )
        with surfacing():
            code = core.march(parts, equations, cloud, options, powers, progress)
        status = core.STATUS[code]
    if status == "flat":
        raise PropagationError(_flat(progress.t))
    if status != "ok":
        ahead = min(progress.t + 1e-6 * (interval[1] - interval[0]), interval[1])  # what the steps ran into
        raise PropagationError(blow_up(model, cloud.x[progress.culprit], ahead, *interval, "corrected"))
    return progress


def _log_volumes(cloud: core.Cloud, options: np.record, t: float) -> Floats:
    """Logarithm of the volume of each particle, after its smoothing length has been solved for."""
    if not core.settle(core.parts().search, cloud, options, _TOLERANCE):
        raise PropagationError(_flat(t))
    return cloud.x.shape[1] * np.log(cloud.h / options.eta)


def _unmixed(L: Floats, density: ParticleDensity) -> tuple[Floats, bool]:
    """Log-density, and whether it had to be read from the kernels.

    Where particles of different origin have mixed, mass over volume differs from one to the next. The kernel
    mixture, with what kernels widen taken back, knows less of a cloud in order but more of a mixed one.
    """
    p = density.pdf(density.x)
    smooth = np.where(p > 0.0, np.log(np.maximum(p, 1e-300)), L)
    mixed = math.sqrt(density.mass @ (smooth - L) ** 2) > _MIXED
    return (smooth if mixed else L), mixed


def _flat(t: float) -> str:
    return (
        f"at t = {t:.6g} the particles' covariance is singular to rounding: some combination of the states "
        f"has no spread left. Widen the initial covariance there, or add noise to that state"
    )


def _degree(density: ParticleDensity, scheme: CorrectedScheme) -> int:
    """Largest degree up to the scheme's with particles enough for its functions; one at least, unless 0.

    A few heavy particles cannot carry many functions either: their effective number counts.
    """
    n, effective = density.dim, 1.0 / np.sum(density.mass**2)
    most = min(density.n_particles / _PARTICLES_A_FUNCTION, effective)
    affordable = (p for p in range(2, scheme.degree + 1) if math.comb(n + p, p) <= most)
    return max(affordable, default=min(scheme.degree, 1))


def _options(density: ParticleDensity, model: SDE, t1: float, scheme: CorrectedScheme) -> np.record:
    kernel = Kernel.of(scheme.kernel, density.dim)
    numbers = core.Options(
        kernel=kernel.kind,
        normalisation=kernel.constant,
        eta=scheme.support / kernel.radius,
        degree=_degree(density, scheme),
        variance=kernel.variance,
        tol=scheme.tol,
        dt_max=min(model.max_step, math.inf if model.autonomous else (t1 - density.t) / _TIME_SLICES),
        pause_after=_PAUSE_AFTER,
    )
    return packed(numbers)


def _info(
    model: SDE, scheme: CorrectedScheme, progress: np.record, n_functions: int, mixed: bool
) -> PredictInfo:
    evaluations, searches, used = int(progress.evaluations), int(progress.searches), int(progress.functions)
    status = "ok"
    if 0 < used < n_functions:
        status = f"ok; the particles told {used} of {n_functions} polynomials apart"
    if mixed:
        status += (
            "; particles have mixed: log-densities are those of the kernels, shorter intervals do better"
        )
    return PredictInfo(
        n_steps=int(progress.steps),
        n_evaluations=evaluations,
        n_searches=searches,
        n_rejected=int(progress.rejected),
        n_bypassed=max(evaluations - searches, 0),
        skipped=skip_notes(model, max(evaluations - searches, 0)),
        scheme=scheme.name,
        status=status,
        code=Code.OK if status == "ok" else Code.MIXED,
    )
