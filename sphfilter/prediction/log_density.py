"""The log-density scheme: from lattice to lattice along backward stochastic characteristics."""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from .._types import Floats, Ints
from ..config import LogDensityScheme
from ..core._addresses import address_of, addresses
from ..core._jit import start_threads
from ..core.characteristics.aim import AIMED
from ..core.characteristics.control import (
    COUNTERS,
    EVALUATIONS,
    LONGEST,
    LOST_MASS,
    NET_MASS,
    NODES,
    PATH_STEP,
    RESIDUAL,
    SQUARES,
    STATE_SIZE,
    STATUS,
    STEP_ERRORS,
    STEPS,
    VOLUME,
    Control,
    Run,
)
from ..core.characteristics.expectation import BACK, BACK_IN_BLOCKS, EXPECTED, REFLECTED
from ..core.characteristics.flood import LAY
from ..core.characteristics.judge import BETWEEN, JUDGE
from ..core.characteristics.march import Entries, march, needed
from ..core.characteristics.noise_paths import ALONG, Noise
from ..core.characteristics.step_choice import CHOOSE
from ..core.cloud.inherited import ROUGH
from ..core.field.field import Field
from ..core.field.fitting import BUILD
from ..core.field.stencils import stencils
from ..core.limits import ROUNDING, TINY
from ..density.particle_density import ParticleDensity
from ..errors import LatticeError, PropagationError, StoppedError, UnresolvedError
from ..info import DOUBTFUL, Code, PredictInfo, may_be_off
from ..lattice.check import beside, cells_beside, deep_enough
from ..lattice.field import nodes as nodes_of
from ..lattice.level_set import (
    LatticeDensity,
    enough_particles,
    fewest_particles,
    gaussian_volume,
    lattice_depth,
    min_nodes,
)
from ..lattice.resolved import MOST
from ..model.compile import surfacing
from ..model.derived import scales
from ..model.sde import SDE
from ._shared import Predicted, blow_up, skip_notes
from .again import FINEST
from .noise_rules import paths
from .time_slices import drift_slices, noise_samples

_PAUSE_AFTER = 200  # steps between two chances to be interrupted
_PART = 0.6  # of a density's error, that is its mean's; measured: half, twice take 1.02, 1.41 times the work
#: Of what lattices get wrong in the middles of their cells, by the number of states: there it is most, and
#: up and down from cell to cell. Measured on eight scenes of two states: a tenth, seldom two.
_LATTICES_PART = {2: 0.2}
_TIME_PART = 0.01  # of the lattice's error, spacing⁴; measured: half, twice take 1.02, 1 times the work
_TOLERANCES = 1e-7, 1e-4  # of that; measured: half, twice take up to 1.35 and .83 times the work
#: Of the residual of a lattice, that a step's error may be. Measured: half takes 1 to 1.8 times the work, and
#: leaves one of nine lattices for a cloud; twice takes .6 to 1 times, with errors .5 to 3 times as large, and
#: a hundred times, 2e-6, where they were tiny.
_SHARE = 0.5
#: Of the error allowed, that steps may make, and lattices. Measured: half takes 1.13 and 1.23 times the work,
#: twice .99 and .96 times.
_EACH = 0.35
# Residual that steps go by at least, over spacing⁴. Measured: half takes .9 to 1.3 times the work, twice .7
# to 1.1 times; errors are .4 to 3 times as large with both.
_LEAST = 0.02
_LEASTS = 1e-7, 3e-4  # its bounds; measured: with half one of nine lattices ends as a cloud; twice: none
#: Particles times paths from which threads pay; by these numbers alone, so that the thread count never
#: changes a bit of the result.
_THREADS_FROM = 20_000


def why_not(model: SDE, density: ParticleDensity, n_particles: int) -> str:
    """Can this scheme carry the density? Returns a reason why not, empty if it can."""
    if model.domain.walled.any():
        reason = _held_by_walls(model, density)
        if reason:
            return reason
    if density.form.cell is None:
        return "the density has no smooth logarithm"
    if n_particles < fewest_particles(model.dim):
        return f"{n_particles} particles are too few for a lattice of {model.dim} states"
    return ""


