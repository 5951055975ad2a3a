"""Particles of density values on a regular lattice."""

from typing import Any

import numpy as np

from .._types import Bools, Floats
from ..config import PaperScheme
from ..lattice.regular import Lattice, collocation_masses, fit_support
from .particle_density import ParticleDensity


def particles_on(
    lattice: Lattice,
    values: Floats,
    between: Floats,
    core: Bools,
    scheme: PaperScheme,
    density: dict[str, Any],
) -> ParticleDensity:
    """Make particles of density values on a lattice: masses, and the initial h that fits them best.

    The values (M,) are zero where no particle is to be, and those `between` are at the nodes of
    ``lattice.half_shifted()``. The fit counts at the nodes of the core, bool (M,), and at interstitial nodes
    from the lowest density of the core up. In `density` are its other attributes: t, represented_mass,
    capacity, domain.
    """
    kept = values > 0
    mass = values * lattice.cell_volume
    interior_between = between >= values[core & kept].min(initial=np.inf)
    fit = fit_support(lattice, mass, values, between, core & kept, interior_between, scheme)
    return particles_with(fit.h, lattice, values, scheme, density)


def particles_with(
    h: float, lattice: Lattice, values: Floats, scheme: PaperScheme, density: dict[str, Any]
) -> ParticleDensity:
    """Make particles of one smoothing length h; other arguments as of `particles_on`."""
    kept = values > 0
    x, mass = lattice.nodes[kept], values[kept] * lattice.cell_volume
    if density.get("domain") is not None:
        x = density["domain"].wrap(x)
    if scheme.masses == "collocation":
        solved = collocation_masses(x, h, values[kept], scheme.kernel)
        mass = mass if solved is None else solved
    of_scheme: dict[str, Any] = {"kernel": scheme.kernel, "read_out": scheme.read_out}
    return ParticleDensity(x=x, mass=mass, h=np.full(len(x), h), **of_scheme, **density)
