"""The transient FPK equation without measurements: a density carried to a list of times."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from os import PathLike
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._types import Floats, ReadOut
from ..config import AnyConfig, RemeshRule, SolverConfig
from ..density.particle_density import ParticleDensity
from ..density.resample import max_particles_of
from ..density.storage import density_from, load_arrays, part, stored, under, write_arrays
from ..errors import ModelError
from ..info import Code, PredictInfo
from ..model.dynamics import Dynamics
from ..validate import array, onwards
from .again import Outcome, or_as_cloud, predict_from_finer
from .predict import Prediction, predict
from .remesh import Remeshing


@dataclass(frozen=True)
class Trajectory:
    """Densities of a transient solution, at its times.

    Attributes
    ----------
    times : ndarray, shape (T,)
    densities : tuple of ParticleDensity
    infos : tuple of PredictInfo

    Examples
    --------
    >>> import sphfilter as sf
    >>> start = sf.initialize(sf.Gaussian([2.0], [[0.1]]), n_particles=60)
    >>> path = sf.propagate(start, sf.LinearSDE([[-1.0]], noise=[[1.0]]), times=[0.5, 1.0])
    >>> print(path.moment([1]).round(4), path.probability(lambda X: X[:, 0] > 1.0).round(3))
    [1.2131 0.7358] [0.641 0.346]
    """

    times: Floats
    densities: tuple[ParticleDensity, ...]
    infos: tuple[PredictInfo, ...]

    def __repr__(self) -> str:
        span = f", t = {self.times[0]:g} to {self.times[-1]:g}" if len(self.times) else ""
        return f"Trajectory({len(self.times)} densities{span})"

    def moment(self, powers: Sequence[int], central: bool = False, kind: ReadOut | None = None) -> Floats:
        """`ParticleDensity.moment` at all times, shape (T,)."""
        return np.array([density.moment(powers, central, kind) for density in self.densities])

    def probability(self, region: Callable[[Floats], ArrayLike], kind: ReadOut | None = None) -> Floats:
        """`ParticleDensity.probability` at all times, shape (T,)."""
        return np.array([density.probability(region, kind) for density in self.densities])

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything to one npz file, which `load` reads back to the last bit."""
        arrays = {"n_times": np.array(len(self.times))}
        for k, (density, info) in enumerate(zip(self.densities, self.infos, strict=True)):
            said = {key: np.array(value) for key, value in asdict(info).items()}
            arrays |= under(k, stored(density) | under("info", said))
        write_arrays(path, arrays)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "Trajectory":
        """Read a trajectory that `save` wrote."""
        arrays, steps = load_arrays(path), []
        for k in range(int(arrays["n_times"])):
            own = part(str(k), arrays)
            said = part("info", own)
            known = (f.name for f in fields(PredictInfo) if f.name in said)  # an older file has less
            info = PredictInfo(**{name: _plain(said[name]) for name in known})
            steps.append((density_from(own), info))
        densities, infos = zip(*steps, strict=True) if steps else ((), ())
        return cls(np.array([density.t for density in densities]), densities, infos)


def _plain(value: NDArray[Any]) -> Any:
    return value.item() if value.ndim == 0 else tuple(value.tolist())


def propagate(
    density: ParticleDensity,
    model: Dynamics,
    times: ArrayLike,
    config: AnyConfig | None = None,
    *,
    n_particles: int | None = None,
    callback: Callable[[ParticleDensity, PredictInfo], object] | None = None,
) -> Trajectory:
    """Solve the transient FPK equation without measurements.

    Where a lattice proves too coarse for the density to come, the interval before is repeated on 3 or 9 times
    the particles; where ``scheme="auto"`` finds no lattice that holds the density, a cloud goes on. Particles
    are put on a new lattice on the way where ``config.remesh`` asks for it. The infos say so.

    Parameters
    ----------
    density : ParticleDensity
        Made by `initialize`.
    model : SDE or DiscreteModel
    times : array_like, shape (T,)
        Times at which the density is wanted, seconds, not decreasing.
    config : SolverConfig or FilterConfig, optional
    n_particles : int, optional
        Upper bound of the number of particles at re-griddings; the density's own if not given.
    callback : callable, optional
        Called as ``callback(density, info)`` at each of the times; the solution stops there if it returns
        a true value.

    Returns
    -------
    Trajectory

    Raises
    ------
    ModelError
        Times that decrease, or lie before the time of the density.
    PropagationError
        The model blew up, or no scheme could go on; the sentence says when, where and what to change.

    Examples
    --------
    >>> import sphfilter as sf
    >>> well = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    >>> start = sf.initialize(sf.Gaussian([0.0], [[0.1]]), n_particles=100)
    >>> path = sf.propagate(start, well, times=[1.0, 2.0, 4.0])
    >>> print([f"{p.cov()[0, 0]:.2f}" for p in path.densities])
    ['0.63', '0.79', '0.83']
    """
    times, config = array("times", np.atleast_1d(times), (None,)), config or SolverConfig()
    times = onwards(times, density.t)
    if np.any(np.diff(times, prepend=density.t) < 0):
        raise ModelError(f"times must not decrease, nor begin before t = {density.t:g}, that of the density")
    n_particles = max_particles_of(density, n_particles)
    # filters have a new lattice at every measurement, and no rule
    rule: RemeshRule = getattr(config, "remesh", "never")
    remeshing = Remeshing(rule, config.scheme, n_particles)
    densities, infos, origin = [], [], None
    for t in times:
        density, info, origin = _piecewise(density, model, float(t), config, remeshing, origin)
        densities.append(density)
        infos.append(info)
        if callback is not None and callback(density, info):
            break
    return Trajectory(times[: len(densities)], tuple(densities), tuple(infos))


def _piecewise(
    density: ParticleDensity,
    model: Dynamics,
    t: float,
    config: AnyConfig,
    remeshing: Remeshing,
    origin: Prediction | None,
) -> tuple[ParticleDensity, PredictInfo, Prediction | None]:
    """One interval, cut where a new lattice may be needed: its end, its info, and what led there."""
    began, infos = perf_counter(), list[PredictInfo]()
    while not infos or density.t < t:
        density, told, regridded = remeshing.renewed(density, model, t)
        stop = remeshing.stop(density, model, t)
        before, density, info, _ = or_as_cloud(
            partial(_carried, density, model, stop, remeshing.n_particles, origin), config
        )
        origin = Prediction(before, info.mass_error, model, density.t)
        if told:
            status = told if info.status == "ok" else f"{told}; {info.status.removeprefix('ok; ')}"
            info = replace(info.marked(Code.REGRIDDED, status), n_regrids=info.n_regrids + regridded)
        infos.append(info)
    return density, replace(PredictInfo.joined(infos), seconds=perf_counter() - began), origin


def _carried(
    density: ParticleDensity,
    model: Dynamics,
    t: float,
    n_particles: int,
    origin: Prediction | None,
    config: AnyConfig,
) -> Outcome[PredictInfo]:
    """The `Outcome` of one interval, the one before made again where it left too coarse a density."""
    options: dict[str, Any] = {"t": t, "n_particles": n_particles, "goes_on": False}

    def predicted(density: ParticleDensity) -> Outcome[PredictInfo]:
        return Outcome(density, *predict(density, model, config=config, **options), n_particles)

    return predict_from_finer(predicted, model, density, origin, config, n_particles)
