"""Parameters by maximum evidence, with standard errors.

The log-evidence of a filter that draws nothing is a smooth function of the parameters: it can be maximised,
and its second derivatives at the maximum are the (observed) information.
"""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import drawing
from .._types import Bools, Floats, Readings, Rows
from ..errors import EstimationError
from ..filter.results import FilterResult
from ..filter.sph_filter import SPHFilter
from ..model.named import InputRecord
from .evidence import Bound, Builder, Evidence, Pickled, Progress, check_name, checked_guess, error_of_run
from .maximum import NEAR, ROUND, bounded_where_refused, climbed, off_bounds, polished, ridge, room, searched
from .posterior import ParameterPosterior, Prior, posterior_of
from .quadratic import Quadratic, quadratic, roughness, step_for


@dataclass(frozen=True, repr=False)
class ParameterFit(Pickled):
    """Parameters of largest evidence, with their standard errors.

    Attributes
    ----------
    estimate, standard_error : mapping of str to float
        The standard error of a parameter on a bound is NaN; the parameter is held there for the standard
        errors of the others.
    covariance : ndarray, shape (n, n)
        Inverse of the negative Hessian of the log-evidence; NaN for parameters on a bound.
    log_evidence : float
        Log-evidence at the estimate, nats.
    result : FilterResult
        The run of the filter at the estimate.
    n_readings : int
        Measured numbers, NaN not counted.
    data : str
        Fingerprint of times, measurements and inputs.
    n_evaluations : int
        Runs of the filter.
    roughness : float
        Standard deviation of the log-evidence around a smooth function, nats, as seen at the estimate.
    at_bound : tuple of str
        Parameters on a bound, or too near one for a standard error.
    converged : bool
        The maximum is, by the slopes of the log-evidence, within a quarter of a standard error.
    status : str
        What happened, as a sentence.
    times, measurements, inputs
        What the fit was made to, for ``fit.filter.run`` and the like.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    >>> level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
    >>> times = 0.4 * np.arange(1, 31)
    >>> _, z = sf.simulate(model, level, x0=[0.0], times=times, rng=3)
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> fit = sf.fit_parameters(flt, times, z, guess={"a": 0.5})
    >>> print(f"{fit.estimate['a']:.2f} ± {fit.standard_error['a']:.2f}, AIC {fit.aic:.1f}")
    0.85 ± 0.41, AIC 70.1
    """

    estimate: Mapping[str, float]
    standard_error: Mapping[str, float]
    covariance: Floats
    log_evidence: float
    result: FilterResult
    n_readings: int
    data: str
    n_evaluations: int
    roughness: float
    at_bound: tuple[str, ...]
    converged: bool
    status: str
    times: Floats
    measurements: Rows
    inputs: InputRecord | None
    _evidence: Evidence

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the n parameters, in the order of the covariance."""
        return tuple(self.estimate)

    @property
    def filter(self) -> Any:
        """A new filter at the start of the measurements, with the estimate and the user's own settings.

        Where a function makes filters, what it makes of the estimate.
        """
        given, own = self._evidence.given, dict(self.estimate)
        return given.with_parameters(own) if isinstance(given, SPHFilter) else given(own)

    @property
    def evidence_error(self) -> float:
        """Estimated error of the log-evidence, nats; NaN where the filter does not say."""
        return error_of_run(self.result)

    @property
    def correlation(self) -> Floats:
        """Correlations of the estimates, shape (n, n)."""
        s = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(s, s)

    @property
    def aic(self) -> float:
        """Akaike's criterion: 2 n − 2 log-evidence."""
        return 2.0 * len(self.estimate) - 2.0 * self.log_evidence

    @property
    def bic(self) -> float:
        """Schwarz' criterion: n log(readings) − 2 log-evidence."""
        return len(self.estimate) * float(np.log(self.n_readings)) - 2.0 * self.log_evidence

    def posterior(
        self, prior: Prior | None = None, *, n_draws: int = 1024, report: Progress | None = None
    ) -> ParameterPosterior:
        """Return the probability density of the parameters, a `ParameterPosterior`; skewed, bounded as it is.

        Parameters are drawn about the estimate, always the same ones, and weighted by prior and evidence.

        Parameters
        ----------
        prior : mapping of str to distribution, or callable, optional
            What was known before: objects with ``logpdf``, such as ``scipy.stats.norm(1.0, 0.2)``, by name,
            cut at the fit's bounds; or a function of a dict of all parameters that returns the log-density.
            Flat within the bounds where nothing is said.
        n_draws : int
            Draws at most, 64 or more; fewer where 256 effective ones come sooner. Each is a run.
        report : callable, optional
            As of `fit_parameters`.

        Raises `ModelError` for a prior of a parameter that the fit has not, or without logpdf, and
        `EstimationError` if no draw has both a prior density and an evidence.
        """
        evidence = copy(self._evidence)
        evidence.report, evidence.n_evaluations = report, 0
        return posterior_of(evidence, self.estimate, self.covariance, prior, n_draws)

    def plot(self, parameters: Sequence[str] | None = None, ax: Any = None) -> Any:
        """Draw the estimates with ellipses of one and two standard errors; needs matplotlib.

        Parameters
        ----------
        parameters : sequence of str, optional
            Names of those that are drawn, all if not given.
        ax : matplotlib Axes, or an array (k, k) of these, optional
            A new figure if not given; returned either way.
        """
        return drawing.fit(self, self.names, drawing.chosen(self.names, parameters), ax)

    def __str__(self) -> str:
        rows = [f"{k} = {v:.5g} ± {self.standard_error[k]:.2g}" for k, v in self.estimate.items()]
        evidence = f"log-evidence {self.log_evidence:.3f} ± {self.evidence_error:.1g} nat"
        return "\n".join([*rows, f"{evidence}; {self.status}"])


