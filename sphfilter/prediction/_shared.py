"""What the schemes share: what they return, and sentences about a prediction."""

import itertools
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from .._types import Floats
from ..core._views import as_compiled
from ..core.cloud import inherited
from ..density.moments import columns
from ..density.particle_density import ParticleDensity
from ..info import PredictInfo
from ..model.dynamics import Dynamics
from ..model.sde import SDE

#: A density after a prediction, and what is said of it.
Predicted: TypeAlias = tuple[ParticleDensity, PredictInfo]


def kept(x: Floats, moved: Floats, w: Floats, cov: Floats) -> float:
    """What of an error of the mean a prediction leaves, of states (N, n), as the core says of columns."""
    return float(inherited.kept(columns(x), columns(moved), as_compiled(w), as_compiled(cov)))


@lru_cache(maxsize=64)
def skip_notes(model: Dynamics, bypassed: int) -> tuple[str, ...]:
    """Sentences for `PredictInfo.skipped`: work that the model's structure or valid neighbour lists saved."""
    if not isinstance(model, SDE):
        return ()
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


#: What keeps particles out of the far tail, by scheme.
_OUT_OF_THE_TAIL = {
    "log_density": "lay no particles so far out, with scheme=LogDensityScheme(reach=3)",
    "paper": "use a smaller represented_mass so that particles stay out of the far tail",
}


def blow_up(model: SDE, state: Floats, t: float, start: float, t1: float, scheme: str = "log_density") -> str:
    """Sentence for a model that left the finite numbers at a state (n,), between `start` and `t1`."""
    velocity = model.drift(state, t)
    what = (
        "grows without bound, or faster than steps can follow"
        if np.isfinite(velocity).all()
        else "is NaN or infinite"
    )
    values = ", ".join(f"{name} = {value:.4g}" for name, value in zip(model.states, state, strict=True))
    return (
        f"the model blew up at t = {t:.6g} (prediction from {start:g} to {t1:g}), at the particle {values}: "
        f"its velocity {what}. Check the drift there, predict over a shorter interval, or "
        f"{_OUT_OF_THE_TAIL[scheme]}"
    )


def carried_off(model: SDE, x: Floats, start: float, t1: float) -> str:
    """`blow_up`'s sentence if the drift alone carries some of the states x (N, n) to infinity; else empty."""
    from scipy.integrate import solve_ivp  # on use: import time

    asked = itertools.count()

    def velocity(t: float, y: Floats) -> Floats:
        if next(asked) > _ASKED:
            raise _Stiff
        return model.drift(y.reshape(x.shape), t).ravel()

    try:
        with np.errstate(all="ignore"):
            paths = solve_ivp(velocity, (start, t1), x.ravel(), rtol=1e-3, atol=1e-6 * np.ptp(x))
    except _Stiff:
        return ""
    ends = paths.y[:, -1].reshape(x.shape)
    if paths.success and np.isfinite(ends).all():
        return ""
    away = np.abs(np.nan_to_num(ends - x, nan=np.inf)).max(axis=1)
    return blow_up(model, ends[np.argmax(away)], paths.t[-1], start, t1)


class _Stiff(Exception):
    """A drift that takes too many steps to be followed."""


_ASKED = 3000  # evaluations of the drift, of all states at once; measured: half and twice change no run
