"""Prior times likelihood as a few Gaussians, split before the update along which the reading bends."""

import math
from typing import Any

import numpy as np

from .._types import Floats, Ints
from ..density.as_family import family_of, moments_on_line, pieces_density
from ..density.family import OF_MISFIT
from ..density.memory import error_budget
from ..density.merging import OF_CHANGE, merged
from ..density.particle_density import ParticleDensity
from ..density.pieces import Pieces, nodes, pieces_of
from ..density.pieces_posterior import Settings, pieces_posterior
from ..density.splitting import White
from ..errors import PropagationError
from .by_family import error_beyond_nodes
from .reading_at_prior import ReadingAtPrior, error_left_by_update, info_fields

__all__ = ["by_pieces"]

_FINE = 0.6  # of the target: what pieces are made for; measured: half, .9: 1.1 times the error
#: Times that: bend, and difference of opinions. Measured: half, twice leave errors 1 to 1.3 times as large.
_BEND, _OFF = 12.0, 5.0
#: Part of the difference that is an error. Measured: half leaves .94 times the error, twice changes none.
_OF_OFF = 0.5


def by_pieces(
    density: ParticleDensity, asked: ReadingAtPrior, target: float, most: int
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as Gaussians, as fine as a target error asks for.

    Parameters
    ----------
    density : ParticleDensity
        Pieces, or near one Gaussian.
    asked : Asked
        Of a sensor with Gaussian noise.
    target : float
        Standard deviations, rms over the states.
    most : int
        Nodes of all pieces at which the sensor may be asked.

    Raises
    ------
    PropagationError
        More nodes would be needed, or there is no reason to split a density of another shape.
    """
    prior, misfit = _prior(density, error_budget(density.error, target))
    white, log_scale = asked.whitened()
    aim = _FINE * target  # of every reading: what is wrong with pieces fades, as they are split anew
    found = pieces_posterior(prior, white, _sees(white, prior), Settings(_BEND * aim, _OFF * aim, most))
    pieces, change = merged(found.pieces, aim / OF_CHANGE)
    new = pieces_density(density, pieces)
    before = math.hypot(density.error, OF_MISFIT * misfit)
    log_evidence = found.log_evidence + log_scale
    missed = 0.0
    if not asked.linear:  # splitting cuts tails off
        both = (prior.log_p, moments_on_line(density)), (pieces.log_p, moments_on_line(new))
        missed = error_beyond_nodes(density, asked, *both, log_evidence)
    error = math.hypot(
        error_left_by_update(density, new) * before, _OF_OFF * found.error, OF_CHANGE * change, missed
    )
    said = info_fields(asked, "pieces", log_evidence, error, found.evidence_error)
    return new.noted(error=error), said


def _prior(density: ParticleDensity, most: float) -> tuple[Pieces, float]:
    """A density as pieces, and the misfit of that."""
    if density.pieces is not None:
        return density.pieces, 0.0
    if density.family is None or density.domain is not None:
        raise PropagationError("the density is of another shape than pieces are made of")
    misfit = family_of(density, 2)[1]
    if not OF_MISFIT * misfit <= most:
        raise PropagationError("the density is no Gaussian, of which pieces are made")
    assert density.moments is not None
    return pieces_of(*density.moments), misfit


def _sees(white: White, prior: Pieces) -> Ints:
    """States that a reading depends on, as far as nodes of the prior show; all if it depends on none."""
    xi = nodes(prior.mean.shape[1])[0]
    X = (prior.mean[:, None] + np.einsum("kab,ib->kia", prior.root, xi)).reshape(-1, xi.shape[1])
    here, turned = white(X), np.roll(X, 1, axis=0)

    def changes(axis: int) -> bool:
        other = X.copy()
        other[:, axis] = turned[:, axis] + _irregular(X[:, axis])
        return not np.array_equal(white(other), here, equal_nan=True)

    seen = [axis for axis in range(X.shape[1]) if changes(axis)]
    return np.array(seen or range(X.shape[1]))


def _irregular(values: Floats) -> Floats:
    """Shifts that leave no value where it was, in the units of what varies."""
    return 0.37 * (np.ptp(values) or 1.0) * np.cos(np.arange(len(values)))
