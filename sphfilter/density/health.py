"""Is a cloud of particles still in order? The adverse phenomena of 002 section 5, seen in a density."""

from dataclasses import dataclass

import numpy as np

from .._types import Bools, Floats
from ..core.limits import TINY
from ..core.monomials import up_to
from ..core.sph.neighbors import build_index, choose_method, neighbor_lists
from ..errors import ModelError
from .particle_density import ParticleDensity

#: Nats. A cloud in order has .002 to .05 however sheared (two to four states, 300 to 1300 particles), one
#: that has mixed .2 to 1; at .1 neighbours contradict each other by a tenth of the density.
_MIXED = 0.1
#: Steps shorten with the smallest distance: from a twentieth of the typical one on they are five to ten times
#: as many. Shear alone, which passes, leaves a quarter, and what spreads on a limit cycle a fifteenth.
_CLUMPED = 0.05
#: Share of the particles that moves without any neighbour. Those at the rim come first, and carry nothing.
_ASTRAY = 0.05


@dataclass(frozen=True, kw_only=True)
class Health:
    """How far the particles of a density are from a regular lattice.

    Attributes
    ----------
    mixing : float
        Nats: log-mass of a particle against a smooth function of its neighbours', root mean square over the
        mass. Zero on a lattice of a Gaussian; grows where particles of other origin come between.
    spacing : float
        Smallest distance of two particles over the median of nearest distances: falls where mass clumps.
    spreading : float
        Nearest distance averaged over the mass, over the median: grows where heavy particles part.
    rogue : float
        Share of the particles that have no neighbour within the support of either's kernel.
    rogue_mass : float
        Probability that the rogue particles carry.
    effective : float
        Effective number of particles, 1 / sum m². Only a new lattice changes it.

    Examples
    --------
    >>> import sphfilter as sf
    >>> order = sf.health(sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=60))
    >>> print(f"{order.mixing:.3f}, {order.rogue}, {order.effective:.1f}")
    0.000, 0.0, 17.8
    """

    mixing: float
    spacing: float
    spreading: float
    rogue: float
    rogue_mass: float
    effective: float

    @property
    def severity(self) -> float:
        """Largest of mixing, clumping and rogue particles over its tolerated value; above one is too much."""
        return max(self._severities().values())

    @property
    def complaint(self) -> str:
        """The worst of the three in words; empty where all are tolerated."""
        severities = self._severities()
        worst = max(severities, key=severities.__getitem__)
        return worst if severities[worst] > 1.0 else ""

    def _severities(self) -> dict[str, float]:
        return {
            "particles have mixed": self.mixing / _MIXED,
            "particles have clumped": _CLUMPED / max(self.spacing, TINY),
            "particles have gone astray": self.rogue / _ASTRAY,
        }


def health(density: ParticleDensity) -> Health:
    """Measure how far the particles of a density are from a regular lattice (002 5.1).

    Distances are those of the kernels, between the states themselves; of a lattice or a cloud they are taken
    between whitened states. On a periodic axis they go the short way round.

    Parameters
    ----------
    density : ParticleDensity

    Returns
    -------
    Health

    Raises
    ------
    ModelError
        The density has a single particle.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> cloud = sf.initialize(sf.Gaussian([0.0, 0.0], np.eye(2)), 200, sf.SolverConfig(scheme="paper"))
    >>> print(f"{sf.health(cloud).severity:.2f}, {sf.health(cloud).complaint!r}")
    0.05, ''
    """
    N = density.n_particles
    if N < 2:
        raise ModelError("health compares particles with their neighbours: the density has only one")
    z, mass, support = _as_kernels_see(density)
    smooth, nearest = (a[:N] for a in _smoothed(z, np.log(mass)))
    off = np.log(density.mass) - smooth
    alone = _alone(z, support)[:N]
    typical = np.median(nearest)
    return Health(
        mixing=float(np.sqrt(density.mass @ off**2)),
        spacing=float(nearest.min() / typical),
        spreading=float(density.mass @ nearest / typical),
        rogue=float(alone.mean()),
        rogue_mass=float(density.mass[alone].sum()),
        effective=float(1.0 / np.sum(density.mass**2)),
    )


def _as_kernels_see(density: ParticleDensity) -> tuple[Floats, Floats, Floats]:
    """States, masses and supports of the particles, and after them of their images beyond ends."""
    x, mass, h = density.x, density.mass, density.h
    K = density.sph_kernel.radius
    if not (density.form.smooth or density.form.own_points):
        if density.domain is not None:
            reach = 2.0 * K * h.max()  # supports, within which the neighbours of a polynomial lie
            x, mass, h = density.domain.seen(density.domain.fold(x), mass, h, reach)
        return np.ascontiguousarray(x), mass, K * h
    factor = np.linalg.cholesky(density.cov("points"))
    z = np.linalg.solve(factor, (x - density.mean()).T).T
    return np.ascontiguousarray(z), mass, K * h / np.prod(np.diag(factor)) ** (1.0 / density.dim)


def _alone(z: Floats, support: Floats) -> Bools:
    """Which particles see no other, and are seen by none, shape (N,)."""
    N, n = z.shape
    index = build_index(z, float(np.median(support)), choose_method(N, n))
    start, _ = neighbor_lists(z, support, support.copy(), 0, index)
    return start[1:] == start[:-1]


def _smoothed(z: Floats, values: Floats) -> tuple[Floats, Floats]:
    """What quadratic polynomials through the neighbours of each point z (N, n) make of values (N,) there.

    Of few points, which are two at least, they are linear. Returns values (N,) of the polynomials at their
    own points, and distances (N,) to the nearest point.
    """
    from scipy.spatial import cKDTree  # on use: import time

    N, n = z.shape
    powers = up_to(2, n)
    if len(powers) > max(n + 1, N // 2):
        powers = up_to(1, n)
    distance, neighbors = cKDTree(z).query(z, min(3 * len(powers), N - 1) + 1)  # three for each term
    reach = distance[:, -1:]
    d = (z[neighbors] - z[:, None]) / reach[:, :, None]
    basis = np.stack([np.prod(d[..., np.repeat(range(n), power)], axis=-1) for power in powers], axis=-1)
    q = distance / (1.05 * reach)
    weighted = basis * ((1.0 - q) ** 4 * (1.0 + 4.0 * q))[..., None]  # Wendland's C2 function
    normal = np.swapaxes(weighted, 1, 2) @ basis
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(len(powers))
    right = np.einsum("ikp,ik->ip", weighted, values[neighbors])
    return np.linalg.solve(normal, right[..., None])[:, 0, 0], distance[:, 1]
