"""Posteriors of parameters, by draws that are weighted by the evidence of the measurements."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import drawing
from .._types import Floats, Ints
from ..core.limits import TINY
from ..density.moments import moments
from ..density.quasi_random import quasi_random
from ..density.weighted import quantile_of
from ..errors import EstimationError, ModelError
from ..validate import count, short
from .evidence import Evidence, Pickled, check_name
from .quadratic import first_steps, scales

#: Log-density of all parameters by name; or distributions of single ones.
LogPrior: TypeAlias = Callable[[dict[str, float]], float]
Prior: TypeAlias = Mapping[str, Any] | LogPrior
_TAILS = 5.0  # degrees of freedom of what is drawn from: its variance is 5 / (5 - 2) = 1.7 times the fit's
_PARTS = 8  # sets of draws, each even by itself: their scatter is known to 1 / √(2 (8 - 1)) = .27 of it
_ROUNDS = 8  # of draws, after each of which it may be enough: 1 / 8 = .125 of them in vain at most
_ENOUGH = 256.0  # effective draws; measured: means of one to five parameters within .01 to .04 deviations
_FEW = 30.0  # effective draws that tell no tails: 30 / 20 = 1.5 lie beyond a quantile of .05


@dataclass(frozen=True, eq=False, repr=False)
class ParameterPosterior(Pickled):
    """The probability density of fitted parameters, given the measurements, as weighted draws.

    Attributes
    ----------
    names : tuple of str, length n
    draws, weights : ndarray, shape (K, n) and (K,)
        Values of the parameters and their probabilities, whose sum is one.
    log_evidence, log_evidence_error : float
        Logarithm of the evidence averaged over the prior, and what the draws leave of error in it, nats; NaN
        where a prior is flat without end.
    estimate, standard_error : mapping of str to float
        Those of the fit.
    parts : ndarray of int, shape (K,)
        Which of eight sets, that tell errors, a draw is of.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model = sf.LinearSDE([[-0.6]], noise=[[1.0]])
    >>> level = sf.GaussianMeasurement.from_expressions(["x"], ["x"], [["R"]], parameters={"R": 0.1})
    >>> times = 0.4 * np.arange(1, 21)
    >>> _, z = sf.simulate(model, level, x0=[0.0], times=times, rng=3)
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> fit = sf.fit_parameters(flt, times, z, guess={"R": 0.2}, bounds={"R": (0.0, None)})
    >>> posterior = fit.posterior(n_draws=256)
    >>> low, high = posterior.quantile("R", [0.05, 0.95])
    >>> print(f"{fit.estimate['R']:.2f}; {posterior.mean['R']:.2f}, {low:.2f} to {high:.2f}")
    0.17; 0.29, 0.06 to 0.65
    >>> print(f"{posterior.probability(lambda p: p['R'] > 0.2):.2f}")
    0.6...
    """

    names: tuple[str, ...]
    draws: Floats
    weights: Floats
    log_evidence: float
    log_evidence_error: float
    estimate: Mapping[str, float]
    standard_error: Mapping[str, float]
    parts: Ints

    @property
    def effective(self) -> float:
        """How many draws of one weight would be as good: one over the sum of squared weights."""
        return 1.0 / float(self.weights @ self.weights)

    @property
    def flagged(self) -> bool:
        """Whether so few draws are effective that the answers are not to be relied on."""
        return self.effective < _FEW

    @property
    def status(self) -> str:
        """What came of the draws, as a sentence."""
        told = f"{self.effective:.0f} of {len(self.weights)} draws are effective"
        more = "too few to be relied on: take more n_draws, or another prior, or fit from elsewhere"
        return f"{told}, {more}" if self.flagged else told

    @property
    def mean(self) -> Mapping[str, float]:
        """Means by name."""
        return self._named(self.weights @ self.draws)

    @property
    def mean_error(self) -> Mapping[str, float]:
        """Standard errors of the means by name, of the draws alone, as eight sets of them tell."""
        off = self.weights[:, None] * (self.draws - self.weights @ self.draws)
        return self._named(_scatter(off, self.parts))

    @property
    def covariance(self) -> Floats:
        """Covariance of the parameters, shape (n, n)."""
        return moments(self.draws, self.weights)[1]

    @property
    def standard_deviation(self) -> Mapping[str, float]:
        """Standard deviations by name."""
        return self._named(np.sqrt(np.diag(self.covariance)))

    def _named(self, values: Floats) -> Mapping[str, float]:
        return MappingProxyType(dict(zip(self.names, values.tolist(), strict=True)))

    def quantile(self, name: str, probability: ArrayLike) -> Any:
        """Value below which a parameter lies with a probability; an array (q,) for an array of these."""
        check_name("the posterior", name, self.names)
        return quantile_of(self.draws[:, self.names.index(name)], self.weights, probability)

    def probability(self, condition: Callable[[dict[str, Floats]], ArrayLike]) -> float:
        """Probability of a condition: a function of a dict of arrays (K,) by name that returns booleans."""
        columns = {name: self.draws[:, k].copy() for k, name in enumerate(self.names)}
        return float(self.weights @ np.broadcast_to(np.asarray(condition(columns), float), len(self.draws)))

    def plot(self, parameters: Sequence[str] | None = None, ax: Any = None) -> Any:
        """Draw histograms beside the Gaussians of the fit; arguments as of `ParameterFit.plot`."""
        return drawing.posterior(self, self.names, drawing.chosen(self.names, parameters), ax)

    def __str__(self) -> str:
        rows = []
        for name, mean in self.mean.items():
            low, middle, high = self.quantile(name, [0.05, 0.5, 0.95])
            told = f"{name} = {mean:.5g} ± {self.standard_deviation[name]:.2g}"
            rows.append(f"{told}, median {middle:.5g}, 5 % to 95 %: {low:.5g} to {high:.5g}")
        if math.isfinite(self.log_evidence):
            rows.append(f"log-evidence {self.log_evidence:.3f} ± {self.log_evidence_error:.1g} nat")
        return "\n".join([*rows, self.status])


def posterior_of(
    evidence: Evidence, estimate: Mapping[str, float], covariance: Floats, prior: Any, n_draws: int
) -> ParameterPosterior:
    """Draw parameters about an estimate with its covariance (n, n), and weight them by their evidence.

    What is drawn from is a Student t, after every round one of the weighted moments so far, in logarithms of
    distances from bounds. Weights are over the mixture of all that was drawn from (J.-M. Cornuet et al.,
    "Adaptive multiple importance sampling", Scand. J. Stat. 39, 2012).
    """
    each = count("n_draws", n_draws, least=_PARTS * _ROUNDS) // (_PARTS * _ROUNDS)
    log_prior, proper = _checked(prior, evidence)
    target = _Target(evidence, log_prior, np.array([*estimate.values()]), covariance)
    proposals, y, log_p = [target.first], np.empty((0, len(covariance))), np.empty(0)
    for k in range(_ROUNDS):
        new = _drawn(*proposals[k], np.arange(k * each, (k + 1) * each))
        y, log_p = np.vstack([y, new]), np.append(log_p, [target(v) for v in new])
        w, total = _weighted(y, log_p, proposals)
        effective = 1.0 / max(float(w @ w), TINY)
        if _ENOUGH <= effective <= len(y):
            break
        proposals.append(_next(*proposals[k], y, w, effective))
    parts, some = np.tile(np.repeat(np.arange(_PARTS), each), k + 1), w > 0.0
    if not some.any():
        raise EstimationError(
            f"none of {len(y)} draws about the fit has both a prior density and an evidence; give a prior "
            f"that does not exclude the estimate {dict(estimate)}, or fit within its bounds"
        )
    told = (total, float(_scatter(w, parts))) if proper else (math.nan, math.nan)
    errors = MappingProxyType(evidence.named(np.sqrt(np.diag(covariance))))
    x = target.of(y[some])
    return ParameterPosterior(tuple(estimate), x, w[some], *told, estimate, errors, parts[some])


class _Target:
    """Prior times evidence in coordinates y: logarithms of distances from the nearer bound, where one is."""

    def __init__(self, evidence: Evidence, log_prior: LogPrior, best: Floats, covariance: Floats) -> None:
        self.evidence, self.log_prior, (low, high) = evidence, log_prior, evidence.bounds
        self.sign = np.where(best - low <= high - best, 1.0, -1.0)  # away from the bound
        nearer = np.where(self.sign > 0.0, low, high)
        self.bounded = np.isfinite(nearer)
        self.bound = np.where(self.bounded, nearer, 0.0)
        cov = self._whole(best, covariance, high - low)
        far = np.maximum(np.abs(best - self.bound), np.sqrt(np.diag(cov)))  # or it would be on the bound
        slope = np.where(self.bounded, self.sign / far, 1.0)
        root: Floats = slope[:, None] * np.linalg.cholesky(cov)
        self.first = np.where(self.bounded, np.log(far), best), root

    def _whole(self, best: Floats, covariance: Floats, wide: Floats) -> Floats:
        """A fit's covariance; where it has none, by how far the log-evidence falls away from the bound."""
        cov = np.where(np.isfinite(covariance), covariance, 0.0)
        for k in np.flatnonzero(np.isnan(np.diag(covariance))).tolist():

            def mirrored(v: Floats, k: int = k) -> float:
                there = best.copy()
                there[k] += self.sign[k] * np.abs(v[0] - best[k])
                return self.evidence(there)

            ends = best[[k]] - wide[k], best[[k]] + wide[k]
            step = first_steps(best[[k]], *ends)
            with suppress(EstimationError):  # it falls nowhere: the draws will tell
                step = scales(
                    mirrored, best[[k]], self.evidence(best), step, *ends, self.evidence.names[k : k + 1]
                )
            cov[k, k] = step[0] ** 2
        return cov

    def of(self, y: Floats) -> Floats:
        """Parameters (..., n) at coordinates."""
        return np.where(self.bounded, self.bound + self.sign * np.exp(np.where(self.bounded, y, 0.0)), y)

    def __call__(self, y: Floats) -> float:
        """Its logarithm at y (n,), and no run of the filter beyond bounds, or where the prior has nothing."""
        x, (low, high) = self.of(y), self.evidence.bounds
        if np.any((x < low) | (x > high)):
            return -np.inf
        known = float(self.log_prior(self.evidence.named(x))) + float(y[self.bounded].sum())
        return known + self.evidence(x) if known > -np.inf else -np.inf


