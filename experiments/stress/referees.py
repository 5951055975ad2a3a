"""References of problems, with the error of each: closed forms, Kalman filter, grids, clouds of particles."""

import signal
import threading
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from experiments.show.comparison import least_eigenvalue, moment_errors
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter
from reference_filters.particle import ParticleFilter
from sphfilter import consistency
from sphfilter.errors import SphfilterError

from .records import follow

#: Errors that are wrong: of the mean in posterior standard deviations, of a variance relative to itself, of
#: the log-evidence of the record in nats. And the share of them that a reference's own error may have.
LIMITS = {"mean": 0.2, "variance": 0.2, "evidence": 0.3}
_ALLOWED = 0.2 * np.array(list(LIMITS.values()))[:, None]
#: Nodes an axis of the coarser of two grids, by the number of states; seconds that the grids may take.
_NODES, _GRID_SECONDS = {1: 256, 2: 64}, 20.0
#: Grids cut densities at 1e-11 of their maximum, 7.1 standard deviations of a Gaussian: a posterior must lie
#: well inside the prior to be right.
_GRID_REACH = 5.0
#: Particles in each of several clouds: to check a grid, then as few and as many as are needed, unless the few
#: are so far apart that the many will be, too, or these take too many seconds.
_CLOUDS, _CHECK, SIZES, _HOPELESS, _SECONDS = 4, 20_000, (60_000, 250_000), 4.0, 120.0
#: Clouds of usual steps against which fine ones are held, and bias times √particles that fine steps may
#: have: a 16th of the usual. Of what both are apart by, fine ones are said to be off by a third, as if they
#: had a quarter of the usual bias.
_USUAL, _FINE, _STILL_OFF = 2, 0.4 / 16, 1.0 / 3.0
#: Standard errors by which a grid and clouds may differ.
_SIGMAS = 5.0


@dataclass(frozen=True)
class Referee:
    """Posteriors to compare with.

    Attributes
    ----------
    name : str
        What it is; empty where there is none.
    x, P, log_evidence : ndarray, shapes (T, n), (T, n, n), (T,)
    own : ndarray, shape (3, T)
        Its own error in the units of `LIMITS`, which it has for the first `n_trusted` epochs.
    n_trusted : int
    why : str
        Why there is none, or none for later epochs.
    """

    name: str = ""
    x: np.ndarray = field(default_factory=lambda: np.empty((0, 1)))
    P: np.ndarray = field(default_factory=lambda: np.empty((0, 1, 1)))
    log_evidence: np.ndarray = field(default_factory=lambda: np.empty(0))
    own: np.ndarray = field(default_factory=lambda: np.empty((3, 0)))
    n_trusted: int = 0
    why: str = ""


def referee(problem, seed, sizes=SIZES):
    """Return the first reference that is good to the end, or the one that is good for most epochs.

    A closed form or the Kalman filter; two grids (one or two states, noise that does not depend on the state)
    that agree with each other and with small clouds; four clouds of particles that agree with each other
    and with clouds of coarser steps.
    """
    found, reasons = Referee(), []
    for name, make in {"exact": _exact, "grids": _grids, "clouds": partial(_few_or_many, sizes)}.items():
        try:
            other = make(problem, seed)
        # the referees are not on trial: whatever stops one, there is none
        except Exception as trouble:
            reasons.append(f"{name}: {trouble}")
            continue
        if other is None:
            continue
        if other.n_trusted == len(problem.times):
            return other
        reasons.append(f"{other.name}: good for {other.n_trusted} epochs, {other.why}")
        found = max(found, other, key=lambda r: r.n_trusted)
    return Referee(**(vars(found) | {"why": "; ".join(reasons)}))


def errors_of(x, P, log_evidence, reference):
    """Errors of the first epochs in the units of `LIMITS`, shape (3, k), in the reference's scale.

    NaN where the reference's covariance is not positive definite, so that nothing can be said.
    """
    k = min(len(x), len(reference.x))
    errors = np.full((3, k), np.nan)
    good = _definite(reference.P[:k])
    if not good.any():
        return errors
    with np.errstate(all="ignore"):
        x_ref, P_ref = reference.x[:k][good], reference.P[:k][good]
        errors[0, good] = moment_errors(x[:k][good], P[:k][good], x_ref, P_ref)[0]
        ratio = np.diagonal(P[:k][good], axis1=1, axis2=2) / np.diagonal(P_ref, axis1=1, axis2=2)
        errors[1, good] = np.abs(ratio - 1.0).max(axis=1)
        errors[2] = np.abs(np.cumsum(log_evidence[:k] - reference.log_evidence[:k]))
    return errors