def fit_parameters(
    filt: SPHFilter | Builder,
    times: ArrayLike,
    measurements: Readings,
    guess: Mapping[str, float],
    *,
    bounds: Mapping[str, Bound] | None = None,
    max_evaluations: int = 1000,
    report: Progress | None = None,
    inputs: InputRecord | None = None,
) -> ParameterFit:
    """Find the parameters under which the measurements have the largest evidence.

    A simplex search (Nelder and Mead) finds the neighbourhood of the maximum, Newton's method the maximum,
    with differences over parts of a standard error, in coordinates in which the log-evidence is round.

    Parameters
    ----------
    filt : SPHFilter, or callable
        A filter at the start of the measurements, whose model or sensor has the parameters; a name that both
        have is one parameter. Or, for anything else that is to be fitted (the start), a function of a dict of
        parameters that returns such a filter. Any object with ``run(times, measurements)`` will do, and with
        the `FilterResult` that it returns.
    times : array_like, shape (T,)
        Seconds.
    measurements : sequence of length T
        None or NaN where none came.
    guess : mapping of str to float
        Where the search begins; these parameters are fitted, others stay.
    bounds : mapping of str to (float or None, float or None), optional
        Lowest and highest value.
    max_evaluations : int
        Number of filter runs, about, after which the search is stopped.
    report : callable, optional
        Called after every run with their number, the parameters as a dict, and the log-evidence.
    inputs : array_like (T, m), or mapping of str to array_like (T,), optional
        As of ``SPHFilter.run``.

    Returns
    -------
    ParameterFit

    Raises
    ------
    ModelError
        A parameter that neither model nor sensor has (the nearest is named), or bounds without the guess.
    EstimationError
        The filter refuses the guess, or the measurements do not determine the parameters: the log-evidence
        falls in no direction, or not in the one that is named.

    Notes
    -----
    A maximum is local: begin elsewhere to look for others. A filter that refuses some parameters is no
    hindrance to the search: where it refuses what is below zero, as of a variance, zero is a bound.
    The log-evidence counts measurements that the filter rejected too.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    >>> level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
    >>> times = 0.4 * np.arange(1, 31)
    >>> _, z = sf.simulate(model, level, x0=[0.0], times=times, rng=3)
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> print(sf.fit_parameters(flt, times, z, guess={"a": 0.5}))
    a = 0.84... ± 0.41
    log-evidence -34.05... ± ... nat; the maximum was found...

    The noise of the sensor, by a function that makes filters:

    >>> def build(p):
    ...     sensor = level.changed(noise_cov=p["R"])
    ...     return sf.SPHFilter(model, sensor, x0=[0.0], P0=[[0.1]])
    >>> fit = sf.fit_parameters(build, times, z, guess={"R": 0.2}, bounds={"R": (0.0, None)})
    >>> print(fit.status)
    the maximum was found...
    """
    names, theta, low, high = checked_guess(guess, bounds)
    evidence = Evidence(filt, times, measurements, names, report, inputs)
    evidence.bounds = low, high
    evidence.first(theta)
    try:
        return _fitted(evidence, theta, max_evaluations)
    except EstimationError:
        if not (positive := bounded_where_refused(evidence, theta)):
            raise
    found, said = _fitted(evidence, theta, max_evaluations), "the filter refuses values below zero of"
    return replace(found, status=f"{found.status}; {said} {', '.join(positive)}")


