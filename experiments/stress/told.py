"""Errors that filters told of themselves over those they made: by what held the posterior, and by states."""

import math
from typing import NamedTuple

import numpy as np

from experiments.show.style import COLOURS, INK, grid, legend_below, panels, save
from experiments.show.tables import number
from sphfilter import FilterConfig

from .referees import LIMITS

#: What filters are asked for here: an error of the mean, in deviations of each state.
ASKED = FilterConfig().target_error
FLAGS = "readings that are", "number", "flagged"
HEADINGS = "error of", "held by", "states", "errors", "median", "10 %", "90 %", "below a third", "above three"
#: Of what errors are: of the mean, the variance and the evidence of every reading, and that of the record.
KINDS = (*LIMITS, "record's evidence")
#: Own errors of a reference by which an error that is made must stand out, to be counted.
_STANDS_OUT = 2.5
#: Less than this is rounding: a ten-thousandth of what filters are asked for.
_NOTHING = 1e-6
#: Errors that are not told well: as shares of, and as many times what is made.
_FAR = 3.0
_ALL = "all"
_COLOURS = [COLOURS[name] for name in ("sph", "sph_paper", "pf", "ukf", "ekf", "kf")]
_ENDS = np.array([1e-6, 1.0])


class Told(NamedTuple):
    """An error that was told and the one that was made, in the units of `LIMITS`."""

    what: str
    held: str
    states: int
    told: float
    made: float


def told_of(problem, record, referee, verdict):
    """All errors of a record that its reference can tell and its filter told, as a list of `Told`."""
    k, n = verdict.errors.shape[1], len(problem.x0)
    made, told, own = verdict.errors.copy(), record.told[:, :k], referee.own[:, :k].copy()
    made[0], own[0] = _of_means(record, referee, k)
    made[2] = np.abs(
        record.log_evidence[:k] - referee.log_evidence[:k]
    )  # the verdict's: of the record so far
    good = (made > np.maximum(_STANDS_OUT * own, _NOTHING)) & np.isfinite(told)
    found = [Told(KINDS[i], str(record.held[j]), n, told[i, j], made[i, j]) for i, j in np.argwhere(good)]
    total = np.linalg.norm(told[2]) if k else np.nan
    if np.isfinite(total) and verdict.errors[2, -1] > max(_STANDS_OUT * own[2, -1], _NOTHING):
        found.append(Told(KINDS[-1], str(record.held[k - 1]), n, total, verdict.errors[2, -1]))
    return found


def _of_means(record, referee, k):
    """Errors (k,) of means as `target_error` counts, in deviations of each state; and the reference's own."""
    off = record.x[:k] - referee.x[:k]
    made = np.sqrt(np.mean(off**2 / np.diagonal(referee.P[:k], axis1=1, axis2=2), axis=1))
    return made, referee.own[0, :k] / math.sqrt(off.shape[1])  # one at random has so much of |L⁻¹ off|


def flags_of(record, referee, verdict):
    """Whether the epochs of a record are right, and whether flagged, (k, 2): those whose reference is good.

    Right is a mean within three times what filters are asked for and nothing beyond `LIMITS`.
    """
    made, own = _of_means(record, referee, verdict.errors.shape[1])
    right = (made <= _FAR * ASKED) & (verdict.errors <= np.array(list(LIMITS.values()))[:, None]).all(axis=0)
    return np.column_stack((right, record.flagged[: len(made)]))[own <= ASKED]


def flag_lines(flags):
    """Lines of a table: right and wrong epochs of arrays of `flags_of`, and the share of flags."""
    flags = np.concatenate(flags)
    names = (f"right: mean within {_FAR:g} times {ASKED:g}, and the limits", True), ("wrong", False)
    groups = [(name, flags[flags[:, 0] == right, 1]) for name, right in names]
    return [(name, str(len(own)), number(own.mean(), ".2g")) for name, own in groups if len(own)]


def lines(found):
    """Lines of a table: of all that hold posteriors, and of each in all and each number of states."""
    groups = {}
    for one in found:
        for held, states in {(_ALL, _ALL), (one.held, _ALL), (one.held, one.states)}:
            groups.setdefault((one.what, held, str(states)), []).append(one.told / one.made)
    order = sorted(groups, key=lambda g: (KINDS.index(g[0]), g[1] != _ALL, g[1], g[2] != _ALL, g[2]))
    return [(*group, *_cells(np.array(groups[group]))) for group in order]


def _cells(ratios):
    shares = np.mean(ratios < 1.0 / _FAR), np.mean(ratios > _FAR)
    return str(len(ratios)), *(number(v, ".2g") for v in (*np.quantile(ratios, [0.5, 0.1, 0.9]), *shares))


def draw(path, found):
    """Draw errors made against errors told, a panel an error, a point an epoch, into a file."""
    figure, axes = panels(1, len(LIMITS), (10.5, 4.2), sharex=True, sharey=True)
    names = sorted({one.held for one in found})
    for ax, what in zip(axes.flat, LIMITS, strict=True):
        for held, colour in zip(names, _COLOURS, strict=False):
            pairs = [(one.told, one.made) for one in found if (one.what, one.held) == (what, held)]
            ax.scatter(
                *np.reshape(pairs, (-1, 2)).T, s=7, color=colour, alpha=0.5, lw=0, zorder=3, label=held
            )
        band = _ENDS / _FAR, _ENDS * _FAR
        ax.fill_between(_ENDS, *band, color=INK, alpha=0.08, lw=0, label="within three times")
        ax.plot(_ENDS, _ENDS, color=INK, lw=0.9)
        ax.set(xscale="log", yscale="log", xlim=_ENDS, ylim=_ENDS, xlabel="told")
        ax.set_title(what, loc="left", fontsize=9.5, fontweight="bold")
        grid(ax)
    axes[0, 0].set_ylabel("made")
    figure.suptitle("Errors made against errors told, at every reading of random models", fontsize=11)
    legend_below(figure, *axes.flat, columns=5, fontsize=8.5)
    return save(figure, path)
