"""Fixed-interval smoothing: the density of the state at each time, given all measurements.

p(x_k | z_1..T) is the filter's p(x_k | z_1..k) times β_k(x) = p(z_k+1..T | x_k = x). log β is carried back
from measurement to measurement on lattices that follow the smoothed density, and so is only asked for where
that is: by itself it need not have an end. In three states and more points stand for lattices.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools, Floats, Readings
from ..config import CloudScheme, LogDensityScheme
from ..core.cloud.control import may_be_wrong
from ..core.field.field import Field
from ..density.family import ON_LATTICE
from ..density.memory import flagged_from
from ..density.particle_density import ParticleDensity
from ..density.resample import no_weight, on_lattice, times_likelihood
from ..errors import ModelError, PropagationError
from ..filter.inherited import shift_left_by_update
from ..filter.readings import rows_of, sensor_of
from ..filter.results import FilterResult
from ..filter.sph_filter import SPHFilter
from ..info import DOUBTFUL
from ..lattice.field import extrapolated_mass, nodes
from ..lattice.level_set import lattice_reach
from ..lattice.resolved import TIMES
from ..model.discrete import DiscreteModel
from ..model.measurements import Sensor
from ..model.named import InputRecord, driven, each_input
from ..prediction import chapman_kolmogorov
from ..prediction.backward import carried_back, likelihood_field
from ..prediction.log_density import why_not
from ..validate import short
from ..validate import times as checked_times
from .cloud_smoother import POINTS, SmoothedEpoch, between, on_clouds

#: Standard deviations that lattices of the smoother reach further than those of the filter: what β is beyond
#: their edge is a guess, and stays one. Measured: half and twice move means of three records by .002 at most.
_FURTHER = 0.8
_MOMENTS = "x_prior", "P_prior", "x", "P"  # of the filter after an update, and what that tells
_TOLD = "log_evidence", "accepted", "error", "variance_error", "evidence_error", "flagged"


@dataclass(frozen=True)
class SmoothedResult:
    """Densities given all measurements; the first axis is the measurement epoch.

    Attributes
    ----------
    t : ndarray, shape (T,)
        Seconds.
    x : ndarray, shape (T, n)
        Smoothed means.
    P : ndarray, shape (T, n, n)
        Smoothed covariances.
    densities : tuple of ParticleDensity, length T
    filtered : FilterResult
        The filter's own run.
    log_evidence : ndarray, shape (T,)
        Log-evidence of all measurements, nats, as put together at each epoch: the filter's log-evidence of
        the measurements before, and the backward pass's of the measurements after. How far these numbers are
        apart measures the probability that the two passes lose.
    extrapolated : ndarray, shape (T,)
        Probability of each smoothed density outside of all particles of the filter's density, where the
        smoothed density rests on a guess. NaN on clouds, which have no particles of the filter's in them.
    error : ndarray, shape (T,)
        Estimated error of each smoothed mean, in smoothed standard deviations: rms over the states. Told over
        made was measured to be 1.8 to 3 on clouds (linear models, Van der Pol, a cart), .6 to 10 for two
        wells. On lattices it was 2 to 8, where more than 1e-4 is made (two wells, Duffing, Van der Pol).
    variance_error : ndarray, shape (T,)
        Estimated error of the smoothed variances, as a part of each, where it is most.
    flagged : ndarray of bool, shape (T,)
        Whether a mean or a variance may well be off by more than three of the filter's target errors.

    Examples
    --------
    >>> import sphfilter as sf
    >>> level, model = sf.GaussianMeasurement([[1.0]], [[0.1]]), sf.LinearSDE([[-0.6]], noise=[[1.0]])
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> smoothed = sf.smooth(flt, [1.0, 2.0, 3.0], [0.5, -0.2, 0.1])
    >>> print(smoothed.x.shape, round(smoothed.densities[1].quantile(0, 0.5), 2))
    (3, 1) -0.13
    >>> bool(max(smoothed.log_evidence) - min(smoothed.log_evidence) < 1e-3)
    True
    """

    t: Floats
    x: Floats
    P: Floats
    densities: tuple[ParticleDensity, ...]
    filtered: FilterResult
    log_evidence: Floats
    extrapolated: Floats
    error: Floats
    variance_error: Floats
    flagged: Bools

    def __repr__(self) -> str:
        names = ", ".join(f.name for f in fields(self))
        return f"SmoothedResult({len(self.t)} epochs of {np.shape(self.x)[-1]} states: {names})"


def smooth(
    filt: SPHFilter,
    times: ArrayLike,
    measurements: Readings,
    *,
    sensors: Sequence[Sensor | str | None] | None = None,
    inputs: InputRecord | None = None,
) -> SmoothedResult:
    """Smooth over a fixed interval: filter forward, then carry back what later measurements say.

    Parameters
    ----------
    filt : SPHFilter
        The filter at the start of the measurements; it stays there. Its scheme must be the default or the
        cloud.
    times : array_like, shape (T,)
        Not decreasing, seconds, none before the filter's own. Times may repeat.
    measurements : sequence of length T
        None or NaN where none came.
    sensors : sequence of length T, optional
        The sensor of each measurement, where they are of several; None for the filter's own, whose parts have
        names if it is `Sensors`.
    inputs : array_like (T, m), or mapping of str to array_like (T,), optional
        As of ``SPHFilter.run``.

    Returns
    -------
    SmoothedResult

    Raises
    ------
    ModelError
        The filter, its model or its scheme cannot be smoothed; the sentence says why.
    PropagationError
        The filter cannot go on, or lattices that were asked for hold no smoothed density; it names the time.

    Notes
    -----
    A measurement that the filter refused is not used on the way back either. Steps back end at the times at
    which the model jumps. In one and two states, and where a number of particles is given, log β goes back on
    lattices. In three and more, and where the filter's scheme is the cloud, it goes back over the filter's
    clouds, from points each of whose transitions is linearised; then points led by it go forward once more.
    Their weights are exact but for β itself; intervals of strongly nonlinear models go in parts. No noise is
    too small, and none has to be on every state. Where these are told to be far worse than the filter, as
    where β has several peaks, the filter's points are weighted by how likely later ones come from them
    (Doucet, Godsill, Andrieu 2000), and an epoch has these where they tell a third. `SmoothedResult.error`
    tells what is left, by a cloud of an eighth of the points in longer parts; if it is too much, take more:
    ``scheme=CloudScheme(n_points=...)``.
    The start is taken as its pdf says: of a filter that carries a cloud already, one of kernels.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    >>> level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
    >>> times = 0.4 * np.arange(1, 31)
    >>> _, z = sf.simulate(model, level, x0=[0.0], times=times, rng=3)
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> smoothed = sf.smooth(flt, times, z)
    >>> before, after = smoothed.filtered.P[5, 0, 0], smoothed.densities[5].cov()[0, 0]
    >>> print(f"variance {before:.4f} before later measurements, {after:.4f} after")
    variance 0.0786 before later measurements, 0.0701 after
    """
    times, start = checked_times("times", times), filt
    points = isinstance(filt, SPHFilter) and _by_points(filt)
    filt = _on_clouds(filt) if points else _on_lattices(filt)
    read = _checked(filt, times, measurements, sensors)
    driving = each_input(filt.model.inputs, inputs, len(times))
    try:
        epochs, filtered = _forward(filt, times, read, driving, points)
        smoothed = on_clouds(epochs, start.density) if points else _backward(epochs)
    except PropagationError:
        if points or filt is start:  # lattices that were asked for
            raise
        return smooth(_on_clouds(start), times, measurements, sensors=sensors, inputs=inputs)
    each = [own for own, epoch in zip(smoothed, epochs, strict=True) for _ in range(epoch.rows)]
    densities, total, extrapolated, error, wider = zip(*each, strict=True)
    most = flagged_from(filt.config.target_error)
    flagged = [a > most or may_be_wrong(b, most) for a, b in zip(error, wider, strict=True)]
    return SmoothedResult(
        t=times,
        x=np.array([density.mean() for density in densities]),
        P=np.array([density.cov() for density in densities]),
        densities=densities,
        filtered=filtered,
        log_evidence=np.array(total),
        extrapolated=np.array(extrapolated),
        error=np.array(error),
        variance_error=np.array(wider),
        flagged=np.array(flagged),
    )


def _on_lattices(filt: SPHFilter) -> SPHFilter:
    """A filter whose densities lie on lattices, where a target error would choose among other shapes too."""
    if not isinstance(filt, SPHFilter) or not filt.adapts or filt.config.scheme != "auto":
        return filt
    twin = copy.copy(filt)
    twin.config = replace(filt.config, scheme=LogDensityScheme())
    twin._state = replace(filt._state, density=on_lattice(filt.density, filt.n_particles))
    return twin


def _by_points(filt: SPHFilter) -> bool:
    """Whether a filter is smoothed on clouds: by its scheme, or where no lattice is asked for nor goes."""
    scheme, fixed = filt.config.scheme, not (filt.adapts or isinstance(filt.model, DiscreteModel))
    return isinstance(scheme, CloudScheme) or (scheme == "auto" and filt.model.dim > ON_LATTICE and not fixed)


def _on_clouds(filt: SPHFilter) -> SPHFilter:
    """A filter that carries clouds; of so many points as it asks for, else of those that λ is fitted at."""
    twin = copy.copy(filt)
    if not isinstance(filt.config.scheme, CloudScheme):
        twin.config = replace(filt.config, scheme=CloudScheme(n_points=POINTS))
    return twin


def _checked(
    filt: SPHFilter, times: Floats, measurements: Readings, sensors: Sequence[Sensor | str | None] | None
) -> list[tuple[Sensor, ArrayLike | None]]:
    """Every measurement with its sensor, where all that is given can be smoothed."""
    if not isinstance(filt, SPHFilter):
        raise ModelError(f"smooth needs an SPHFilter, got {short(filt)}; it makes its own run of it")
    sensors = [None] * len(times) if sensors is None else list(sensors)
    if not len(times) == len(measurements) == len(sensors):
        raise ModelError(
            f"smooth needs a measurement, and a sensor if any are given, for each time; got {len(times)} "
            f"times, {len(measurements)} measurements and {len(sensors)} sensors"
        )
    if times[0] < filt.t:
        raise ModelError(f"the first time {times[0]:g} is before the filter's own time {filt.t:g}")
    if not filt.model.domain.unbounded:
        raise ModelError("smooth takes no model with a domain: states have to be on the whole line")
    scheme, model = filt.config.scheme, cast(Any, filt.model)
    if isinstance(scheme, CloudScheme):
        reason = ""
    elif isinstance(model, DiscreteModel):
        reason = chapman_kolmogorov.why_not(model)
    else:
        reason = why_not(model, filt.density, filt.n_particles)
    if not isinstance(scheme, str | LogDensityScheme | CloudScheme):
        reason = f"the filter's scheme is {scheme.name!r}; leave it to the default or to the cloud"
    if reason:
        raise ModelError(f"smooth needs densities that the log_density scheme carries: {reason}")
    own = [sensor_of(filt.measurement, sensor, None, filt.model) for sensor in sensors]
    return list(zip(own, rows_of(filt.measurement, measurements), strict=True))


@dataclass
class _Epoch:
    """State of the filter at one of the distinct times, those at which the model jumps included."""

    filt: SPHFilter  # after the updates
    n_steps: int  # of the prediction
    seen: list[tuple[Sensor, ArrayLike | None]]  # (sensor, z) that were used
    rows: int  # measurements at that time, used or not
    variance_error: float = math.nan  # of the filter's, after the last of them

    def log_likelihood(self, X: Floats) -> Floats:
        """Log-likelihood of the measurements used, at states X (N, n)."""
        t = self.filt.t
        return sum((sensor.log_likelihood(z, X, t) for sensor, z in self.seen), np.zeros(len(X)))


def _forward(
    filt: SPHFilter,
    times: Floats,
    read: Sequence[tuple[Sensor, ArrayLike | None]],
    inputs: Sequence[Mapping[str, float] | None],
    begun: bool,
) -> tuple[list[_Epoch], FilterResult]:
    """Run a copy of the filter; its epochs, with its start if that is `begun`, and their `FilterResult`."""
    filt = copy.copy(filt)
    filt.config = replace(filt.config, exact_linear=False)  # its steps are those of the way back
    epochs = [_Epoch(copy.copy(filt), 0, [], 0)] if begun else []
    rows = []
    for t, (sensor, z), u in zip(times, read, inputs, strict=True):
        for stop in [*(filt.model.breaks(filt.t, t) if epochs else ()), t]:
            steps = _predicted(filt, stop, u) if stop > filt.t else 0
            if not epochs or filt.t > epochs[-1].filt.t:
                epochs.append(_Epoch(copy.copy(filt), steps, [], 0))
        info = filt.update(z, sensor)
        epochs[-1].rows += 1
        if info.accepted and sensor.observed(z).any():
            epochs[-1].seen.append((driven(sensor, filt.inputs), z))
        epochs[-1].filt, epochs[-1].variance_error = copy.copy(filt), info.variance_error
        rows.append([getattr(filt, name) for name in _MOMENTS] + [getattr(info, name) for name in _TOLD])
    columns = map(np.array, zip(*rows, strict=True))
    return epochs, FilterResult(times, **dict(zip(_MOMENTS + _TOLD, columns, strict=True)))


def _predicted(filt: SPHFilter, t: float, u: Mapping[str, float] | None) -> int:
    """Predict to time t with inputs u; steps that this took."""
    predicted = filt.predict(t=t, u=u)
    carried = isinstance(filt.config.scheme, CloudScheme) or predicted.scheme == "log_density"
    if predicted.n_steps and not carried:
        raise ModelError(
            f"smooth needs densities that the log_density scheme carries; to t = {t:g} it was "
            f"{predicted.scheme}: {predicted.status}"
        )
    return predicted.n_steps


def _backward(epochs: list[_Epoch]) -> list[SmoothedEpoch]:
    """Smooth the epochs of a filter that carries lattices."""
    last = epochs[-1].filt
    scheme = LogDensityScheme(reach=lattice_reach(last.config.scheme, last.model.dim) + _FURTHER)
    laid: Any = times_likelihood(last.density, no_weight, last.n_particles, scheme)[0]
    found = likelihood_field(laid.field, epochs[-1].log_likelihood(nodes(laid.field)))
    error = last.density.error
    out = [SmoothedEpoch(last.density, last.log_evidence, 0.0, error, epochs[-1].variance_error)]
    for before, after in zip(epochs[-2::-1], epochs[:0:-1], strict=True):
        try:
            smoothed, found, future = _one_back(before, after, found, scheme)
        except PropagationError as problem:
            raise PropagationError(
                f"smoothing back from t = {after.filt.t:g} to {before.filt.t:g}: {problem}"
            ) from problem
        past: Any = before.filt
        guessed = extrapolated_mass(past.density.field, smoothed.x, smoothed.mass)
        left = shift_left_by_update(past.P, smoothed.cov()) * past.density.error
        total = past.log_evidence + future  # beside the filter's: so many nats are about as many deviations
        error = math.hypot(smoothed.error, left, total - last.log_evidence)
        smoothed = smoothed.noted(error=error)
        out.append(SmoothedEpoch(smoothed, total, guessed, error, math.sqrt(2.0) * error))
    return out[::-1]


def _one_back(
    before: _Epoch, after: _Epoch, found: Field, scheme: LogDensityScheme
) -> tuple[ParticleDensity, Field, float]:
    """From one epoch to the one before: the smoothed density there, λ with its measurements, and log ∫ p β.

    `found` is λ at the later epoch, measurements there included.
    """
    u = after.filt.inputs  # of the prediction between
    priors = between(before.filt, after.filt.t, max(after.n_steps, 1), u)
    model: Any = before.filt.model.with_inputs(u)
    smoothed: Any
    for prior, t in zip(priors[::-1], [after.filt.t, *(p.t for p in priors[:0:-1])], strict=True):
        if isinstance(model, DiscreteModel):
            log_beta = chapman_kolmogorov.integrated_back(model, found, prior)
        else:
            log_beta = carried_back(model, found, prior, t)
        for times in TIMES if isinstance(model, DiscreteModel) else TIMES[:1]:
            many = times * before.filt.n_particles
            smoothed, future, laid = times_likelihood(prior, log_beta, many, scheme)
            if laid.off.residual <= DOUBTFUL:
                break
        else:
            if isinstance(model, DiscreteModel):
                raise PropagationError("the transition jumps, and no lattice holds what later readings say")
        X = nodes(smoothed.field)
        values = log_beta(X)
        if prior is not priors[0]:
            found = likelihood_field(smoothed.field, values)
    found = likelihood_field(smoothed.field, values + before.log_likelihood(X))
    return smoothed.noted(error=laid.off.mean), found, future
