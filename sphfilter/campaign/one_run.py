"""One run of a campaign: a case is drawn, and every filter is put through it."""

import hashlib
import inspect
import signal
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, fields
from multiprocessing import parent_process
from threading import current_thread, main_thread
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._types import Floats, in_a_line
from ..consistency.ranks import Ranker, clock, gaussian_ranks
from ..errors import ModelError
from ..filter.results import TRUTHS, AnyFilter, shapes

#: What every filter has to tell.
_MOMENTS = "x_prior", "P_prior", "x", "P", "log_evidence", "accepted"


@dataclass(frozen=True)
class Case:
    """One simulated run, as a scenario draws it.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Measurement times, seconds.
    truth : ndarray, shape (T, n)
    z : ndarray, shape (T, k)
        Measurements; NaN where none came.
    x0, P0 : ndarray, shapes (n,), (n, n)
        Start of the filters.
    t0 : float
        Time of the start, seconds.
    inputs : ndarray, shape (T, m), or None
        What the inputs of the model are over the interval that ends at each time, in the model's order; None
        for the values that the model has.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> case = sf.Case(times=[1.0], truth=[[0.2]], z=[[0.3]], x0=np.zeros(1), P0=np.eye(1))
    >>> print(case.t0)
    0.0
    """

    times: Floats
    truth: Floats
    z: Floats
    x0: Floats
    P0: Floats
    t0: float = 0.0
    inputs: Floats | None = None

    __repr__ = in_a_line

    def __init__(
        self,
        times: ArrayLike,
        truth: ArrayLike,
        z: ArrayLike,
        x0: ArrayLike,
        P0: ArrayLike,
        t0: float = 0.0,
        inputs: ArrayLike | None = None,
    ) -> None:
        arrays = {"times": times, "truth": truth, "z": z, "x0": x0, "P0": P0}
        for name, value in arrays.items():
            object.__setattr__(self, name, np.asarray(value, dtype=float))
        object.__setattr__(self, "t0", t0)
        object.__setattr__(self, "inputs", None if inputs is None else _columns(inputs, len(self.times)))
        n = np.shape(self.x0)[0]
        if not len(self.times) == len(self.truth) == len(self.z):
            raise ModelError(
                f"a case needs as many truths and measurements as times; got {len(self.times)} times, "
                f"{len(self.truth)} truths and {len(self.z)} measurements"
            )
        if np.shape(self.truth)[1:] != (n,) or np.shape(self.P0) != (n, n):
            raise ModelError(
                f"a case with x0 of length {n} needs truth (T, {n}) and P0 ({n}, {n}); "
                f"got {np.shape(self.truth)} and {np.shape(self.P0)}"
            )


def _columns(inputs: ArrayLike, count: int) -> Floats:
    """Inputs of a case as an array of a row for each time."""
    found = np.asarray(inputs, dtype=float)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or len(found) != count or not np.isfinite(found).all():
        raise ModelError(
            f"inputs of a case must be finite and of shape ({count}, m), a row for each time and a column "
            f"for each input; got shape {np.shape(inputs)}"
        )
    return found


class Scenario(Protocol):
    """A source of cases for a campaign."""

    @property
    def name(self) -> str:
        """The name in tables and files."""

    def draw(self, rng: np.random.Generator, /) -> Case:
        """One simulated run."""


def arrays_of(case: Case) -> dict[str, Floats]:
    """Parts of a case by name; inputs only if there are any."""
    found = {f.name: getattr(case, f.name) for f in fields(case)}
    return {name: np.asarray(value, dtype=float) for name, value in found.items() if value is not None}


def put_through(filt: Any, case: Case, first: int | None = None, **options: Any) -> Any:
    """Let a filter run through a case, or its `first` epochs; returns what its `run` does.

    Of a case without inputs it is not told about any, so that filters which know of none take it.
    """
    inputs = getattr(case, "inputs", None)
    given = options if inputs is None else {"inputs": inputs[:first], **options}
    return filt.run(case.times[:first], case.z[:first], **given)


