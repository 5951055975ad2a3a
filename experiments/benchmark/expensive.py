"""Who wins where the drift is expensive: run time as a function of the cost of one evaluation.

A competitor's run takes its time on a cheap drift plus its evaluations times their cost. Both are measured on
one scenario; real runs with a drift that burns that time check the sum wherever they are short enough.
"""

import math
from dataclasses import astuple, dataclass, replace
from time import perf_counter

import numpy as np
from numba import njit

import sphfilter as sf
from experiments.show import tables
from experiments.show.files import write_csv
from sphfilter.campaign.one_run import put_through

from .counting import OtherModel
from .measure import warm_up
from .methods import short, size_text
from .watch import Watched

__all__ = ["BASE", "COSTS", "Check", "burning_model", "checks", "fastest", "seconds_at", "table", "write"]

#: The scenario whose rows are used; seconds an evaluation; errors of the mean that are asked for.
BASE = "van_der_pol"
COSTS = (1e-6, 1e-5, 1e-4, 1e-3)
_LEVELS = (0.1, 0.03, 0.01, 0.003)


@dataclass(frozen=True)
class Check:
    """A real run: evaluations cost `cost` seconds each; the run took `measured` instead of `predicted`."""

    series: str
    size: int
    cost: float
    predicted: float
    measured: float


def burning_model(model):
    """The same equation with a compiled drift that spins, and without derivatives.

    Returns
    -------
    model : SDE
        Its parameter `loops` says how often the drift spins for one state.
    a_loop : float
        Seconds a loop, measured.
    """
    burning = _burning(model.drift_batch, model.dim, len(model.p))
    noise = model.noise(np.zeros((1, model.dim)), 0.0)[0]
    values = dict(enumerate(model.p.tolist()))
    parameters = {f"p{k}": value for k, value in values.items()} | {"loops": 0.0}
    made = sf.SDE(burning, model.dim, noise, model.spectral_density, parameters=parameters)
    X = np.zeros((200, model.dim))

    def cost(loops):
        trial = made.with_parameters(loops=loops)
        trial.drift(X, 0.0)
        start = perf_counter()
        trial.drift(X, 0.0)
        return (perf_counter() - start) / len(X)

    a_loop = (min(cost(2000.0) for _ in range(5)) - cost(0.0)) / 2000
    return made, a_loop


def _burning(fill, n, n_parameters):
    """A compiled drift of one state, autonomous, that spins p[-1] times before it does its work."""

    @njit(error_model="numpy")
    def drift(x, t, p):  # of time it must not read a thing, or the model does not count as autonomous
        spun = 1.0
        for _ in range(int(p[n_parameters])):
            spun = math.sin(spun) + 1.0
        out = np.empty((1, n))
        fill(x.reshape((1, n)), 0.0, p, out)
        out[0, 0] += 0.0 * spun  # or the compiler would leave the loop out
        return out[0]

    return drift


def checks(scenario, case, competitors, lines, limit):
    """Real runs of all competitors at all costs that are predicted to take at most `limit` seconds.

    Returns
    -------
    list of Check
    """
    made = []
    by_key = {(i.family, i.size, i.threads): i for i in lines}
    model, a_loop = burning_model(scenario.model)
    for cost in COSTS:
        burnt = _other(scenario, model.with_parameters(loops=round(cost / a_loop)))
        for method in competitors:
            line = by_key.get((method.family, method.size, method.threads))
            predicted = np.nan if line is None else seconds_at(line, cost)
            if method.threads > 1 or not predicted <= limit:
                continue
            warm_up(replace(method, factory=replace(method.factory, scenario=_other(scenario, model))), case)
            start = perf_counter()
            filt = replace(method.factory, scenario=burnt)(case, np.random.default_rng(0))
            put_through(Watched(filt, limit=4 * limit), case)
            made.append(Check(method.series, method.size, cost, predicted, perf_counter() - start))
    return made


def _other(scenario, model):
    return OtherModel(scenario.name, scenario.settings, scenario.between, model)


def seconds_at(line, cost):
    """Run time of a competitor when one evaluation of the drift takes `cost` seconds."""
    return line.seconds + cost * line.drift / line.threads


def winners(lines):
    """The fastest competitor at each cost and error.

    A particle filter that is not good enough is taken with as many particles as its law asks for: the error
    falls with the root of their number.

    Returns
    -------
    dict of float to dict of float to (Line, float, float) or None
        {cost: {error: (line, seconds, factor on its particles)}}.
    """
    usable = [i for i in lines if not i.failed and np.isfinite(i.drift) and i.threads == 1]
    return {cost: {error: fastest(usable, cost, error) for error in _LEVELS} for cost in (0.0, *COSTS)}


def fastest(lines, cost, error):
    """The fastest of some lines, as an entry of `winners`."""
    found = []
    for line in lines:
        more = max(1.0, (line.mean / error) ** 2)
        if more == 1.0 or line.family in ("pf", "pf4"):
            found.append((line, more * seconds_at(line, cost), more))
    return min(found, key=lambda entry: entry[1], default=None)


def table(lines, title):
    """Who wins, as a rich table."""
    headings = ["Cost of a drift", *(f"error ≤ {error:g}" for error in _LEVELS)]
    rows = [(_cost_text(cost), *map(_who, best.values())) for cost, best in winners(lines).items()]
    return tables.table(title, headings, rows, left=len(headings))


def _who(found):
    if found is None:
        return "nobody"
    line, seconds, more = found
    size = size_text(line.family, line.size if more == 1 else int(float(f"{line.size * more:.2g}")))
    return f"{short(line.family)}{', ' if size else ''}{size}: {seconds:.2g} s"


def _cost_text(cost):
    """A cost for people."""
    return "as compiled" if cost == 0 else f"{cost * 1e6:g} µs" if cost < 1e-3 else f"{cost * 1e3:g} ms"


def write(folder, lines, checked):
    """Write who wins, and the real runs, as files."""
    best = [(cost, error, found) for cost, of in winners(lines).items() for error, found in of.items()]
    rows = [
        (cost, error, *((found[0].series, found[0].size, found[1]) if found else ("", "", "")))
        for cost, error, found in best
    ]
    write_csv(folder / "expensive.csv", ["cost", "error", "filter", "size", "seconds"], rows)
    heading = ["filter", "size", "cost", "predicted", "measured"]
    write_csv(folder / "expensive_checks.csv", heading, (astuple(check) for check in checked))
