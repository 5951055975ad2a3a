"""One exponential family, carried by an ordinary equation at the nodes of a cubature rule."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from .._types import Floats
from ..config import FamilyScheme
from ..core._addresses import address_of
from ..core.cloud.inherited import OF_UNSIGNED
from ..core.family.basis import basis, beyond
from ..core.family.march import STATUS, Control, Report, march
from ..core.family.rates import DEFECT, RATES, Flow
from ..core.family.rules import degrees
from ..core.limits import EDGE, HIGHEST, LARGEST_EXPONENT
from ..density.as_family import defect_in, family_density, family_of, moments_on_line
from ..density.defect import Defect, read_out
from ..density.family import ASTRAY, Family, miscounted, turned
from ..density.particle_density import ParticleDensity
from ..errors import ConfigError, PropagationError, StoppedError
from ..info import DOUBTFUL, Code, PredictInfo, may_be_off
from ..model.compile import surfacing
from ..model.sde import SDE
from ._shared import Predicted, blow_up, skip_notes
from .time_slices import drift_slices, noise_samples

_OF_STEPS = 0.3  # part of the steps' errors that is told; measured: half, twice change no mean of six scenes
_STATES = 512  # on one side of a well; measured: times are good to .03 (tests/prediction/test_escape.py)
_FAR = 3.0  # times the edge of a density, where wells are looked for: of U ≈ d² / 8, e^-40 leaves by then
_NOT_FOLLOWED = (
    "no polynomial of this degree follows the logarithm of the density; predict over a shorter interval, or "
    "use another scheme"
)


def degree_of(scheme: FamilyScheme, n: int) -> int:
    """Degree of a family of n states: the scheme's, or the highest up to six whose rule is known."""
    known = degrees(n)
    degree = scheme.degree or max((d for d in known if d <= HIGHEST), default=0)
    if degree not in known:
        raise ConfigError(f"there is no family of degree {degree or 'any'} for {n} states, but of {[*known]}")
    return degree


def why_not(model: SDE, density: ParticleDensity) -> str:
    """Can one family carry the density? Returns a reason why not, empty if it can."""
    if model.domain.walled.any() or density.walls[0].size:
        return "an axis ends, and polynomials do not"
    if density.form.cell is None and density.form.degree == 0:
        return "the density has no smooth logarithm"
    return ""


def propagate(
    density: ParticleDensity, model: SDE, t1: float, scheme: FamilyScheme, n_particles: int
) -> Predicted:
    """Carry a density to time t1, seconds, as one exponential family.

    Raises `PropagationError` if no polynomial follows the density, the drift is not finite where it is, or
    more steps are needed than allowed: says when, where, and what to change.
    """
    reason = why_not(model, density)
    if reason:
        raise PropagationError(f"one family does not carry this density: {reason}; use another scheme")
    settled = replace(scheme, degree=degree_of(scheme, density.dim))
    return carried_family(density, model, t1, settled, n_particles)


def carried_family(
    density: ParticleDensity,
    model: SDE,
    t1: float,
    scheme: FamilyScheme,
    n_particles: int,
    most: float = 1.0,  # standard deviations that the mean may be off by
) -> Predicted:
    """Carry a density that fits as a family of a scheme's degree, whose steps may add an error of `most`."""
    n, degree = density.dim, scheme.degree
    assert degree is not None
    start, misfit = family_of(density, degree)
    packed = defect_in(density, start, misfit).packed
    y = np.concatenate([start.mu, start.A.ravel(), start.c])
    control = Control(density.t, t1, scheme.tolerance, _longest_step(model, density, t1), scheme.max_steps)
    with surfacing():
        report = march(
            flow_of(model), basis(n, degree), beyond(n, degree), turned(n, degree), control, y, packed
        )
    if STATUS[report.code] != "ok":
        raise _given_up(model, y, report, density.t, t1)
    moved = Family(y[:n].copy(), y[n : n + n * n].reshape(n, n).copy(), y[n + n * n :].copy()).normalised()
    defect, astray = Defect.of(packed, moved), moved.astray
    of_steps = _OF_STEPS / OF_UNSIGNED * report.stepping
    defect = defect._replace(U=defect.U + of_steps**2 * moved.A @ moved.A.T)
    before = 0.0 if density.gaussian else miscounted(start)
    read, more = read_out(moved, defect), max(miscounted(moved) ** 2 - before**2, 0.0)
    apart = math.hypot(astray, OF_UNSIGNED * math.sqrt(more))  # of what was there before the error knows
    error, of_variance = math.hypot(read.error, apart), math.hypot(read.variance, math.sqrt(2.0) * apart)
    if not error < math.hypot(most, density.error) or not astray < ASTRAY:
        raise PropagationError(
            f"prediction from {density.t:g} to {t1:g}: {_NOT_FOLLOWED}; the mean would be off by {error:.2g} "
            f"standard deviations"
        )
    told = {"error": error, "defect": defect, "rough": defect.rough(moved)}
    gaussian = density.gaussian and model.linear
    new = family_density(density, moved, t=float(t1), capacity=n_particles, gaussian=gaussian, **told)
    return new, _info(model, report, error, of_variance)


