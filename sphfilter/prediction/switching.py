"""Modes carried together: each by its own equation, with jumps between.

∂p_i/∂t = L_i p_i + Σ_j λ_ji p_j is split: every mode goes by its own equation, but for some times at which
states jump. These are the nodes of Gauss's rule, and states jump for as long there as the rule weighs them:
for densities that have jumped once on the way that is as good as the rule (Strang's even steps are but a
trapezoidal one). There are as many times as the estimated error asks for. Points take jumps each by
itself (`jumping`); of other densities sums are made at every time (`mixing`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats
from ..config import CloudScheme, FilterConfig
from ..core.cloud.control import power_of_two
from ..core.limits import ADDED
from ..density.as_family import gaussians_of
from ..density.family import ON_LATTICE
from ..density.memory import Memory, error_budget
from ..density.modes import ModeDensities, SplittingError, no_ripple
from ..density.particle_density import ParticleDensity
from ..errors import PropagationError
from ..info import Code, PredictInfo, codes_of
from ..model.dynamics import Dynamics
from ..model.jump_markov import JumpMarkovModel
from .again import Outcome, or_as_cloud
from .jumping import UNLIKELY, Way, carried_with_jumps, suits
from .ladder import as_asked
from .mixing import Allowed
from .mixing_modes import summed
from .pieces import carried_exactly
from .predict import predict
from .splitting_error import jumps_of, splitting_error, with_excursions

MOST_SUBSTEPS = 256  # of an interval; measured: half and twice change no run
_COARSE = "{} steps of the jumps between modes leave {:.2g} of the probability in doubt"
#: What errors of many steps add up by, of each read-out; those of all others add up as of "family".
_KINDS = {"family": "family", "log_density": "log_density", "cloud": "cloud"}


@dataclass(frozen=True, kw_only=True)
class ModesInfo(PredictInfo):
    """One prediction of all modes of a model that switches.

    Attributes
    ----------
    n_substeps : int
        Steps of the splitting; of maps one, as they need none.
    splitting_error : float
        Estimated part of the probability that this splitting has put at wrong states; in `error`.
    modes : dict of str to PredictInfo
        What was said of each mode that had a probability.
    """

    n_substeps: int = 1
    splitting_error: float = 0.0
    modes: dict[str, PredictInfo] = field(default_factory=dict)


class ModesPrediction(NamedTuple):
    """The last prediction of all modes, should it have to be made again."""

    before: ModeDensities  # that it began with
    n_substeps: int  # of its splitting
    model: JumpMarkovModel


def predict_modes(
    modes: ModeDensities,
    model: JumpMarkovModel,
    t1: float,
    config: FilterConfig,
    n_particles: int | str,
    n_substeps: int | None = None,
    apart: float = 1.0,
    reach: float = 1.0,
) -> tuple[ModeDensities, ModesInfo]:
    """Carry the densities of all modes to time t1, seconds, later than they are.

    The splitting has as many steps as its error asks for, unless `n_substeps` are given: it may be off by
    `ADDED` of the target (measured: errors are .8 to 1.1 times as large with half, 1 to 2.1 times with twice,
    for .9 and .7 times the work). Mergers of Gaussians are to change `apart` times less than usual, `reach`
    times as far out. The number of particles is as of `predict`. Raises `PropagationError` if a mode that is
    not unlikely cannot be carried; it says why.
    """
    t0, target, jumps = modes.heaviest.t, config.target_error, model.rates.any()
    steps, off = 1, [no_ripple(model.dim) for _ in model.names]
    if jumps and model.transitions is None:
        steps, off = _steps(modes, model, t1 - t0, ADDED * config.target_error, n_substeps)
    told, way = _Told(model.names), Way.of(model, (t0, t1), steps)
    count = _points(modes, model, config, n_particles) if jumps else 0
    unsure, wrong = way.in_doubt(modes)
    moved = None if count else _in_turn(modes, model, way, config, n_particles, apart, reach, told)
    if moved is None:
        told, forced = _Told(model.names), isinstance(config.scheme, CloudScheme)
        moved, infos = carried_with_jumps(modes, model, way, count or points_of_modes(modes, target), target)
        for i, info in infos.items():
            told.hear(i, info if forced else as_asked(info, target))
    modes = moved
    whole = np.array([ripple.mass for ripple in off])
    splitting = np.sqrt(modes.splitting**2 + whole**2 + np.minimum(wrong, 1.0) ** 2)
    modes = modes.noted(splitting=splitting, ripples=off, unsure=unsure)
    return modes, told.info(modes, steps, float(modes.w @ whole), target)


def _points(modes: ModeDensities, model: JumpMarkovModel, config: FilterConfig, n_particles: Any) -> int:
    """Points of a cloud for each mode, where modes go as clouds; else zero."""
    if isinstance(config.scheme, CloudScheme):
        return config.scheme.n_points
    needs = [density.needs for _, _, density in modes.some if density.needs is not None]
    if config.scheme != "auto" or n_particles != "auto" or len(needs) < len(modes.some):
        return 0
    sums = needs[0].smooth and model.dim <= ON_LATTICE
    as_points = not sums and (suits(model) or goes_as_points(modes))
    return points_of_modes(modes, config.target_error) if as_points else 0


def points_of_modes(modes: ModeDensities, target: float) -> int:
    """Points of a cloud for each mode that a target asks for, by the modes' shares in its error."""
    needs = [(log_w, density.needs or Memory(), density.dim) for _, log_w, density in modes.some]
    return int(power_of_two(sum(math.exp(log_w) * own.cloud(target, dim) for log_w, own, dim in needs)))


def goes_as_points(modes: ModeDensities) -> bool:
    """Whether a density goes as points."""
    return any(density.form.own_points for _, _, density in modes.some)


