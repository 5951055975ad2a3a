"""How well the start is represented, and for how long that matters (002 4.6, Figs 9, 10 and 11)."""

from functools import partial
from typing import NamedTuple

import numpy as np

import sphfilter as sf
from reference_filters.closed_forms import linear_moments
from reference_filters.grid import GridFilter
from sphfilter.lattice.regular import fit_support, place_gaussian

from ..show.style import ACCENT, frame, panels, plain_numbers
from .picture import Picture
from .transient import KERNEL, start_of, transient_model

__all__ = ["initial_accuracy", "rms_error", "support_sweep", "swept"]

_N_SUPPORT, _N_MASSES = 1649, 577
#: The common value that Fig 10 compares the fitted support with.
_COMMON = 2.5
_END = {"linear_underdamped": 3.0, "van_der_pol": 3.0}
_STEPS = 20
#: The error is averaged over equal cells within this many standard deviations of the reference.
_REACH = 3.25


def support_sweep(scenario, seed, n_runs, known):
    """Error of a standard normal density on particles against the kernels' support (Fig 9)."""
    figure, (axes,) = panels(1, 2, (11, 4.4), sharey=True)
    for ax, kernel in zip(axes, ("gaussian", "lucy"), strict=True):
        fit = swept(_N_SUPPORT, kernel)
        best = fit.support[np.argmin(fit.error)]
        ax.plot(fit.support, fit.error_particles, color=ACCENT["third"], label="at the particles")
        ax.plot(fit.support, fit.error_interstitial, color=ACCENT["other"], label="between the particles")
        ax.plot(fit.support, fit.error, color="k", lw=2, label="both together")
        ax.axvline(best, color="0.5", ls="--", lw=0.9, label=f"best: {best:.2f}")
        ax.set_yscale("log")
        plain_numbers(ax.yaxis)
        frame(ax, f"{kernel.capitalize()} kernel", r"support $\Lambda = K h / \Delta x$", "")
        ax.legend(fontsize=9)
    axes[0].set_ylabel(r"$\varepsilon_{RMS}$ of the density")
    figure.suptitle(
        f"The paper's scheme: standard normal density of two states on {_N_SUPPORT} particles, one h for all",
        fontsize=11,
    )
    sentence = (
        "support.png: how far the kernels of a lattice should reach. A shorter reach leaves ripples, a "
        "longer one blurs; the start uses the best."
    )
    return Picture({"support": figure}, (sentence,))


def swept(n_particles, kernel, steps=81):
    """The sweep of 002 4.6.1 for N(0, I) in two dimensions, as a `SupportFit`."""
    scheme = sf.SolverConfig.paper(kernel=kernel, support_steps=steps).scheme
    normal = sf.Gaussian([0.0, 0.0], np.eye(2))
    place = place_gaussian(normal.mean, normal.cov, n_particles, scheme)
    target, between = (normal.pdf(grid.nodes) for grid in (place.lattice, place.lattice.half_shifted()))
    mass = target * place.kept * place.lattice.cell_volume
    lowest = target[place.core].min()
    return fit_support(place.lattice, mass, target, between, place.core, between >= lowest, scheme)


def initial_accuracy(scenario, seed, n_runs, known):
    """Error of the density over time, for two supports and for two kinds of mass (Figs 10 and 11)."""
    model, start = transient_model(scenario), start_of(scenario)
    times = np.linspace(0.0, _END[scenario.name], _STEPS + 1)
    references = list(_references(model, start, times))
    error = partial(_history, model, start, references)
    best = swept(_N_SUPPORT, KERNEL, steps=9)
    fitted = best.support[np.argmin(best.error)]
    figure, (axes,) = panels(1, 2, (11, 4.4))
    fixed = {"support_range": (_COMMON, _COMMON), "support_steps": 1}
    axes[0].plot(times, error(_N_SUPPORT, {}), color="k", label=rf"fitted, $\Lambda$ = {fitted:g}")
    axes[0].plot(times, error(_N_SUPPORT, fixed), color=ACCENT["other"], label=rf"$\Lambda$ = {_COMMON:g}")
    axes[1].plot(times, error(_N_MASSES, {}), color="k", label="masses: density × volume")
    solved = error(_N_MASSES, {"masses": "collocation"})
    axes[1].plot(times, solved, color=ACCENT["other"], label="masses: collocation")
    for ax, what, n in zip(axes, ("support", "masses"), (_N_SUPPORT, _N_MASSES), strict=True):
        frame(ax, f"{what} at the start, N = {n}", "time (s)", r"$\varepsilon_{RMS}$ of the density (s/m²)")
        ax.set_yscale("log")
        plain_numbers(ax.yaxis)
        ax.margins(x=0.02)
        ax.legend(fontsize=9)
    against = "its exact Gaussian" if model.linear else "the grid solution"
    what = f"error of the transient density against {against}"
    figure.suptitle(f"{scenario.name}, the paper's scheme: {what}", fontsize=11)
    sentence = (
        "accuracy.png: error of the density without measurements. Exact masses at the start are of little "
        "use once the particles have left their lattice."
    )
    return Picture({"accuracy": figure}, (sentence,))


class _Reference(NamedTuple):
    t: float
    mean: np.ndarray
    cov: np.ndarray
    pdf: object


def _references(model, start, times):
    """Yield the solution at each time: exact for linear models, else on a grid."""
    if model.linear:
        zero = np.zeros((1, model.dim))
        A, b, D = model.jacobian(zero[0], 0.0), model.drift(zero, 0.0)[0], model.diffusion(zero, 0.0)[0]
        for t in times:
            mean, cov = linear_moments(A, b, 2.0 * D, start.mean, start.cov, t)
            yield _Reference(t, mean, cov, sf.Gaussian(mean, cov).pdf)
    else:
        yield from _grid_references(model, start, times)


def _grid_references(model, start, times):
    grid = GridFilter(model, None, start.mean, start.cov)
    for t in times:
        if t > grid.t:
            grid.predict(t=t)
        yield _Reference(t, grid.x, grid.P, grid.density.pdf)


def _history(model, start, references, n_particles, changes):
    """RMS error at the times of the references, an array (T,), for a changed configuration."""
    config = sf.SolverConfig.paper(kernel=KERNEL, **changes)
    density = sf.initialize(start, n_particles, config)
    path = sf.propagate(density, model, [r.t for r in references], config)
    return np.array([rms_error(p.pdf, r) for p, r in zip(path.densities, references, strict=True)])


def rms_error(pdf, reference):
    """ε_RMS (002 (32)) on points that fill an ellipse about the reference evenly."""
    y = np.linspace(-_REACH, _REACH, 60)
    white = np.stack(np.meshgrid(y, y), axis=-1).reshape(-1, 2)
    white = white[np.sum(white**2, axis=1) < _REACH**2]
    X = reference.mean + white @ np.linalg.cholesky(reference.cov).T
    return float(np.sqrt(np.mean((pdf(X) - reference.pdf(X)) ** 2)))