@lru_cache(maxsize=64)
def flow_of(model: SDE) -> Flow:
    """A model, which never changes, as families are carried by it; it must outlive its use."""
    n, drift = model.dim, address_of(model.drift_batch)
    slope = curvature = drift  # never called
    if model.state_dependent_noise:
        slope = address_of(model.diffusion_divergence_batch)
        curvature = address_of(model.diffusion_curvature_batch)
    constant = model.constant_diffusion
    return Flow(
        drift,
        address_of(model.divergence_batch),
        address_of(model.diffusion_batch),
        slope,
        curvature,
        model.p,
        np.ascontiguousarray(model.diffusion(np.zeros((1, n)), 0.0)[0]) if constant else np.zeros((n, n)),
        not constant and not model.state_dependent_noise,
        model.state_dependent_noise,
        address_of(RATES),
        address_of(DEFECT),
    )


def _longest_step(model: SDE, density: ParticleDensity, t1: float) -> float:
    """Longest step, seconds, that sees a model change in time."""
    if model.autonomous:
        return model.max_step
    around = density.mean() if model.state_dependent_noise else None
    slices = max(drift_slices(model, density, t1), noise_samples(model, density.t, t1, around)[1])
    return min(model.max_step, (t1 - density.t) / slices)


def _given_up(model: SDE, y: Any, report: Report, start: float, t1: float) -> PropagationError:
    """What a march that did not come to its end is told with."""
    status, mean = STATUS[report.code], y[: model.dim]
    if status == "not finite" or not np.isfinite(model.drift(mean, report.t)).all():
        return PropagationError(blow_up(model, mean, report.t, start, t1))
    what = f"prediction from {start:g} to {t1:g} stopped at t = {report.t:.6g}"
    if status == "too many steps":
        return StoppedError(
            f"{what}: {report.steps} steps were not enough; allow more with "
            f"scheme=FamilyScheme(max_steps=...)"
        )
    return PropagationError(f"{what}: {_NOT_FOLLOWED}")


def _info(model: SDE, report: Report, error: float, of_variance: float) -> PredictInfo:
    info = PredictInfo(
        n_steps=report.steps,
        n_rejected=report.rejected,
        n_evaluations=report.evaluations,
        residual=report.residual,
        error=error,
        variance_error=of_variance,
        skipped=_skipped(model),
        scheme="family",
    )
    return info.also(Code.UNRESOLVED, may_be_off(error)) if error > DOUBTFUL else info


@lru_cache(maxsize=64)
def _skipped(model: SDE) -> tuple[str, ...]:
    """Work that a family and the structure of a model save."""
    notes = (note for note in skip_notes(model, 0) if not note.startswith("diffusion velocity"))
    return "particles: one polynomial is the logarithm of the density", *notes


def escaped(density: ParticleDensity, model: SDE, t1: float) -> float:
    """Part by which what leaves the well of a density of one state until t1, seconds, widens its variance.

    A family that is fitted to one well knows nothing of the next: its defect is asked where it is. The model
    is taken as it is now. Zero in more states, in a domain (on a circle the next may be the same), and where
    no well lies beyond the nodes of a family.
    (C. Gardiner, "Stochastic Methods", 4th ed. 2009, 5.5: the mean first-passage time; what has left is in
    another well, twice as far off as the barrier.)
    """
    if density.dim != 1 or not model.domain.unbounded:
        return 0.0
    mean, cov = (float(part.item()) for part in moments_on_line(density))
    left, reach = 0.0, EDGE * math.sqrt(cov)
    for side in (-1.0, 1.0):
        off = side * reach * np.linspace(-1.0, _FAR, _STATES)
        x = (mean + off)[:, None]
        f, D = side * model.drift(x, density.t)[:, 0], model.diffusion(x, density.t)[:, 0, 0]
        beyond = np.flatnonzero((f > 0.0) & (side * off > 0.5 * reach))
        if len(beyond) and np.isfinite(f).all() and (D > 0.0).all():
            time = _passage(side * off, f, D, int(beyond[0]))
            left += min((t1 - density.t) / time, 1.0) * 4.0 * float(off[beyond[0]]) ** 2 / cov
    return left


def _passage(y: Floats, f: Floats, D: Floats, barrier: int) -> float:
    """Mean time until a state that begins at zero first passes a barrier, one of places y (K,), seconds."""
    from scipy.integrate import cumulative_trapezoid  # on use: import time

    y, f, D = y[: barrier + 1], f[: barrier + 1], D[: barrier + 1]
    U = -cumulative_trapezoid(f / D, y, initial=0.0)
    U = np.minimum(U - U.min(), 0.5 * LARGEST_EXPONENT)  # forever, and of times it a number is left
    inside = cumulative_trapezoid(np.exp(-U) / D, y, initial=0.0)
    return float(cumulative_trapezoid(np.where(y > 0.0, np.exp(U) * inside, 0.0), y)[-1])
