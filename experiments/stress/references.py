"""The reference of a cell: exact where a closed form exists, else the grid, else many particles."""

import signal
import threading
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from experiments.show.comparison import least_eigenvalue, moment_errors, rms
from reference_filters.grid import grid_convergence
from reference_filters.kalman import KalmanFilter
from reference_filters.particle import ParticleFilter
from sphfilter import consistency
from sphfilter.errors import SphfilterError

from .judge import trusted

__all__ = ["Reference", "at_most", "reference"]

#: Particles of the last resort, in each of two independent runs.
_N_PARTICLES = 150_000
#: The grid cuts densities at 1e-11 of their maximum, 7.1 standard deviations of a Gaussian: a posterior must
#: lie well inside the prior to be right. Particles must be this many in effect.
_GRID_REACH, _EFFECTIVE = 5.0, 2500.0
#: Seconds after which the grid leaves the cell to the particles: stiff drifts can take it hours.
_GRID_SECONDS = 30.0


@dataclass(frozen=True)
class Reference:
    """Posterior moments to compare with.

    Attributes
    ----------
    name : str
        What it is; empty where there is none, and `why` says why.
    x, P, log_evidence : ndarray, shapes (T, n), (T, n, n), (T,)
    mean_error, cov_error : float
        Its own error, rms, in standard deviations.
    truth : ndarray, shape (T, n), or None
    """

    name: str = ""
    x: np.ndarray | None = None
    P: np.ndarray | None = None
    log_evidence: np.ndarray | None = None
    mean_error: float = 0.0
    cov_error: float = 0.0
    why: str = ""
    truth: np.ndarray | None = None


def reference(problem, seed):
    """Return the best reference of a problem, the first below whose own error is small enough.

    A closed form or the Kalman filter; the grid with its error from half the resolution (1 or 2 states,
    noise that does not depend on the state); two runs of 150,000 particles with their spread.
    """
    reasons = []
    for make in (_exact, _grid, _particles):
        try:
            found = make(problem, seed)
        # the referees are not on trial: whatever stops one, there is none
        except Exception as problem_found:
            reasons.append(f"{make.__name__.strip('_')}: {problem_found}")
            continue
        if found is None:
            continue
        if not _definite(found.P):
            reasons.append(f"{found.name}: its covariance is not positive definite to rounding")
        elif trusted(found):
            return replace(found, truth=problem.truth)
        else:
            reasons.append(f"{found.name}: own error {found.mean_error:.2g}, {found.cov_error:.2g}")
    return Reference(why="; ".join(reasons), truth=problem.truth)


def _definite(P):
    """Tell whether errors can be measured in units of these covariances (T, n, n)."""
    positive = np.isfinite(P).all() and (np.diagonal(P, axis1=1, axis2=2) > 0).all()
    return positive and least_eigenvalue(P) > 1e-14


def _exact(problem, seed):
    if problem.exact is not None:
        return Reference(problem.exact_name, *problem.exact(problem))
    if not (problem.model.linear and problem.measurement.H is not None):
        return None
    start = (problem.x0, problem.P0, problem.t0)
    r = KalmanFilter(problem.model, problem.measurement, *start).run(problem.times, problem.z)
    return Reference("Kalman filter", r.x, r.P, r.log_evidence)


def _grid(problem, seed):
    if problem.model.dim > 2 or problem.model.state_dependent_noise:
        return None
    start = (problem.x0, problem.P0, problem.t0)
    with np.errstate(all="ignore"), at_most(_GRID_SECONDS):
        c = grid_convergence(problem.model, problem.measurement, start, problem.times, problem.z)
    r = c.result
    if consistency.distance(r.x, r.x_prior, r.P_prior).max() > _GRID_REACH:
        raise SphfilterError("a posterior lies in the tail of its prior, which the grid cuts")
    return Reference("grid", r.x, r.P, r.log_evidence, rms(c.mean_change), rms(c.cov_change))


@contextmanager
def at_most(seconds):
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


def _particles(problem, seed):
    """Two runs, with steps of different kind and order: their mean, and half their distance as its error."""
    runs = []
    start = problem.x0, problem.P0, problem.t0
    for order in (2, 4):
        how = {"rng": np.random.default_rng([seed, order]), "resampling": "ess", "order": order}
        f = ParticleFilter(problem.model, problem.measurement, *start, n_particles=_N_PARTICLES, **how)
        runs.append(_watched(f, problem))
    (x1, P1, e1), (x2, P2, e2) = runs
    x, P = 0.5 * (x1 + x2), 0.5 * (P1 + P2)
    errors = map(rms, moment_errors(x1, P1, x, P))
    return Reference(f"{_N_PARTICLES:,} particles, twice", x, P, 0.5 * (e1 + e2), *errors)


def _watched(f, problem):
    """Run a particle filter as long as enough particles count."""
    rows = []
    for t, z in zip(problem.times, problem.z, strict=True):
        if t > f.t:
            f.predict(t=t)
        f.update(z)
        if f.effective_size < _EFFECTIVE:
            raise SphfilterError(f"only {f.effective_size:.0f} particles count at t = {t:g}")
        rows.append((f.x.copy(), f.P.copy(), f.log_likelihood))
    return [np.array(column) for column in zip(*rows, strict=True)]