def propagate(
    density: ParticleDensity,
    model: SDE,
    t1: float,
    scheme: LogDensityScheme,
    n_particles: int,
    allowed: float = 0.0,
    most_work: float = math.inf,
) -> Predicted:
    """Carry a density that has a `field` to time t1, seconds, on lattices of at most n_particles nodes.

    An `allowed` error of the mean, in standard deviations, is shared out over steps and lattices: each of
    these then has the nodes that its share asks for, and the first one n_particles. Zero: as many as there
    are. Raises `PropagationError` where the drift is not finite where particles are, the lattice cannot hold
    the density, too much probability was lost on the way, or after `most_work` evaluations of the drift: it
    says when, where, and what to change.
    """
    start, n = density.t, density.dim
    allowed = allowed if n in _LATTICES_PART else 0.0
    noise, slices = noise_between(model, start, t1, density.mean())
    low, high = model.domain.walls
    noise = noise._replace(low=low, high=high)
    depth = _depth(density, scheme)
    spacing = (gaussian_volume(n, depth) / n_particles) ** (1.0 / n)
    least = float(np.clip(_LEAST * spacing**4, *_LEASTS))
    residual = max(least, min(density.residual or 0.0, 1e-2))
    nodes, volume = float(n_particles), density.volume or gaussian_volume(n, depth)
    if density.residual and not allowed:
        nodes = needed(density.residual, nodes, n_particles, n)
    most = n_particles if allowed == 0.0 else min(MOST, FINEST**n * n_particles)
    tolerance = scheme.tolerance or float(np.clip(_TIME_PART * spacing**4, *_TOLERANCES))
    control = Control(
        n_particles=most,
        depth=depth,
        tolerance=tolerance,
        share=_SHARE,
        least=least,
        noise_share=scheme.noise_share or math.inf,
        pause_after=_PAUSE_AFTER,
        most_work=most_work,
        most_lost=max(scheme.most_lost, allowed / _PART),
        doubtful=DOUBTFUL / _PART,
        fewest=min_nodes(n),
        steps=_EACH * allowed / _PART,
        lattices=_EACH * allowed / _LATTICES_PART.get(n, _PART),
    )
    counters = np.zeros(len(COUNTERS), np.int64)
    longest = model.max_step
    if not model.autonomous:
        longest = min(longest, (t1 - start) / max(slices, drift_slices(model, density, t1)))
    state, times = np.zeros(STATE_SIZE), np.array([start, t1])
    state[VOLUME], state[NODES], state[RESIDUAL] = volume, nodes, residual
    state[PATH_STEP], state[LONGEST], state[LOST_MASS] = min(t1 - start, longest), longest, abs(density.lost)
    rule = paths(noise.G.shape[1], scheme.quadrature)
    field: Any = density.field
    status = "paused"
    threads = n_particles * len(rule.log_weight) >= _THREADS_FROM
    entries = _entries(model, threads)
    while status == "paused":
        if counters[STEPS] >= scheme.max_steps:
            status = "too many steps"
            break
        if counters[EVALUATIONS] > most_work:
            status = "too much work"
            break
        with surfacing():
            *values, x, mass, mean, cov, code = march(
                entries, noise, field, stencils(n), rule, times, Run(control, state, counters)
            )
        field = Field(*values)
        status = STATUS[code]
    if status == "not finite":
        raise PropagationError(blow_up(model, _fastest(model, x, times[0]), times[0], start, t1))
    if status != "ok":
        kind, reason = _REASONS[status]
        about = {"lost": 100 * state[LOST_MASS], "nodes": n_particles, "steps": scheme.max_steps}
        about |= {"dim": model.dim, "enough": enough_particles(model.dim)}
        raise _given_up(kind(reason.format(**about)), (start, times[0], t1), counters)
    laid = LatticeDensity(x, mass, field, 0.0, float(state[VOLUME]), mean, cov, model.domain.walls)
    gaussian = density.gaussian and model.linear
    kept = _kept(noise.G, t1 - start, density.cov(), cov)
    error, lost = _carried(density, kept, state)
    known = {"residual": 0.0 if gaussian else float(state[RESIDUAL]), "error": error, "lost": lost}
    known["rough"] = density.rough * kept**ROUGH
    moved = ParticleDensity.on_lattice(laid, float(t1), density.capacity, gaussian, density.domain, **known)
    return moved, _info(model, scheme, counters, moved, float(state[LOST_MASS]) - abs(density.lost), threads)


