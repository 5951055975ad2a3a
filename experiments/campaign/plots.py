"""Pictures of a consistency campaign: NEES, NIS, errors over time, and histograms of ranks."""

import numpy as np

from experiments.scene.filters import name_of
from experiments.show.plots import consistency_figure
from experiments.show.style import COLOURS, filter_heading, grid, panels, plain_numbers, plt, save
from sphfilter import consistency

_BINS = 10


def draw(out, scenario, campaign, numbers):
    """Draw all pictures into the folder `out`; their paths by what they show."""
    figures = {
        "NEES and NMEE averaged over the runs, and RMS errors": (
            "consistency",
            consistency_figure(scenario, campaign),
        ),
        "Ranks of the truth in the posterior": ("truth", _truth_figure(scenario, numbers)),
        "Measurements against their predictions": ("measurements", _measurement_figure(campaign, numbers)),
    }
    return {shows: save(figure, out / f"{stem}.png") for shows, (stem, figure) in figures.items()}


def _truth_figure(scenario, numbers):
    """Histograms of HPD ranks, and of the ranks of each state, a column a filter."""
    rows = {"HPD rank": lambda ranks: ranks.hpd}
    for d, label in enumerate(scenario.labels):
        rows[label] = lambda ranks, d=d: ranks.state_pit[d]
    n_counts = numbers.n_runs * numbers.n_epochs
    n = len(numbers.filters)
    figure, axes = panels(len(rows), n, (max(2.1 * n, 7.0), 1.7 * len(rows) + 0.9), sharex=True)
    for column, (name, f) in enumerate(numbers.filters.items()):
        p_values = [f.ranks.hpd_p, *f.ranks.state_pit_p]
        for ax, (label, of), p in zip(axes[:, column], rows.items(), p_values, strict=True):
            _histogram(ax, of(f.ranks), name, p, n_counts)
            ax.set_ylabel("" if column else label)
        filter_heading(axes[0, column], name)
    figure.supxlabel(
        "rank: probability of a higher density, or of a lower value, than the truth's", fontsize=9
    )
    figure.suptitle("Ranks of the truth: flat if the posterior is right (dashed)", fontsize=11)
    return figure


def _measurement_figure(campaign, numbers):
    """NIS over time, and histograms of the PIT of each reading, a column a filter."""
    k = campaign.z.shape[-1]
    filters = numbers.filters
    figure = plt.figure(figsize=(max(2.1 * len(filters), 7.0), 3.2 + 1.7 * k), layout="constrained")
    places = figure.add_gridspec(1 + k, len(filters), height_ratios=[1.7] + [1.0] * k)
    top = figure.add_subplot(places[0, :])
    for name, result in campaign.results.items():
        nis = consistency.run_average(consistency.nis(result.innovation, result.innovation_cov))[0]
        top.plot(campaign.times, nis, color=COLOURS[name], lw=1.3, marker="o", ms=2.5, label=name_of(name))
    low, high = consistency.nees_bounds(k, len(campaign.truth))
    top.axhspan(low, high, color="0.5", alpha=0.18, lw=0, label="95 % interval")
    top.axhline(k, color="0.5", lw=0.8, ls="--")
    top.set(yscale="log", xlabel="time (s)", ylabel="normalised innovation\nsquared (NIS)")
    plain_numbers(top.yaxis)
    grid(top)
    top.margins(x=0.01)
    top.legend(frameon=False, fontsize=8, ncols=len(filters) + 1, loc="upper left", bbox_to_anchor=(0, 1.2))
    n_counts = numbers.n_runs * numbers.n_epochs
    for column, (name, f) in enumerate(filters.items()):
        for reading in range(k):
            ax = figure.add_subplot(places[1 + reading, column])
            _histogram(ax, f.ranks.pit[reading], name, f.ranks.pit_p[reading], n_counts)
            if reading == 0:
                filter_heading(ax, name)
            ax.set_ylabel("" if column else f"PIT, reading {reading + 1}" if k > 1 else "PIT")
    return figure


def _histogram(ax, fractions, name, p, n_counts):
    """Fractions of the ranks in equal parts of (0, 1), beside what is right and how far chance takes it."""
    ax.set_yticks([])
    ax.set_xlim(0, 1)
    ax.set_xticks([0, 0.5, 1], ["0", ".5", "1"])
    ax.spines[["top", "right", "left"]].set_visible(False)
    if not np.isfinite(fractions).any() or not fractions.any():
        ax.text(0.5, 0.5, "not known", ha="center", transform=ax.transAxes, color="0.5", fontsize=9)
        return
    height = _BINS * fractions
    ax.bar((np.arange(_BINS) + 0.5) / _BINS, height, 0.9 / _BINS, color=COLOURS[name], alpha=0.8)
    chance = 1.96 * np.sqrt((_BINS - 1) / n_counts)
    ax.axhspan(1 - chance, 1 + chance, color="0.5", alpha=0.2, lw=0, zorder=0)
    ax.axhline(1, color="0.2", lw=0.8, ls="--")
    ax.set_ylim(0, max(2.0, 1.3 * height.max(), 1.25 * (1 + chance)))
    ax.text(0.98, 0.96, f"p = {p:.2g}", ha="right", va="top", transform=ax.transAxes, fontsize=8)
