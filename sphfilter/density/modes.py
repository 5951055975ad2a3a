"""A density for each mode of a model that switches, and their probabilities."""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Floats
from ..core.limits import TINY
from ..errors import PropagationError
from .moments import cov_of_sum, moments_of_sum
from .particle_density import ParticleDensity
from .statistics import FEW_SUBPOINTS
from .weighted import WeightedStates


class SplittingError(NamedTuple):
    """Where a density is wrong: states X (M, n), and probabilities (M,) that are too many or few there.

    `mass` is the part of the probability that moves the mean: those that only spread more have none. It is
    not `exact` where the model bends: states are those of its linearisation, and it may be anywhere.
    """

    X: Floats
    off: Floats
    mass: float
    exact: bool = True


def no_ripple(n: int) -> SplittingError:
    """The splitting error of a density that has none."""
    return SplittingError(np.empty((0, n)), np.empty(0), 0.0)


class ModeDensities:
    """p(x, i) = w_i p_i(x): the states of one time, in every mode.

    Logarithms log_w (M,) of the modes' probabilities may lack a constant; they are minus infinity where there
    is none, and there alone a density may be None. `splitting` (M,) are estimated errors of the densities
    that come from jumps between the modes, not those of the densities themselves, and `ripples` the part of
    these that the last prediction has added; `unsure` (M,) are variances of the errors that log_w has, of
    evidences and of jumps. Raises `PropagationError` if all probabilities are zero.
    """

    def __init__(
        self,
        log_w: Floats,
        densities: Sequence[ParticleDensity | None],
        splitting: Floats | None = None,
        ripples: Sequence[SplittingError] | None = None,
        unsure: Floats | None = None,
    ) -> None:
        total = logsumexp(log_w)
        if not np.isfinite(total):
            raise PropagationError(
                "no mode of the model explains what was measured: all have probability zero"
            )
        self.log_w: Floats = np.asarray(log_w - total, dtype=np.float64)
        self.log_w.flags.writeable = False
        self.densities = tuple(densities)
        self.splitting = np.zeros(len(log_w)) if splitting is None else splitting
        self.unsure = np.zeros(len(log_w)) if unsure is None else unsure
        self.ripples = ripples

    @classmethod
    def alike(cls, w: Floats, density: ParticleDensity, summed: bool) -> "ModeDensities":
        """One density for all modes, which have probabilities w (M,); `summed` says whether modes mix."""
        if summed and density.needs is not None:
            density = density.noted(needs=density.needs._replace(smooth=True))
        with np.errstate(divide="ignore"):
            return cls(np.log(w), [density] * len(w))

    def noted(self, **known: Any) -> "ModeDensities":
        """The same with another `log_w`, `densities`, `splitting`, `ripples` or `unsure`."""
        names = ("log_w", "densities", "splitting", "ripples", "unsure")
        return ModeDensities(**{name: getattr(self, name) for name in names} | known)

    def cut(self, most: int) -> "ModeDensities":
        """Densities of the modes that go on as so many points each, where their memory chooses the number."""
        return self._with_needs([p and p.needs and p.needs.cut(most) for p in self.densities])

    def remembering(self, other: "ModeDensities") -> "ModeDensities":
        """Densities of the modes that go on as other ones do."""
        return self._with_needs([p and p.needs for p in other.densities])

    def _with_needs(self, needs: Sequence[Any]) -> "ModeDensities":
        own = [p and p.noted(needs=known or p.needs) for p, known in zip(self.densities, needs, strict=True)]
        return self.noted(densities=own)

    @property
    def w(self) -> Floats:
        """Probabilities (M,)."""
        w: Floats = np.exp(self.log_w)
        return w

    @property
    def some(self) -> list[tuple[int, float, ParticleDensity]]:
        """Number, logarithm of the probability and density of every mode that has one."""
        found = enumerate(zip(self.log_w.tolist(), self.densities, strict=True))
        return [(i, log_w, p) for i, (log_w, p) in found if p is not None and log_w > -np.inf]

    @property
    def n_particles(self) -> int:
        """Number of particles of all modes."""
        return sum(p.n_particles for _, _, p in self.some)

    @property
    def heaviest(self) -> ParticleDensity:
        """The density of the most probable mode."""
        return max(self.some, key=lambda mode: mode[1])[2]

    @cached_property
    def _own_moments(self) -> list[tuple[int, float, Floats, Floats]]:
        """Number, probability, mean (n,) and covariance (n, n) of every mode that has one."""
        return [(i, math.exp(log_w), p.mean(), p.cov()) for i, log_w, p in self.some]

    @cached_property
    def moments(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n) over all modes; read-only. The mean of an angle is a direction."""
        domain = self.heaviest.domain
        _, w, means, covs = (np.array(part) for part in zip(*self._own_moments, strict=True))
        mean, cov = moments_of_sum(w, means, covs)
        if domain is not None:
            spread = [p.form.states(FEW_SUBPOINTS, True) for _, _, p in self.some]
            X = np.concatenate([x for x, _ in spread])
            mass = np.concatenate([share * part for share, (_, part) in zip(w, spread, strict=True)])
            mean[domain.periodic] = domain.mean(X, mass / mass.sum())[domain.periodic]
            cov = cov_of_sum(w, domain.nearest(means - mean), covs)
        mean.flags.writeable = cov.flags.writeable = False
        return mean, cov

    @cached_property
    def in_doubt(self) -> Floats:
        """Probabilities (M,) that those of the modes may be off by, as `unsure` says: of all, one at most."""
        unsure = np.sqrt(self.unsure)
        with np.errstate(divide="ignore"):  # w (exp(unsure) - 1), of however little a w
            return np.asarray(np.exp(np.minimum(self.log_w + unsure + np.log(-np.expm1(-unsure)), 0.0)))

    def apart(self, came: Floats) -> Floats:
        """By how much (M, M) a row's mode is off what comes to a column's by `came` (M, M): one at most.

        A mean by as many standard deviations, a variance by twice as many parts.
        """
        found = np.zeros(came.shape)
        rows, w, means, covs = (np.array(part) for part in zip(*self._own_moments, strict=True))
        for j, parts in enumerate((w[:, None] * came[rows]).T):
            if parts.any():
                mean, cov = moments_of_sum(parts / parts.sum(), means, covs)
                variances = np.maximum(np.diag(cov), TINY)
                wider = np.diagonal(covs, axis1=1, axis2=2) / variances - 1.0
                found[rows, j] = np.sqrt(np.mean((means - mean) ** 2 / variances + 0.5 * wider**2, axis=1))
        return np.minimum(found, 1.0)

    @property
    def error(self) -> float:
        """Estimated error of the means, in standard deviations: rms over the modes.

        Of probabilities in doubt d_i the mean over all is off by Σ d_i (m_i - m). Beyond a mode's own these
        are not known to lie where that is, but about a standard deviation off.
        """
        own = [np.exp(log_w) * (p.error**2 + self.splitting[i] ** 2) for i, log_w, p in self.some]
        if self.unsure.any():
            mean, cov = self.moments
            domain = self.heaviest.domain
            for i, w, middle, _ in self._own_moments:
                off = middle - mean if domain is None else domain.nearest((middle - mean)[None])[0]
                known = min(self.in_doubt[i], w)
                own += [known**2 * np.mean(off**2 / np.diag(cov)), (self.in_doubt[i] - known) ** 2]
        return float(np.sqrt(sum(own)))

    def logpdf(self, X: Floats) -> Floats:
        """Logarithm of the density of the states X (M, n), whatever the mode."""
        return np.asarray(logsumexp([log_w + p.logpdf(X) for _, log_w, p in self.some], axis=0))

    def spread(self) -> WeightedStates:
        """States and weights of all modes together."""
        each = [(np.exp(log_w), p.spread()) for _, log_w, p in self.some]
        X = np.concatenate([found.X for _, found in each])
        return WeightedStates(X, np.concatenate([w * found.w for w, found in each]), self.logpdf)
