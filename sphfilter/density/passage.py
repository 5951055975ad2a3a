"""A cloud of points over an interval: order, noise that is even along it, motion; and once more, guided."""

from enum import IntEnum
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..core._addresses import NOWHERE_AT, address_of
from ..core._views import as_compiled
from ..core.cloud import bridge
from ..core.cloud.blocks import blocks_of, centres
from ..core.cloud.curve import along_curve, places
from ..core.cloud.cycle import PARTS, Bounds, Cloud, Standing, nothing_begun
from ..core.cloud.cycle import put_through as through
from ..core.cloud.inherited import Inherited
from ..core.cloud.linearise import LINEARISE, linearised
from ..core.cloud.maps import LINEARISE_MAP, MAPPED
from ..core.cloud.move import MOVE, affine, move, moved_over
from ..core.cloud.noise import ADDITIVE, LANES, NORMAL, OF_STATE, mixed, stored
from ..core.cloud.pace import Bias, Steps, chosen
from ..core.cloud.reader import Reader
from ..core.cloud.steps import BESIDE, BETWEEN, FLOW, NO_LEG, STIFF_FLOW, Leg
from ..core.cloud.way import AGAIN, FIRST, KERNEL, begin, carry, carry_linear, everywhere
from ..core.limits import ENTRIES
from ..model.compile import surfacing
from ..model.discrete import DiscreteModel
from ..model.dynamics import Dynamics
from ..model.paths import change_of, noise_root
from ..model.sde import SDE
from .moments import columns
from .points import NO_LINES, CloudState, Pace, Passage, Path, Points, Told
from .quasi_random import NetPart, even, net

#: Passages after which a path is forgotten, and numbers of all points that they may hold: a reading leads
#: points through all of them once more. Measured: half and twice of both change no run.
MOST, _NUMBERS = 24, 2**22
#: Least part of a start's spread that is noise. Measured: with a quarter and a half, evaluations of two
#: scenes are 1 to 1.15 times as many, errors .9 to 1.15 times as large.
_SPREAD = 1.0 / 3.0
_NO_NETS = tuple(np.broadcast_to(0.0, (0, 0)) for _ in range(3))
_LED_BEFORE: set[tuple[int, int]] = set()  # points and states
_NO_ROWS = np.empty((1, 0, 0))
_NO_CHANGES = np.empty((0, 0, 0)), np.empty((0, 0)), np.empty((0, 0, 0))


def points_of_gaussian(mean: Floats, cov: Floats, count: int, key: int, number: int = 0) -> Points:
    """A Gaussian of mean (n,) and covariance (n, n) as points, each with noise as wide as their distance.

    Clouds of other numbers have starts of their own: those of one net are parts of each other.
    """
    n = len(mean)
    spread = max(count ** (-1.0 / n), _SPREAD)
    root = noise_root(cov) if np.linalg.det(cov) <= 0.0 else np.linalg.cholesky(cov)
    x = mean + np.sqrt(1.0 - spread**2) * np.einsum("ij,kj->ik", net(count, n, NetPart.START + number), root)
    w = np.full(count, 1.0 / count)
    x = x[along(x, w)]
    key = stored_key(key, KERNEL)
    u, middle = even(count, n, key, 0), centres(columns(x))
    noise = _changed(None, key, middle, (np.eye(n), np.zeros(n), spread * root))
    block = blocks_of(count)
    return Points(gone(noise, x, u, block, False), w, Path(x, block, (noise,), (u,)))


def points_of_sample(points: Points, count: int, key: int) -> Points:
    """Weighted points of any density as the begin of a path of `count` points."""
    n = points.x.shape[1]
    about = _lineage_of(points), count, key, net(count, n, 0).T, *places(n)
    begun = begin(columns(points.x), as_compiled(points.w), *about)
    start, y, u, w, block, middle, lower, flow, older = begun
    kernel = Passage(None, stored_key(key, KERNEL), middle, middle, flow, lower, _NO_ROWS)
    return Points(y.T, w, Path(start.T, block, (kernel,), (u.T,), older))


