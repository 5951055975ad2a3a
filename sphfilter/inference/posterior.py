"""Posteriors of parameters, by draws that are weighted by the evidence of the measurements."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike

from .. import drawing
from .._types import Floats, Ints
from ..core.limits import TINY
from ..density.points import moments
from ..density.quasi_random import quasi_random
from ..density.weighted import quantile_of
from ..errors import EstimationError, ModelError
from ..validate import count, short
from .evidence import Evidence, check_name
from .maximum import first_steps
from .quadratic import scales

__all__ = ["ParameterPosterior", "Prior", "posterior_of"]

#: What was known of parameters before: log-densities of single ones by name, or one of them all by name.
LogPrior: TypeAlias = Callable[[dict[str, float]], float]
Prior: TypeAlias = Mapping[str, Any] | LogPrior
#: Mean (n,) and root (n, n) of what is drawn from.
Proposal: TypeAlias = tuple[Floats, Floats]
_TAILS = 5.0  # degrees of freedom of what is drawn from: its variance is 5 / (5 - 2) = 1.7 times the fit's
_PARTS = 8  # sets of draws, each even by itself: their scatter is known to 1 / √(2 (8 - 1)) = .27 of it
_ROUNDS = 8  # of draws, after each of which it may be enough: 1 / 8 of them is drawn in vain at most
_ENOUGH = 256.0  # effective draws: means within 1 / √256 = .06 deviations, were they drawn at random
_FEW = 30.0  # effective draws that tell no tails: 30 / 20 = 1.5 lie beyond a quantile of .05


@dataclass(frozen=True, eq=False)
class ParameterPosterior:
    """The probability density of fitted parameters, given the measurements, as weighted draws.

    Attributes
    ----------
    names : tuple of str, length n
    draws : ndarray, shape (K, n)
        Values of the parameters.
    weights : ndarray, shape (K,)
        Their probabilities; the sum is one.
    log_evidence : float
        Logarithm of the evidence averaged over the prior, nats: that of the model, whatever its parameters.
        NaN where the prior is flat without end.
    log_evidence_error : float
        Standard error of that, of the draws alone, nats.
    estimate, standard_error : mapping of str to float
        Those of the fit.
    parts : ndarray of int, shape (K,)
        Which of eight sets, that are drawn apart, a draw is of.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model = sf.LinearSDE([[-0.6]], noise=[[1.0]])
    >>> level = sf.GaussianMeasurement.from_expressions(["x"], ["x"], [["R"]], parameters={"R": 0.1})
    >>> times = 0.4 * np.arange(1, 31)
    >>> _, z = sf.simulate(model, level, x0=[0.0], times=times, rng=3)
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> fit = sf.fit_parameters(flt, times, z, guess={"R": 0.2}, bounds={"R": (0.0, None)})
    >>> posterior = fit.posterior()
    >>> low, high = posterior.quantile("R", [0.05, 0.95])
    >>> print(f"{fit.estimate['R']:.2f}; {posterior.mean['R']:.2f}, {low:.2f} to {high:.2f}")
    0.07; ...
    >>> print(f"{posterior.probability(lambda p: p['R'] > 0.2):.2f}")
    0.1...
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

    @overload
    def quantile(self, name: str, probability: float) -> float: ...

    @overload
    def quantile(self, name: str, probability: Sequence[float] | Floats) -> Floats: ...

    def quantile(self, name: str, probability: ArrayLike) -> float | Floats:
        """Value below which a parameter lies with a probability; an array (K,) for such of probabilities.

        Raises `ModelError` for an unknown name, or a probability that is not between 0 and 1.
        """
        check_name("the posterior", name, self.names)
        return quantile_of(self.draws[:, self.names.index(name)], self.weights, probability)

    def probability(self, condition: Callable[[dict[str, Floats]], ArrayLike]) -> float:
        """Probability of a condition, a function of a dict of arrays (K,) by name that returns booleans (K,).

        Draws count for their weights, so that ``lambda p: p["a"] * p["b"] > 1.0`` asks what it says.
        """
        columns = {name: self.draws[:, k].copy() for k, name in enumerate(self.names)}
        return float(self.weights @ np.broadcast_to(np.asarray(condition(columns), float), len(self.draws)))

    def plot(self, parameters: Sequence[str] | None = None, ax: Any = None) -> Any:
        """Draw histograms of the parameters beside the Gaussians of the fit; needs matplotlib.

        Parameters
        ----------
        parameters : sequence of str, optional
            Names of those that are drawn, all if not given.
        ax : matplotlib Axes, or an array (k, k) of these, optional
            A new figure if not given; returned either way.
        """
        return drawing.posterior(self, self.names, drawing.chosen(self.names, parameters), ax)

    def __repr__(self) -> str:
        return f"ParameterPosterior({'; '.join(str(self).splitlines())})"

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
    evidence: Evidence,
    estimate: Mapping[str, float],
    covariance: Floats,
    bounds: Mapping[str, tuple[float, float]],
    prior: Prior | None,
    n_draws: int,
) -> ParameterPosterior:
    """Draw parameters about an estimate with its covariance (n, n), and weight them by their evidence.

    What is drawn from is a Student t in coordinates without bounds, after every round one of the weighted
    moments so far. Weights are over the mixture of all that was drawn from (J.-M. Cornuet et al., "Adaptive
    multiple importance sampling", Scand. J. Stat. 39, 2012).
    """
    each = count("n_draws", n_draws, least=_PARTS * _ROUNDS) // (_PARTS * _ROUNDS)
    log_prior, proper = _checked(prior, bounds)
    within, best = _Within(*np.array([*bounds.values()]).T), np.array([*estimate.values()])
    proposals = [within.begun(best, _whole(evidence, best, covariance, within))]
    y, log_p = np.empty((0, len(best))), np.empty(0)
    for k in range(_ROUNDS):
        new = _drawn(*proposals[k], np.arange(k * each, (k + 1) * each))
        y, log_p = np.vstack([y, new]), np.append(log_p, _log_target(evidence, log_prior, *within.of(new)))
        w, total = _weighted(y, log_p, proposals)
        effective = 1.0 / max(float(w @ w), TINY)
        if _ENOUGH <= effective <= len(y):
            break
        proposals.append(_next(proposals[k], y, w, effective))
    parts, some = np.tile(np.repeat(np.arange(_PARTS), each), k + 1), w > 0.0
    if not some.any():
        raise EstimationError(
            f"none of {len(y)} draws about the fit has both a prior density and an evidence; give a prior "
            f"that does not exclude the estimate {dict(estimate)}, or fit within its bounds"
        )
    said = (total, float(_scatter(w, parts))) if proper else (math.nan, math.nan)
    spread = MappingProxyType(dict(zip(estimate, np.sqrt(np.diag(covariance)).tolist(), strict=True)))
    draws = within.of(y[some])[0]
    return ParameterPosterior(tuple(estimate), draws, w[some], *said, estimate, spread, parts[some])