def _depth(density: ParticleDensity, scheme: LogDensityScheme) -> float:
    """Nats below the highest value of log p at which lattices are cut."""
    depth, field = lattice_depth(scheme, density.dim), density.field
    if scheme.reach or field is None:
        return depth
    log_p, x = field.log_p[: field.kept], nodes_of(field)[: field.kept]
    return deep_enough(log_p, x, np.exp(log_p), depth, cells_beside(field, density.walls))


def noise_between(model: SDE, t0: float, t1: float, around: Floats) -> tuple[Noise, int]:
    """The noise from t0 to t1, and steps that see it change around a state (n,)."""
    if not model.state_dependent_noise:
        found = _constant_noise_factor(model) if model.constant_diffusion else _noise_factor(model, t0, t1)
        G, slices = found
        noise = Noise(G, model.p, not model.constant_diffusion, model.linear, along=address_of(ALONG))
        return noise, slices
    slices = 1 if model.autonomous else noise_samples(model, t0, t1, around)[1]
    G, columns = np.zeros((model.dim, model.n_columns)), address_of(model.noise_columns_batch)
    return Noise(G, model.p, True, False, True, columns, along=address_of(ALONG)), slices


def _held_by_walls(model: SDE, density: ParticleDensity) -> str:
    """Why a density does not stay smooth between the walls of a model; empty if it does."""
    if "bounded" in model.domain.kinds:
        return "an axis is bounded, and a lattice does not see what leaves there"
    if model.state_dependent_noise:
        return "an axis ends at a wall, and the noise depends on the state"
    std = np.sqrt(np.diag(density.cov()))
    for out, ends in zip((-std, std), model.domain.walls, strict=True):
        for d in np.flatnonzero(np.isfinite(ends)):
            X = density.x.copy()
            X[:, d] = ends[d]
            if not model.diffusion_rows[d] and model.drift(X, density.t)[:, d].any():
                return f"state {model.states[d]} has no noise, and the drift carries it to its wall or away"
            X[:, d] += out[d]
            if not np.isfinite(model.drift(X, density.t)).all():
                return f"the drift is not finite beyond the wall of state {model.states[d]}"
    return ""


def _carried(density: ParticleDensity, kept: float, state: Floats) -> tuple[float, float]:
    """Error of the mean after a march, in standard deviations, and the probability lost on the way to it.

    Errors of steps and lattices come as they may; what a jump of the drift loses it loses again in each step.
    """
    lost = kept * density.lost + float(state[NET_MASS])
    before = math.sqrt(max(0.0, density.error**2 - (_PART * density.lost) ** 2))
    lattices = _LATTICES_PART.get(density.dim, _PART) * math.sqrt(state[SQUARES])
    return math.hypot(kept * before, _PART * state[STEP_ERRORS] + lattices, _PART * lost), lost


def _kept(G: Floats, dt: float, before: Floats, after: Floats) -> float:
    """Part of an error of the mean, in standard deviations, that is left of it after a time.

    In each direction it falls as in the Ornstein-Uhlenbeck process that takes the covariance before to that
    after: λ = exp(-u) + q (1 - exp(-u)) / u, λ the variance after and q that of the noise as parts of the one
    before, leaves exp(-u) / λ of its square. Where a drift contracts, noise may have brought more variance
    than there is.
    """
    root = np.linalg.cholesky(before)
    grown, axes = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, after).T))
    noise = np.square(axes.T @ np.linalg.solve(root, G)).sum(axis=1) * dt
    left = [_left(max(wide, ROUNDING), q) for wide, q in zip(grown.tolist(), noise.tolist(), strict=True)]
    return math.sqrt(min(sum(left) / len(left), 1.0))


def _left(wide: float, q: float) -> float:
    """exp(-u) / λ of `_kept`, for λ = wide, by halving; both terms are half of λ at most where it begins."""
    low, high = -math.log(wide), max(math.log(2.0 / wide), 2.0 * q / wide)
    for _ in range(60):
        u = 0.5 * (low + high)
        if math.exp(-u) - q * (math.expm1(-u) / u if u else -1.0) > wide:
            low = u
        else:
            high = u
    return math.exp(-low) / wide


def load(model: SDE) -> None:
    """Compile or load the march on few particles and on many, which has threads."""
    for threads in (False, True):
        _entries(model, threads)


