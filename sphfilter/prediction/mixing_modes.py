"""Sums of the densities of all modes: where states jump, and of what several explanations leave."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from .._types import Floats
from ..config import FilterConfig
from ..core.limits import TINY
from ..density.memory import error_budget
from ..density.modes import ModeDensities
from ..density.particle_density import ParticleDensity
from .mixing import Allowed, Part, mixed


def summed(
    log_w: Floats,
    densities: Sequence[Sequence[ParticleDensity | None]],
    splitting: Floats,
    target: float,
    allowed: Allowed,
) -> ModeDensities:
    """In every mode the sum of densities, as one density.

    Of K densities in each of M modes, `log_w` (K, M) are logarithms of their weights but for a constant, and
    `splitting` (K, M) their errors that come from jumps. A density may be None where the weight is zero.
    `target` and `allowed` are as of `mixed`.
    """
    own_w, own = [], []
    for i in range(log_w.shape[1]):
        each = zip(log_w[:, i].tolist(), (row[i] for row in densities), strict=True)
        parts = [Part(w, p) for w, p in each if p is not None and w > -math.inf]
        own_w.append(float(logsumexp([part.log_w for part in parts])) if parts else -math.inf)
        own.append(mixed(parts, target, allowed) if parts else None)
    share = np.exp(log_w)
    off = np.sqrt((splitting**2 * share).sum(axis=0) / np.maximum(share.sum(axis=0), TINY))
    return ModeDensities(np.array(own_w), own, off)


def mixture(parts: Sequence[tuple[float, ModeDensities]], config: FilterConfig) -> ModeDensities:
    """p(x, i) = Σ_k b_k p_k(x, i): what explanations with probabilities b_k leave of the modes together.

    The parts are weights b_k, whose sum may be any, and densities of one time; those of zero weight are left
    out. The target error says how far sums are merged. Raises `PropagationError` if nothing holds a sum.
    """
    parts = [part for part in parts if part[0] > 0.0]
    if len(parts) == 1:
        return parts[0][1]
    b = np.array([weight for weight, _ in parts])
    b = b / b.sum()
    log_w = np.log(b)[:, None] + np.array([modes.log_w for _, modes in parts])
    splitting = np.array([modes.splitting for _, modes in parts])
    error = math.sqrt(float(b @ [modes.error**2 for _, modes in parts]))
    target = config.target_error
    allowed = error_budget(error, target)
    densities = [modes.densities for _, modes in parts]
    found = summed(log_w, densities, splitting, target, Allowed(allowed, allowed))
    off = b @ np.array([modes.in_doubt for _, modes in parts])
    return found.noted(unsure=np.log1p(off / np.maximum(found.w, TINY)) ** 2)


def whatever_the_mode(modes: ModeDensities, target_error: float) -> ParticleDensity:
    """The density of the states: the sum of those of the modes, as one."""
    each = Allowed(target_error, target_error)
    return mixed([Part(log_w, p) for _, log_w, p in modes.some], target_error, each)