class _Within(NamedTuple):
    """Coordinates y without bounds of parameters x that have some: logarithms of distances from these."""

    low: Floats
    high: Floats

    def begun(self, best: Floats, covariance: Floats) -> Proposal:
        """An estimate (n,) and its covariance (n, n), in y; a standard error or more away from bounds."""
        off = np.minimum(np.sqrt(np.diag(covariance)), 0.25 * (self.high - self.low))
        x = np.clip(best, self.low + off, self.high - off)
        free = np.isinf(self.low) & np.isinf(self.high)
        below, above = (np.where(np.isfinite(d), d, 1.0) for d in (x - self.low, self.high - x))
        slope = np.where(free, 1.0, 1.0 / (x - self.low) + 1.0 / (self.high - x))
        y = np.where(free, x, np.log(below) - np.log(above))
        return y, slope[:, None] * np.linalg.cholesky(covariance)

    def of(self, y: Floats) -> tuple[Floats, Floats]:
        """Parameters (K, n) of coordinates, and logs (K,) of how much volume of theirs is in one of y."""
        from scipy.special import expit, log_expit  # on use: import time

        x, log_volume = y.copy(), np.zeros(len(y))
        for k, (low, high) in enumerate(zip(*self, strict=True)):
            v = y[:, k]
            if math.isfinite(high - low):
                x[:, k] = low + (high - low) * expit(v)
                log_volume += math.log(high - low) + log_expit(v) + log_expit(-v)
            elif math.isfinite(low):
                x[:, k], log_volume = low + np.exp(v), log_volume + v
            elif math.isfinite(high):
                x[:, k], log_volume = high - np.exp(-v), log_volume - v
        return x, log_volume


def _log_target(evidence: Evidence, log_prior: LogPrior, x: Floats, log_volume: Floats) -> list[float]:
    """Log of prior times evidence at parameters (K, n), times their volume; no run without a prior."""
    known = [float(log_prior(evidence.named(one))) for one in x]
    return [
        p + v + evidence(one) if p > -np.inf else -np.inf
        for one, p, v in zip(x, known, log_volume.tolist(), strict=True)
    ]


