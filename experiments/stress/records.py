"""Run a filter through a problem, and keep what it said at every epoch and what it did that none may do."""

import time
import warnings
from dataclasses import dataclass, field
from functools import partial

import numpy as np

import sphfilter as sf
from experiments.arguments.stress import FILTERS as NAMES
from experiments.show.comparison import least_eigenvalue
from reference_filters.particle import ParticleFilter
from sphfilter.errors import SphfilterError

#: An estimated error of the mean, in posterior standard deviations, that is a flag.
ERROR_FLAG = 0.2
#: Eigenvalue of a covariance scaled to a unit diagonal, and distance of all mass from one, that rounding may
#: leave.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Record:
    """What one run left behind, in the coordinates of the problem that a relation began with.

    Attributes
    ----------
    end : str
        "finished", "refused" (an `SphfilterError`), "crash" or "timeout".
    sentence : str
        Of the exception.
    x, P, log_evidence : ndarray, shapes (k, n), (k, n, n), (k,)
        After every epoch up to the end; log p of the readings of the epoch.
    told : ndarray, shape (3, k)
        Errors of the mean, the variance and the epoch's evidence that the filter told after every epoch, in
        the units of `referees.LIMITS`; NaN where it did not say.
    held : ndarray of str, shape (k,)
        What held the posterior.
    flagged : ndarray of bool, shape (k,)
        Whether the epoch had a flag of its own.
    said : str
        Statuses and reasons that were unusual.
    schemes : str
    seconds : float
    fault : str
        What no run may show whatever the problem.
    """

    end: str
    sentence: str = ""
    x: np.ndarray = field(default_factory=lambda: np.empty((0, 1)))
    P: np.ndarray = field(default_factory=lambda: np.empty((0, 1, 1)))
    log_evidence: np.ndarray = field(default_factory=lambda: np.empty(0))
    told: np.ndarray = field(default_factory=lambda: np.empty((3, 0)))
    held: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=str))
    flagged: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=bool))
    said: str = ""
    schemes: str = ""
    seconds: float = 0.0
    fault: str = ""

    @property
    def flags(self):
        """Whether there was a flag at an epoch or before it, shape (k,)."""
        return np.logical_or.accumulate(self.flagged)


def default_filter(problem, seed=0, config=None):
    """The SPH filter: every setting but the number of particles, where it is one, is the default."""
    start = {"x0": problem.x0, "P0": problem.P0, "t0": problem.t0, "n_particles": problem.n_particles}
    return sf.SPHFilter(problem.model, problem.sensors[0], **start, config=config)


def _paper(problem, seed=0):
    # 002 takes the Gaussian kernel in four dimensions, Lucy's in two
    kernel = "lucy" if problem.model.dim <= 2 else "gaussian"
    return default_filter(problem, seed, sf.FilterConfig.paper(kernel=kernel))


def _particles(n, problem, seed=0):
    return ParticleFilter(*problem.start, n_particles=n, rng=np.random.default_rng([seed, n]))


_LOOSE = partial(default_filter, config=sf.FilterConfig(target_error=0.03))
_MAKERS = (
    default_filter,
    _paper,
    partial(_particles, 1000),
    partial(_particles, 10_000),
    default_filter,
    _LOOSE,
)
#: Filters on trial: make(problem, seed). The last two are given problems whose number of particles is "auto".
FILTERS = dict(zip(NAMES, _MAKERS, strict=True))


def record_of(problem, make=default_filter):
    """The `Record` of a filter make(problem) over all readings; never raises what the filter raises."""
    rows, words, end, sentence, watched = [], ({}, {}), "finished", "", None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            watched = _Watched(make(problem))
            for row in follow(watched, problem, words):
                rows.append(row)
        except SphfilterError as refusal:
            end, sentence = "refused", str(refusal)
        except Exception as crash:  # a finding, not an accident
            end, sentence = "crash", f"{type(crash).__name__}: {crash}"
    names = "x", "P", "log_evidence", "told", "held", "flagged"
    columns = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True)) if rows else {}
    if rows:
        columns["told"] = columns["told"].T
    said, schemes = ("; ".join(found) for found in words)
    fault, seconds = _fault(watched, columns.get("P")), watched.seconds if watched else 0.0
    record = Record(end, sentence, **columns, said=said, schemes=schemes, seconds=seconds, fault=fault)
    return _moved_back(problem, record)