def _trusted(name, x, P, log_evidence, own):
    """A `Referee`, trusted up to the first epoch at which its own error is too large."""
    good = (own <= _ALLOWED).all(axis=0) & _definite(P)
    n = len(good) if good.all() else int(np.argmin(good))
    why = "" if n == len(good) else f"then errors {', '.join(f'{e:.2g}' for e in own[:, n])}"
    return Referee(name, x, P, log_evidence, own, n, why)


def _definite(P):
    """Whether errors can be measured in units of each covariance (T, n, n)."""
    with np.errstate(all="ignore"):
        good = [
            np.isfinite(p).all() and (np.diag(p) > 0).all() and least_eigenvalue(p[None]) > 1e-13 for p in P
        ]
    return np.array(good, dtype=bool)


@contextmanager
def _at_most(seconds):
    """Stop Python code after a while, where the system and the thread allow it."""
    if not hasattr(signal, "SIGALRM") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number, frame):
        raise SphfilterError(f"stopped after {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _rows(filt, problem):
    """Means, covariances and evidences of a filter that overlooks no change with the clock."""
    with np.errstate(all="ignore"):
        rows = list(follow(filt, problem, careful=True))
    return tuple(np.array(column) for column in list(zip(*rows, strict=True))[:3])


def _exact(problem, seed):
    linear = problem.model.linear and all(reader.H is not None for reader in problem.readers)
    if not (linear or problem.exact):
        return None
    filt = problem.exact(problem) if problem.exact else KalmanFilter(*problem.start)
    name = "closed form" if problem.exact else "Kalman filter"
    return _trusted(name, *_rows(filt, problem), np.zeros((3, len(problem.times))))


class _Grid(GridFilter):
    """A grid that refuses a posterior of which it may have cut a part."""

    def update(self, z, measurement=None):
        info = super().update(z, measurement)
        if consistency.distance(self.x, self.x_prior, self.P_prior) > _GRID_REACH:
            raise SphfilterError("a posterior lies in the tail of its prior, which the grid cuts")
        return info


def _grids(problem, seed):
    if problem.model.dim > 2 or problem.model.state_dependent_noise:
        return None
    size = _NODES[problem.model.dim]
    with _at_most(_GRID_SECONDS):
        coarse, fine = (
            _rows(_Grid(*problem.start, size=m, tol=e), problem)
            for m, e in ((size, 1e-3), (2 * size, 1.25e-4))
        )
    found = _trusted("grid", *fine, errors_of(*coarse, Referee("", *fine)))
    # two grids may both overlook a peak of a likelihood, which clouds do not without knowing
    check = _clouds(problem, seed, _CHECK)
    apart = errors_of(check.x, check.P, check.log_evidence, found)
    if not (apart <= _ALLOWED + _SIGMAS * check.own)[:, : found.n_trusted].all():
        raise SphfilterError("they differ from clouds of particles")
    return found


def _few_or_many(sizes, problem, seed):
    few = _clouds(problem, seed, sizes[0])
    if few.n_trusted == len(problem.times) or (few.own[:, :1] > _HOPELESS * _ALLOWED).any():
        return few
    with suppress(SphfilterError), _at_most(_SECONDS):
        return max(few, _clouds(problem, seed, sizes[1]), key=lambda r: r.n_trusted)
    return few


def _clouds(problem, seed, size):
    """Mean of independent clouds of fine steps, with its sampling error and what its steps are off by.

    Each error is the larger of an epoch's own and half of the record's.
    """
    usual = [_cloud(problem, size, None, [seed, size, 1, k]) for k in range(_USUAL)]
    fine = [_cloud(problem, size, _FINE / np.sqrt(size), [seed, size, 0, k]) for k in range(_CLOUDS)]
    middle = _middle(fine)
    apart = np.array([errors_of(*run, Referee("", *middle)) for run in fine])
    sampling = np.square(apart).sum(axis=0) / (_CLOUDS - 1) / _CLOUDS
    bias = _STILL_OFF * errors_of(*_middle(usual), Referee("", *middle))
    own = np.sqrt(sampling + bias**2)
    of_record = np.sqrt(np.mean(np.square(own), axis=1, keepdims=True))
    return _trusted(f"{_CLOUDS} clouds of {size:,}", *middle, np.maximum(own, 0.5 * of_record))


def _cloud(problem, size, tolerance, seed):
    """Rows of a particle filter whose steps may be off by the tolerance (None: its default)."""
    how = {"n_particles": size, "rng": np.random.default_rng(seed), "resampling": "ess"}
    return _rows(ParticleFilter(*problem.start, **how, tolerance=tolerance), problem)


def _middle(runs):
    """Means, covariances and evidences in the middle of several runs."""
    return tuple(np.mean(values, axis=0) for values in zip(*runs, strict=True))