def _in_turn(
    modes: ModeDensities,
    model: JumpMarkovModel,
    way: Way,
    config: FilterConfig,
    n_particles: int | str,
    apart: float,
    reach: float,
    told: "_Told",
) -> ModeDensities | None:
    """The densities of all modes at the end of a way, which are carried, and mixed at its times of jumps.

    None where a sum would go on as points in more than one state: points take jumps each by itself.
    """
    target, steps = config.target_error, max(len(way.jumps), 1)
    allowed = error_budget(modes.error, target)
    # what steps add to polynomials and pieces is alike, and adds up; of lattices it comes as it may
    each = Allowed(allowed / (steps + 1) / apart, allowed / math.sqrt(steps + 1), reach)
    smaller = [config.target_error / part for part in (steps, math.sqrt(steps), 1.0)]
    configs = dict(zip(_KINDS, (replace(config, target_error=error) for error in smaller), strict=True))
    for t, P in zip(way.times[1:-1].tolist(), way.jumps, strict=True):
        modes = _carried(modes, model, t, configs, n_particles, told)
        modes = _switched(modes, P, target, each)
        if model.dim > 1 and goes_as_points(modes) and not model.domain.walled.any():
            return None
    return _carried(modes, model, way.span[1], configs, n_particles, told)


class _Told:
    """Infos of the modes' predictions, and the one that is made of them."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._infos: list[list[PredictInfo]] = [[] for _ in names]

    def hear(self, i: int, info: PredictInfo) -> None:
        self._infos[i].append(info)

    def info(self, modes: ModeDensities, steps: int, splitting: float, target: float) -> ModesInfo:
        """All of it as one; flags of modes that matter."""
        joined = {i: PredictInfo.joined(infos) for i, infos in enumerate(self._infos) if infos}
        whole = PredictInfo.joined(list(joined.values()))
        flagged = {i: info for i, info in joined.items() if info.flagged and modes.w[i] > target}
        said = "; ".join(f"{self._names[i]}: {info.status}" for i, info in flagged.items()) or "ok"
        names = ("n_steps", "n_evaluations", "mass_error", "scheme", "skipped")
        found = ModesInfo(
            **{name: getattr(whole, name) for name in names},
            error=modes.error,
            status=said,
            code=codes_of(flagged.values()),
            n_substeps=steps,
            splitting_error=splitting,
            modes={self._names[i]: info for i, info in joined.items()},
        )
        return found.also(Code.COARSE, _COARSE.format(steps, splitting)) if splitting > target else found


def _switched(modes: ModeDensities, P: Floats, target: float, allowed: Allowed) -> ModeDensities:
    """The densities after jumps of probabilities P (M, M) between modes, in which states do not move."""
    with np.errstate(divide="ignore"):
        log_P = np.log(P)
    rows = [[own] * len(log_P) for own in modes.densities]
    splitting = np.broadcast_to(modes.splitting[:, None], log_P.shape)
    return summed(modes.log_w[:, None] + log_P, rows, splitting, target, allowed)


def _carried(
    modes: ModeDensities,
    model: JumpMarkovModel,
    t: float,
    configs: Mapping[str, FilterConfig],
    n_particles: Any,
    told: _Told,
) -> ModeDensities:
    """Every mode by its own equation to time t; an unlikely one that cannot be carried ends.

    The configurations have the target errors of one step of many, by the kind of the density.
    """
    if t == modes.heaviest.t:
        return modes
    log_w, densities = modes.log_w.copy(), list(modes.densities)
    for i, own, density in modes.some:
        sde = model.modes[model.names[i]]
        if sde.linear and sde.domain.unbounded and (density.gaussian or gaussians_of(density)):
            densities[i] = carried_exactly(density, sde, t)
            told.hear(i, PredictInfo(scheme="exact_linear", error=density.error))
            continue

        def predicted(
            config: Any, density: ParticleDensity = density, sde: Dynamics = sde
        ) -> Outcome[PredictInfo]:
            options: dict[str, Any] = {"t": t, "n_particles": n_particles, "goes_on": False}
            moved, info = predict(density, sde, config=config, **options)
            return Outcome(density, moved, info, moved.n_particles)

        try:
            outcome = or_as_cloud(predicted, configs[_kind(density)])
            if _kind(outcome.density) != _kind(density):  # which needs no more than its own kind does
                outcome = or_as_cloud(predicted, configs[_kind(outcome.density)])
        except PropagationError as problem:
            if own > math.log(UNLIKELY):
                raise PropagationError(f"mode {model.names[i]!r}: {problem}") from problem
            log_w[i], densities[i] = -math.inf, None
            continue
        densities[i] = outcome.density
        told.hear(i, outcome.info)
    return modes.noted(log_w=log_w, densities=densities)


def _kind(density: ParticleDensity) -> str:
    return _KINDS.get(density.read_out, "family")


def _steps(
    modes: ModeDensities, model: JumpMarkovModel, dt: float, allowed: float, given: int | None
) -> tuple[int, list[SplittingError]]:
    """Steps of the splitting that an error needs, and what it is then in each mode."""
    steps, w = 1 if given is None else given, modes.w @ model.transition(dt)
    while True:
        off = splitting_error(modes, model, dt, steps)
        error = float(w @ [ripple.mass for ripple in off])
        if given is not None or error <= allowed or steps == MOST_SUBSTEPS:
            return steps, with_excursions(off, modes, model, dt, steps)
        more = math.ceil(steps * (error / allowed) ** 0.25)  # errors of Gauss fall faster
        steps, pieces = min(max(more, steps + 1), 2 * steps), math.ceil(jumps_of(model, dt))
        steps = min(pieces * math.ceil(steps / pieces) if steps > pieces else steps, MOST_SUBSTEPS)
