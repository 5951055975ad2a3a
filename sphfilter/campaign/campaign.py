"""Monte-Carlo campaigns: many simulated runs of a scenario, every filter on the same measurements.

The numbers depend on the seed alone. Run r has a seed of its own, from which the truth's is spawned and each
filter's is derived by the filter's name: more runs, other filters, another number of workers or an
interruption change nothing in the runs and filters that stay.
"""

import numbers
import signal
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any, NamedTuple

import numpy as np

from .. import validate
from .._types import Floats
from ..errors import CampaignError, ModelError
from ..filter.results import FilterResult
from . import one_run, store
from .one_run import Case, Factory, Scenario

__all__ = ["CampaignResult", "Case", "Failure", "draw_case", "run_campaign"]


class Failure(NamedTuple):
    """A filter that raised in a run, or the "simulation" that did before any filter was asked."""

    run: int
    filter: str
    message: str


@dataclass(frozen=True)
class CampaignResult:
    """Results of all filters in all runs.

    Attributes
    ----------
    scenario : str
    seed : int
    times : ndarray, shape (T,)
    truth : ndarray, shape (R, T, n)
    z : ndarray, shape (R, T, k)
    x0, P0 : ndarray, shapes (R, n), (R, n, n)
        Means and covariances that the filters start from, at the time t0.
    t0 : float
    results : dict of str to FilterResult
        Its ``t`` is (T,), its other arrays have the runs as first axis: (R, T, ...). A run in which the
        filter failed is NaN (and not accepted).
    run_time : dict of str to ndarray, shape (R,)
        Wall-clock seconds spent in the filter's ``run``, less compiling; NaN where it failed.
    failures : list of Failure
    inputs : ndarray, shape (R, T, m), or None
        What the inputs of the model were over the interval that ends at each time, if the cases have any.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> case = sf.Case([1.0], [[0.2]], [[0.3]], np.zeros(1), np.eye(1))
    >>> class Once:
    ...     name = "once"
    ...     draw = staticmethod(lambda rng: case)
    >>> def sph(case, rng):
    ...     model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    ...     return sf.SPHFilter(model, sensor, case.x0, case.P0, n_particles=60)
    >>> campaign = sf.run_campaign(Once(), {"sph": sph}, n_runs=2, seed=1)
    >>> print(campaign.results["sph"].x.ravel().round(3), campaign.z.ravel(), campaign.failures)
    [0.255 0.255] [0.3 0.3] []
    """

    scenario: str
    seed: int
    times: Floats
    truth: Floats
    z: Floats
    x0: Floats
    P0: Floats
    t0: float
    results: dict[str, FilterResult]
    run_time: dict[str, Floats]
    failures: list[Failure]
    inputs: Floats | None = None

    def __repr__(self) -> str:
        n_runs, n_epochs, n = np.shape(self.truth)
        ran = f"{n_runs} runs of {n_epochs} epochs of {n} states, seed {self.seed}: {', '.join(self.results)}"
        return f"CampaignResult({self.scenario!r}, {ran}; {len(self.failures)} failures)"

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything to one ``.npz`` file."""
        store.save_result(self, path)

    @classmethod
    def open(cls, folder: str | PathLike[str]) -> "CampaignResult":
        """Read what is finished in a folder of `run_campaign`, wherever and by whatever it was filled.

        Raises `ConfigError` where there is no such folder, and `CampaignError` where no run is finished.
        """
        told, paths = store.opened(folder)
        names = list(told["filters"])
        return _gather(
            told["scenario"]["name"], told["seed"], lambda k: store.load(paths[k]), len(paths), names
        )

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "CampaignResult":
        """Read what `save` wrote."""
        values = store.load(path)
        values["results"] = {name: FilterResult(**r) for name, r in values["results"].items()}
        values["failures"] = [Failure(*f) for f in values["failures"]]
        return cls(**values)


def run_campaign(
    scenario: Scenario,
    filters: Mapping[str, Factory],
    n_runs: int,
    seed: int,
    n_jobs: int | None = 1,
    folder: str | PathLike[str] | None = None,
    progress: Callable[[int, int], object] | None = None,
    ranks: bool = True,
) -> CampaignResult:
    """Run every filter on `n_runs` cases of a scenario.

    Parameters
    ----------
    scenario : object with ``name`` and ``draw(rng) -> Case``
        The times of its cases are always the same.
    filters : mapping of str to callable
        ``factory(case, rng)`` returns a filter with ``run(times, z) -> FilterResult``; of cases with inputs,
        ``run(times, z, inputs=)``. Whatever it raises is recorded, and the campaign goes on.
    n_runs : int
    seed : int
    n_jobs : int or None
        Worker processes of joblib; scenario and factories must be picklable if more than one. None takes
        the surrounding ``joblib.parallel_config``, with which other backends (dask) come in.
    folder : path, optional
        Each finished run is written there at once, and not kept in memory. Called again with the same folder,
        finished runs are read instead of redone, also if `n_runs` has changed.
    progress : callable, optional
        Called with (runs done, runs in all), first with the number found in `folder`.
    ranks : bool
        Rank measurements and truths in the densities of filters that have one. Ranking takes longer than
        some filters do.

    Returns
    -------
    CampaignResult

    Raises
    ------
    ModelError
        Nothing to run, or cases that differ in shape or times.
    ConfigError
        The folder holds another campaign: other scenario, seed, filters or versions.
    CampaignError
        A worker process died, or a run could not be written.

    Notes
    -----
    A folder knows scenario and filters by their text, functions by their code and the values of all that it
    refers to, however deep; other packages by their versions. `CampaignResult.open` reads one anywhere.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> class Decay:
    ...     name = "decay"
    ...     def draw(self, rng):
    ...         times, x0, P0 = np.arange(1.0, 6.0), np.zeros(1), np.eye(1)
    ...         truth, z = sf.simulate(model, sensor, rng.normal(size=1), [0.0, *times], rng)
    ...         return sf.Case(times, truth[1:], z[1:], x0, P0)
    >>> sph = lambda case, rng: sf.SPHFilter(model, sensor, case.x0, case.P0, n_particles=60)
    >>> campaign = sf.run_campaign(Decay(), {"sph": sph}, n_runs=3, seed=1)
    >>> print(campaign.results["sph"].x.shape, len(campaign.failures))
    (3, 5, 1) 0
    >>> print(sf.report(campaign).filters["sph"].nees < 3.0)
    True
    """
    n_runs, filters = validate.count("n_runs", n_runs), dict(filters)
    if not filters:
        raise ModelError("run_campaign needs at least one filter, as a mapping of name to factory")
    if not isinstance(seed, numbers.Integral) or seed < 0:
        raise ModelError(f"seed must be an integer of zero or more, got {seed!r}")
    seeds = np.random.SeedSequence(int(seed)).spawn(n_runs)
    records, finished, first_case = {}, {}, None
    if folder is not None:
        folder = Path(folder)
        first = _digest(scenario, seeds[0])
        store.claim(folder, store.manifest(scenario, filters, int(seed), first))
        finished = store.finished(folder, n_runs)
    todo = [(r, scenario, filters, seeds[r], ranks) for r in range(n_runs) if r not in finished]
    coming = _in_parallel(todo, n_jobs, progress, n_runs)
    # at once, whatever is raised here: workers must not wait for a reader
    with _interrupts() as interrupted, closing(coming):
        for done, (r, record) in enumerate(coming, len(finished) + 1):
            if interrupted:
                raise KeyboardInterrupt
            first_case = _same_times(scenario.name, record, first_case, r)
            if folder is None:
                records[r] = record
            else:  # here and not where it was run, which may be another machine
                finished[r] = store.write_run(folder, r, record)
            if progress is not None:
                progress(done, n_runs)
    read = records.pop if folder is None else lambda r: store.load(finished[r])
    return _gather(scenario.name, int(seed), read, n_runs, list(filters))


def _in_parallel(
    todo: Sequence[tuple[Any, ...]],
    n_jobs: int | None,
    progress: Callable[[int, int], object] | None,
    n_runs: int,
) -> Generator[Any, None, None]:
    """Yield the runs of `todo`, whose rows are what `one_run.run` takes, as they come."""
    from joblib import Parallel, delayed  # on use: import time

    if progress is not None:
        progress(n_runs - len(todo), n_runs)
    workers = Parallel(n_jobs=n_jobs, return_as="generator_unordered", batch_size=1)
    try:
        yield from workers(delayed(one_run.run)(*row) for row in todo)
    except (KeyboardInterrupt, GeneratorExit):  # here, or where the results go
        _end_workers(n_jobs)
        raise
    except Exception as problem:
        if not isinstance(problem, BrokenExecutor | MemoryError) and type(problem).__name__ != "KilledWorker":
            raise  # the last is dask's word for it
        raise CampaignError(
            "a worker process died, for lack of memory perhaps: try fewer of them (n_jobs). Runs that were "
            "finished are kept if there is a folder, and the same call goes on from them."
        ) from problem


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Note every Ctrl-C beside raising it: Python drops what is raised where an object is being deleted."""
    seen: list[int] = []
    before = signal.getsignal(signal.SIGINT)

    def noted(number: int, frame: Any) -> None:
        seen.append(number)
        signal.default_int_handler(number, frame)

    if current_thread() is not main_thread() or before is not signal.default_int_handler:
        yield seen
        return
    signal.signal(signal.SIGINT, noted)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)