def _entries(model: SDE, threads: bool) -> Entries:
    """Addresses of what the march calls; compiles or loads it."""
    if threads:
        start_threads()
    own = model.flow_drift_batch, model.flow_divergence_batch, model.diffusion_batch
    reflected = REFLECTED if model.domain.walled.any() else None
    return addresses(
        Entries, *own, BACK_IN_BLOCKS if threads else BACK, CHOOSE, AIMED, JUDGE, LAY, BETWEEN, BUILD,
        EXPECTED, reflected,
    )  # fmt: skip


#: What a march is given up with, by its status.
_REASONS: dict[str, tuple[type[PropagationError], str]] = {
    "lost": (
        UnresolvedError,
        "the lattice lost or gained {lost:.2g} % of the probability: the drift jumps, or the density has "
        "edges finer than its particles; use more of them",
    ),
    "too few nodes": (
        LatticeError,
        "no lattice of at most {nodes} particles resolves the density; use more particles (a Gaussian of "
        "{dim} states takes about {enough})",
    ),
    "outgrown": (
        LatticeError,
        "the density is spread over more lattice cells than fit into memory: its pieces are far apart, or "
        '{dim} states are too many; carry it as a cloud, scheme="cloud"',
    ),
    "stalled": (
        StoppedError,
        "steps became too small: the drift is too stiff there, or not smooth; check it",
    ),
    "too many steps": (
        StoppedError,
        "{steps} steps were not enough; allow more with scheme=LogDensityScheme(max_steps=...)",
    ),
    "too much work": (StoppedError, "a lattice takes far more work than a cloud of points"),
}


def _noise_factor(model: SDE, t0: float, t1: float) -> tuple[Floats, int]:
    """G (n, m) with D = G Gᵀ / 2, as many columns as D ever has rank, and steps that see D change."""
    D, slices = noise_samples(model, t0, t1)
    d = scales(np.abs(D).max(axis=0))
    w, V = np.linalg.eigh(D / np.outer(d, d))
    rank = (w > 1e-14 * max(w.max(), TINY)).sum(axis=1).max()
    middle = len(D) // 2
    G = (d[:, None] * V[middle] * np.sqrt(2.0 * np.maximum(w[middle], 0.0)))[:, ::-1][:, :rank]
    return np.ascontiguousarray(G), slices


@lru_cache(maxsize=64)
def _constant_noise_factor(model: SDE) -> tuple[Floats, int]:
    """As `_noise_factor`, where D never changes."""
    return _noise_factor(model, 0.0, 1.0)


def _fastest(model: SDE, x: Floats, t: float) -> Floats:
    """The state whose velocity is largest, or not finite."""
    speed = np.abs(model.drift(x, t)).sum(axis=1)
    return x[np.argmax(np.where(np.isfinite(speed), speed, np.inf))]


def _info(
    model: SDE, scheme: LogDensityScheme, counters: Ints, moved: ParticleDensity, lost: float, threads: bool
) -> PredictInfo:
    steps, rejected, evaluations, relaid = (int(c) for c in counters)
    cut = beside(moved.field, moved.mean(), moved.cov(), moved.walls)
    error = math.hypot(moved.error, cut.mean)
    skipped = ["neighbour search: the lattice knows its neighbours", "gradients: the expectation needs none"]
    skipped += [note for note in skip_notes(model, 0) if "evaluation of D" in note]
    if model.linear:
        skipped.append("divergence of the drift along the paths: it is constant")
    if not threads:
        skipped.append("threads: too little work for them")
    info = PredictInfo(
        n_steps=steps,
        n_rejected=rejected,
        n_evaluations=evaluations,
        n_regrids=steps + relaid,
        mass_error=lost,
        residual=moved.residual or 0.0,
        error=error,
        mass_left_out=cut.mass,
        skipped=tuple(skipped),
        scheme=scheme.name,
    )
    return info.also(Code.UNRESOLVED, may_be_off(error)) if error > DOUBTFUL else info


def _given_up(
    problem: PropagationError, span: tuple[float, float, float], counters: Ints
) -> PropagationError:
    """A problem with when it came, of a march from one time to another, and its work for all of it."""
    start, t, t1 = span
    what = f"prediction from {start:g} to {t1:g} stopped at t = {t:.6g}: {problem}"
    told = type(problem)(f"{what}, or predict over a shorter interval")
    told.work = float(counters[EVALUATIONS]) * ((t1 - start) / (t - start) if t > start else 1.0)
    return told
