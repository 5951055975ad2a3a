"""Prediction: a density carried through the Fokker-Planck-Kolmogorov equation."""

from dataclasses import replace
from time import perf_counter
from typing import Any, Literal, NamedTuple

from .._types import Interval
from ..config import AnyConfig, CloudScheme, FamilyScheme, LogDensityScheme, PaperScheme, SolverConfig
from ..density.as_cloud import passages_of
from ..density.memory import Memory
from ..density.particle_density import ParticleDensity
from ..density.resample import max_particles_of, on_lattice, target_of
from ..errors import LatticeError, ModelError, PropagationError, UnresolvedError
from ..info import PredictInfo
from ..model.asking import asked_before, tell_of
from ..model.discrete import DiscreteModel
from ..model.domain import Domain
from ..model.dynamics import Dynamics
from ..model.sde import SDE
from ..model.timing import spans
from ..validate import count, end_of
from . import automatic, chapman_kolmogorov, cloud, family, ladder, log_density, paper
from ._shared import Predicted
from .again import ALWAYS, Ladder, Outcome, Time, carried_to_target, or_as_cloud
from .pieces import propagate_exactly


def predict(
    density: ParticleDensity,
    model: Dynamics,
    dt: Interval | None = None,
    config: AnyConfig | None = None,
    *,
    t: float | None = None,
    n_particles: int | Literal["auto"] | None = None,
    most_particles: int | None = None,
    goes_on: bool = True,
    time: Time = ALWAYS,
) -> Predicted:
    """Carry a density over dt seconds, or to time t.

    Parameters
    ----------
    density : ParticleDensity
    model : SDE or DiscreteModel
        One in discrete time goes over whole steps.
    dt : float or timedelta, optional
        Interval, seconds, >= 0.
    config : SolverConfig or FilterConfig, optional
    t : float, optional
        Absolute time to predict to, seconds, instead of dt.
    n_particles : int or "auto", optional
        Upper bound of the number of particles, should re-gridding be needed; the density's own if not given.
        With "auto", and from then on, every step takes the cheapest representation that keeps the estimated
        error within the configuration's `target_error` (of a `SolverConfig`, .01).
    most_particles : int, optional
        Particles at most of a prediction that ``scheme="auto"`` makes again where a lattice loses
        probability; 30,000 if not given.
    goes_on : bool
        Whether ``scheme="auto"`` goes on as a cloud of points, and says so, where what it tried is refused;
        if not, the refusal is raised.
    time : Time, optional
        What a time budget leaves of particles, with "auto".

    Returns
    -------
    ParticleDensity, PredictInfo

    Raises
    ------
    ModelError
        The interval is negative, or model and density differ in dimension.
    PropagationError
        The model blew up; the sentence says when, where and what to change.

    Examples
    --------
    >>> import sphfilter as sf
    >>> well = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    >>> start = sf.initialize(sf.Gaussian([0.0], [[0.1]]), n_particles=100)
    >>> later, info = sf.predict(start, well, 2.0)
    >>> print(f"t = {later.t}, {info.scheme}, {info.status}, variance {later.cov()[0, 0]:.3f}")
    t = 2.0, log_density, ok, variance 0.788
    """
    began = perf_counter()
    if model.dim != density.dim:
        raise ModelError(f"the model has {model.dim} states, the density {density.dim}")
    end = end_of(density.t, dt, t)
    density = _in_domain(density, model.domain)
    config = config or SolverConfig()
    scheme = config.scheme
    if not isinstance(model, SDE):
        _check_steps(model, scheme, density.t, end)
    if end == density.t:
        name = scheme if isinstance(scheme, str) else scheme.name
        return density, PredictInfo(scheme=name, skipped=("everything: the interval is empty",))
    if most_particles is not None:
        most_particles = count("most_particles", most_particles, least=0)
    target, bound = target_of(density, config, n_particles), max_particles_of(density, n_particles)
    infos, start = [], density.t

    def carried(density: ParticleDensity, t1: float) -> ParticleDensity:
        left_out = cloud.left_out_later(density, model, t1)
        if target is None:
            density, info = _on_particles(density, model, t1, config, bound, most_particles, goes_on)
        else:
            density, info = _to_target(density, model, t1, config, target, time)
        infos.append(info)
        return density.noted(left_out=left_out)

    known = asked_before()
    for begin, stop in spans(model.breaks(start, end), start, end):
        density = carried(density if density.t == begin else density.noted(t=begin), stop)
    density = density if density.t == end else density.noted(t=end)
    took = perf_counter() - began
    tell_of(known, took)
    return density, PredictInfo.joined(infos).noted(seconds=took)


def _check_steps(model: Dynamics, scheme: Any, t0: float, t1: float) -> None:
    """Refuse what no step of a model in discrete time can do: part of one, or a scheme that has none."""
    if not isinstance(scheme, CloudScheme | LogDensityScheme | str):
        raise ModelError(
            f"a model in discrete time has no equation that the scheme {scheme.name!r} could solve: leave "
            f"the scheme to the default, or give scheme='cloud' or scheme='log_density'"
        )
    model.own_steps(t0, t1)


def _to_target(
    density: ParticleDensity, model: Dynamics, t1: float, config: AnyConfig, target: float, time: Time
) -> Predicted:
    """Carry a density to time t1, up to which the model does not jump, with a target error."""
    scheme = config.scheme
    if not isinstance(scheme, LogDensityScheme):
        return ladder.propagate(density, model, t1, target, time)

    def on(nodes: int) -> Predicted:
        allowed = time.for_lattices(density, target)
        if isinstance(model, DiscreteModel):
            return chapman_kolmogorov.propagate(density, model, t1, nodes)
        assert isinstance(model, SDE)
        return log_density.propagate(on_lattice(density, nodes), model, t1, scheme, nodes, allowed)

    def predicted(nodes: int) -> Predicted:
        try:
            return on(nodes)
        except (LatticeError, UnresolvedError) as problem:
            return Ladder().within(model.dim).climbed(nodes, lambda rung: on(rung.n_particles), problem)[1]

    first = max_particles_of(density, "auto")
    moved, info, nodes = carried_to_target(density, predicted, target, first, time)
    return moved.noted(needs=(density.needs or Memory())._replace(nodes=nodes), capacity=nodes), info