def _fitted(evidence: Evidence, guess: Floats, max_evaluations: int) -> ParameterFit:
    """The fit within the bounds of an evidence."""
    low, high = evidence.bounds
    theta, value = searched(evidence, guess, max_evaluations)
    theta, value = off_bounds(evidence, theta, value)
    theta, value, free, local = climbed(evidence, theta, value, max_evaluations)
    rough, left, covariance = 0.0, np.inf if free.any() else 0.0, np.full((len(guess), len(guess)), np.nan)
    if local is not None:
        inside, centre = evidence.within(theta, free), theta[free]
        rough = roughness(inside, centre, value, local.root)
        centre, value, left = polished(inside, centre, value, local, rough, low[free], high[free])
        theta[free] = centre
        h = min(step_for(rough), room(centre, local.root, low[free], high[free]))
        local = quadratic(inside, centre, value, local.root, h)
        _refuse_flat(local, rough, h, evidence.names_of(free))
        covariance[np.ix_(free, free)] = local.covariance
    return _told(evidence, theta, value, covariance, rough, free, np.sqrt(2.0 * max(left, 0.0)))


def profile_evidence(
    filt: SPHFilter | Builder,
    times: ArrayLike,
    measurements: Readings,
    fit: ParameterFit,
    name: str,
    values: ArrayLike,
    inputs: InputRecord | None = None,
) -> Floats:
    """The largest log-evidence that the other parameters allow, for fixed values of one.

    Parameters
    ----------
    filt, times, measurements, inputs
        As for `fit_parameters`.
    fit : ParameterFit
        Its result.
    name : str
        One of its parameters.
    values : array_like, shape (K,)

    Returns
    -------
    ndarray, shape (K,)
        Nats; minus infinity where the filter refuses.

    Raises
    ------
    ModelError
        The fit has no such parameter.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    >>> level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
    >>> times = 0.4 * np.arange(1, 31)
    >>> _, z = sf.simulate(model, level, x0=[0.0], times=times, rng=3)
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> fit = sf.fit_parameters(flt, times, z, guess={"a": 0.5})
    >>> sides = fit.estimate["a"] + fit.standard_error["a"] * np.array([-1.0, 0.0, 1.0])
    >>> profile = sf.profile_evidence(flt, times, z, fit, "a", sides)
    >>> print((profile - fit.log_evidence).round(2) + 0.0)  # -0.5 were the log-evidence a parabola
    [-0.53  0.   -0.47]
    """
    check_name("the fit", name, fit.names)
    k, best = fit.names.index(name), np.array(list(fit.estimate.values()))
    evidence = Evidence(filt, times, measurements, fit.names, None, inputs)
    free = np.isfinite(np.diag(fit.covariance))
    free[k] = False
    points = np.asarray(values, dtype=float)
    out = np.empty(len(points))
    for i, value in enumerate(points):
        theta = best.copy()
        theta[k] = value
        if np.isfinite(fit.covariance[k, k]):
            theta[free] += fit.covariance[free, k] / fit.covariance[k, k] * (value - best[k])
        out[i] = ridge(evidence, theta, free, fit.covariance, k)
    return out


def _refuse_flat(local: Quadratic, rough: float, h: float, names: Sequence[str]) -> None:
    """Refuse a log-evidence that does not fall in some direction, or not so that it can be seen."""
    value, direction = local.flattest
    seen = 3.0 * rough / h**2
    if value < -max(ROUND, seen):
        return
    direction = direction / np.abs(direction).max()
    shown = [(c, name) for c, name in zip(direction.tolist(), names, strict=True) if abs(c) > 1e-3]
    terms = " ".join(f"{math.copysign(1.0, shown[0][0]) * c:+.3g} {name}" for c, name in shown)
    terms = terms.removeprefix("+")
    if seen > ROUND:
        raise EstimationError(
            f"the log-evidence is rough by {rough:.1g} nat, too much to see how it falls in the direction "
            f"{terms}; use more particles"
        )
    raise EstimationError(
        f"the measurements do not determine the parameters: the log-evidence does not fall in the direction "
        f"{terms}; fix one of them by leaving it out of guess, or give more measurements"
    )


def _told(
    evidence: Evidence, theta: Floats, value: float, covariance: Floats, rough: float, free: Bools, off: float
) -> ParameterFit:
    """The result, with a sentence about it; the last slopes say that the maximum is `off` standard errors."""
    held, converged = tuple(evidence.names_of(~free)), off < NEAR
    said = "the maximum was found" if converged else "the search was stopped before it had found the maximum"
    said += f", by its slopes {off:.1g} standard errors away" if 0.01 < off < np.inf else ""
    if held:
        said += f"; on a bound or very near it, without a standard error: {', '.join(held)}"
    own = "n_readings", "data", "n_evaluations", "times", "measurements", "inputs"
    return ParameterFit(
        estimate=MappingProxyType(evidence.named(theta)),
        standard_error=MappingProxyType(evidence.named(np.sqrt(np.diag(covariance)))),
        covariance=covariance,
        log_evidence=value,
        result=evidence.result(theta),
        roughness=rough,
        at_bound=held,
        converged=bool(converged),
        status=said,
        _evidence=evidence,
        **{name: getattr(evidence, name) for name in own},
    )
