"""Converged posteriors where no grid reaches: the average of independent large particle filters.

Three errors remain. The sampling error is measured, by the spread of the runs. The bias of the time steps is
held below it: their tolerance is .1 / sqrt(particles of a run), a third of the least sampling error of ten
runs together. The bias of a particle filter itself is of the order of the variance of one run, in
posterior variances: smaller than the sampling error by about sqrt(runs) times the error of one run.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sphfilter import validate
from sphfilter.campaign.one_run import put_through

from ._store import digest, save
from .particle import ParticleFilter

#: To be raised when a change of the filter changes what it would find.
_VERSION = 1
#: States at which model and sensor are probed for the name of the cache, and their spread around the start.
_PROBES, _SPREADS = 16, (0.5, 2.0, 8.0)
#: Bias of the time steps over an interval, times sqrt(n_particles).
_BIAS = 0.1
_RECORDED = ("x", "P", "log_evidence")


@dataclass(frozen=True)
class Reference:
    """Average of independent particle filters at T times, and its standard errors.

    Attributes
    ----------
    t : ndarray, shape (T,)
        Seconds.
    x, P : ndarray, shapes (T, n), (T, n, n)
        Posterior mean and covariance.
    log_evidence : ndarray, shape (T,)
        Log-density of each measurement given the earlier ones.
    x_error, P_error, evidence_error : ndarray
        Standard error of each of these numbers: standard deviation of the runs over sqrt(n_runs).
    total_error : float
        Standard error of the sum of `log_evidence`.
    n_paths : int
        Particles of all runs together.
    """

    t: np.ndarray
    x: np.ndarray
    P: np.ndarray
    log_evidence: np.ndarray
    x_error: np.ndarray
    P_error: np.ndarray
    evidence_error: np.ndarray
    total_error: float
    n_paths: int


def converged(model, measurement, case, n_particles=1_000_000, n_runs=10, rng=0, cache=None, n_threads=2):
    """Average `n_runs` independent particle filters of `n_particles` on the measurements of a case.

    The runs weigh the same: their evidences differ by much less than a factor where a run has converged, and
    weights would only add noise.

    Parameters
    ----------
    model, measurement
        As for `ParticleFilter`.
    case : object with times (T,), z (T, k), x0 (n,), P0 (n, n), t0, and inputs (T, m) if there are any
        Such as `sphfilter.campaign.Case`.
    n_particles, n_runs : int
        At least two runs.
    rng : int or Generator
        Seed; run number i is the same whatever `n_runs` and `n_threads`.
    cache : path, optional
        Folder that keeps every finished run: an interrupted call goes on where it was, and more runs later
        add to those there. The file is named by what model and sensor compute at fixed states, the case and
        the settings.
    n_threads : int

    Returns
    -------
    Reference
    """
    n_particles = validate.count("n_particles", n_particles, 2)
    n_runs = validate.count("n_runs", n_runs, 2)
    seed = int(validate.generator(rng).integers(2**62))
    path = None
    if cache is not None:
        name = _digest(model, measurement, case, (n_particles, seed, _VERSION))
        path = Path(cache) / f"particles-{name}.npz"
    runs = _load(path)
    for i in range(len(runs), n_runs):
        filt = ParticleFilter(
            model, measurement, case.x0, case.P0, case.t0, n_particles=n_particles,
            rng=np.random.default_rng([seed, i]), n_threads=n_threads, tolerance=_BIAS / np.sqrt(n_particles),
        )  # fmt: skip
        result = put_through(filt, case)
        runs.append(tuple(getattr(result, name) for name in _RECORDED))
        _save(path, runs)
    return _average(np.asarray(case.times, dtype=float), runs[:n_runs], n_particles)


def _average(t, runs, n_particles):
    """Mean of the runs and its standard error."""
    root, averages, errors = np.sqrt(len(runs)), [], []
    for values in zip(*runs, strict=True):
        averages.append(np.mean(values, axis=0))
        errors.append(np.std(values, axis=0, ddof=1) / root)
    totals = [log_evidence.sum() for _, _, log_evidence in runs]
    total_error = float(np.std(totals, ddof=1) / root)
    return Reference(t, *averages, *errors, total_error, n_particles * len(runs))


def _digest(model, measurement, case, settings):
    """Name of a problem: what it computes at fixed states, so that any way to write a model will do."""
    draws = np.random.default_rng(0).standard_normal((_PROBES, model.dim)) @ np.linalg.cholesky(case.P0).T
    X = np.concatenate([case.x0 + spread * draws for spread in _SPREADS])
    times = np.asarray(case.times, dtype=float)
    parts = [repr(settings).encode(), times, case.z, case.x0, case.P0, case.t0, model.spectral_density]
    for t in (float(case.t0), 0.5 * (case.t0 + times[-1]) + 0.1234):
        parts += [model.drift(X, t), model.noise(X, t)]
        parts += [measurement.log_likelihood(z, X, t) for z in case.z]
    inputs = getattr(case, "inputs", None)
    if inputs is not None:
        parts += [inputs, *(model.with_inputs(u).drift(X, t) for u in inputs)]
    return digest(parts)


def _load(path):
    """Finished runs: tuples in the order of `_RECORDED`."""
    if path is None or not path.exists():
        return []
    with np.load(path) as data:
        return list(zip(*(data[name] for name in _RECORDED), strict=True))


def _save(path, runs):
    """Write all runs to one file."""
    save(path, **dict(zip(_RECORDED, map(np.array, zip(*runs, strict=True)), strict=True)))
