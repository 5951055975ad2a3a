"""A few families carried by the model, each by itself: one that does not follow is split at the start."""

import math
from functools import partial

import numpy as np

from .._types import Floats
from ..core.family.basis import beyond
from ..core.family.march import STATUS, Control, march
from ..core.family.rules import degrees
from ..core.limits import LITTLE
from ..density.as_family import families_density
from ..density.families import HEAVY, Families, families_of, merged_families
from ..density.families_posterior import AWAY, split, strongest_bend
from ..density.family import ASTRAY, OF_MISFIT, Family, gaussian_family
from ..density.particle_density import ParticleDensity
from ..errors import PropagationError
from ..info import PredictInfo
from ..model.compile import surfacing
from ..model.sde import SDE
from .family import OF_RESIDUAL, flow_of, longest_step

_HIGHEST = 5  # degree of parts: higher ones stall more often than they follow better
LEVELS = 2  # of splits
_STEPS = 100  # of one family
_LIGHT = 0.03  # of the error that may be added, over the share of a part that is not worth another split


def carried_families(
    density: ParticleDensity, model: SDE, t1: float, allowed: float, most: float, levels: int = LEVELS
) -> tuple[ParticleDensity, PredictInfo]:
    """Carry families to time t1, or one that does not follow, by its parts, split up to `levels` times.

    They may add an error, in standard deviations, and ask the model at so many nodes of all parts at most.

    Raises
    ------
    PropagationError
        More nodes would be needed, or parts do not follow either.
    """
    marches, level = _Marches(density, model, t1, allowed, most), 0
    families = density.families
    if families is None:
        assert density.family is not None
        families, level = marches.split(families_of(density.family), [0]), 1
    while True:
        failed = marches.carry(families)
        heavy = [] if level == levels else [k for k in failed if marches.matters(families, k)]
        marches.carry_plain(families.some([k for k in failed if k not in heavy]))
        if not heavy:
            break
        families, level = marches.split(families, heavy), level + 1
    moved, change = marches.together(), 0.0
    if density.families is not None:  # noise makes alike what was split before
        moved, change = merged_families(moved, allowed, HEAVY)
    error = math.hypot(density.error, marches.error, change)
    info = PredictInfo(
        scheme="pieces",
        error=error,
        n_steps=marches.steps,
        n_evaluations=marches.evaluations,
        residual=marches.residual,
        skipped=("particles: a few polynomials are the logarithms of parts of the density",),
    )
    return families_density(density, moved, t=float(t1), error=error), info


def bent(density: ParticleDensity, model: SDE, t1: float) -> bool:
    """Does the drift bend one family until time t1 by more than it may be off in its frame?"""
    assert density.family is not None
    bend = strongest_bend(density.family, partial(model.drift, t=density.t))[1]
    return bool(bend * (t1 - density.t) > ASTRAY)


class _Marches:
    """Parts that are carried one by one, and the work that took."""

    def __init__(self, density: ParticleDensity, model: SDE, t1: float, allowed: float, most: float) -> None:
        self._model, self._flow, self._span = model, flow_of(model), (density.t, t1)
        self._longest, self._allowed, self._left = longest_step(model, density, t1), allowed, most
        self._degree = max(d for d in degrees(density.dim) if d <= _HIGHEST)
        self._back = np.linalg.inv(np.linalg.cholesky(density.cov()))
        self._done: list[tuple[float, Family, float]] = []  # log of the weight, family, and its error
        self._odd, self._plain, self._lost, self.steps, self.evaluations = 0.0, 0.0, 0.0, 0, 0

    def split(self, families: Families, which: list[int]) -> Families:
        """Some of the families in parts each."""
        bends, parts = partial(self._model.drift, t=self._span[0]), []
        shares = np.exp(families.log_w)
        for k in which:
            part, off = split(families, k, bends, self._degree, _LIGHT * self._allowed / shares[k])
            self._odd += shares[k] * off**2
            parts.append(part)
        return Families(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def carry(self, families: Families) -> list[int]:
        """Carry each to the end; returns the numbers of those that do not follow."""
        rule, n, failed = families.basis, families.mu.shape[1], []
        for k, log_w in enumerate(families.log_w):
            one = families.one(k)
            y = np.concatenate([one.mu, one.A.ravel(), one.c])
            most = self._allowed / OF_RESIDUAL * max(1.0, HEAVY / math.exp(log_w)) / self._part(one)
            control = Control(*self._span, LITTLE * self._allowed, self._longest, _STEPS, most)
            with surfacing():
                report = march(self._flow, rule, beyond(n, one.degree), rule, control, y, np.empty(0))
            self.steps, self.evaluations = self.steps + report.steps, self.evaluations + report.evaluations
            self._left -= report.evaluations * len(rule.xi)
            if self._left < 0.0:
                raise PropagationError("more families would be needed than a cloud takes points")
            moved = Family(y[:n], y[n : n + n * n].reshape(n, n), y[n + n * n :])
            if STATUS[report.code] != "ok" or not np.isfinite(y).all() or not moved.astray < ASTRAY:
                failed.append(k)
                continue
            off = OF_RESIDUAL * (report.residual + report.stepping) * self._part(one)
            self._done.append((log_w, moved.normalised(), off))
        return failed

    def _part(self, one: Family) -> float:
        """How wide a family is, over the whole."""
        return float(np.linalg.norm(self._back @ one.A)) / math.sqrt(len(one.mu))

    def carry_plain(self, families: Families) -> None:
        """Carry Gaussians in the place of families that do not follow."""
        plain = [_plain(families, k) for k in range(len(families.log_w))]
        self._plain += sum(w * off for w, (_, off) in zip(np.exp(families.log_w), plain, strict=True))
        if plain:
            families = families._replace(c=np.array([c for c, _ in plain]))
        self._lost += sum(math.exp(families.log_w[k]) for k in self.carry(families))

    def matters(self, families: Families, k: int) -> bool:
        """Would a Gaussian in the place of a family be too much of an error?"""
        return math.exp(families.log_w[k]) * _plain(families, k)[1] > LITTLE * self._allowed

    def together(self) -> Families:
        """The parts that have been carried, as one density."""
        if not self._done:
            raise PropagationError("families do not follow the density")
        log_w, families, _ = zip(*self._done, strict=True)
        parts = (np.array(part) for part in zip(*families, strict=True))
        return Families(np.array(log_w), *parts).normalised()

    @property
    def residual(self) -> float:
        """Error of what families could not follow, averaged over the mass."""
        return sum(math.exp(log_w) * off for log_w, _, off in self._done)

    @property
    def error(self) -> float:
        """Error of the mean that was added, standard deviations."""
        return math.hypot(self.residual + self._plain, math.sqrt(self._odd), AWAY * self._lost)


def _plain(families: Families, k: int) -> tuple[Floats, float]:
    """Coefficients of the Gaussian in the frame of a family, and what it is off by."""
    one = families.one(k)
    c = gaussian_family(one.mu, one.A @ one.A.T, one.degree).c
    return c, OF_MISFIT * float(np.linalg.norm((one.c - c)[1:]))
