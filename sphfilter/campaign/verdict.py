"""A filter's figures in one plain sentence."""

from collections.abc import Iterable, Sequence

import numpy as np

from .._types import Bools, Floats
from ..consistency import nees_bounds, p_values
from .figures import FilterReport

_LEVEL = 0.01  # probability that right filters are faulted: measured by tests/campaign/test_verdict.py
#: Epochs outside an interval that holds 95 %, as a fraction, that are many where no referee has a number. Of
#: ten independent ones more are so by chance once in 87 times: `scipy.stats.binom.sf(2, 10, 0.05)` = .0115.
_MANY = 0.2


def verdict(numbers: FilterReport, labels: Sequence[str], referee: FilterReport | None = None) -> str:
    """Say whether a filter is consistent, and if not in what; `labels` name the n states.

    What is tested holds of every filter that is right, Gaussian or not: that ranks of measurements and truths
    are uniform, that errors have no sign and successive innovations no correlation; and that the NEES leaves
    its interval no more often than that of a `referee`, a filter that is right, if there is one: runs that it
    lost too were bad luck. All together a right filter is faulted with a probability of one per cent.
    """
    if numbers.n_failed == numbers.n_runs:
        return f"failed in all of {numbers.n_runs} runs"
    faults = _faults(numbers, labels)
    if numbers.n_failed:
        faults.append(f"failed in {numbers.n_failed} of {numbers.n_runs} runs")
    if _lost_more(numbers, referee):
        faults.append(f"lost the truth in {numbers.n_diverged} of {numbers.n_runs} runs")
    return "; ".join(faults or [_nothing_found(numbers)])


def unseen(n_runs: int, dim: int) -> str:
    """Say what so many runs of a filter of some states may have missed at an epoch."""
    _, high = nees_bounds(dim, n_runs)
    runs, factor, bias = f"{n_runs} run{'s' * (n_runs > 1)}", high / dim, 2.0 / n_runs**0.5
    return (
        f"what {runs} may have missed: variances too small by a factor of {factor:.2g} at an epoch, and a "
        f"bias of {bias:.2g} standard deviations, pass half of the time"
    )


def _lost_more(numbers: FilterReport, referee: FilterReport | None) -> bool:
    """Whether more runs were lost than chance takes: one in twenty, or the referee's number."""
    if referee is None:
        return p_values.more_exits(numbers.n_diverged, 0, numbers.n_runs) < _LEVEL
    return p_values.more_lost(numbers.n_diverged, referee.n_diverged, numbers.n_runs) < _LEVEL


def _faults(numbers: FilterReport, labels: Sequence[str]) -> list[str]:
    ranks, innovations = numbers.ranks, numbers.innovations
    n, k = len(labels), len(ranks.pit_p)
    single = ranks.hpd_p, innovations.whiteness_p, numbers.exits_p
    tests = np.concatenate([ranks.state_pit_p, numbers.nmee_p, ranks.pit_p, single])
    parts = np.split(p_values.holm(tests, _LEVEL), np.cumsum([n, n, k]))
    wrong, biased, predicted, (shape, coloured, outside) = parts
    faults = []
    for word, which in _shapes(ranks.state_pit, wrong).items():
        which = [d for d in which if word != "lopsided" or not biased[d]]
        if which:
            p = np.min(ranks.state_pit_p[which])
            faults.append(f"{word} in {_listed(labels, which)}: {_how(word, numbers, p)}")
    if outside and not wrong.any():
        faults.append(f"NEES outside its interval in {1 - numbers.nees_inside:.0%} of epochs")
    if biased.any():
        sizes = ", ".join(f"{m:+.2g} std" for m in numbers.nmee[biased])
        faults.append(f"biased in {_listed(labels, np.flatnonzero(biased))} by {sizes}")
    if shape:
        faults.append(
            f"the truth lies outside the region of highest density that holds 95 % in {ranks.outside_95:.0%} "
            f"of epochs, and its ranks there are not uniform (p = {ranks.hpd_p:.0e})"
        )
    if predicted.any():
        worst = np.nanmin(ranks.pit_p)
        faults.append(f"measurements do not fall as predicted (ranks not uniform, p = {worst:.0e})")
    if coloured:
        faults.append(f"successive innovations are correlated ({innovations.whiteness:+.2f})")
    return faults


def _how(word: str, numbers: FilterReport, p: float) -> str:
    """The evidence for a verdict: the NEES, or only the finer test of the ranks."""
    if word == "lopsided":
        return f"the truth lies on one side of its density too often (p = {p:.0e})"
    sure = word == "optimistic"
    share, side = (numbers.nees_above, "above") if sure else (numbers.nees_below, "below")
    if share > _MANY:
        return f"NEES {side} its interval in {share:.0%} of epochs"
    where = "at the ends" if sure else "in the middle"
    return f"ranks of the truth crowd {where} of its density (p = {p:.0e})"


def _shapes(histograms: Floats, wrong: Bools) -> dict[str, list[int]]:
    """Sort states whose ranks are not uniform by what their histograms look like."""
    found: dict[str, list[int]] = {}
    for state in np.flatnonzero(wrong):
        ranks = histograms[state]
        width, lean = ranks[[0, 1, 8, 9]].sum() - ranks[3:7].sum(), ranks[5:].sum() - ranks[:5].sum()
        word = "optimistic" if width > 0 else "pessimistic"
        found.setdefault("lopsided" if abs(lean) > abs(width) else word, []).append(int(state))
    return found


def _nothing_found(numbers: FilterReport) -> str:
    inside = f"NEES in its interval in {numbers.nees_inside:.0%} of epochs"
    if not numbers.ranks.state_pit.any():
        return f"not judged, the ranks of the truth are not known (run takes truth=); {inside}"
    if np.isnan(numbers.ranks.state_pit_p).all():
        return f"not judged, that takes {p_values.FEWEST_RUNS} runs at least; {inside}"
    if numbers.nees_inside < 1.0 - _MANY and np.isnan(numbers.exits_p):
        return f"nothing found against it but {inside} only (if no Gaussian it may be right: ask a referee)"
    return f"consistent: nothing found against it, {inside}"


def _listed(labels: Sequence[str], which: Iterable[int]) -> str:
    return " and ".join(labels[i] for i in which)
