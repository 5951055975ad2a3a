"""Errors of a transient solution over the particles, the scheme and the time step."""

from dataclasses import fields

import numpy as np

from sphfilter.config import SCHEMES
from sphfilter.errors import ConfigError

from .cells import SCHEME, UNKNOWN
from .errors import errors_of

#: Of the published scheme; textbooks give them the orders 1, 2 and 4.
INTEGRATORS = "euler", "midpoint", "rk4"
#: Sizes of a time step by what they are, for people, and as settings of the published scheme.
RULES = {
    "step": ("time step (s)", lambda value: {"cfl": "fixed", "dt_max": value}),
    "c_cfl": ("C_CFL", lambda value: {"c_cfl": value}),
}
_FINER = 4  # times smaller than the smallest the step is that stands for none
_N_STEPS = 4


def scheme_change(name, keys):
    """Changes that solve a problem with a scheme.

    Of the settings `keys` it takes those that are its own: the published scheme's where that has the key too.
    """
    own = {key: value for key, value in keys.items() if _owner(key) == name}
    start = {"start.reach": None} if name == "paper" else {}  # whose lattice follows from its own settings
    return {SCHEME: {"name": name} | own} | start


def _owner(key):
    """The scheme that a setting belongs to, the published one where it is of more than one."""
    known = (name for name in ("paper", *SCHEMES) if key in {f.name for f in fields(SCHEMES[name])})
    return next(known, "paper")  # which refuses it by name if there is none


def variants(setting, schemes, keys):
    """What is changed for every scheme, by its name; what the problem's file says if `schemes` is None.

    The `keys` are settings of schemes, as `scheme_change` takes them. Raises `ConfigError` if there is no
    such scheme, or it has no such setting.
    """
    if schemes is None:
        config = setting.problem.settings.solver.config.scheme
        return {config if isinstance(config, str) else config.name: {}}
    wrong = [name for name in schemes if name not in SCHEMES]
    if wrong:
        raise ConfigError(f"--schemes: there is no scheme {wrong[0]!r}; there are {', '.join(SCHEMES)}")
    found = {name: scheme_change(name, keys) for name in schemes}
    for key in keys:
        setting.with_changes(scheme_change(_owner(key), keys)).check()
    return found


def by_scheme(setting, truth, counts, schemes, told):
    """Run schemes on every number of particles at most; a list of `Cell` whose labels have both.

    The `schemes` are changes by name, from `variants`. `told(label)` is called before every cell.
    """
    cells = []
    for name, changes in schemes.items():
        for count in counts:
            label = {"scheme": name, "particles": count}
            told(label)
            cells.append(setting.run(label, changes | {"solver.n_particles": count}, truth))
    return cells


def default_steps(setting, keys):
    """Time steps that halve from the largest one that is stable at the start, parts of an output interval.

    Explicit steps are stable up to about 2.7 c_K h² / tr D; the scheme's own limit is one c_K h² / tr D.
    """
    problem = setting.with_changes(scheme_change("paper", keys)).problem
    density = problem.begin()
    D = problem.model.diffusion(density.x[:1], density.t)[0]
    longest = density.kernel_variance * float(density.h.min()) ** 2 / max(float(np.trace(D)), 1e-300)
    interval = float(np.diff(problem.times, prepend=density.t).max())
    halvings = max(int(np.ceil(np.log2(interval / longest))), 1)
    return [interval / 2 ** (halvings + k) for k in range(_N_STEPS)]


def _stepping(keys, integrator, rule, value):
    """Changes that solve with an integrator and steps of a size, by one of `RULES`."""
    own = RULES[rule][1](value)
    return scheme_change("paper", {"c_diffusion": None} | keys | {"integrator": integrator} | own)


def by_step(setting, truth, rule, values, keys, told):
    """Run the published scheme with every integrator and size of the time step; a list of (`Cell`, `Errors`).

    Its error against the truth has a floor, that of the particles. Against the same particles carried with
    much smaller steps it has none: this is the error of the time step alone, the `Errors` of each pair.
    Labels have integrator and the rule.

    The `values` are sizes by a `rule` of `RULES`; `keys` are settings of the published scheme, whose limit of
    diffusion is off unless they say so. `told(label)` is called before every cell. Raises `ConfigError` if
    the particles cannot be carried with the small steps.
    """
    finest = min(values) / _FINER
    told({"integrator": "rk4", rule: finest})
    fine = setting.run({}, _stepping(keys, "rk4", rule, finest), truth)
    if fine.failure:
        raise ConfigError(f"no solution with {RULES[rule][0]} {finest:g} to compare with: {fine.failure}")
    still = truth.seen_by(fine.densities)
    rows = []
    for integrator in INTEGRATORS:
        for value in sorted(values, reverse=True):
            label = {"integrator": integrator, rule: value}
            told(label)
            cell = setting.run(label, _stepping(keys, integrator, rule, value), truth)
            rows.append((cell, _alone(cell, still)))
    return rows


def _alone(cell, still):
    return UNKNOWN if cell.failure else errors_of(cell.densities, still)
