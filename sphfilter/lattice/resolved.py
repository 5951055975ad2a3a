"""A posterior laid again where its lattice overlooks a peak, does not resolve it, or leaves out too much."""

import math
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.special import gammaincc

from .._types import Bools, Floats, OfStates
from ..core.field.field import Field
from ..core.field.walls import NO_WALLS, Walls
from ..core.limits import LARGEST_EXPONENT, ROUNDING, SAID, TINY
from ..errors import PropagationError
from . import field as lattice_field
from .check import Misfit, felt, left_out, misfit
from .level_set import LatticeDensity, lay, root_of
from .peaks import Peak, along_axes, peaks
from .posterior import within_pieces
from .regular import mean_and_cov
from .walls import between, inside, moved_in

TOLERATED = 0.05  # residual of a lattice that is not laid again; measured: half takes up to 1.6 times as long
HIGHER = 1.0  # nats above polynomials that overlook something; measured: half, twice move means by .003
TIMES = (1, 3, 9)  # particles of the first try; measured: with (1, 2) means are off by up to .27
#: Particles of a step that is made again. Measured: twice takes up to 1.14 times the work, half the same.
MOST = 20_000
#: Times what a Gaussian leaves out, that may lie beside the nodes; measured: half and twice change no run.
_BESIDE = 10.0
_SHALLOWER = (1.0, 0.75, 0.5)  # depths of a peak's lattice; measured: (1,) fails in test_update_seeing.py


class Search(NamedTuple):
    """How far a posterior is searched for what its lattice does not hold."""

    most_left_out: float  # probability
    lines: bool = False  # is the likelihood asked along lines too?
    named: Floats | None = None  # states (M, n) that peaks may lie at
    surveyed: tuple[Floats, Floats] | None = None  # states (M, n), weights (M,) of the prior; or its nodes
    finer: bool = True  # may it take more particles?
    walls: Walls = NO_WALLS  # where states end


class Resolved(NamedTuple):
    """A posterior, what its lattice gets wrong, and the probability of what was found beyond it."""

    laid: LatticeDensity
    off: Misfit
    left_out: float = 0.0
    times: int = 1  # the particles it may have
    felt: float = 0.0  # as what the probability left out counts, by how far away it is
    between: float = 0.0  # what of it lies between the nodes

    @property
    def wrong(self) -> float:
        """Probability that is wrong with it."""
        return self.off.residual + self.left_out + min(self.off.log_mass, 1.0)


class _Part(NamedTuple):
    """Knowledge of a posterior: weighted states, and the logarithm of their mass."""

    x: Floats
    w: Floats
    log_mass: float
    log_p: Floats | None  # of the states; None if their weights are no more than a survey


#: States (N, n) and masses (N,) of a prior, and its field if they lie on a lattice.
Prior: TypeAlias = tuple[Floats, Floats, Field | None]


def resolved(
    laid: LatticeDensity | PropagationError,
    prior: Prior,
    product: OfStates,
    log_weight: OfStates,
    bounds: tuple[int, float],
    search: Search,
) -> Resolved:
    """Check a posterior against what is found between and beyond its nodes, and lay it again if need be.

    Returns the first lattice that holds and resolves all that was found, or the best of all. Where there was
    none so far, the error that says why stands in its place; it is raised if nothing is found. `product` and
    `log_weight` take states (M, n) to the logarithms (M,) of prior times likelihood, and of the likelihood;
    bounds are the number of particles, and depth.
    """
    x, mass, _ = prior
    tail = float(gammaincc(0.5 * x.shape[1], bounds[1]))  # beyond the cut of a Gaussian
    found = _overlooked(laid, prior, product, log_weight, search)
    parts, tried = [], []
    if isinstance(laid, LatticeDensity):
        moments = laid.mean, laid.cov
        least = laid.log_mass + math.log(search.most_left_out)
        found = [peak for peak in found if peak.log_mass + math.log(felt(*moments, peak.x[None])[0]) > least]
        parts.append(_part_of(laid))
        tried.append(Resolved(laid, misfit(laid, product)))
        survey = _survey(*(search.surveyed or (x, mass)), log_weight, search.walls)
        if _missing(laid, survey)[1] > _BESIDE * (tail + search.most_left_out):
            parts.append(survey)
    best = _best(tried, parts, tail)
    if best is not None and not found and _good(best, search, tail):
        return best
    for new in _tries(laid, found, parts, product, bounds, search):
        tried.append(new)
        best = _best(tried, parts, tail)
        if best is not None and _good(best, search, tail):
            return best
    if best is None:
        assert not isinstance(laid, LatticeDensity)  # which would have been the best
        raise laid
    return best._replace(between=_between(best.laid, parts))


