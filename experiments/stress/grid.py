"""The list of all cells, chosen by name."""

from fnmatch import fnmatch
from functools import partial

from sphfilter.errors import ConfigError, nearest

from . import data_families, model_families
from .cell import Cell

__all__ = ["cells", "chosen"]


def cells():
    """Return every cell of the grid, families in order, levels rising in difficulty or size."""
    return [
        Cell(family, system, f"{level:g}", partial(_build, build, level), unit, level in quick)
        for family, system, unit, build, levels, quick in model_families.FAMILIES + data_families.FAMILIES
        for level in levels
    ]


def _build(build, level, rng):
    return build(rng, level)


def chosen(patterns=(), quick=False):
    """Return the cells whose name fits one of the patterns (all without a pattern).

    Parameters
    ----------
    patterns : sequence of str
        With ``*`` and ``?`` as in file names; a family alone means all of it.
    quick : bool
        Of the reduced grid only.

    Raises
    ------
    ConfigError
        A pattern that fits no cell.
    """
    every = [cell for cell in cells() if cell.quick or not quick]
    if not patterns:
        return every
    found = []
    for pattern in patterns:
        fits = [cell for cell in every if _fits(cell, pattern)]
        if not fits:
            families = dict.fromkeys(cell.family.replace(" ", "_") for cell in every)
            raise ConfigError(
                f"no cell is named {pattern!r}{nearest(pattern, families)}; "
                f"families are {', '.join(families)}"
            )
        found += [cell for cell in fits if cell not in found]
    return found


def _fits(cell, pattern):
    return fnmatch(cell.name, pattern) or fnmatch(cell.name, f"{pattern}/*")
