"""Absolute against relative CFL on Duffing's oscillator in five regimes (000 4.2, Table 4)."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from experiments.scene.files import changes_of
from experiments.show.style import COLOURS, frame, legend_below, panels, save
from experiments.show.tables import number, print_table, table
from sphfilter.errors import ConfigError

from . import tables
from .cells import Cell, row_of
from .studies import scheme_change
from .transient import progress, scheme_keys, setting_of, told_truth

__all__ = ["PUBLISHED", "Run", "compare", "study"]

#: Seconds that 000 Table 4 prints for 50 s on 64 cores, absolute and relative; infinite: more than 10 000.
PUBLISHED = {
    "duffing_linear": (276.0, 47.0),
    "duffing_weak": (6577.0, 56.0),
    "duffing_full": (np.inf, 325.0),
    "duffing_bimodal_weak": (np.inf, 689.0),
    "duffing_bimodal_full": (np.inf, 900.0),
}
_KINDS = "absolute", "relative"
#: Those of 000 4.2: Gaussian kernel, h of 1.2 spacings (Appendix B), Euler, S = .1, steps of 5 ms at most.
_KEYS = {
    "kernel": "gaussian",
    "support_range": [3.6, 3.6],
    "support_steps": 1,
    "integrator": "euler",
    "c_cfl": 0.1,
    "dt_max": 5e-3,
    "c_diffusion": None,
}
_N_PARTICLES, _END = 400, 30.0
_QUICK_PARTICLES, _QUICK_END = 200, 4.0


@dataclass(frozen=True)
class Run:
    """One regime with one kind of CFL.

    Attributes
    ----------
    cell : Cell
        Labels have problem and cfl.
    steady : tuple of float
        Relative errors of E[x²] and E[v²] against the steady state at the last time, 000 (158).
    published : float
        Seconds in 000 Table 4; infinite where it only says more than 10 000.
    """

    cell: Cell
    steady: tuple
    published: float


def compare(setting, truth, keys, told):
    """Run a regime with absolute and with relative CFL; returns two `Run`."""
    runs = []
    for kind, published in zip(_KINDS, PUBLISHED.get(setting.problem.name, 2 * (np.nan,)), strict=True):
        label = {"problem": setting.problem.name, "cfl": kind}
        told(label)
        cell = setting.run(label, scheme_change("paper", _KEYS | keys | {"cfl": kind}), truth)
        runs.append(Run(cell, _steady(setting.problem, cell), published))
    return runs


def _steady(problem, cell):
    known = {row.powers: row.value for row in problem.settings.steady}
    if cell.failure:
        return np.nan, np.nan
    return tuple(
        abs(cell.densities[-1].moment(powers) / known[powers] - 1.0) if powers in known else np.nan
        for powers in ((2, 0), (0, 2))
    )


def study(args, console):
    """`--cfl`."""
    changes, keys = scheme_keys(changes_of(args))
    changes["solver.n_particles"] = args.n_particles or (_QUICK_PARTICLES if args.quick else _N_PARTICLES)
    usual = _QUICK_END if args.quick else _END
    end = usual if args.end is None else args.end
    settings = [setting_of(name, changes, end, args.limit) for name in _names(args.scenario)]
    settings[0].with_changes(scheme_change("paper", _KEYS | keys)).check()
    truths = [told_truth(console, setting) for setting in settings]
    with progress(console, len(_KINDS) * len(settings)) as told:
        runs = [run for pair in zip(settings, truths, strict=True) for run in compare(*pair, keys, told)]
    title = f"S = .1, Euler, to {end:g} s (published: to 50 s on 64 cores with 1789 or 4049 particles)"
    print_table(console, _table(title, runs))
    draw = partial(_draw, title=title, runs=runs)
    rows = [_row(run) for run in runs]
    tables.end(console, args, "converge_cfl", "cfl", [run.cell for run in runs], rows, draw)


def _row(run):
    """A flat dict, for a file."""
    steady = dict(zip(("steady_x2", "steady_v2"), run.steady, strict=True))
    return row_of(run.cell) | steady | {"published_seconds": run.published}


def _names(name):
    if name is None:
        return list(PUBLISHED)
    if name not in PUBLISHED:
        raise ConfigError(
            f"--cfl takes one of {', '.join(PUBLISHED)}, or no name for all of them, not {name!r}"
        )
    return [name]


def _table(title, runs):
    headings = ("Duffing", "CFL", "particles", "covariance", "density, L2", "steady E[x²]", "steady E[v²]",
                "steps", "cpu s", "published, s")  # fmt: skip
    made = table(title, headings, left=2)
    for run in runs:
        cell, (problem, kind) = run.cell, run.cell.label.values()
        errors = (number(value, ".2g") for value in (cell.errors.cov, cell.errors.l2))
        steady = (number(100 * value, ".2g", " %") for value in run.steady)
        cost = ("", "failed") if cell.failure else (str(cell.n_steps), f"{cell.cpu_seconds:.3g}")
        numbers = (number(cell.n_particles, ".0f"), *errors, *steady, *cost, _seconds(run.published))
        made.add_row(_short(problem), kind, *numbers, end_section=kind == "relative")
    return made


def _seconds(value):
    return "> 10000" if np.isinf(value) else f"{value:.0f}"


def _short(name):
    return name.removeprefix("duffing_").replace("_", " ")


def _draw(path, title, runs):
    """Bars of run times and errors, a group a regime."""
    figure, (axes,) = panels(1, 3, (13.0, 4.8))
    names = list(dict.fromkeys(run.cell.label["problem"] for run in runs))
    place = np.arange(len(names))
    for k, (kind, colour) in enumerate(zip(_KINDS, (COLOURS["ekf"], COLOURS["sph"]), strict=True)):
        chosen = [run for run in runs if run.cell.label["cfl"] == kind]
        at = place + 0.36 * (k - 0.5)
        axes[0].bar(at, [run.cell.cpu_seconds for run in chosen], 0.34, color=colour, label=f"{kind}, ours")
        published = [min(run.published, 1e4) for run in chosen]
        axes[0].plot(at, published, "_", ms=14, mew=2, color=colour, label=f"{kind}, 000 Table 4 (run time)")
        axes[1].bar(at, [run.cell.errors.cov for run in chosen], 0.34, color=colour)
        axes[2].bar(at, [100 * run.steady[0] for run in chosen], 0.34, color=colour)
    labels = (
        "processor time, s (10⁴: more than that)",
        "covariance, rms over the times",
        "steady E[x²], error (%)",
    )
    for ax, label in zip(axes, labels, strict=True):
        frame(ax, "", "", label)
        ax.set_xticks(place, [_short(name).replace(" ", "\n") for name in names])
    axes[0].set_yscale("log")
    legend_below(figure, axes[0], columns=4)
    figure.suptitle(title, fontsize=10)
    return save(figure, path)