def moved_points(
    points: Points, model: Dynamics, t0: float, t1: float, steps: Steps, count: int, key: int
) -> Points:
    """Points carried over an interval in steps; those of a new path are `count`."""
    path = points.path
    most = min(MOST, max(4, _NUMBERS // (count * model.dim)))
    if path is None or len(path.passages) >= most or len(points.w) != count:
        points = points_of_sample(points, count, key)
        path = points.path
        assert path is not None
    (start, block, passages, U, _), leg = path, None
    about = columns(points.x), block, net(count, model.dim, len(passages)).T, key
    if model.linear:
        x, u, *linear = carry_linear(change_of(model, t1 - t0), *about)
    else:
        leg = leg_of(model, t0, t1, *steps)
        with surfacing():
            x, u, *linear = carry(leg, *about)
    passage = Passage(leg, key, *linear)._replace(model=model, span=(t0, t1), steps=steps)
    return Points(x.T, points.w, Path(start, block, (*passages, passage), (*U, u.T), path.older))


def moved_freely(x: Floats, model: Dynamics, span: tuple[float, float], steps: Steps, key: int) -> Floats:
    """States (N, n) moved over an interval in steps, each along noise of its own."""
    (N, n), block = x.shape, np.zeros(len(x), np.int64)
    if model.linear:
        flow, offset, lower = (part[None] for part in change_of(model, span[1] - span[0]))
        u = np.random.Generator(np.random.Philox(key)).standard_normal((N, n))
        return affine(columns(x), columns(u), block, np.zeros((1, n)), offset, flow, lower).T
    leg, moving = leg_of(model, *span, *steps), columns(x).copy()
    ends = np.zeros((n, N)), np.zeros((1, n, steps.number * model.n_noise))  # are as their noise moves them
    with surfacing():
        move(leg, moving, *ends, block, np.uint64(key), 0, -(-N // LANES))
    return moving.T


class Use(IntEnum):
    """What numbers of the key of an age are for, beside predictions: 0 of a cloud, and 1 of its shadow."""

    READING = 2  # of a cloud; and of its shadow the next
    LEFT_OUT = 4  # noise of what a lattice has left out, in a prediction
    ELSEWHERE = 4  # points of a family, at a reading
    PARTS = 5  # points of a part of a sum, and of the next
    JUMPS = 40  # of a cloud, and of its shadow the next


def age_of(density: Any) -> int:
    """Predictions since the start, where a density remembers them; else a number of its time, 0 at 0.

    It is the key of what happens then, whatever the density: evidence is smooth in a model's parameters.
    """
    if density.needs is not None:
        return int(density.needs.age)
    return int(np.array([density.t + 0.0]).view(np.uint64)[0]) >> 1  # a sign that integers have not


def sub_key(key: Any, number: int) -> Any:
    """The key, of compiled code, of one of the things that a key is for."""
    return np.uint64(mixed(np.uint64(key), np.uint64(number)))


def stored_key(key: Any, number: int) -> int:
    """A sub-key as a number that signed integers hold."""
    return int(stored(key, int(number)))


class Through(NamedTuple):
    """How a record ended that was put through a cloud, how many of its readings were, and what is left."""

    end: int  # of `core.cloud.cycle`
    done: int
    state: CloudState  # after the last of them
    points: int  # of the next cloud
    calm: int  # as of `Memory`
    before: Any  # without the last of them, if any was; its rows are those of all
    rows: tuple[Floats, ...]  # of each reading, as `core.cloud.cycle.put_through` returns them


def put_through(
    state: CloudState,
    model: Dynamics,
    times: Floats,
    readings: tuple[Reader, Floats],
    least: Ints,
    counts: tuple[int, int],
    calm: int,
    bounds: Bounds,
) -> Through:
    """Readings put through a cloud and its shadow of so many points, as far as each of them is usual.

    The state is as a reading has left it, or has begun a way; times (K + 1,), seconds, begin with that of
    the cloud; readings are of a sensor (K, k) at the other times, least (K,) the steps of each interval,
    counts and calm as of `Memory`.
    """
    led = [(count, model.dim) in _LED_BEFORE for count in counts]
    nets = [
        nets_of(count, model.dim) + (leading_nets(count, model.dim) if known else _NO_NETS)
        for count, known in zip(counts, led, strict=True)
    ]
    leg, changes = NO_LEG, _NO_CHANGES
    if model.linear:
        each = [change_of(model, dt) for dt in np.diff(times).tolist()]
        flows, offsets, lowers = zip(*each, strict=True)
        changes = np.array(flows), np.array(offsets), np.array(lowers)
    else:
        leg = _leg(model, False)
    clouds = _cloud(state.points, nets[0]), _cloud(state.shadow, nets[1])
    pace, told = (state.pace.step, state.pace.stiff), (counts[0], calm, state.age)
    standing = Standing(*clouds, state.size, *state.told, *pace, *told, state.inherited)
    about = (leg, address_of(STIFF_FLOW), changes), readings, (times, least), standing
    lead = address_of(bridge.BRIDGE) if any(led) else NOWHERE_AT
    with surfacing():
        end, done, *sides, rows = through((*map(address_of, PARTS), lead), *about, bounds, places(model.dim))
    after, before = map(_left, sides)
    return Through(end, done, *after, Through(end, done - 1, *before, None, rows), rows)


def _cloud(points: Points, nets: tuple[Floats, ...]) -> Cloud:
    """A cloud or its shadow as compiled code takes it, which these nets move on."""
    return Cloud(columns(points.x), points.w, _lineage_of(points), _begun(points), nets)


def _begun(points: Points) -> tuple[Any, ...]:
    """The way that points have begun, as `core.cloud.way.begin` returns it; empty, of points without one."""
    path = points.path
    if path is None:
        return tuple(nothing_begun(points.x.shape[1]))
    (kernel,), (u,) = path.passages, path.u
    begin = columns(path.x), columns(points.x), columns(u), points.w
    return *begin, path.block, kernel.start, kernel.lower, kernel.flow, path.older


def nets_of(count: int, dim: int) -> tuple[Floats, ...]:
    """Standard normals (dim, count), read-only, of a guide and of both passages of a way."""
    return tuple(net(count, dim, part).T for part in (NetPart.LED, 0, 1))


def leading_nets(count: int, dim: int) -> tuple[Floats, ...]:
    """Those of points that are led piece by piece; as soon as some of a number are, records have them."""
    _LED_BEFORE.add((count, dim))
    return nets_of(bridge.MORE * count, dim)


def _left(standing: tuple[Any, ...]) -> tuple[CloudState, int, int]:
    """A cloud as compiled code left it, how many points the next one has, and how calm it was."""
    x, w, lineage, few_x, few_w, few_lineage, size, *told, inherited, step, stiff, count, calm, age = standing
    points, shadow = Points(x.T, w, lineage=lineage), Points(few_x.T, few_w, lineage=few_lineage)
    known = Told(*told), Pace(step, stiff), Inherited(*inherited)
    return CloudState(points, shadow, size, *known, age), count, calm


def _lineage_of(points: Points) -> Ints:
    """Numbers (readings, N) of what points come from; none, where each is its own."""
    return NO_LINES if points.lineage is None else points.lineage


def gone_again(path: Path, models: tuple[Dynamics, ...]) -> Path:
    """A path of which only what begins it is known, and of its predictions the models, spans and steps."""
    x, own = path.x, iter(models)
    passages: list[Passage] = []
    U: list[Floats] = []
    for part, known in enumerate(path.passages):
        u = even(len(x), x.shape[1], known.key, part)
        passage = known
        if known.span[1] > known.span[0]:
            passage = _passage(next(own), x, known.span, Steps(*known.steps), known.key)
        x = gone(passage, x, u, path.block, False)
        passages.append(passage)
        U.append(u)
    return Path(path.x, path.block, tuple(passages), tuple(U), path.older)


def normals(count: int, dim: int, key: Any, parts: int, first: int = 0) -> tuple[Floats, ...]:
    """Standard normals (count, dim) of each part of a path, by numbers of a key from a first one on."""
    return tuple(even(count, dim, stored_key(key, first + k), k) for k in range(parts))


def gone(passage: Passage, x: Floats, u: Floats, block: Ints, again: bool) -> Floats:
    """Points (N, n) at the end of a passage, from x, with ends moved by u; `again`: other noise beside."""
    if passage.leg is None:
        about = block, passage.start, passage.end, passage.flow, passage.lower
        return np.asarray(affine(columns(x), columns(u), *about).T)
    key = sub_key(passage.key, AGAIN if again else FIRST)
    with surfacing():
        return np.asarray(moved_over(passage.leg, columns(x), columns(u), passage.rows, block, key).T)


def leg_of(model: Dynamics, t0: float, t1: float, steps: int, stiff: bool = False) -> Leg:
    """A model over an interval, as compiled code takes it."""
    return _leg(model, stiff)._replace(t=t0, h=(t1 - t0) / steps, steps=steps)


@lru_cache(maxsize=64)
def _leg(model: Dynamics, stiff: bool) -> Leg:
    """A model over no time yet."""
    own: tuple[Any, ...]
    if isinstance(model, DiscreteModel):
        own = model.step_batch, model.jacobian_batch, None, None, MAPPED, LINEARISE_MAP, MOVE
        Q, kinds = model.covariance, (NORMAL, False, False)
    else:
        assert isinstance(model, SDE)
        additive, flow = not model.state_dependent_noise, (model.flow_drift_batch, model.flow_jacobian_batch)
        moves = STIFF_FLOW if stiff else FLOW, BESIDE if additive else BETWEEN, LINEARISE, MOVE
        own, Q = (*flow, model.noise_batch, *moves), model.spectral_density
        walls = "reflecting" in model.domain.kinds
        kinds = ADDITIVE if additive else OF_STATE, model.constant_diffusion, walls
    at = [NOWHERE_AT if function is None else address_of(function) for function in own]
    return Leg._make([*at, model.p, noise_root(Q), model.domain.codes, 0.0, 0.0, 0, *kinds])


def chosen_steps(
    points: Points,
    model: Dynamics,
    span: tuple[float, float],
    begin: Steps,
    bounds: tuple[int, int],
    allowed: float,
    key: int = 0,
) -> tuple[Steps, Bias, float]:
    """Steps within bounds, and their `Bias`, which is allowed; more than the most where that is not enough.

    The last number is the part of a few points that the model carries to infinity.
    """
    motion, cloud = (_leg(model, False), address_of(STIFF_FLOW)), (columns(points.x), points.w)
    about = span, cloud, key, places(model.dim), begin, bounds
    with surfacing():
        number, stiff, bias, lost = chosen(motion, *about, allowed)
    return Steps(number, stiff), Bias(*bias), lost


def _passage(model: Dynamics, x: Floats, span: tuple[float, float], steps: Steps, key: int) -> Passage:
    """A model over an interval, linearised about blocks of points x (N, n)."""
    start = centres(columns(x))
    if model.linear:
        return _changed(model, key, start, change_of(model, span[1] - span[0]))._replace(
            span=span, steps=steps
        )
    leg = leg_of(model, *span, *steps)
    return Passage(leg, key, start, *_linearised(leg, start), model, span, steps)


def relinearised(passage: Passage, start: Floats, key: int) -> Passage:
    """A passage linearised about other centres (blocks, n)."""
    if passage.leg is None:  # the same in all blocks
        flow, lower = passage.flow[0], passage.lower[0]
        change = flow, passage.end[0] - flow @ passage.start[0], lower
        return _changed(passage.model, key, start, change)._replace(span=passage.span)
    end, flow, lower, rows = _linearised(passage.leg, start)
    return passage._replace(key=key, start=start, end=end, flow=flow, lower=lower, rows=rows)


def _linearised(leg: Leg, start: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Ends of centres (blocks, n), Φ, L and V of a leg."""
    with surfacing():
        end, flow, lower, rows = linearised(leg, start)
    return end, flow, lower, rows


class Transitions(NamedTuple):
    """A passage linearised about each of N states by itself, end + L u with u standard normal."""

    model: Dynamics
    span: tuple[float, float]
    steps: Steps
    x: Floats  # (N, n), at the begin
    end: Floats  # (N, n), without noise
    lower: Floats  # L, (N, n, n)
    rows: Floats | None  # V, (N, n, d); None: the model is linear

    @classmethod
    def of(cls, model: Dynamics, x: Floats, span: tuple[float, float], steps: Steps) -> "Transitions":
        """Linearise about states x (N, n), as many at once as steps have `ENTRIES`."""
        if model.linear:
            Phi, offset, L = change_of(model, span[1] - span[0])
            lower = np.broadcast_to(L, (len(x), *L.shape)).copy()
            return cls(model, span, steps, x, np.einsum("ab,ib->ia", Phi, x) + offset, lower, None)
        leg, many = leg_of(model, *span, *steps), max(ENTRIES // (steps.number * model.dim**2), 1)
        ends, _, lowers, rows = zip(
            *[_linearised(leg, x[k : k + many]) for k in range(0, len(x), many)], strict=True
        )
        return cls(model, span, steps, x, *map(np.concatenate, (ends, lowers, rows)))

    def moved(self, u: Floats, key: int, number: Ints | None = None) -> Floats:
        """Ends (M, n), as the model has them, of states of numbers (M,) or of all, moved by u (M, n)."""
        number = np.arange(len(self.x)) if number is None else number
        if self.rows is None:
            return self.end[number] + np.einsum("iab,ib->ia", self.lower[number], u)
        leg, block = leg_of(self.model, *self.span, *self.steps), np.arange(len(number))
        about = columns(self.x[number]), columns(u), self.rows[number], block, sub_key(key, FIRST)
        with surfacing():
            return np.asarray(moved_over(leg, *about).T)


def _changed(
    model: Dynamics | None, key: int, start: Floats, change: tuple[Floats, Floats, Floats]
) -> Passage:
    """A change Φ x + offset + L u of points in blocks of these centres (blocks, n)."""
    end, flow, lower = everywhere(change, start)
    return Passage(None, key, start, end, flow, lower, _NO_ROWS, model)


def along(x: Floats, w: Floats) -> Ints:
    """Numbers of points (N, n) in an order in which neighbours follow each other."""
    return along_curve(columns(x), as_compiled(w), *places(x.shape[1]))