def _drawn(mean: Floats, root: Floats, order: Ints) -> Floats:
    """Draws (8 m, n) of a Student t, evenly spread: those of these numbers (m,) of each of eight sequences.

    Each coordinate is drawn given those before it, which makes a t of more degrees of freedom, and a scale.
    """
    from scipy.special import stdtrit  # on use: import time

    u = np.vstack([quasi_random(len(order), len(mean), key, order) for key in range(_PARTS)])
    z, square = np.empty_like(u), np.zeros(len(u))
    for k in range(len(mean)):
        z[:, k] = stdtrit(_TAILS + k, u[:, k]) * np.sqrt((_TAILS + square) / (_TAILS + k))
        square += z[:, k] ** 2
    return mean + z @ root.T


def _weighted(y: Floats, log_p: Floats, proposals: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, float]:
    """Weights (K,) of draws over the mixture of what they came from; the log of their mean before."""
    from scipy.stats import multivariate_t  # on use: import time

    drawn = [multivariate_t.logpdf(y, mean, root @ root.T, df=_TAILS) for mean, root in proposals]
    log_w = log_p - np.logaddexp.reduce(drawn, axis=0).reshape(-1) + math.log(len(proposals))
    total = float(np.logaddexp.reduce(log_w))
    w = np.exp(log_w - total) if total > -np.inf else np.zeros(len(y))
    return w, total - math.log(len(y))


