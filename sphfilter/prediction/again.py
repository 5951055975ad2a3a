"""Again on more particles: the one ladder that predictions and updates climb, and what comes of a step."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Generic, NamedTuple, Protocol, TypeVar

from ..config import AnyConfig, CloudScheme
from ..core.limits import ADDED
from ..core.step_control import HELPED, MORE, TRIES
from ..density.memory import error_budget
from ..density.particle_density import ParticleDensity
from ..errors import LatticeError, PropagationError, StoppedError, UnresolvedError
from ..info import Code, PredictInfo, UpdateInfo
from ..lattice.level_set import min_nodes
from ..lattice.resolved import MOST, TIMES
from ..model.dynamics import Dynamics
from ..model.sde import SDE
from ._shared import Predicted

Info = TypeVar("Info", PredictInfo, UpdateInfo)
Found = TypeVar("Found")

#: How many times finer a lattice may be along an axis than that of the density it starts from: beyond, it
#: sees the borders between that one's polynomials. Measured: 2 and 6 change no run.
FINEST = 3
#: Evaluations of the drift that a step may take which is made again: some ten times those of a cloud.
#: Measured: half and twice change no run.
MOST_WORK = 1e7
ORDER = 1.5  # the error of a lattice falls about as N^-1.5


class Outcome(NamedTuple, Generic[Info]):
    """Outcome of a step."""

    before: ParticleDensity  # that the step began with: a finer one, where it had to be made anew
    density: ParticleDensity  # that it ended with
    info: Info
    bound: int  # particles that the next lattice may have


class Rung(NamedTuple):
    """One more try of a step."""

    level: int  # 1, 2, ...
    times: int  # the particles of the first try
    n_particles: int
    deeper: float  # standard deviations that lattices reach further than on the first try


class Ladder(NamedTuple):
    """Numbers of particles that a step is tried on again."""

    times: tuple[int, ...] = TIMES[1:]  # the particles of the first try
    deeper: float = 0.0  # standard deviations that lattices reach further on each rung than on the one below
    most: float = MOST  # particles

    def rungs(self, n_particles: int) -> Iterator[Rung]:
        """The tries above one on `n_particles`, as far as there may be so many."""
        for level, times in enumerate(self.times, start=1):
            if times * n_particles > self.most:
                return
            yield Rung(level, times, times * n_particles, level * self.deeper)

    def within(self, dim: int) -> "Ladder":
        """The ladder for a lattice of `dim` states: no rung finer than `FINEST` allows, nor one twice."""
        times = tuple(min(times, FINEST**dim) for times in self.times)
        return self._replace(times=times if self.deeper else tuple(dict.fromkeys(times)))

    def climbed(
        self, n_particles: int, attempt: Callable[[Rung], Found], problem: PropagationError | None = None
    ) -> tuple[Rung, Found]:
        """The first rung on which an attempt raises no `PropagationError`, with what it returned.

        Where there is none, or the next would be too much work, what stopped the first try is raised: the
        `problem`, if one was made before. On so many times the particles a try is so many times the work.
        """
        before, work = 1, 0.0 if problem is None else problem.work
        for rung in self.rungs(n_particles):
            if work * rung.times / before > MOST_WORK:
                break
            before = rung.times
            try:
                return rung, attempt(rung)
            except PropagationError as again:
                problem, work = problem or again, again.work
                problem.work = max(problem.work, work)
        raise problem or PropagationError(f"no step is made again on more than {self.most:g} particles")


def or_as_cloud(
    predicted: Callable[[AnyConfig], Outcome[PredictInfo]], config: AnyConfig
) -> Outcome[PredictInfo]:
    """Predict; where ``scheme="auto"`` is refused, go on as a cloud, which says what the problem was.

    `predicted` makes the `Outcome` of a prediction of a configuration. What was refused is raised if a cloud
    is refused too.
    """
    try:
        return predicted(config)
    except PropagationError as problem:
        if config.scheme != "auto":
            raise
        try:
            outcome = predicted(replace(config, scheme=CloudScheme()))
        except Exception:  # a black-box drift may raise anything; the first problem says what
            raise problem from problem.__cause__
        info = outcome.info
        return outcome._replace(info=info.marked(Code.FALLBACK, f"{info.status}; {problem}"))


class Origin(Protocol):
    """The step that a density comes from."""

    @property
    def before(self) -> ParticleDensity | None:
        """The density that the step began with."""

    def repeated(self, config: AnyConfig, n_particles: int, /) -> ParticleDensity:
        """The density it ended with on another number of particles."""


def predict_from_finer(
    predicted: Callable[[ParticleDensity], Outcome[PredictInfo]],
    model: Dynamics,
    density: ParticleDensity,
    origin: Origin | None,
    config: AnyConfig,
    n_particles: int,
) -> Outcome[PredictInfo]:
    """Predict; if the density is too coarse for that, repeat what led to it on more particles.

    `predicted` makes the `Outcome` of a prediction of a density, and `origin` is the step that the density
    comes from, made with `n_particles` at most.
    """
    try:
        return predicted(density)
    except (LatticeError, UnresolvedError) as problem:
        # else nothing smooths what is coarse
        noisy = not isinstance(model, SDE) or model.diffusion_rows.any()
        if origin is None or origin.before is None or origin.before.form.cell is None or not noisy:
            raise
        rung, outcome = Ladder().climbed(
            n_particles, lambda rung: predicted(origin.repeated(config, rung.n_particles)), problem
        )
        status = f"the {type(origin).__name__.lower()} before repeated on {rung.times} times the particles"
        return outcome._replace(info=outcome.info.marked(Code.REPEATED, status))


class Time(NamedTuple):
    """Numbers of particles that a time budget leaves for the first try, and for one more on a number."""

    most: int = MOST
    fits: Callable[[int], bool] = lambda n_particles: True

    def for_lattices(self, density: ParticleDensity, target: float) -> float:
        """Error by which the lattices of a prediction choose their nodes; zero where time chooses them.

        Where the past uses up the target, and readings forget little of it, a lattice may add `ADDED`, and
        half of that is not tried again. Measured: half and twice change no run.
        """
        return error_budget(density.error, target, ADDED) if self.most >= MOST else 0.0


#: No time budget.
ALWAYS = Time()


def carried_to_target(
    density: ParticleDensity,
    predicted: Callable[[int], Predicted],
    target: float,
    n_particles: int,
    time: Time = ALWAYS,
    most_work: float = math.inf,
) -> tuple[ParticleDensity, PredictInfo, int]:
    """Predict on a lattice, again with more nodes where the estimated error is above the target.

    `predicted` makes the prediction of the density on a number of nodes, of which the first try has
    `n_particles`; the target is in standard deviations, and all tries may take `most_work` evaluations of the
    drift together. Returns what was predicted, and the number of nodes for the next step. Raises
    `PropagationError` if the first try could not be made, or the one that the target asks for next is too
    much work.
    """
    best: tuple[ParticleDensity, PredictInfo, int] | None = None
    ratio, allowed, work = math.inf, error_budget(density.error, target), 0.0
    n_particles = min(n_particles, time.most)
    for _ in range(1 + TRIES):
        try:
            moved, info = predicted(n_particles)
        except PropagationError:
            if best is None:
                raise
            break
        if moved.form.cell is None:
            return moved, info, n_particles
        alike = best is not None and best[1].code == info.code == Code.OK
        if best is not None and alike and info.mass_error > HELPED * best[1].mass_error:
            break  # the density itself is coarse, not what it becomes
        best = moved, info, n_particles
        ratio = math.sqrt(max(info.error**2 - density.error**2, 0.0)) / allowed
        if not ratio > 1.0 or n_particles >= MOST:
            break
        more = min(math.ceil(n_particles * min(max(ratio ** (1.0 / ORDER), 1.2), 3.0)), MOST)
        work += info.n_evaluations
        if work + info.n_evaluations * more / n_particles > most_work:
            raise StoppedError(f"a lattice of {more} particles would take more work than there may be")
        if not time.fits(more):
            late = f"the prediction on {more} particles that the target asks for: no time for it"
            best = moved, replace(info, skipped=(*info.skipped, late)), n_particles
            break
        n_particles = more
    assert best is not None  # the first try raises or is one
    moved, info, bound = best
    if ratio < 1.0 / MORE:
        bound = max(min_nodes(density.dim), int(0.8 * bound))
    return moved, info, bound
