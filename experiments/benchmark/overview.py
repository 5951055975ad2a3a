"""One row a scene: what was asked of the default filter and what it left, beside its rivals."""

from itertools import pairwise

import numpy as np

from experiments.show import tables

from .methods import size_text
from .told import ratios

_RIVAL, _OWN = "pf4", "auto"
_TOLD_AT = 100  # one over the target error for which told is held against left


def seconds_at(lines, error):
    """Run time at which a filter of some sizes makes an error: by powers between them, by its square beyond.

    Lines are those of one particle filter, smallest first; NaN without any.
    """
    known = [i for i in lines if not i.failed and np.isfinite(i.mean)]
    if not known:
        return np.nan
    for i, j in pairwise(known):
        if i.mean >= error > j.mean:
            return i.seconds * (j.seconds / i.seconds) ** (np.log(error / i.mean) / np.log(j.mean / i.mean))
    end = known[0] if error > known[0].mean else known[-1]
    return end.seconds * (end.mean / error) ** 2


def markdown(outcomes):
    """The table, and below it how often a rival is ahead; empty where one of the two was not run."""
    sizes = sorted({i.size for o in outcomes for i in o.lines if i.family == _OWN})
    if not sizes or not any(i.family == _RIVAL for o in outcomes for i in o.lines):
        return ""
    rivals = sorted({i.size for o in outcomes for i in o.lines if i.family == _RIVAL})[1:]
    asked = [size_text(_OWN, size).removeprefix("target error ") for size in sizes]
    heading = ["scene", *(f"asked {text}" for text in asked), *(f"PF, {size:,}" for size in rivals), "UKF"]
    rows, compared = [], []
    for outcome in outcomes:
        own, rival = ([i for i in outcome.lines if i.family == f] for f in (_OWN, _RIVAL))
        others = [i for i in outcome.lines if i.family == "ukf"]
        by_size = {i.size: i for i in own}
        ratio = [_ratio(by_size.get(size), rival) for size in sizes]
        compared.append(ratio)
        cells = [_cell(by_size.get(size)) for size in sizes]
        cells += [_cell(next((i for i in rival if i.size == size), None)) for size in rivals]
        cells.append(_cell(others[0] if others else None))
        times = ", ".join(f"{r:.2g}" for r in ratio if np.isfinite(r))
        rows.append([outcome.scenario, *cells, times, _told(by_size.get(_TOLD_AT))])
    table = tables.markdown([*heading, "PF's time for the same error, over ours", "told over left"], rows)
    said = [_sentence(text, r) for text, r in zip(asked, np.array(compared).T, strict=True)]
    return "\n".join(["## Asked, left, and beside others", "", *table, "", *said, "", ""])


def _ratio(line, rival):
    if line is None or line.failed or not np.isfinite(line.mean):
        return np.nan
    return seconds_at(rival, line.mean) / line.seconds


def _cell(line):
    """Error of the mean and seconds; † where the reference is hardly better."""
    if line is None or line.failed == line.runs:
        return ""
    return f"{line.mean:.2g}{'' if line.certified else ' †'}, {line.seconds:.2g} s"


def _told(line):
    """Error told over the one left: the median, and eight of ten."""
    if line is None or not len(line.told):
        return ""
    low, middle, high = ratios(line)
    return f"{middle:.2g} ({low:.2g}, {high:.2g})"


def _sentence(text, ratio):
    known = ratio[np.isfinite(ratio)]
    if not len(known):
        return f"- Asked {text}: nothing to compare."
    mean = np.exp(np.mean(np.log(known)))
    ahead = int(np.sum(known < 1.0))
    who = f"PF ahead on {ahead} of {len(known)} scenes"
    return f"- Asked {text}: geometric mean of the ratios {mean:.2g}; {who}."
