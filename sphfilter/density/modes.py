"""A density for each mode of a model that switches, and their probabilities."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Floats
from ..errors import PropagationError
from .particle_density import ParticleDensity
from .statistics import FEW_SUBPOINTS
from .weighted import WeightedStates


class SplittingError(NamedTuple):
    """Where a density is wrong: states X (M, n), and probabilities (M,) that are too many or few there."""

    X: Floats
    off: Floats

    @property
    def mass(self) -> float:
        """Part of the probability that is wrong."""
        return min(float(self.off.sum()), 1.0)


def no_ripple(n: int) -> SplittingError:
    """The splitting error of a density that has none."""
    return SplittingError(np.empty((0, n)), np.empty(0))


class ModeDensities:
    """p(x, i) = w_i p_i(x): the states of one time, in every mode.

    Logarithms log_w (M,) of the modes' probabilities may lack a constant; they are minus infinity where there
    is none, and there alone a density may be None. `splitting` (M,) are estimated errors of the densities
    that come from jumps between the modes, not those of the densities themselves, and `ripples` the part of
    these that the last prediction has added; `unsure` (M,) are variances of the errors that log_w has of the
    evidence that points have told; none where sums did. Raises `PropagationError` if all probabilities are
    zero.
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
        self.ripples, self.unsure = ripples, unsure

    @classmethod
    def alike(cls, w: Floats, density: ParticleDensity, summed: bool) -> "ModeDensities":
        """One density for all modes, which have probabilities w (M,); `summed` says whether modes mix."""
        if summed and density.needs is not None:
            density = density.noted(needs=density.needs._replace(smooth=True))
        with np.errstate(divide="ignore"):
            return cls(np.log(w), [density] * len(w))

    def split(self, splitting: Floats, ripples: Sequence[SplittingError]) -> "ModeDensities":
        """Densities of the modes with other errors that come from jumps."""
        return ModeDensities(self.log_w, self.densities, splitting, ripples, self.unsure)

    def cut(self, most: int) -> "ModeDensities":
        """Densities of the modes that go on as so many points each, where their memory chooses the number."""
        return self._with_needs([p and p.needs and p.needs.cut(most) for p in self.densities])

    def remembering(self, other: "ModeDensities") -> "ModeDensities":
        """Densities of the modes that go on as other ones do."""
        return self._with_needs([p and p.needs for p in other.densities])

    def _with_needs(self, needs: Sequence[Any]) -> "ModeDensities":
        own = [p and p.noted(needs=known or p.needs) for p, known in zip(self.densities, needs, strict=True)]
        return ModeDensities(self.log_w, own, self.splitting, self.ripples, self.unsure)

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
    def moments(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n) over all modes; read-only. The mean of an angle is a direction."""
        domain = self.heaviest.domain
        each = [(np.exp(log_w), p.mean(), p.cov()) for _, log_w, p in self.some]
        w, means, covs = (np.array(part) for part in zip(*each, strict=True))
        mean = w @ means
        off = means - mean
        if domain is not None:
            spread = [p.form.states(FEW_SUBPOINTS, True) for _, _, p in self.some]
            X = np.concatenate([x for x, _ in spread])
            mass = np.concatenate([share * part for share, (_, part) in zip(w, spread, strict=True)])
            mean[domain.periodic] = domain.mean(X, mass / mass.sum())[domain.periodic]
            off = domain.nearest(means - mean)
        cov = np.einsum("k,kab->ab", w, covs) + np.einsum("k,ka,kb->ab", w, off, off)
        mean.flags.writeable = cov.flags.writeable = False
        return mean, cov

    @property
    def error(self) -> float:
        """Estimated error of the means, in standard deviations: rms over the modes.

        Of probabilities w_i with errors w_i ε_i the mean over all is off by Σ w_i ε_i (m_i - m).
        """
        own = [np.exp(log_w) * (p.error**2 + self.splitting[i] ** 2) for i, log_w, p in self.some]
        if self.unsure is not None:
            mean, cov = self.moments
            domain = self.heaviest.domain
            for i, log_w, p in self.some:
                off = p.mean() - mean if domain is None else domain.nearest((p.mean() - mean)[None])[0]
                own.append(np.exp(2.0 * log_w) * self.unsure[i] * np.mean(off**2 / np.diag(cov)))
        return float(np.sqrt(sum(own)))

    def logpdf(self, X: Floats) -> Floats:
        """Logarithm of the density of the states X (M, n), whatever the mode."""
        return np.asarray(logsumexp([log_w + p.logpdf(X) for _, log_w, p in self.some], axis=0))

    def spread(self) -> WeightedStates:
        """States and weights of all modes together."""
        each = [(np.exp(log_w), p.spread()) for _, log_w, p in self.some]
        X = np.concatenate([found.X for _, found in each])
        return WeightedStates(X, np.concatenate([w * found.w for w, found in each]), self.logpdf)
