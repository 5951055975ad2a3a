"""Prediction: a density carried through the Fokker-Planck-Kolmogorov equation."""

from dataclasses import replace

from .affine import with_moments
from .config import CorrectedScheme, LogDensityScheme, PaperScheme, SolverConfig
from .errors import LatticeError, ModelError, PropagationError, UnresolvedError
from .exact import propagate_exactly
from .info import PredictInfo
from .level_set import at
from .resample import bound
from .schemes import corrected, log_density, paper
from .schemes._shared import carried_off
from .validate import real

__all__ = ["FINEST", "MOST_FINER", "SUMMED", "load", "predict", "predict_within"]


def predict(density, model, dt=None, config=None, *, t=None, n_particles=None):
    """Carry a density over dt seconds, or to time t.

    Parameters
    ----------
    density : ParticleDensity
    model : SDE
    dt : float, optional
        Interval, seconds, >= 0.
    config : SolverConfig or FilterConfig, optional
    t : float, optional
        Absolute time to predict to, seconds, instead of dt.
    n_particles : int, optional
        Upper bound of the number of particles, should re-gridding be needed; the density's own if not given.

    Returns
    -------
    ParticleDensity, PredictInfo

    Raises
    ------
    ModelError
        The interval is negative, or model and density differ in dimension.
    PropagationError
        The model blew up; says when, where and what to change.

    Examples
    --------
    >>> import sphfilter as sf
    >>> well = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    >>> start = sf.initialize(sf.Gaussian([0.0], [[0.1]]), n_particles=100)
    >>> later, info = sf.predict(start, well, 2.0)
    >>> print(f"t = {later.t}, {info.scheme}, {info.status}, variance {later.cov()[0, 0]:.3f}")
    t = 2.0, log_density, ok, variance 0.788
    """
    return predict_within(MOST_FINER, density, model, dt, config, t=t, n_particles=n_particles)


def predict_within(most, density, model, dt=None, config=None, *, t=None, n_particles=None):
    """As `predict`, where the automatic choice repeats what a lattice loses on `most` particles at most."""
    if (dt is None) == (t is None):
        raise ModelError("predict takes either dt or t=, one of them")
    if model.dim != density.dim:
        raise ModelError(f"the model has {model.dim} states, the density {density.dim}")
    target = real("t", t) if dt is None else density.t + real("dt", dt)
    if target < density.t:
        raise ModelError(f"cannot predict back in time: from t = {density.t:g} to {target:g}")
    density = _in_domain(density, model.domain)
    config = config or SolverConfig()
    scheme = config.scheme
    if target == density.t:
        name = scheme if scheme == "auto" else scheme.name
        return density, PredictInfo(scheme=name, skipped=("everything: the interval is empty",))
    n_particles = bound(density, n_particles)
    if config.exact_linear and model.linear:
        exact = propagate_exactly(density, model, target, n_particles)
        if exact is not None:
            return exact
    if scheme == "auto":
        return _best(density, model, target, n_particles, most)
    return _SCHEMES[type(scheme)](density, model, target, scheme, n_particles)


def load(model, density, config):
    """Compile what predictions call only now and then; returns the scheme they may fall back on, or None."""
    if isinstance(config.scheme, PaperScheme | CorrectedScheme):
        return None
    if not log_density.fits(model, density, density.n_particles):
        log_density.load(model)
    if config.scheme != "auto":
        return None
    return CorrectedScheme() if model.domain.unbounded else SUMMED


def _in_domain(density, domain):
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


def _corrected(density, model, target, scheme, n_particles):
    return corrected.propagate(_uncut(density), model, target, scheme, n_particles)


def _uncut(density):
    """Nodes with the mean and covariance of the density that their lattice was cut out of.

    A Gaussian cut at Z keeps F(Z²; n + 2) / F(Z²; n) of its covariance, F the distribution of chi square: in
    four dimensions a hundredth is gone at Z = 4, and particles that obey the moment equations never find it.
    """
    if density.field is None or density.moments is None:
        return density
    moved = with_moments(density, *density.moments)
    return replace(moved, log_density=at(density.field, moved.x))


def _best(density, model, target, n_particles, most):
    """The log-density where it can be carried, if need be on more particles; else moment-corrected SPH."""
    reason = log_density.fits(model, density, n_particles)
    if not reason:
        try:
            return log_density.propagate(density, model, target, LogDensityScheme(), n_particles)
        except (LatticeError, UnresolvedError) as problem:
            return _finer(density, model, target, n_particles, most, problem)
        except PropagationError as problem:
            reason = str(problem)
    if density.domain is not None:
        moved, info = paper.propagate(density, model, target, SUMMED, n_particles)
        return moved, replace(info, status=f"not log_density: {reason}")
    try:
        moved, info = _corrected(density, model, target, CorrectedScheme(), n_particles)
    except PropagationError as problem:
        told = "stopped at" in reason
        raise PropagationError(reason if told else str(problem)) from problem
    return moved, replace(info, status=f"not log_density: {reason}")


def _finer(density, model, target, n_particles, most, problem):
    """Carry a density on more particles than allowed; the next update has as many as are.

    Where a lattice loses probability, the density is finer than its particles for a while: between two wells,
    along a fold. Other schemes see no more on as few particles, and do not notice.
    """
    blown = carried_off(model, density.x, density.t, target)
    if blown:
        raise PropagationError(blown) from problem
    for times in _FINER:
        if times > FINEST**model.dim or times * n_particles > most:
            break
        try:
            more = times * n_particles
            moved, info = log_density.propagate(density, model, target, LogDensityScheme(), more)
        except PropagationError:
            continue
        return moved, replace(info, status=f"on {times} times the particles: {problem}")
    raise problem


#: How many times the particles are tried where the lattice loses probability.
_FINER = 3, 9, 27
#: How many times finer a lattice may be along an axis than that of the density it starts from: beyond, it
#: sees the borders between that one's polynomials.
FINEST = 3
MOST_FINER = 30_000
#: Plain sums over kernels, for domains whose ends other schemes do not know.
SUMMED = PaperScheme(kernel="wendland_c2")
_SCHEMES = {
    LogDensityScheme: log_density.propagate,
    CorrectedScheme: _corrected,
    PaperScheme: paper.propagate,
}