def _good(tried: Resolved, search: Search, tail: float) -> bool:
    resolved = max(tried.off.residual, tried.off.log_mass) < TOLERATED
    return resolved and tried.felt < search.most_left_out + tail


def _part_of(laid: LatticeDensity) -> _Part:
    return _Part(laid.x, laid.mass, laid.log_mass, laid.log_mass + laid.field.log_p[: laid.field.kept])


def _survey(x: Floats, mass: Floats, log_weight: OfStates, walls: Walls) -> _Part:
    """Knowledge that states of the prior have of the posterior, those of them that weigh anything."""
    weight = np.log(np.maximum(mass * inside(walls, x), TINY)) + np.maximum(log_weight(x), -1e250)
    w = np.exp(weight - weight.max())
    some = w > ROUNDING
    return _Part(x[some], w[some] / w.sum(), float(weight.max() + np.log(w.sum())), None)


def _best(tried: list[Resolved], parts: list[_Part], tail: float) -> Resolved | None:
    """The lattice with which least is wrong, going by all parts that are known by now."""
    out = [_left_out(each.laid, parts, tail) for each in tried]
    judged = [e._replace(left_out=left, felt=far) for e, (left, far) in zip(tried, out, strict=True)]
    return min(judged, key=lambda each: each.wrong, default=None)


def _left_out(laid: LatticeDensity, parts: list[_Part], tail: float) -> tuple[float, float]:
    """Probability that a lattice leaves out, and as what it counts: most of a part, or beside its nodes."""
    left = left_out(laid.field, laid.walls)
    left = left if left > SAID + _BESIDE * tail else 0.0
    logs = [min(part.log_mass - laid.log_mass, LARGEST_EXPONENT) for part in parts]
    odds = np.exp(logs)[:, None] * [_missing(laid, part) for part in parts]
    alone = [len(part.x) == 1 for part in parts]  # each apart from the others
    most, counted = np.maximum(odds[alone].sum(axis=0), odds.max(axis=0))
    most = max(left, float(most / (1.0 + most)))
    return most, max(most, float(counted / (1.0 + counted)))


def _between(laid: LatticeDensity, parts: list[_Part]) -> float:
    """Probability that lies between the nodes of a lattice, whose polynomials know nothing of it."""
    most = -math.inf
    for part in parts:
        unknown = part.w @ (_unknown(laid, part) & ~_beside(laid, part))
        most = max(most, math.log(max(float(unknown), TINY)) + part.log_mass - laid.log_mass)
    return 1.0 / (1.0 + math.exp(min(-most, LARGEST_EXPONENT)))


def _missing(laid: LatticeDensity, part: _Part) -> tuple[float, float]:
    """Share of a part that lies in cells without a node, or of which nothing is known; as what it counts."""
    beside, unknown = _beside(laid, part), _unknown(laid, part)
    missing = unknown if part.w @ unknown > part.w @ beside else beside
    w, x = part.w[missing], part.x[missing]
    return float(w.sum()), float(w @ felt(laid.mean, laid.cov, x))


def _beside(laid: LatticeDensity, part: _Part) -> Bools:
    """Whether states (M,) of a part lie in cells without a node."""
    return ~lattice_field.inside_lattice(laid.field, moved_in(laid.walls, laid.field.A, part.x))


def _unknown(laid: LatticeDensity, part: _Part) -> Bools:
    """Whether the polynomials know nothing of states (M,) of a part; of a survey nothing tells."""
    if part.log_p is None:
        return np.zeros(len(part.x), dtype=bool)
    return _above(laid, part.x, part.log_p)


def _above(laid: LatticeDensity, X: Floats, log_p: Floats) -> Bools:
    """Whether a density of logarithms (M,) at states X (M, n) is far above the polynomials."""
    return log_p - laid.log_mass - laid.log_p(X) > HIGHER


