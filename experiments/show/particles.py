"""Particles in pictures: points coloured by the logarithm of what they carry."""

import numpy as np

#: Decades told apart by colour; lighter particles have the colour of the lightest.
_DECADES = 6
_PIXELS = 150  # of an image, along an axis


def mass_field(ax, x, mass, size=6.0):
    """Scatter particles x (N, 2 or 3), coloured by the logarithm of their mass over the heaviest's.

    Heavy particles lie on top. Returns the artist, for `mass_bar`.
    """
    order = np.argsort(mass)
    with np.errstate(divide="ignore"):
        shade = np.log10(mass[order] / mass.max())
    look = {"s": size, "lw": 0, "cmap": "viridis", "vmin": -_DECADES, "vmax": 0}
    return ax.scatter(*x[order].T, c=np.maximum(shade, -_DECADES), **look)


def density_image(ax, density, limits):
    """Draw a density of two states over a rectangle, by the logarithm of its value over the highest.

    White where it is too low to be told. Returns the artist, for `mass_bar`.
    """
    axes = [np.linspace(*ends, _PIXELS) for ends in limits]
    value = density.pdf(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2))
    with np.errstate(divide="ignore"):
        shade = np.log10(value / value.max())
    shown = np.where(shade >= -_DECADES, shade, np.nan).reshape(_PIXELS, _PIXELS)
    look = {"cmap": "viridis", "vmin": -_DECADES, "vmax": 0, "shading": "nearest", "rasterized": True}
    return ax.pcolormesh(*axes, shown, **look)


def mass_bar(figure, artist, axes, what="mass of a particle"):
    """One colour bar of `mass_field` for several axes."""
    bar = figure.colorbar(artist, ax=axes, shrink=0.85, aspect=30, extend="min", pad=0.015)
    ticks = range(-_DECADES, 1, 2)
    bar.set_ticks(list(ticks), labels=["1" if k == 0 else f"$10^{{{k}}}$" for k in ticks])
    bar.set_label(f"{what}, highest = 1")