def _next(mean: Floats, root: Floats, y: Floats, w: Floats, effective: float) -> tuple[Floats, Floats]:
    """What the next round draws from: the weighted moments, and one draw's part of the last."""
    if not w.any():
        return mean, root
    mean, cov = moments(y, w)
    return mean, np.asarray(np.linalg.cholesky(cov + root @ root.T / effective), dtype=float)


def _scatter(terms: Floats, parts: Ints) -> Floats:
    """Standard error of sums of terms (K, ...) over draws, by how much those over the eight sets differ."""
    sums = np.array([terms[parts == k].sum(axis=0) for k in range(_PARTS)])
    return math.sqrt(_PARTS) * np.std(sums, axis=0, ddof=1)


def _checked(prior: Any, evidence: Evidence) -> tuple[LogPrior, bool]:
    """Log-density of parameters by name, flat within bounds where none is given; whether it is proper."""
    if callable(prior):
        return prior, True
    if prior is not None and not isinstance(prior, Mapping):
        raise ModelError(f"prior maps names to distributions, or is a function of a dict, got {short(prior)}")
    known, size = dict(prior or {}), 1.0
    for name in known:
        check_name("the fit", name, evidence.names)
    for name, low, high in zip(evidence.names, *evidence.bounds, strict=True):
        one: Any = known.get(name)
        if name in known and not hasattr(one, "logpdf"):
            raise ModelError(
                f"the prior of {name!r} needs a logpdf, as scipy.stats.norm() has; got {short(one)}"
            )
        size *= (
            high - low if name not in known else one.cdf(high) - one.cdf(low) if hasattr(one, "cdf") else 1.0
        )
    proper = math.isfinite(size)
    norm = math.log(max(size, TINY)) if proper else 0.0
    return lambda p: sum(float(one.logpdf(p[name])) for name, one in known.items()) - norm, proper