def _overlooked(
    laid: LatticeDensity | PropagationError,
    prior: Prior,
    product: OfStates,
    log_weight: OfStates,
    search: Search,
) -> list[Peak]:
    """Peaks of which the polynomials of a lattice know nothing."""
    x, mass, field = prior
    product, log_weight = (between(function, search.walls) for function in (product, log_weight))
    states = [x] if field is None else [x, x + 0.5 * field.A.sum(axis=1)]
    mean, cov = mean_and_cov(x, mass)
    if search.lines:
        states.append(along_axes(product, log_weight, mean, np.sqrt(np.diag(cov))))
    if search.named is not None:
        states.append(search.named)
    X = np.concatenate(states)
    X = X[inside(search.walls, X)]
    if field is not None:  # elsewhere the prior is a guess
        X = X[lattice_field.inside_lattice(field, X)]
    if not len(X):
        return []
    values = product(X)
    factor = root_of(cov, "the density is narrower than the digits of its mean can tell")
    if isinstance(laid, LatticeDensity):
        widest = values + np.log(np.sqrt(2.0 * math.pi) * np.diag(factor)).sum()  # no peak has more mass
        high = widest + np.log(felt(laid.mean, laid.cov, X)) > laid.log_mass + math.log(search.most_left_out)
        X, values = X[high], values[high]
        above = _above(laid, X, values)
        X, values = X[above], values[above]
    elif values.max() < -1e200:
        return []
    if not len(X):
        return []
    farthest = np.linalg.norm(np.linalg.solve(factor, (x - mean).T), axis=0).max()  # a tail is a guess
    found = peaks(product, X, values, factor)
    return [p for p in found if np.linalg.norm(np.linalg.solve(factor, p.x - mean)) < farthest]


def _tries(
    laid: LatticeDensity | PropagationError,
    found: list[Peak],
    parts: list[_Part],
    product: OfStates,
    bounds: tuple[int, float],
    search: Search,
) -> Iterator[Resolved]:
    """Other lattices, the cheapest first; what pieces of their own hold joins the parts that are known."""
    n_particles, depth = bounds
    walls = search.walls
    shape = within_pieces(laid) if isinstance(laid, LatticeDensity) else found[0].factor if found else None
    tops = [_Part(peak.x[None], np.ones(1), peak.log_mass, product(peak.x[None])) for peak in found]
    parts += tops
    # three get a lattice of their own: one and six change no run
    heaviest = sorted(zip(found, tops, strict=True), key=lambda pair: -pair[0].log_mass)[:3]
    for peak, top in heaviest:
        for shallower in _SHALLOWER:
            new = _around(product, peak, n_particles, shallower * depth, walls)
            if new is None:
                continue
            result = Resolved(new, misfit(new, product))
            yield result
            if result.off.residual < TOLERATED and not any(_missing(new, top)):
                parts.append(_part_of(new))
                break
        if shape is not None and np.linalg.det(peak.factor) < np.linalg.det(shape):
            shape = peak.factor
    if shape is None or not parts:
        return
    X = np.concatenate([part.x for part in parts])
    values = product(X)
    highest = values.max()
    deeper = max(depth, min(highest - _level(values, parts), 3.0 * depth))
    X = X[values > highest - deeper]
    if not len(X):  # a likelihood that is nothing at all peaks, where a few nats make no difference
        return
    for times in TIMES if search.finer else TIMES[:1]:
        if times * n_particles > MOST or (times == 1 and len(parts) == 1):
            continue
        try:
            new = lay(product, X[0], shape, X, times * n_particles, deeper, walls=walls)
        except PropagationError:
            continue
        yield Resolved(new, misfit(new, product), times=times)


def _level(values: Floats, parts: list[_Part]) -> float:
    """Height of the lowest part's top, a few nats below which its mass is held too."""
    tops, start = [], 0
    for part in parts:
        tops.append(values[start : start + len(part.x)].max())
        start += len(part.x)
    return float(min(tops)) - 5.0


def _around(
    product: OfStates, peak: Peak, n_particles: int, depth: float, walls: Walls
) -> LatticeDensity | None:
    """A lattice around a peak, in the shape of what it holds; None if there is none."""
    try:
        laid = lay(product, peak.x, peak.factor, peak.x[None], n_particles, depth, walls=walls)
        return lay(product, laid.mean, within_pieces(laid), laid.x, n_particles, depth, walls=walls)
    except (PropagationError, np.linalg.LinAlgError):
        return None
