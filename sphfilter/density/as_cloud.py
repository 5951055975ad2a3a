"""Densities as clouds of weighted points."""

from typing import Any

from .._types import Floats
from .cloud import KERNEL, smoothing_length
from .moments import moments
from .particle_density import SUMMED, ParticleDensity
from .points import CloudState, Passage


def cloud_density(
    density: ParticleDensity,
    x: Floats,
    mass: Floats,
    summed: tuple[Floats, Floats] | None = None,
    **changes: Any,
) -> ParticleDensity:
    """A density whose place in the record is that of another, as a cloud of points x (N, n), weights (N,).

    Their mean (n,) and covariance (n, n), where they are known, are not summed again.
    """
    if not mass.min() > 0.0:
        x, mass, summed = x[mass > 0.0], mass[mass > 0.0], None
    total = mass.sum()
    mass = mass.view() if abs(total - 1.0) <= SUMMED else mass / total
    summed = moments(x, mass) if summed is None else summed
    names = ("t", "represented_mass", "capacity", "domain", "error", "lost", "rough")
    about = {name: getattr(density, name) for name in names} | changes
    h = smoothing_length(mass, summed[1])
    parts: dict[str, Any] = {"x": x.view(), "mass": mass, "h": h, "kernel": KERNEL, "read_out": "cloud"}
    new = ParticleDensity.of_new(**parts, **about)
    vars(new.form.bare)["summed"] = summed  # of a `Cloud`: else it would be summed again
    return new


def cloud_of(
    density: ParticleDensity, state: CloudState, summed: tuple[Floats, Floats], **changes: Any
) -> ParticleDensity:
    """A density whose place in the record is that of another, as the cloud of a state of known moments."""
    (x, w), domain = state.points[:2], density.domain
    known = (x, w, summed) if domain is None else (domain.wrap(x), w)
    return cloud_density(density, *known, **changes, cloud=state)


def thinned(density: ParticleDensity, count: int) -> ParticleDensity:
    """A part of a cloud's points, at least `count`; the density itself where it has not twice as many."""
    every, own = slice(None, None, max(density.n_particles // count, 1)), density.form.own_points
    if own is None or every.step == 1:
        return density
    return cloud_density(density, own[0][every], own[1][every])


def passages_of(density: ParticleDensity) -> tuple[Passage, ...]:
    """What has moved a cloud's points since the last reading; nothing that is known, of other densities."""
    path = None if density.cloud is None else density.cloud.points.path
    return () if path is None else path.passages
