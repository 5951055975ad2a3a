"""What new lattices on the way are worth: one problem solved with each rule, side by side (002 section 5)."""

from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import LogLocator

import sphfilter as sf
from experiments.scene.files import parse_change
from experiments.show import tables
from experiments.show.comparison import rms
from experiments.show.particles import mass_bar, mass_field
from experiments.show.style import INK, frame, legend_below, panels, plt, save
from sphfilter.errors import ConfigError

from .tables import comparison, moments

_KEY = "solver.config.remesh"


@dataclass(frozen=True)
class Rule:
    """A problem solved with one rule."""

    name: str  # "never", "health", or "every 2 s"
    problem: object  # Problem
    solution: object  # Solution


def rules_of(text):
    """Changes of the settings by dotted key, by the name of each rule of a list such as "never,health,2"."""
    values = [parse_change(f"{_KEY}={part.strip()}")[1] for part in text.split(",") if part.strip()]
    if not values:
        raise ConfigError("--remesh takes never, health, or seconds, or some of them: never,health,2")
    return {value if isinstance(value, str) else f"every {value:g} s": {_KEY: value} for value in values}


def table(rules, reference):
    """A row a rule: what it did, what it cost, how far off it was and how the cloud looks in the end."""
    compared = () if reference is None else ("mean off: rms", "most", "cov off: rms", "most", "at the end")
    headings = ("how many", "steps", "s", *compared, "mixing, nat", "spacing", "astray")
    made = tables.table("", ("new lattices", *headings), frame=None)
    for rule in rules:
        infos = rule.solution.trajectory.infos
        row = [rule.name, *(str(sum(getattr(i, key) for i in infos)) for key in ("n_regrids", "n_steps"))]
        row.append(f"{rule.solution.seconds.sum():.2g}")
        if reference is not None:
            mean, cov = comparison(rule.problem, rule.solution, reference).T
            row += [f"{v:.2g}" for v in (rms(mean), mean.max(), rms(cov), cov.max(), cov[-1])]
        end = sf.health(rule.solution.trajectory.densities[-1])
        made.add_row(*row, f"{end.mixing:.2g}", f"{end.spacing:.2g}", f"{100 * end.rogue:.1f} %")
    return made


def draw(out, rules, reference):
    """Draw clouds at the end (002 Fig 15), and variances and errors against time (Figs 16, 17); paths."""
    figures = {"remesh_clouds": _clouds(rules), "remesh_variances": _variances(rules, reference)}
    return [save(figure, out / f"{name}.png") for name, figure in figures.items()]


def _clouds(rules):
    problem = rules[0].problem
    figure, axes = panels(1, len(rules), (4.2 * len(rules) + 0.6, 4.0), sharex=True, sharey=True)
    for ax, rule in zip(axes[0], rules, strict=True):
        density = rule.solution.trajectory.densities[-1]
        drawn = list((problem.settings.axes or (0, min(1, density.dim - 1)))[:2])
        artist = mass_field(ax, density.x[:, drawn], density.mass)
        labels = [problem.labels[axis] for axis in drawn]
        title = f"new lattices: {rule.name}, {density.n_particles} particles"
        frame(ax, title, labels[0], labels[1] if ax is axes[0, 0] else "")
    mass_bar(figure, artist, axes)
    figure.suptitle(f"{problem.name}: particles at t = {problem.times[-1]:g}", fontsize=11)
    return figure


def _variances(rules, reference):
    problem = rules[0].problem
    n, t = problem.model.dim, problem.times
    figure, axes = panels(2, 2, (10, 6), sharex=True)
    ranks = np.linspace(0.0, 1.0, len(rules))  # rules that do the same are both seen
    looks = [{"color": plt.cm.viridis(0.8 * rank), "lw": 3.0 - 1.8 * rank} for rank in ranks]
    for axis, ax in enumerate(axes[0, : min(n, 2)]):
        for rule, look in zip(rules, looks, strict=True):
            ax.plot(t, _variance(rule.solution.values, n, axis), label=rule.name, **look)
        if reference is not None:
            exact = _variance(reference.values, n, axis)
            ax.plot(t, exact, color=INK, lw=1.2, ls=":", label=reference.name)
        ax.set_ylim(bottom=0.0)
        frame(ax, f"variance of {problem.labels[axis]}", "", "")
    for rule, look in zip(rules, looks, strict=True):
        if reference is not None:
            error = comparison(problem, rule.solution, reference)[:, 1]
            axes[1, 0].plot(t, np.maximum(error, 1e-6), **look)
        steps = [info.n_steps for info in rule.solution.trajectory.infos]
        axes[1, 1].plot(t, steps, **look)
    frame(axes[1, 0], "error of the covariance, in its standard deviations", "t", "")
    frame(axes[1, 1], "time steps from output to output", "t", "")
    for ax in axes[1]:
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(LogLocator())
    legend_below(figure, axes[0, 0], columns=5)
    figure.suptitle(f"{problem.name}: new lattices on the way", fontsize=11)
    return figure


def _variance(values, n, axis):
    return moments(values, n)[1][:, axis, axis]
