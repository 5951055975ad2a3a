"""What later measurements say about a state: λ(x, t0) = log E[exp λ(X(t1), t1) | X(t0) = x].

The backward Kolmogorov equation is the FPK equation without its divergence, and along paths that go on in
time: the weighted noise paths of the log-density scheme solve it as they are, by steps of negative length.
λ is no log-density: it may be flat, or rise towards the edge of the lattice that it is known on.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, OfStates
from ..core._addresses import NOWHERE_AT, addresses, function_at
from ..core._jit import jit
from ..core.characteristics.aim import AIMED
from ..core.characteristics.expectation import BACK, EXPECTED, Step
from ..core.characteristics.noise_paths import Begin, Noise, Span
from ..core.characteristics.step_limits import driven_ends, path_error
from ..core.field.field import Field
from ..core.field.fitting import build_field
from ..core.field.stencils import stencils
from ..density.particle_density import ParticleDensity
from ..model.compile import shared, surfacing
from ..model.derived import zeros
from ..model.sde import SDE
from ..model.timing import beside
from .log_density import noise_between
from .noise_rules import paths

_FLAT = -1e-9  # largest second derivative beyond a lattice; measured: half, twice move means by 1e-12
_TOLERANCE = 1e-5  # of the paths' ends, in deviations; measured: half and twice change none of three records
_MOST_PARTS = 64  # Runge-Kutta steps of a path: of errors 64⁻⁴ = 6e-8 is left
_QUADRATURE = 7  # Gauss-Hermite points of one noise: exact to degree 2 · 7 - 1 = 13

back_at, aim_at = BACK.at, AIMED.at


class _Entries(NamedTuple):
    """Addresses of what a step back calls."""

    drift: int
    divergence: int
    aim: int
    back: int
    expected: int


class _Leg(NamedTuple):
    """A step of the noise."""

    t: float  # where its paths begin, seconds
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


def carried_back(model: SDE, found: Field, prior: ParticleDensity, t1: float) -> OfStates:
    """Return λ at the time of a prior, where it is asked for, as a function of states (M, n).

    `found` is λ at t1, seconds, one step of the noise later, as `likelihood_field` made it. The model may
    jump at both ends of the step.
    """
    n, mean, begin, end = model.dim, prior.mean(), prior.t, t1
    for before, after in (beside(stop, prior.t, t1) for stop in model.breaks(prior.t, t1)):
        begin, end = after if before <= begin else begin, before if end <= after else end
    noise = noise_between(model, begin, end, mean)[0]._replace(constant_divergence=True)
    drift, none = model.flow_drift_batch, shared(zeros)
    entries = addresses(_Entries, drift, none, AIMED, BACK, EXPECTED)
    rule = paths(noise.G.shape[1], _QUADRATURE)
    x, mass, L = np.array(prior.x), np.array(prior.mass), np.linalg.cholesky(prior.cov())
    with surfacing():
        parts = _parts(entries, noise, x, mass, L, begin, end - begin)

    def log_expected(X: Floats) -> Floats:
        leg = _Leg(begin, end - begin, parts, not model.linear)  # here: the model must outlive its addresses
        with surfacing():
            return _ahead(entries, noise, found, stencils(n), rule, mean, leg, np.array(X))

    return log_expected


@jit
def _parts(entries: _Entries, noise: Noise, x: Floats, m: Floats, L: Floats, t: float, h: float) -> int:
    """Runge-Kutta steps of paths from nodes x (N, n) of a density, with masses m and lower factor L."""
    drift, f, parts = function_at(entries.drift), np.empty(x.shape), 1
    drift(x, t, noise.p, f)
    begin = Begin(x, f, f)
    while parts < _MOST_PARTS:
        once, twice = driven_ends(drift, noise, begin, Span(t, h, parts))
        if not path_error(once, twice, m, L) > _TOLERANCE:
            break
        parts *= 2
    return parts


@jit
def _ahead(
    entries: _Entries, noise: Noise, field: Field, sten: Any, paths: Any, centre: Floats, leg: _Leg, X: Floats
) -> Floats:
    """λ (M,) at the states X (M, n) before a step of the noise."""
    drift, divergence = function_at(entries.drift), function_at(entries.divergence)
    response = aim_at(entries.aim)(drift, noise, field, centre, leg.t, -leg.h, leg.parts)
    step = Step(
        drift, divergence, noise, field, sten, paths, response, leg.t, -leg.h, leg.parts, leg.blurred,
        entries.expected, NOWHERE_AT,
    )  # fmt: skip
    out = np.empty(X.shape[0])
    back_at(entries.back)(step, X, -np.inf, out)
    return out