def _end_workers(n_jobs: int | None) -> None:
    """End worker processes of this machine at once: what is left of their queues may wait for ever."""
    from joblib.externals.loky import get_reusable_executor
    from joblib.parallel import get_active_backend

    if n_jobs != 1 and type(get_active_backend()[0]).__name__ == "LokyBackend":
        get_reusable_executor().shutdown(wait=False, kill_workers=True)


def draw_case(scenario: Scenario, seed: int, run: int) -> Case:
    """Draw one run of the campaign with this seed again, counted from zero."""
    return one_run.draw(scenario, np.random.SeedSequence(int(seed)).spawn(run + 1)[run])


def _digest(scenario: Scenario, seed: np.random.SeedSequence) -> str:
    """Digest of a case, or of the words with which it could not be drawn."""
    try:
        return store.case_digest(one_run.draw(scenario, seed))
    except Exception as problem:
        return f"{type(problem).__name__}: {problem}"


def _gather(
    scenario: str, seed: int, read: Callable[[int], dict[str, Any]], n_runs: int, names: Sequence[str]
) -> CampaignResult:
    """Put the records of all runs, one after the other, into arrays that have them as first axis."""
    failures: list[Failure] = []
    first: dict[str, Any] | None = None
    histories: dict[str, Any] = {}
    for r in range(n_runs):
        record = read(r)
        failures += [Failure(*failure) for failure in record.pop("failures")]
        if not record:  # nothing was simulated
            continue
        histories = histories or _room(record, n_runs)
        first = _same_times(scenario, record, first, r)
        _put(histories, r, record, scenario)
    if first is None:
        raise CampaignError(f"no run of scenario {scenario!r} could be simulated: {failures[0].message}")
    kept = ("truth", "z", "x0", "P0", "inputs")
    cases = {key: histories["case"][key] for key in kept if key in histories["case"]}
    results = {name: FilterResult(t=first["times"], **histories["results"][name]) for name in names}
    run_time = {name: histories["run_time"][name] for name in names}
    return CampaignResult(scenario=scenario, seed=seed, times=first["times"], t0=float(first["t0"]), **cases,
                          results=results, run_time=run_time, failures=failures)  # fmt: skip


