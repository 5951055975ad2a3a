"""Particles in pictures: points coloured by the logarithm of what they carry."""

import numpy as np

__all__ = ["mass_bar", "mass_field"]

#: Decades told apart by colour; lighter particles have the colour of the lightest.
_DECADES = 6


def mass_field(ax, x, mass, size=6.0):
    """Scatter particles x (N, 2 or 3), coloured by the logarithm of their mass over the heaviest's.

    Heavy particles lie on top. Returns the artist, for `mass_bar`.
    """
    order = np.argsort(mass)
    with np.errstate(divide="ignore"):
        shade = np.log10(mass[order] / mass.max())
    look = {"s": size, "lw": 0, "cmap": "viridis", "vmin": -_DECADES, "vmax": 0}
    return ax.scatter(*x[order].T, c=np.maximum(shade, -_DECADES), **look)


def mass_bar(figure, artist, axes, what="mass of a particle"):
    """One colour bar of `mass_field` for several axes."""
    bar = figure.colorbar(artist, ax=axes, shrink=0.85, aspect=30, extend="min", pad=0.015)
    ticks = range(-_DECADES, 1, 2)
    bar.set_ticks(list(ticks), labels=["1" if k == 0 else f"$10^{{{k}}}$" for k in ticks])
    bar.set_label(f"{what}, highest = 1")
