"""What later measurements say about a state: λ(x, t0) = log E[exp λ(X(t1), t1) | X(t0) = x].

The backward Kolmogorov equation is the FPK equation without its divergence, in reversed time and with the
drift reversed, so that the weighted noise paths of the log-density scheme solve it as they are. λ is no
log-density: it may be flat, or rise towards the edge of the lattice that it is known on.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, OfStates
from ..core._addresses import addresses, function_at
from ..core._jit import jit
from ..core.characteristics.aim import AIMED
from ..core.characteristics.expectation import BACK, Step
from ..core.characteristics.noise_paths import Noise
from ..core.field.field import Field
from ..core.field.fitting import build_field
from ..core.field.stencils import stencils
from ..model.compile import shared, surfacing
from ..model.derived import zeros
from ..model.sde import SDE
from .log_density import noise_factor, paths

__all__ = ["carried_back", "likelihood_field"]

_FLAT = -1e-9  # largest second derivative of what goes on beyond a lattice, in its units
_TURN = 0.2  # Runge-Kutta step times the largest rate of the drift's Jacobian
_QUADRATURE = 7  # Gauss-Hermite points of one noise

back_at, aim_at = BACK.at, AIMED.at


class _Entries(NamedTuple):
    """Addresses of what a step back calls."""

    drift: tuple[int, int]
    divergence: tuple[int, int]
    aim: tuple[int, int]
    back: tuple[int, int]


class _Leg(NamedTuple):
    """A step of the noise, in reversed time."""

    t: float  # at its end, seconds
    h: float
    parts: int  # Runge-Kutta steps of a path
    blurred: bool  # what paths leave of the noise counts


def likelihood_field(field: Field, values: Floats) -> Field:
    """λ between the nodes of a lattice, as a `Field`: its values (N,) there, polynomials around them.

    Beyond the lattice the quadratic part goes on, where it is concave, as a plane else. `field` is that of
    a density on the same nodes.
    """
    n = field.mu.size
    sten = stencils(n)
    found = build_field(field.mu, field.A, field.node, field.kept, np.ascontiguousarray(values), sten)
    complete = np.flatnonzero(found.tail[:, 0, 0] != 0.0)
    second = np.zeros((len(complete), n, n))
    for k in range(n, n + n * (n + 1) // 2):
        a, b = sten.axis[k], sten.axis[sten.parent[k]]
        second[:, a, b] = second[:, b, a] = found.coefficient[complete, k] * (2.0 if a == b else 1.0)
    w, V = np.linalg.eigh(second)
    found.tail[complete] = np.einsum("iak,ik,ibk->iab", V, np.minimum(w, _FLAT), V)
    return found._replace(cap=math.inf)


def carried_back(model: SDE, found: Field, t0: float, t1: float, around: Floats) -> OfStates:
    """Return λ at t0 as a function of states (M, n), from that at t1 as `likelihood_field` made it.

    Parameters
    ----------
    model : SDE
        Its noise does not depend on the state.
    found : Field
    t0, t1 : float
        Seconds, t1 > t0: one step of the noise.
    around : ndarray, shape (N, n)
        States at t0 that matter.
    """
    n, h = model.dim, t1 - t0
    G, _ = noise_factor(model, t0, t1)
    noise = Noise(G, model.p, not model.constant_diffusion, True)
    rates = np.empty((len(around), n * n))
    with surfacing():
        model.jacobian_batch(np.array(around), t0, model.p, rates)
    rate = np.linalg.norm(rates[np.isfinite(rates).all(axis=1)].reshape(-1, n, n), axis=(1, 2)).max(initial=0)
    parts = max(1, math.ceil(h * rate / _TURN))
    entries = addresses(_Entries, model.reversed_drift_batch, shared(zeros), AIMED, BACK)
    rule, centre = paths(G.shape[1], _QUADRATURE), around.mean(axis=0)

    def log_expected(X: Floats) -> Floats:
        leg = _Leg(-t0, h, parts, not model.linear)  # made here: the model must outlive its addresses
        with surfacing():
            return _ahead(entries, noise, found, stencils(n), rule, centre, leg, np.array(X))

    return log_expected


@jit
def _ahead(
    entries: _Entries, noise: Noise, field: Field, sten: Any, paths: Any, centre: Floats, leg: _Leg, X: Floats
) -> Floats:
    """λ (M,) at the states X (M, n) before a step of the noise."""
    drift, divergence = function_at(entries.drift), function_at(entries.divergence)
    response = aim_at(entries.aim)(drift, noise, field, centre, leg.t, leg.h, leg.parts)
    step = Step(drift, divergence, noise, field, sten, paths, response, leg.t, leg.h, leg.parts, leg.blurred)
    out = np.empty(X.shape[0])
    back_at(entries.back)(step, X, -np.inf, out)
    return out
