"""One look for all pictures of particles and errors."""

from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")  # files only: no window system is asked for

import matplotlib.pyplot as plt
import numpy as np

from experiments.show.plots import COLOURS

__all__ = ["ACCENT", "DECADES", "INK", "Picture", "frame", "mass_bar", "mass_field", "quantity", "save"]

INK = "0.2"
ACCENT = {"sph": COLOURS["sph"], "other": COLOURS["ekf"], "third": COLOURS["pf"]}
#: Decades of mass told apart by colour; lighter particles have the colour of the lightest.
DECADES = 6
_DPI = 130


class Picture(NamedTuple):
    """Figures by file stem, and sentences that say what they show."""

    figures: dict
    sentences: tuple


def save(figure, path):
    """Write a figure, close it, and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)
    return path


def mass_field(ax, x, mass, size=6.0):
    """Scatter particles x (N, 2), coloured by the logarithm of their mass over the heaviest's.

    Heavy particles lie on top. Returns the artist, for `mass_bar`.
    """
    order = np.argsort(mass)
    with np.errstate(divide="ignore"):
        shade = np.log10(mass[order] / mass.max())
    return ax.scatter(
        *x[order].T, c=np.maximum(shade, -DECADES), s=size, lw=0, cmap="viridis", vmin=-DECADES, vmax=0
    )


def mass_bar(figure, artist, axes, what="mass of a particle"):
    """One colour bar of `mass_field` for several axes."""
    bar = figure.colorbar(artist, ax=axes, shrink=0.85, aspect=30, extend="min", pad=0.015)
    ticks = range(-DECADES, 1, 2)
    bar.set_ticks(list(ticks), labels=["1" if k == 0 else f"$10^{{{k}}}$" for k in ticks])
    bar.set_label(f"{what}, highest = 1")


def quantity(scenario, state):
    """Axis label of a state."""
    unit = scenario.units[state]
    return f"{scenario.labels[state]} ({unit})" if unit else scenario.labels[state]


def frame(ax, title, xlabel, ylabel):
    """Title at the left, labels, and a light grid behind."""
    ax.set_title(title, loc="left", fontsize=10)
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    ax.grid(alpha=0.25, lw=0.5)
    ax.set_axisbelow(True)
