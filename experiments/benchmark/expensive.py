"""Who wins where the drift is expensive: run time as a function of the cost of one evaluation.

A competitor's run takes its time on a cheap drift plus its evaluations times their cost. Both are measured on
one scenario.
"""

import numpy as np

from experiments.show import tables
from sphfilter.files.write import write_csv

from .methods import short, size_text

#: The scenario whose rows are used; seconds an evaluation; errors of the mean that are asked for.
BASE = "van_der_pol"
COSTS = (1e-6, 1e-5, 1e-4, 1e-3)
_LEVELS = (0.1, 0.03, 0.01, 0.003)


def seconds_at(line, cost):
    """Run time of a competitor when one evaluation of the drift takes `cost` seconds."""
    return line.seconds + cost * line.drift / line.threads


def winners(lines):
    """The fastest competitor by cost and error: its line, its seconds, and a factor on its particles.

    A particle filter that is not good enough is taken with as many particles as its law asks for: the error
    falls with the root of their number. None where nobody is good enough.
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


def write(folder, lines):
    """Write who wins as a file."""
    best = [(cost, error, found) for cost, of in winners(lines).items() for error, found in of.items()]
    rows = [
        (cost, error, *((found[0].series, found[0].size, found[1]) if found else ("", "", "")))
        for cost, error, found in best
    ]
    write_csv(folder / "expensive.csv", ["cost", "error", "filter", "size", "seconds"], rows)
