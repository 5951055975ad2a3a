"""The measurement update: prior times likelihood, on a new lattice, with its evidence."""

import math
from time import perf_counter
from typing import Any, Literal

from numpy.typing import ArrayLike

from ..config import CloudScheme, FamilyScheme, FilterConfig, PaperScheme, checked_filter_config
from ..core.limits import ALIKE
from ..density.left_out import lacking
from ..density.memory import flagged_if_missed
from ..density.particle_density import ParticleDensity
from ..density.resample import max_particles_of, on_lattice, target_of
from ..info import DOUBTFUL, NOTHING_CAME, Code, UpdateInfo, may_be_off
from ..lattice.check import Remote
from ..model.measurements import Sensor
from ..prediction.family import degree_of
from .by_cloud import by_cloud
from .by_family import by_family
from .by_ladder import by_ladder
from .by_lattice import by_lattice, would_widen
from .by_regridding import by_regridding
from .reading_at_prior import ReadingAtPrior


def update(
    density: ParticleDensity,
    measurement: Sensor,
    z: ArrayLike | None,
    config: FilterConfig | None = None,
    *,
    n_particles: int | Literal["auto"] | None = None,
) -> tuple[ParticleDensity, UpdateInfo]:
    """Multiply a density by the likelihood of z and put it on a new lattice (002 6.1-6.3).

    Parameters
    ----------
    density : ParticleDensity
        The prior at the time of the measurement.
    measurement : GaussianMeasurement or LikelihoodMeasurement
    z : array_like, shape (k,), or None
        NaN components are missing; None or all NaN leaves the density as it is.
    config : FilterConfig, optional
    n_particles : int or "auto", optional
        Upper bound of the number of particles afterwards; the density's own if not given. With "auto", and
        from then on, every step takes the cheapest representation that keeps the estimated error within the
        configuration's `target_error`.

    Returns
    -------
    ParticleDensity, UpdateInfo

    Raises
    ------
    ModelError
        z of the wrong length, or a likelihood that is NaN.
    PropagationError
        The likelihood is zero wherever the prior has particles, or no lattice holds the posterior of a
        measurement that is not outlying.

    Examples
    --------
    >>> import sphfilter as sf
    >>> prior = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=100)
    >>> posterior, info = sf.update(prior, sf.GaussianMeasurement([[1.0]], [[1.0]]), [2.0])
    >>> print(f"{posterior.mean()[0]:.4f} {posterior.cov()[0, 0]:.4f} {info.log_evidence:.4f}")
    1.0000 0.5000 -2.2655
    """
    began, config = perf_counter(), checked_filter_config(config)
    target, bound = target_of(density, config, n_particles), max_particles_of(density, n_particles)
    asked = ReadingAtPrior.of(density, measurement, z)
    if not asked.seen.any():
        return density, UpdateInfo(
            accepted=True,
            log_evidence=0.0,
            reason=NOTHING_CAME,
            n_particles=density.n_particles,
            error=density.error,
            seconds=perf_counter() - began,
        )
    if target is not None and config.scheme == "auto" and not config.acceptance.enabled:
        posterior, said = by_ladder(density, asked, target, config)
        said |= flagged_if_missed(said["code"], said["error"], target)
    elif isinstance(config.scheme, FamilyScheme):
        (posterior, said), _ = by_family(density, asked, bound, degree_of(config.scheme, density.dim))
    else:
        regrids = isinstance(config.scheme, PaperScheme) or config.acceptance.enabled
        as_cloud = density.form.own_points or isinstance(config.scheme, CloudScheme)
        by = by_cloud if as_cloud else by_regridding if regrids else by_lattice
        prior = density if as_cloud else on_lattice(density, bound)
        posterior, said = by(prior, asked, bound, config)
    off: dict[str, Any] = {"innovation": asked.innovation, "innovation_cov": asked.S}
    seconds = perf_counter() - began
    info = UpdateInfo(n_particles=posterior.n_particles, seconds=seconds, **off, **said)
    return _with_left_out(density, posterior, asked, info)


def _with_left_out(
    prior: ParticleDensity, posterior: ParticleDensity, asked: ReadingAtPrior, info: UpdateInfo
) -> tuple[ParticleDensity, UpdateInfo]:
    """A posterior that knows what was left out of its prior, too, and an info that tells what that does."""
    left = prior.left_out if info.accepted else None
    left = left and left.read(asked.log_weight(left.x) - info.log_evidence)
    if left is None:
        return posterior, info
    info = told_of(info, lacking(posterior.noted(left_out=left)))
    return posterior.noted(left_out=left.beside(posterior.left_out, posterior)), info


def told_of(info: UpdateInfo, far: Remote) -> UpdateInfo:
    """An info that tells of what is left out far away, and says so where it counts."""
    wider = math.hypot(info.variance_error, far.variance)
    info = info.noted(error=math.hypot(info.error, far.mean), variance_error=wider)
    if far.mean > DOUBTFUL:
        info = info.also(Code.UNRESOLVED, may_be_off(far.mean))
    if far.variance > 1.0 - ALIKE:
        info = info.also(Code.UNRESOLVED, would_widen(far.variance))
    return info