def _weighted(x: Floats, log_p: Floats, proposals: Sequence[Proposal]) -> tuple[Floats, float]:
    """Weights (K,) of draws over the mixture of what they came from; the log of their mean before."""
    drawn = np.logaddexp.reduce([_log_student(x, *one) for one in proposals]) - math.log(len(proposals))
    total = float(np.logaddexp.reduce(log_p - drawn))
    w = np.exp(log_p - drawn - total) if total > -np.inf else np.zeros(len(x))
    return w, total - math.log(len(x))


def _drawn(mean: Floats, root: Floats, order: Ints) -> Floats:
    """Draws (8 m, n) of a Student t, evenly spread: those of these numbers (m,) of each of eight sequences.

    Each coordinate is drawn given those before it, which makes a t of more degrees of freedom, and a scale.
    """
    from scipy.special import stdtrit  # on use: import time

    n = len(mean)
    u = np.vstack([quasi_random(len(order), n, key, order) for key in range(_PARTS)])
    z, square = np.empty_like(u), np.zeros(len(u))
    for k in range(n):
        z[:, k] = stdtrit(_TAILS + k, u[:, k]) * np.sqrt((_TAILS + square) / (_TAILS + k))
        square += z[:, k] ** 2
    return mean + np.einsum("ij,kj->ki", root, z)


def _log_student(x: Floats, mean: Floats, root: Floats) -> Floats:
    """Log-density (K,) of what `_drawn` draws."""
    from scipy.special import gammaln  # on use: import time

    n, z = len(mean), np.linalg.solve(root, (x - mean).T)
    scale = 0.5 * n * math.log(_TAILS * math.pi) + float(np.linalg.slogdet(root)[1])
    constant = gammaln(0.5 * (_TAILS + n)) - gammaln(0.5 * _TAILS) - scale
    return constant - 0.5 * (_TAILS + n) * np.log1p(np.sum(z**2, axis=0) / _TAILS)


def _next(last: Proposal, y: Floats, w: Floats, effective: float) -> Proposal:
    """What the next round draws from: the weighted moments, and one draw's part of the last."""
    if not w.any():
        return last
    mean, cov = moments(y, w)
    return mean, np.asarray(np.linalg.cholesky(cov + last[1] @ last[1].T / effective), dtype=float)


def _scatter(terms: Floats, parts: Ints) -> Floats:
    """Standard error of sums of terms (K, ...) over draws, by how much those over the eight sets differ."""
    sums = np.array([terms[parts == k].sum(axis=0) for k in range(_PARTS)])
    return math.sqrt(_PARTS) * np.std(sums, axis=0, ddof=1)


def _checked(prior: Any, bounds: Mapping[str, tuple[float, float]]) -> tuple[LogPrior, bool]:
    """Log-density of parameters by name, flat within bounds where none is given; whether it is proper."""
    if callable(prior):
        return prior, True
    if prior is not None and not isinstance(prior, Mapping):
        raise ModelError(
            f"prior maps names to what has a logpdf, or is a function of a dict, got {short(prior)}"
        )
    known, mass = dict(prior or {}), 1.0
    for name, one in known.items():
        check_name("the fit", name, [*bounds])
        if not hasattr(one, "logpdf"):
            raise ModelError(
                f"the prior of {name!r} needs a logpdf, as scipy.stats.norm() has; got {short(one)}"
            )
        mass *= float(one.cdf(bounds[name][1]) - one.cdf(bounds[name][0])) if hasattr(one, "cdf") else 1.0
    size = mass * math.prod(high - low for name, (low, high) in bounds.items() if name not in known)
    proper = math.isfinite(size)
    norm = math.log(max(size, TINY)) if proper else 0.0
    return lambda p: sum(float(one.logpdf(p[name])) for name, one in known.items()) - norm, proper


def _whole(evidence: Evidence, best: Floats, covariance: Floats, within: _Within) -> Floats:
    """A fit's covariance (n, n); of parameters without one as far as the log-evidence falls off a bound."""
    out, far = np.where(np.isfinite(covariance), covariance, 0.0), within.high - within.low
    away = np.where(best - within.low <= within.high - best, 1.0, -1.0)
    for k in np.flatnonzero(np.isnan(np.diag(covariance))):
        there, only = best[[k]], away * (np.arange(len(best)) == k)

        def mirrored(v: Floats, there: Floats = there, only: Floats = only) -> float:
            return evidence(best + np.abs(v - there) * only)

        ends = there - far[k], there + far[k]
        step = first_steps(there, *ends)
        with suppress(EstimationError):  # it falls nowhere: the draws will tell
            step = scales(mirrored, there, evidence(best), step, *ends, [evidence.names[int(k)]])
        out[k, k] = step[0] ** 2
    return out