def _on_particles(
    density: ParticleDensity,
    model: Dynamics,
    t1: float,
    config: AnyConfig,
    n_particles: int,
    most_particles: int | None,
    goes_on: bool,
) -> Predicted:
    """Carry a density to time t1, up to which the model does not jump, on a number of particles."""
    as_it_is = isinstance(config.scheme, FamilyScheme | CloudScheme) or isinstance(model, DiscreteModel)
    density = density if as_it_is else on_lattice(density, n_particles)
    if config.exact_linear and model.linear:
        exact = propagate_exactly(density, model, t1, n_particles)
        if exact is not None:
            return exact
    if isinstance(model, DiscreteModel):
        return _in_steps(density, model, t1, config.scheme, n_particles)
    assert isinstance(model, SDE)

    def predicted(config: AnyConfig) -> Outcome[PredictInfo]:
        if config.scheme == "auto":
            moved = automatic.propagate(density, model, t1, n_particles, most_particles)
        else:
            propagate: Any = _SCHEMES[type(config.scheme)]
            moved = propagate(density, model, t1, config.scheme, n_particles)
        return Outcome(density, *moved, n_particles)

    outcome = or_as_cloud(predicted, config) if goes_on else predicted(config)
    return outcome.density, outcome.info


def _in_steps(
    density: ParticleDensity, model: DiscreteModel, t1: float, scheme: Any, n_particles: int
) -> Predicted:
    """Carry a density by a model in discrete time: on a lattice of so many nodes, or as a cloud."""
    if not isinstance(scheme, CloudScheme):
        reason = chapman_kolmogorov.why_not(model)
        try:
            if not reason:
                return chapman_kolmogorov.propagate(density, model, t1, n_particles)
        except PropagationError as problem:
            reason = str(problem)
        if scheme != "auto":
            raise PropagationError(reason)
    points = scheme if isinstance(scheme, CloudScheme) else CloudScheme()
    return cloud.propagate(density, model, t1, points, n_particles)


class Prediction(NamedTuple):
    """The last prediction of a filter: where its density comes from."""

    before: ParticleDensity | None = None  # that it began with; None if there was none
    lost: float = 0.0  # probability that the lattices lost
    model: Dynamics | None = None
    t: float = 0.0  # seconds, where it ended
    readings: tuple[Any, ...] = ()  # used since: pairs of sensor and numbers
    prior: ParticleDensity | None = None  # of the first of them
    log_evidence: float = 0.0  # of them all
    #: Models of predictions before it, and where each ended, seconds: what carries points goes back to the
    #: last reading.
    earlier: tuple[tuple[Dynamics, float], ...] = ()

    @classmethod
    def after(
        cls, origin: Any, before: ParticleDensity, lost: float, model: Dynamics, density: ParticleDensity
    ) -> "Prediction":
        """The prediction that led from one density to another, where the first one is of this origin."""
        goes_on = len(passages_of(density)) > 2  # noise, and more than this prediction
        if goes_on and isinstance(origin, Prediction) and origin.before is not None:
            return cls(origin.before, lost, model, density.t, earlier=origin.legs)
        return cls(before, lost, model, density.t)

    @property
    def legs(self) -> tuple[tuple[Dynamics, float], ...]:
        """Models and ends of the predictions since `before`, this one the last."""
        return () if self.model is None else (*self.earlier, (self.model, self.t))

    def repeated(self, config: AnyConfig, n_particles: int) -> ParticleDensity:
        """The density it ended with on another number of particles."""
        assert self.before is not None
        return self.from_density(self.before, config, n_particles)

    def from_density(self, density: ParticleDensity, config: Any, n_particles: Any) -> ParticleDensity:
        """What the prediction makes of a density instead."""
        for model, t in self.legs:
            options: dict[str, Any] = {"t": t, "n_particles": n_particles, "goes_on": False}
            density = predict(density, model, config=config, **options)[0]
        return density


def load(model: Dynamics, density: ParticleDensity, config: AnyConfig) -> CloudScheme | PaperScheme | None:
    """Compile what predictions call only now and then; returns the scheme they may fall back on, or None."""
    if isinstance(config.scheme, PaperScheme | CloudScheme | FamilyScheme):
        return None
    if not isinstance(model, SDE):
        return CloudScheme()
    if not log_density.why_not(model, density, density.n_particles):
        log_density.load(model)
    if config.scheme != "auto":
        return None
    return CloudScheme() if model.domain.unbounded else automatic.SUMMED


def _in_domain(density: ParticleDensity, domain: Domain) -> ParticleDensity:
    """The density with the domain of a model."""
    if domain.unbounded:
        return density
    outside = ~domain.contains(density.x)
    if outside.any():
        raise ModelError(
            f"{outside.sum()} particles lie beyond the walls of the model's {domain}, one at "
            f"{density.x[outside][0]}: give initialize the same domain="
        )
    return density if density.domain == domain else replace(density, domain=domain)


_SCHEMES = {
    LogDensityScheme: log_density.propagate,
    PaperScheme: paper.propagate,
    CloudScheme: cloud.propagate,
    FamilyScheme: family.propagate,
}
