"""Run one filter on one problem, and watch what it does: answers, refusals, crashes, breaches."""

import time
import warnings
from dataclasses import dataclass, field
from functools import partial

import numpy as np

import sphfilter as sf
from experiments.arguments.stress import METHODS as NAMES
from reference_filters.particle import ParticleFilter
from sphfilter.errors import SphfilterError

__all__ = ["METHODS", "Outcome", "run"]


@dataclass(frozen=True)
class Outcome:
    """What one run left behind.

    Attributes
    ----------
    end : str
        "finished", "refused" (an `SphfilterError`), "crashed" (any other exception) or "timeout".
    sentence : str
        Of the exception.
    x, P, log_evidence : ndarray, shapes (k, n), (k, n, n), (k,)
        After each update up to the end.
    rejection : str
        Why the first measurement was rejected openly that was; empty if none.
    breach : str
        Promise that was broken, such as a filter changed by a call that raised.
    mass : float
        Sum of the masses at the end.
    seconds : float
    schemes, warning : str
        What carried the density, and the first warning given on the way.
    n_particles : int
        At the end.
    """

    end: str
    sentence: str = ""
    x: np.ndarray = field(default_factory=lambda: np.empty((0, 1)))
    P: np.ndarray = field(default_factory=lambda: np.empty((0, 1, 1)))
    log_evidence: np.ndarray = field(default_factory=lambda: np.empty(0))
    rejection: str = ""
    breach: str = ""
    mass: float = 1.0
    seconds: float = 0.0
    schemes: str = ""
    warning: str = ""
    n_particles: int = 0


def _paper(problem, seed):
    # 002 takes the Gaussian kernel in four dimensions, Lucy's in two
    config = sf.FilterConfig.paper(kernel="lucy" if problem.model.dim <= 2 else "gaussian")
    return _sph(problem, config)


def _default(problem, seed):
    return _sph(problem, sf.FilterConfig())


def _sph(problem, config):
    start, shape = (problem.x0, problem.P0), {"n_particles": problem.n_particles, "config": config}
    return sf.SPHFilter(problem.model, problem.measurement, *start, t0=problem.t0, **shape)


def _particle(n, problem, seed):
    start = problem.x0, problem.P0, problem.t0
    rng = np.random.default_rng([seed, n])
    return ParticleFilter(problem.model, problem.measurement, *start, n_particles=n, rng=rng)


#: Filters on trial: make(problem, seed).
METHODS = dict(
    zip(NAMES, (_default, _paper, partial(_particle, 1000), partial(_particle, 10_000)), strict=True)
)


def run(problem, method, seed=0):
    """Run a filter over all measurements; never raises what the filter raises.

    Parameters
    ----------
    problem : Problem
    method : str
        Of `METHODS`.
    seed : int

    Returns
    -------
    Outcome
    """
    watch, end, sentence = _Watch(), "finished", ""
    started = time.perf_counter()
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            watch.follow(METHODS[method](problem, seed), problem)
        except SphfilterError as refusal:
            end, sentence = "refused", str(refusal)
        except Exception as crash:  # a finding, not an accident
            end, sentence = "crashed", f"{type(crash).__name__}: {crash}"
    warned = f"{heard[0].category.__name__}: {heard[0].message}" if heard else ""
    return watch.outcome(end, sentence, time.perf_counter() - started, warned)


class _Watch:
    """Follow a filter epoch by epoch and keep what it shows."""

    def __init__(self):
        self.filter, self.rows, self.schemes = None, [], {}
        self.rejection = self.breach = ""

    def follow(self, filt, problem):
        """Predict to every time and update; whatever the filter raises passes through."""
        self.filter = filt
        for t, z in zip(problem.times, problem.z, strict=True):
            if t > filt.t:
                info = self._call(filt.predict, t=t)
                self.schemes[info.scheme] = None
            info = self._call(filt.update, z)
            if not info.accepted and not self.rejection:
                self.rejection = f"at t = {t:g}: {info.reason}"
            self.rows.append((filt.x.copy(), filt.P.copy(), filt.log_likelihood))

    def _call(self, verb, *args, **kwargs):
        """Call a verb; one that raises must leave the filter as it was."""
        before = self._state()
        try:
            return verb(*args, **kwargs)
        except Exception:
            if not all(
                np.array_equal(a, b, equal_nan=True) for a, b in zip(before, self._state(), strict=True)
            ):
                self.breach = f"{verb.__name__} raised and left the filter changed"
            raise

    def _state(self):
        f = self.filter
        return f.x.copy(), f.P.copy(), f.t, f.log_evidence

    def outcome(self, end, sentence, seconds, warning):
        """Return what was seen."""
        columns = [np.array(column) for column in zip(*self.rows, strict=True)] if self.rows else []
        moments = dict(zip(("x", "P", "log_evidence"), columns, strict=bool(columns)))
        mass = _masses(self.filter)
        return Outcome(end, sentence, **moments, rejection=self.rejection, breach=self.breach,
                       mass=float(mass.sum()), n_particles=len(mass), seconds=seconds,
                       schemes=", ".join(self.schemes), warning=warning)  # fmt: skip


def _masses(filt):
    if filt is None:
        return np.ones(1)
    return filt.weights if isinstance(filt, ParticleFilter) else filt.density.mass
