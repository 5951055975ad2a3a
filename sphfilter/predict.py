"""Prediction: a density carried through the Fokker-Planck-Kolmogorov equation."""

from dataclasses import dataclass

import numpy as np

from .config import SolverConfig
from .errors import ModelError
from .info import PredictInfo
from .resample import bound
from .schemes import paper
from .validate import real

__all__ = ["Trajectory", "predict", "propagate"]


def predict(density, model, dt=None, config=None, *, t=None, n_particles=None):
    """Carry a density over dt seconds, or to time t.

    Parameters
    ----------
    density : ParticleDensity
    model : SDE
    dt : float, optional
        Interval, seconds, >= 0.
    config : SolverConfig or FilterConfig, optional
    t : float, optional
        Absolute time to predict to, seconds, instead of dt.
    n_particles : int, optional
        Upper bound of the number of particles, should re-gridding be needed; the density's own if not given.

    Returns
    -------
    ParticleDensity, PredictInfo

    Raises
    ------
    ModelError
        The interval is negative, or model and density differ in dimension.
    PropagationError
        The model blew up; says when, where and what to change.
    """
    if (dt is None) == (t is None):
        raise ModelError("predict takes either dt or t=, one of them")
    if model.dim != density.dim:
        raise ModelError(f"the model has {model.dim} states, the density {density.dim}")
    target = real("t", t) if dt is None else density.t + real("dt", dt)
    if target < density.t:
        raise ModelError(f"cannot predict back in time: from t = {density.t:g} to {target:g}")
    scheme = (config or SolverConfig()).scheme
    if target == density.t:
        return density, PredictInfo(scheme=scheme.name, skipped=("everything: the interval is empty",))
    return paper.propagate(density, model, target, scheme, bound(density, n_particles))


@dataclass(frozen=True)
class Trajectory:
    """Densities of a transient solution.

    Attributes
    ----------
    times : ndarray, shape (T,)
    densities : tuple of ParticleDensity
    infos : tuple of PredictInfo
    """

    times: np.ndarray
    densities: tuple
    infos: tuple


def propagate(density, model, times, config=None):
    """Solve the transient FPK equation without measurements.

    Parameters
    ----------
    density : ParticleDensity
        Made by `initialize`.
    model : SDE
    times : array_like, shape (T,)
        Times at which the density is wanted, seconds, not decreasing.
    config : SolverConfig, optional

    Returns
    -------
    Trajectory
    """
    times = np.atleast_1d(np.asarray(times, dtype=float))
    densities, infos = [], []
    for t in times:
        density, info = predict(density, model, t=t, config=config)
        densities.append(density)
        infos.append(info)
    return Trajectory(times, tuple(densities), tuple(infos))