class _Watched:
    """A filter whose steps are timed, and of which one that raises must leave it as it was."""

    def __init__(self, filt):
        self.filter, self.changed, self.seconds = filt, "", 0.0

    def __getattr__(self, name):
        return getattr(self.filter, name)

    def predict(self, **given):
        return self._checked(self.filter.predict, **given)

    def update(self, *given):
        return self._checked(self.filter.update, *given)

    def _checked(self, verb, *args, **given):
        before, started = self._state(), time.perf_counter()
        try:
            return verb(*args, **given)
        except Exception:
            pairs = zip(before, self._state(), strict=True)
            if not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
                self.changed = f"{verb.__name__} raised and left the filter changed"
            raise
        finally:
            self.seconds += time.perf_counter() - started

    def _state(self):
        f = self.filter
        return f.x.copy(), f.P.copy(), f.t, f.log_evidence


def _fault(watched, P):
    """What no run may show: a step half taken, a covariance that is none, masses that are not one."""
    if watched is None or watched.changed or P is None:
        return getattr(watched, "changed", "")
    variance = np.diagonal(P, axis1=1, axis2=2)
    if not (np.isfinite(P).all() and (variance > 0).all()):
        return f"a covariance is not finite, or a variance not positive: {variance.min():.3g}"
    if (least := least_eigenvalue(P)) < -_ROUNDING:
        return f"a covariance has a negative eigenvalue, {least:.2g} of its diagonal"
    density = getattr(watched.filter, "density", None)
    mass = np.sum(getattr(watched.filter, "weights", 1.0) if density is None else density.mass)
    return f"the masses sum to {mass:.6g}" if abs(mass - 1.0) > _ROUNDING else ""


def follow(filt, problem, words=None, careful=False):
    """Predict to every time, in parts, use the readings of all sensors, and yield a row of each epoch.

    A row is x, P, log_evidence, told, held, flagged. The pair of dicts `words` gathers what was unusual, and
    the schemes; with `careful` there are stops enough to see every change with the clock.
    """
    words = words or ({}, {})
    for epoch, t in enumerate(problem.times):
        infos, log_evidence = [], 0.0
        stops = problem.equation.stops if careful else _even
        for stop in stops(filt.t, t, problem.parts) if t > filt.t else ():
            infos.append(filt.predict(t=float(stop)))
            words[1][infos[-1].scheme] = None
        for sensor, z in zip(problem.sensors, problem.z, strict=True):
            infos.append(filt.update(z[epoch], sensor))
            log_evidence += infos[-1].log_evidence
        told, flagged = _told(infos, len(problem.sensors)), False
        for info in infos:
            if getattr(info, "flagged", False):
                flagged = True
                words[0][" / ".join(filter(None, (info.status, getattr(info, "reason", ""))))] = None
        flagged = flagged or told[0] > ERROR_FLAG
        yield filt.x.copy(), filt.P.copy(), log_evidence, told, getattr(infos[-1], "rung", ""), flagged


def _told(infos, n_readings):
    """Errors that a filter tells of its mean, its variances and the evidence of the last readings."""
    if not hasattr(infos[-1], "variance_error"):  # a reference
        return np.array([getattr(infos[-1], "error", np.nan), np.nan, np.nan])
    of_evidence = np.linalg.norm([info.evidence_error for info in infos[-n_readings:]])
    return np.array([infos[-1].error, infos[-1].variance_error, of_evidence])


def _even(t0, t1, parts):
    return np.linspace(t0, t1, parts + 1)[1:]


def _moved_back(problem, record):
    """The record in the coordinates x = T y + c, with the evidence of the problem it was made from."""
    if not len(record.x):
        return record
    T = np.eye(len(problem.x0)) if problem.T is None else problem.T
    c = 0.0 if problem.c is None else problem.c
    values = vars(record) | {
        "x": record.x @ T.T + c,
        "P": T @ record.P @ T.T,
        "log_evidence": record.log_evidence + problem.constant,
    }
    return Record(**values)
