"""One look for all pictures: colours, axes, headings, legends, and how a figure becomes a file."""

import matplotlib

matplotlib.use("Agg")  # files only: no window system is asked for

import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..scene.filters import name_of

__all__ = ["ACCENT", "COLOURS", "INK", "filter_heading", "frame", "grid", "legend_below", "panels",
           "plain_numbers", "plt", "quantity", "save"]  # fmt: skip

#: One colour a filter in every picture (Okabe & Ito: distinct for the colour-blind too).
COLOURS = {
    "kf": "#000000",
    "ekf": "#D55E00",
    "ukf": "#CC79A7",
    "pf": "#0072B2",
    "sph": "#009E73",
    "sph_paper": "#E69F00",
    "grid": "#56B4E9",
    "benes": "#000000",
}
INK = "0.2"
ACCENT = {"sph": COLOURS["sph"], "other": COLOURS["ekf"], "third": COLOURS["pf"]}
_DPI = 130


def save(figure, path, dpi=_DPI):
    """Write a figure, close it, and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    return path


def panels(n_rows, n_columns, size, n=None, **shared):
    """A figure of `size` inches and its panels (n_rows, n_columns); the first `n` stay, all if None."""
    figure, axes = plt.subplots(
        n_rows, n_columns, figsize=size, squeeze=False, layout="constrained", **shared
    )
    for ax in axes.flat[axes.size if n is None else n :]:
        ax.remove()
    return figure, axes


def quantity(scene, state):
    """Axis label of a state of a scenario or a transient problem."""
    label, unit = scene.labels[state], scene.units[state]
    return f"{label} ({unit})" if unit else label


def grid(ax):
    """A light grid behind what is drawn."""
    ax.grid(alpha=0.25, lw=0.5)
    ax.set_axisbelow(True)


def frame(ax, title, xlabel, ylabel):
    """Title at the left, labels, and a light grid behind."""
    ax.set_title(title, loc="left", fontsize=10)
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    grid(ax)


def filter_heading(ax, name, more=""):
    """The name of a filter in its colour, above its panels."""
    look = {"color": COLOURS[name], "fontweight": "bold", "fontsize": 10}
    ax.set_title(name_of(name) + more, loc="left", **look)


def plain_numbers(axis):
    """Ticks of a logarithmic axis at 1, 2 and 5 of each decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_below(figure, *axes, columns=None, **look):
    """One legend under all panels, of what `axes` show, each label once, in as few rows as can be."""
    entries = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    place = {"loc": "outside lower center", "frameon": False}
    most = columns or max(int(figure.get_figwidth() / 1.5), 1)
    place["ncols"] = -(-len(entries) // -(-len(entries) // most)) if entries else 1
    return figure.legend(entries.values(), entries, **place | look)
