"""Table and sentences about forecasts, and their numbers in a file."""

import numpy as np
from scipy.stats import binom

from experiments.scene.filters import name_of
from experiments.show.files import write_csv
from experiments.show.tables import table

from ..own_data.csv_data import LEVELS

__all__ = ["score_table", "sentences", "write_scores"]


def score_table(scores, horizons):
    """Log score, error of the median, coverage and width of the intervals, for every filter.

    Parameters
    ----------
    scores : dict of str to (dict of int to Score)
    horizons : sequence of int

    Returns
    -------
    rich.table.Table
    """
    made = table("", [""])
    for name in scores:
        made.add_column(name_of(name), justify="right", style="dim" if name == "history" else "bold")
    rows = [("Log score (nat a year)", lambda s: f"{s.log_score.mean():.3f}")]
    rows.append(("Median absolute error", lambda s: f"{np.median(np.abs(s.median - s.observed)):.1f}"))
    for k, level in enumerate(LEVELS):
        rows.append((f"Inside the {level:.0%} interval", lambda s, k=k: f"{s.coverage[k]:.0%}"))
    rows.append(("Width of the 90% interval", lambda s: f"{np.mean(np.diff(s.intervals[:, 1])):.0f}"))
    for h in horizons:
        made.add_row(f"[bold]{h} year{'s' if h > 1 else ''} ahead[/]")
        for label, text in rows:
            made.add_row(f"  {label}", *(text(of[h]) for of in scores.values()))
    return made


def sentences(scores, history, first):
    """What the table means, as a list of sentences."""
    n = len(next(iter(history.values())).year)
    said = [
        f"Forecasts of {n} yearly sunspot numbers from {first} on, each from the years up to its origin; the "
        f"model was fitted to the years before {first}. A higher log score is better. HISTORY is the law of "
        "the fitted years, whatever the phase of the cycle.",
    ]
    low, high = binom.interval(0.95, n, LEVELS[1]) / np.float64(n)
    said.append(
        f"Were the {LEVELS[1]:.0%} intervals right and the years independent, {low:.0%} to {high:.0%} of the "
        "years would lie inside in 95 of 100 such tables; forecasts of several years overlap, which makes "
        "that wider."
    )
    reference = next((name for name in ("grid", "pf") if name in scores), next(iter(scores)))
    for h in history:
        parts = [
            f"{name_of(name)} {_difference(of[h], scores[reference][h])}"
            for name, of in scores.items()
            if name != reference
        ]
        parts.append(f"HISTORY {_difference(history[h], scores[reference][h])}")
        ahead = f"{h} year{'s' if h > 1 else ''} ahead"
        said.append(
            f"Log score minus that of {reference.upper()}, {ahead} (± a standard error, years taken as "
            f"independent): {', '.join(parts)}."
        )
    return said


def _difference(score, reference):
    """Mean difference of the log scores, with the standard error of paired years."""
    d = score.log_score - reference.log_score
    return f"{d.mean():+.3f} ± {d.std(ddof=1) / np.sqrt(len(d)):.3f}"


def write_scores(path, scores):
    """Write a line for every filter, horizon and year."""
    heading = ["filter", "horizon", "year", "observed", "log_score", "pit", "median"]
    for level in LEVELS:
        heading += [f"low_{level:.0%}", f"high_{level:.0%}"]
    rows = []
    for name, of in scores.items():
        for h, s in of.items():
            columns = np.column_stack([s.year, s.observed, s.log_score, s.pit, s.median])
            numbers = np.hstack([columns, s.intervals.reshape(len(s.year), -1)])
            rows += [[name, h, *(f"{v:.6g}" for v in row)] for row in numbers]
    write_csv(path, heading, rows)
