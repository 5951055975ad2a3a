"""States drawn from an initial distribution."""

import numpy as np

from sphfilter import validate
from sphfilter.density.distributions import Gaussian, Uniform
from sphfilter.errors import ModelError

#: Rounds in which states beyond a wall are drawn again.
_ROUNDS = 1000


def draw(start, rng, n, domain):
    """Return n states, shape (n, dim): angles between their ends, states beyond a wall drawn again.

    Parameters
    ----------
    start : Gaussian, Uniform, array_like (dim,), or object with draw(rng, n) -> (n, dim)
        An array is a state that is known.
    rng : numpy Generator
    n : int
    domain : sphfilter.domain.Domain
    """
    x = domain.wrap(_drawn(start, rng, n, domain.dim))
    for _ in range(_ROUNDS):
        outside = np.flatnonzero(~domain.contains(x))
        if not outside.size:
            return x
        x[outside] = domain.wrap(_drawn(start, rng, outside.size, domain.dim))
    raise ModelError(f"the start hardly ever draws a state within {domain}; move one of the two.")


def _drawn(start, rng, n, dim):
    if hasattr(start, "draw"):
        return validate.array("states drawn by start", start.draw(rng, n), (n, dim))
    if isinstance(start, Gaussian):
        mean = validate.array("mean of the start", start.mean, (dim,))
        return mean + rng.standard_normal((n, dim)) @ np.linalg.cholesky(start.cov).T
    if isinstance(start, Uniform):
        low, high = validate.array("box of the start", start.box, (dim, 2)).T
        return low + (high - low) * rng.random((n, dim))
    return np.tile(validate.array("start", start, (dim,)), (n, 1))