def _same_times(scenario: str, record: dict[str, Any], first: Any, r: int) -> Any:
    """Raise `ModelError` if the times of a record's case are not those of the first; returns the first."""
    case = record.get("case")
    if case is None or first is None:
        return first or case
    for key in ("times", "t0"):
        if not np.array_equal(case[key], first[key]):
            raise ModelError(f"the cases of scenario {scenario!r} differ in {key} (as in run {r})")
    return first


def _room(tree: Any, n_runs: int) -> Any:
    """Arrays for many trees of dictionaries like this one, NaN and False until they are filled."""
    if isinstance(tree, dict):
        return {key: _room(child, n_runs) for key, child in tree.items()}
    tree = np.asarray(tree)
    return np.full((n_runs, *tree.shape), False if tree.dtype == bool else np.nan)


def _put(room: Any, r: int, tree: Any, scenario: str) -> None:
    """Put a tree of dictionaries into row r of what `_room` made, as far as the first run told it."""
    for key, child in tree.items():
        if key not in room:
            continue
        if isinstance(child, dict):
            _put(room[key], r, child, scenario)
            continue
        if np.shape(child) != room[key].shape[1:]:
            shapes = f"{room[key].shape[1:]} and {np.shape(child)}"
            raise ModelError(f"the cases of scenario {scenario!r} differ in shape: {shapes} (as in run {r})")
        room[key][r] = child
