"""Run a filter through a random problem, and keep what it said at every epoch."""

import time
import warnings
from dataclasses import dataclass, field

import numpy as np

import sphfilter as sf
from sphfilter.errors import SphfilterError

__all__ = ["ERROR_FLAG", "Record", "default_filter", "follow", "record_of"]

#: An estimated error of the mean, in posterior standard deviations, that is a flag.
ERROR_FLAG = 0.2


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
    error : ndarray, shape (k,)
        `info.error` after every epoch, NaN where the filter did not say.
    flagged : ndarray of bool, shape (k,)
        Whether the epoch had a flag of its own.
    said : str
        Statuses and reasons that were unusual.
    schemes : str
    seconds : float
    """

    end: str
    sentence: str = ""
    x: np.ndarray = field(default_factory=lambda: np.empty((0, 1)))
    P: np.ndarray = field(default_factory=lambda: np.empty((0, 1, 1)))
    log_evidence: np.ndarray = field(default_factory=lambda: np.empty(0))
    error: np.ndarray = field(default_factory=lambda: np.empty(0))
    flagged: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=bool))
    said: str = ""
    schemes: str = ""
    seconds: float = 0.0

    @property
    def flags(self):
        """Whether there was a flag at an epoch or before it, shape (k,)."""
        return np.logical_or.accumulate(self.flagged)


def default_filter(problem):
    """The filter on trial: every setting but the number of particles, where it is one, is the default."""
    start = {"x0": problem.x0, "P0": problem.P0, "t0": problem.t0}
    return sf.SPHFilter(problem.model, problem.sensors[0], **start, n_particles=problem.n_particles)


def record_of(problem, make=default_filter):
    """Run a filter over all readings; never raises what the filter raises.

    Parameters
    ----------
    problem : RandomProblem
    make : callable
        make(problem) -> filter with predict(t=), update(z, sensor), x, P and t.

    Returns
    -------
    Record
    """
    rows, words, end, sentence = [], ({}, {}), "finished", ""
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for row in follow(make(problem), problem, words):
                rows.append(row)
        except SphfilterError as refusal:
            end, sentence = "refused", str(refusal)
        except Exception as crash:  # a finding, not an accident
            end, sentence = "crash", f"{type(crash).__name__}: {crash}"
    names = "x", "P", "log_evidence", "error", "flagged"
    columns = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True)) if rows else {}
    said, schemes = ("; ".join(found) for found in words)
    seconds = time.perf_counter() - started
    return _moved_back(problem, Record(end, sentence, **columns, said=said, schemes=schemes, seconds=seconds))


def follow(filt, problem, words=None, careful=False):
    """Predict to every time, in parts, use the readings of all sensors, and yield a row of each epoch.

    Parameters
    ----------
    filt : filter
    problem : RandomProblem
    words : pair of dict, optional
        Gather what was unusual, and the schemes.
    careful : bool
        Whether to stop often enough to see every change with the clock.

    Yields
    ------
    x, P, log_evidence, error, flagged
    """
    words = words or ({}, {})
    for epoch, t in enumerate(problem.times):
        infos, log_evidence = [], 0.0
        stops = problem.equation.stops if careful else _even
        for stop in stops(filt.t, t, problem.parts):
            infos.append(filt.predict(t=float(stop)))
            words[1][infos[-1].scheme] = None
        for sensor, z in zip(problem.sensors, problem.z, strict=True):
            infos.append(filt.update(z[epoch], sensor))
            log_evidence += infos[-1].log_evidence
        error, flagged = getattr(infos[-1], "error", np.nan), False
        for info in infos:
            if getattr(info, "flagged", False):
                flagged = True
                words[0][" / ".join(filter(None, (info.status, getattr(info, "reason", ""))))] = None
        yield filt.x.copy(), filt.P.copy(), log_evidence, error, flagged or error > ERROR_FLAG


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
