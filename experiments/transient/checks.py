"""What a transient file can only be asked once its model is known; every refusal names the key."""

import re
from contextlib import contextmanager

import numpy as np

from sphfilter.config import LogDensityScheme
from sphfilter.errors import ConfigError, SphfilterError
from sphfilter.model.expressions import Names


@contextmanager
def named(key, *parts):
    """Errors of the library within start with a key, or with that of a part of it that they begin with.

    A part is the last word of a dotted key below `key`.
    """
    try:
        yield
    except SphfilterError as problem:
        told = str(problem)
        first = re.match(r"\w*", told)[0]
        part = next((part for part in parts if part.rpartition(".")[2] == first), None)
        if part is not None:
            told = f"{key}.{part}{told[len(first) :]}"
        elif not told.startswith(str(key)):
            told = f"{key}: {told}"
        raise type(problem)(told) from problem


def check(problem):
    """Raise the first error of a `Problem` that its settings alone could not show.

    It is a `ConfigError`, an `ExpressionError` or a `ModelError`.
    """
    with named("model.states"):
        Names(problem.settings.model.states)
    with named("model.parameters"):
        Names(problem.settings.model.states, problem.settings.model.parameters)
    with named("model.inputs"):
        Names(
            problem.settings.model.states,
            [*problem.settings.model.parameters, *problem.settings.model.inputs],
        )
    with named("model", "drift", "noise", "diffusion", "spectral_density", "domain"):
        _ = problem.model
    _check_lengths(problem)
    _check_times(problem)
    with named("start", "mean", "cov", "box"):
        _ = problem.distribution
    scheme, lattice = problem.settings.solver.config.scheme, problem.settings.start.lattice
    if lattice is not None and isinstance(scheme, LogDensityScheme):
        raise ConfigError(
            "start.lattice is for schemes that take particles as they lie: solver.config.scheme may be "
            '"auto", "cloud" or "paper", not "log_density"'
        )
    _ = problem.quantities
    _check_reference(problem)


def _check_lengths(problem):
    """One value a state, wherever there has to be."""
    n, settings = problem.model.dim, problem.settings
    start, probe = settings.start, settings.probe
    found = {f"start.{key}": getattr(start, key) for key in ("mean", "cov", "box")}
    found |= {"start.lattice.origin": getattr(start.lattice, "origin", None)}
    found |= {"probe.origin": getattr(probe, "origin", None)}
    found |= {f"statistics.moments[{k}]": powers for k, powers in enumerate(settings.statistics.moments)}
    found |= {f"steady[{k}].powers": row.powers for k, row in enumerate(settings.steady)}
    for key, value in found.items():
        if value is not None and len(value) != n:
            raise ConfigError(f"{key} needs {n} entries, one a state of the model, not {len(value)}")
    axes = settings.axes
    if any(not 0 <= axis < n for axis in axes) or len(set(axes)) < len(axes) or len(axes) > 3:
        raise ConfigError(f"axes = {list(axes)} must be up to three of the states, numbered 0 to {n - 1}")


def _check_times(problem):
    start, times = problem.settings.start.time, problem.times
    if not len(times):
        raise ConfigError(
            f"times.end and times.interval, or times.at, give no time of output after start.time = {start:g}"
        )
    if np.any(np.diff(times, prepend=start) < 0):
        raise ConfigError(
            f"times.at must not decrease, nor begin before start.time = {start:g}, got {times.tolist()}"
        )


def _check_reference(problem):
    """Refuse a reference that does not know the problem."""
    kind, model, begins = problem.settings.reference.kind, problem.model, problem.settings.start.kind
    if kind == "linear" and not (model.linear and begins == "gaussian"):
        raise ConfigError('reference.kind = "linear" needs a linear model and a Gaussian start')
    if kind == "grid" and (model.dim > 2 or model.state_dependent_noise or begins != "gaussian"):
        needs = "one or two states, noise that does not depend on them, and a Gaussian start"
        raise ConfigError(f'reference.kind = "grid" needs {needs}')
    if kind == "drifted_uniform" and not (model.dim == 1 and begins == "uniform"):
        raise ConfigError('reference.kind = "drifted_uniform" needs one state that starts uniform on a box')
    if problem.settings.statistics.cumulants and begins == "expression":
        raise ConfigError("statistics.cumulants needs a Gaussian or uniform start")