#: factory(case, rng) makes a filter at the start of a case.
Factory: TypeAlias = Callable[[Case, np.random.Generator], AnyFilter]


def draw(scenario: Scenario, seed: np.random.SeedSequence) -> Case:
    """Draw the case of a run with this seed."""
    truth_seed = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 0))
    return scenario.draw(np.random.default_rng(truth_seed))


def _filter_rng(seed: np.random.SeedSequence, name: str) -> np.random.Generator:
    """Return the generator of one filter in one run: by its name, so that no other filter matters to it."""
    words = np.frombuffer(hashlib.sha256(name.encode()).digest(), dtype="<u4")
    key = (*seed.spawn_key, *map(int, words))
    return np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))


def run(
    r: int, scenario: Scenario, filters: Mapping[str, Factory], seed: np.random.SeedSequence, ranks: bool
) -> tuple[int, dict[str, Any]]:
    """Draw run r and put all filters through it."""
    if parent_process() is not None and current_thread() is main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends its workers
    try:
        case = draw(scenario, seed)
    except Exception as problem:  # a truth that blows up costs its run and no other
        return r, {"failures": [(r, "simulation", f"{type(problem).__name__}: {problem}")]}
    outcomes = {name: _outcome(make, case, _filter_rng(seed, name), ranks) for name, make in filters.items()}
    return r, {
        "case": arrays_of(case),
        "results": {name: arrays for name, (arrays, _, _) in outcomes.items()},
        "run_time": {name: seconds for name, (_, seconds, _) in outcomes.items()},
        "failures": [(r, name, message) for name, (_, _, message) in outcomes.items() if message],
    }


def _can_be_observed(filt: Any) -> bool:
    """Whether a filter has the densities of `spread`, and a run that takes who looks at them."""
    return callable(getattr(filt, "spread", None)) and "observer" in inspect.signature(filt.run).parameters


def _outcome(
    make: Factory, case: Case, rng: np.random.Generator, ranks: bool
) -> tuple[dict[str, NDArray[Any]], float, str]:
    """Return the arrays of a filter's run, its seconds, and what it raised (empty if nothing)."""
    blank = _blank(case)
    case = deepcopy(case)  # what one filter does to its case must not reach the next
    try:
        filt = make(case, rng)
        observer = Ranker(case.truth) if ranks and _can_be_observed(filt) else None
        options: dict[str, Any] = {"observer": observer} if observer else {}
        start = clock()
        result = put_through(filt, case, **options)
        seconds = clock() - start - (observer.seconds if observer else 0.0)
        arrays = {name: np.asarray(getattr(result, name), blank[name].dtype) for name in _MOMENTS}
        for name in _MOMENTS:
            if (shape := arrays[name].shape) != blank[name].shape:
                raise ModelError(f"the filter's result has {name} of shape {shape}, not {blank[name].shape}")
        # what a filter of one's own need not tell
        for name in [name for name in blank if name not in arrays]:
            value = np.asarray(getattr(result, name, blank[name]), blank[name].dtype)
            arrays[name] = value.reshape(blank[name].shape) if value.size == blank[name].size else blank[name]
        if ranks and observer is None:
            moments = [arrays[name] for name in ("x", "P", "innovation", "innovation_cov")]
            arrays |= gaussian_ranks(case.truth, *moments)
    except (MemoryError, ImportError):
        raise  # the machine's fault, which another call may do without
    except Exception as error:  # a filter under test may raise anything, and that is a finding
        return blank, np.nan, f"{type(error).__name__}: {error}"
    return arrays, seconds, ""


def _blank(case: Case) -> dict[str, NDArray[Any]]:
    """An empty result of this case: nothing is known yet."""
    T, n = np.shape(case.truth)
    empty = {name: np.full((T, *shape), np.nan) for name, shape in shapes(n, np.size(case.z[0])).items()}
    return empty | {name: np.zeros(T, bool) for name in TRUTHS}
