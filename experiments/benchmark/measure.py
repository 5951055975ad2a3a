"""One competitor on one case: its run time, its errors, and what its steps reported."""

from collections import Counter
from dataclasses import asdict
from time import perf_counter, process_time

import numba
import numpy as np

from sphfilter.campaign.one_run import put_through
from sphfilter.consistency.ranks import clock

from .densities import hellinger
from .errors import errors, left_by_epoch, root_mean_square, truth_errors
from .watch import TooSlow, Watched, resident, watch_peak

#: Timed runs of a case: as many as fit into so many seconds, within bounds.
_REPEATS, _SECONDS = 5, 1.0
#: Tries to get ready: on an empty cache one may take its time to compile, and the next goes on from there.
_TRIES = 3


def measure(method, case, reference, seed, limit):
    """Run a competitor on a case and return a row of plain numbers and texts.

    It is held against a `Reference`, draws from `seed`, and is given up after `limit` seconds. If the filter
    raised something, the row has the key "failure" alone.
    """
    try:
        return _measured(method, case, reference, seed, limit)
    except Exception as problem:  # a filter under test may raise anything, and that is a finding
        kind = "" if isinstance(problem, TooSlow) else f"{type(problem).__name__}: "
        return {"failure": f"{kind}{problem}"}


def _measured(method, case, reference, seed, limit):
    numba.set_num_threads(method.threads)
    if method.family == "grid":  # what it prepares for its box does not count
        _timed(method, case, reference, seed, limit)
    known = watch_peak()
    before = resident()
    watched, result, wall, cpu = _timed(method, case, reference, seed, limit)
    memory = resident(peak=True) - before if known else np.nan
    seconds, cpu_seconds = ([wall], [cpu]) if wall > _SECONDS else ([], [])
    while len(seconds) < _REPEATS and sum(seconds) < _SECONDS:  # without anything that watches
        *_, wall, cpu = _timed(method, case, reference, seed, None)
        seconds.append(wall)
        cpu_seconds.append(cpu)
    return {
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "memory": memory,
        **_numbers(result, reference, case),
        **_reports(watched, method),
        "hellinger": root_mean_square(
            [hellinger(watched.densities[i], p) for i, p in reference.densities.items()]
        ),
    }


def _timed(method, case, reference, seed, limit):
    """Make the filter and run it; returns also the seconds of both, by the wall and by the processors.

    Compiling, which is work of one processor, counts in neither.

    What it reports is noted, and its densities are kept, if there is a limit of time.
    """
    start, wall, cpu = perf_counter(), clock(), process_time()
    filt = method.factory(case, np.random.default_rng(seed))
    run = filt if limit is None else Watched(filt, reference.densities, limit)
    result = put_through(run, case)
    wall = clock() - wall
    compiling = perf_counter() - start - wall
    return run, result, wall, process_time() - cpu - compiling


def _numbers(result, reference, case):
    if not (np.all(np.isfinite(result.x)) and np.all(np.isfinite(result.P))):
        raise FloatingPointError("mean or covariance is not finite")
    rmse, nees = truth_errors(result, case.truth)
    left = left_by_epoch(result, reference.result).tolist()
    return {**asdict(errors(result, reference.result)), "left": left, "rmse": rmse.tolist(), "nees": nees}


def _reports(watched, method):
    schemes = Counter(info.scheme for info in watched.predictions)
    return {
        "n_used": max((u.n_particles for u in watched.updates), default=0) or method.size,
        "evaluations": sum(p.n_evaluations for p in watched.predictions),
        "steps": sum(p.n_steps for p in watched.predictions),
        "schemes": dict(schemes),
        "troubles": [p.status for p in watched.predictions if p.status != "ok"],
        "predictions": len(watched.predictions),
        "told": [getattr(u, "error", 0.0) for u in watched.updates],
        "refused": sum(not u.accepted for u in watched.updates),
    }


def warm_up(method, case):
    """Take three measurements, so that what is compiled at first use does not count as run time.

    Once watched, step by step, and once as runs are timed, in one call of compiled code.

    What goes wrong here will go wrong again where it is recorded.
    """
    numba.set_num_threads(method.threads)
    for _ in range(_TRIES):
        try:
            put_through(Watched(method.factory(case, np.random.default_rng(0)), limit=20.0), case, first=3)
            put_through(method.factory(case, np.random.default_rng(0)), case, first=3)
        except TooSlow:
            continue
        except Exception:
            return False
        return True
    return False
