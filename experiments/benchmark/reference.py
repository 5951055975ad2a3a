"""The converged solution of a case, with a bound of its own error, kept on disk.

Linear models have the Kalman filter and the Beneš problem its closed form; other problems of one or two
states a grid, refined until it stands still; the rest many large particle runs.
"""

import json
from dataclasses import asdict, dataclass, fields

import numpy as np

from experiments.scene.filters import Factory
from experiments.scene.settings import Grid
from experiments.show.files import digest, whole
from reference_filters.big_particle import converged
from reference_filters.grid_density import Box, GridDensity, fitted_box
from sphfilter.campaign.one_run import put_through
from sphfilter.campaign.store import case_digest
from sphfilter.errors import PropagationError
from sphfilter.filter.results import FilterResult

from .errors import errors, root_mean_square
from .watch import Watched

#: Nodes an axis, and error allowed a step, of the grid; each refinement divides the error by about five.
_LADDER = ((48, 3e-3), (72, 1e-3), (96, 1e-3), (144, 3e-4), (216, 1e-4), (324, 3e-5))


@dataclass(frozen=True)
class Effort:
    """How good a reference has to be."""

    error: float = 2e-4  # change of the grid's mean, in posterior standard deviations, at which refining ends
    # first and last rung of the grid's ladder
    first: int = 2
    last: int = 4
    # particles of each of the large runs, and their number
    n_paths: int = 400_000
    n_runs: int = 8


@dataclass(frozen=True)
class Reference:
    """Converged posterior of one case."""

    kind: str  # what it is, and how its error was bounded
    result: FilterResult
    # its own error, in the measures of `errors.Errors`; zero where it is exact
    mean: float
    cov: float
    evidence: float
    total: float
    densities: dict  # posterior densities by epoch, for one and two states


def epochs_of_densities(n_epochs):
    """Epochs whose densities are compared: after a third, two thirds and all of the measurements."""
    return sorted({max(0, round(n_epochs * part) - 1) for part in (1 / 3, 2 / 3, 1.0)})


def find(scenario, case, effort, folder):
    """Read the reference of a case from `folder`, or compute it and keep it there.

    Raises `PropagationError` if the grid is too coarse at its last rung.
    """
    path = folder / f"{scenario.name}-{_digest(scenario, case, effort)}.npz"
    if path.exists():
        return _load(path)
    folder.mkdir(parents=True, exist_ok=True)
    if scenario.settings.exact:
        reference = _exact(scenario, case)
    elif scenario.model.dim <= 2 and not scenario.model.state_dependent_noise:
        reference = _grid(scenario, case, effort)
    else:
        reference = _particles(scenario, case, effort, folder)
    _save(path, reference)
    return reference


def _digest(scenario, case, effort):
    s = scenario.settings
    parts = (s.model, *([s.sensor] if s.sensor else s.sensors.values()), s.start, effort)
    text = repr([_as_before(part) for part in parts] + [s.exact])
    return digest(text + case_digest(case))


def _as_before(part):
    """Settings as a dict, without later keys that are empty: references are known by its text."""
    later = getattr(part, "LATER", ())
    return {key: value for key, value in asdict(part).items() if value or key not in later}


def _exact(scenario, case):
    name = scenario.settings.exact
    watched = Watched(Factory(name, scenario)(case, None), epochs_of_densities(len(case.times)))
    result = put_through(watched, case)
    densities = {}
    for i, found in watched.densities.items() if scenario.model.dim <= 2 else ():
        # wide enough for a mixture of two Gaussians with these moments, too
        box = fitted_box(result.x[i][None], np.ones(1), 1.3 * result.P[i], 96)
        densities[i] = GridDensity(box, found.on(box))
    return Reference(f"{name}, exact", result, 0.0, 0.0, 0.0, 0.0, densities)


def _grid(scenario, case, effort):
    """Refine until the mean stands still, or the ladder ends; the last change bounds the error."""
    kept, change = None, None
    for size, tol in _LADDER[effort.first : effort.last + 1]:
        filt = Factory("grid", scenario, Grid(size=size, tol=tol))(case, None)
        watched = Watched(filt, epochs_of_densities(len(case.times)), take=lambda filt: filt.density)
        try:
            result = put_through(watched, case)
        except PropagationError:  # too coarse
            continue
        change = None if kept is None else errors(kept, result)
        kept, densities, n_nodes = result, watched.densities, size
        if change is not None and change.mean <= effort.error:
            break
    if change is None:
        raise PropagationError(
            f"{scenario.name}: no two grids of the reference hold the density; --full tries finer ones"
        )
    kind = f"grid of {n_nodes} nodes an axis, error bounded by the change from the next coarser"
    return Reference(kind, kept, change.mean, change.cov, change.evidence, change.total, densities)


def _particles(scenario, case, effort, folder):
    """Independent large particle runs; their spread is the error of their average."""
    size = {"n_particles": effort.n_paths, "n_runs": effort.n_runs}
    found = converged(scenario.model, scenario.measurement, case, **size, rng=0, cache=folder)
    prior = np.full_like(found.x, np.nan), np.full_like(found.P, np.nan)
    accepted = np.ones(len(found.t), dtype=bool)
    result = FilterResult(found.t, *prior, found.x, found.P, found.log_evidence, accepted)
    kind = f"{effort.n_runs} particle runs of {effort.n_paths:g}, error bounded by their spread"
    errors = (*_white_errors(found), root_mean_square(found.evidence_error), found.total_error)
    return Reference(kind, result, *errors, {})


def _white_errors(found):
    """Standard errors of mean and covariance in the measures of `errors.Errors`.

    Those of the components are given. Sampling errors are correlated like samples of the posterior: the
    covariance of the mean is c P, the variance of entry ij of the covariance c' (P_ii P_jj + P_ij²). With c
    and c' averaged over the components, |L⁻¹ e|² is n c and ‖L⁻¹ E L⁻ᵀ‖² / n is (n + 1) c'.
    """
    n = found.x.shape[1]
    var = np.diagonal(found.P, axis1=1, axis2=2)
    c = np.mean(found.x_error**2 / var, axis=1)
    c_prime = np.mean(found.P_error**2 / (var[:, :, None] * var[:, None, :] + found.P**2), axis=(1, 2))
    return root_mean_square(np.sqrt(n * c)), root_mean_square(np.sqrt((n + 1) * c_prime))


def _save(path, reference):
    """Write a reference to one file."""
    arrays = {f"result_{f.name}": getattr(reference.result, f.name) for f in fields(FilterResult)}
    for i, p in reference.densities.items():
        arrays |= {f"p{i}_centre": p.box.centre, f"p{i}_axes": p.box.axes, f"p{i}_values": p.values}
    numbers = {name: getattr(reference, name) for name in ("kind", "mean", "cov", "evidence", "total")}
    text = json.dumps({"numbers": numbers, "epochs": list(reference.densities)})
    with whole(path) as file:
        np.savez_compressed(file, text=text, **arrays)


def _load(path):
    with np.load(path) as data:
        text = json.loads(str(data["text"]))
        # files may be older than fields that have a default; what they hold was expensive
        kept = {f.name: f"result_{f.name}" for f in fields(FilterResult) if f"result_{f.name}" in data}
        result = FilterResult(**{name: data[key] for name, key in kept.items()})
        densities = {}
        for i in text["epochs"]:
            values = data[f"p{i}_values"]
            densities[i] = GridDensity(Box(data[f"p{i}_centre"], data[f"p{i}_axes"], len(values)), values)
    return Reference(result=result, densities=densities, **text["numbers"])
