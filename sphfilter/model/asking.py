"""What numpy functions of a user's cost: compiled code asks them through the interpreter, call by call."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

from ..core._compiling import PATIENCE

_LOGGER = logging.getLogger("sphfilter")
_MUCH = 0.5  # share of one function, from which it costs more than all the rest: _MUCH = 1 - _MUCH
_SAYS = (
    "%.0f %% of a prediction of %.2g s went into %d calls of the vectorized function %s, of %.2g states on "
    "average; as text (SDE.from_expressions), or for numba as a function of one state, it is compiled"
)


class _Cost:
    """Calls of one function so far."""

    def __init__(self, name: str) -> None:
        self.name, self.calls, self.rows, self.seconds, self.said = name, 0, 0, 0.0, False


_COSTS: dict[int, _Cost] = {}


@contextmanager
def noted(index: int, name: str, rows: int) -> Iterator[None]:
    """Note what a call of the function of a number costs."""
    cost, began = _COSTS.setdefault(index, _Cost(name)), perf_counter()
    try:
        yield
    finally:
        cost.calls, cost.rows = cost.calls + 1, cost.rows + rows
        cost.seconds += perf_counter() - began


def asked_before() -> dict[int, tuple[int, int, float]]:
    """Costs of functions before a prediction: their calls, rows and seconds by number."""
    return {index: (cost.calls, cost.rows, cost.seconds) for index, cost in _COSTS.items()}


def tell_of(before: dict[int, tuple[int, int, float]], took: float) -> None:
    """Say it, once a function, if one took most of the time of a prediction that took long, in seconds."""
    for index, cost in list(_COSTS.items()) if took > PATIENCE else ():
        calls, rows, seconds = before.get(index, (0, 0, 0.0))
        calls, share = cost.calls - calls, (cost.seconds - seconds) / took
        if share > _MUCH and not cost.said:
            cost.said = True
            _LOGGER.warning(_SAYS, 100.0 * share, took, calls, cost.name, (cost.rows - rows) / calls)
