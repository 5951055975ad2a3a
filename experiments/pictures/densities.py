"""Densities on particles: resampling without a measurement, and one Bayesian update (002 Figs 13, 14, 21)."""

import numpy as np

import sphfilter as sf
from sphfilter.lattice.regular import heaviest

from ..show.particles import mass_bar, mass_field
from ..show.style import ACCENT, INK, frame, panels, quantity
from .picture import Picture
from .transient import KERNEL, start_of, transient_model

__all__ = ["bayes_figure", "resampling_figure", "transient_densities"]

_N = 1649
_TIMES = 3.0, 6.0
#: The measurement of Fig 21, at t = 3.
_Z, _R = -4.0, 0.1


def transient_densities(scenario, seed, n_runs, known):
    """Figs 13, 14 and 21 share one prediction from the start to t = 6. Nothing is random."""
    config = sf.FilterConfig.paper(kernel=KERNEL)
    density = sf.initialize(start_of(scenario), _N, config)
    densities = sf.propagate(density, transient_model(scenario), _TIMES, config).densities
    figures = {f"resampling_t{d.t:g}": resampling_figure(scenario, d, config) for d in densities}
    figures["bayes_update"] = bayes_figure(scenario, densities[0], config)
    return Picture(
        figures,
        (
            "resampling_*.png: the density without measurements, and the same density on a new lattice, "
            "which follows any shape and spreads particles that have run together.",
            "bayes_update.png: a measurement makes most particles of the prior worthless. The update puts "
            "about as many on the small region that is left.",
        ),
    )


def resampling_figure(scenario, density, config):
    """A density and the same density on a new lattice (002 4.7, Figs 13 and 14)."""
    new, info = sf.resample(density, config=config)
    figure, (axes,) = panels(1, 3, (13.5, 4.6), sharex=True, sharey=True)
    mass_field(axes[0], density.x, density.mass)
    axes[1].scatter(*density.x.T, s=16, lw=0, color=ACCENT["third"], alpha=0.35, label="as propagated")
    axes[1].scatter(*new.x.T, s=4, lw=0, color=ACCENT["other"], label="resampled")
    axes[1].legend(
        loc="lower right", bbox_to_anchor=(1.02, 0.985), ncols=2, markerscale=1.6, frameon=False, fontsize=9
    )
    artist = mass_field(axes[2], new.x, new.mass)
    dims = " × ".join(map(str, info.lattice_dims))
    titles = (
        f"(a) as propagated, N = {density.n_particles}",
        "(b) both",
        f"(c) resampled, N = {new.n_particles} of {dims} nodes",
    )
    _label(scenario, axes, titles)
    mass_bar(figure, artist, axes)
    figure.suptitle(
        f"{scenario.name}, the paper's scheme: resampling of the transient density at t = {density.t:g} s",
        fontsize=11,
    )
    return figure


def bayes_figure(scenario, prior, config):
    """A measurement update, step by step (002 6.1 and 6.4, Fig 21)."""
    measurement = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[_R]])
    posterior, info = sf.update(prior, measurement, [_Z], config)
    raw = raw_posterior(prior, measurement)
    kept = heaviest(raw, config.scheme.domain_mass)
    figure, axes = panels(2, 3, (13.5, 8.4))
    a, b, c, d, e, f = axes.ravel()
    mass_field(a, prior.x, prior.mass)
    likelihood = np.exp(measurement.log_likelihood([_Z], prior.x, prior.t))
    mass_field(b, prior.x, likelihood)
    mass_field(c, prior.x, raw)
    mass_field(d, prior.x[kept], raw[kept])
    artist = mass_field(e, posterior.x, posterior.mass)
    b.axvline(_Z, color=ACCENT["other"], lw=1.2)
    _marginals(f, prior, posterior)
    titles = (
        f"(a) prior, N = {prior.n_particles}",
        f"(b) likelihood of the measurement, {_number(_Z)} ± {np.sqrt(_R):.2g} m",
        "(c) raw posterior: prior mass × likelihood",
        f"(d) raw posterior, trimmed to {config.scheme.domain_mass:.2%}: N = {kept.sum()}",
        f"(e) resampled posterior, N = {posterior.n_particles}",
    )
    _label(scenario, (a, b, c, d, e), titles)
    for ax in (b, c):
        ax.sharex(a)
        ax.sharey(a)
    d.sharex(e)
    d.sharey(e)
    frame(f, "(f) densities of the position", quantity(scenario, 0), "density (1/m)")
    mass_bar(figure, artist, axes, "mass of a particle; in (b) likelihood")
    verdict = "accepted" if info.accepted else f"refused: {info.reason}"
    what = f"one measurement update at t = {prior.t:g} s ({verdict})"
    figure.suptitle(f"{scenario.name}, the paper's scheme: {what}", fontsize=11)
    return figure


def raw_posterior(prior, measurement):
    """Masses m_i l_i / Σ m_j l_j on the particles of the prior: 002 (57), corrected."""
    log_w = measurement.log_likelihood([_Z], prior.x, prior.t)
    raw = prior.mass * np.exp(log_w - log_w.max())
    return raw / raw.sum()


def _marginals(ax, prior, posterior):
    """Prior, likelihood (to scale with the posterior) and posterior of the position."""
    x = np.linspace(prior.x[:, 0].min(), prior.x[:, 0].max(), 400)[:, None]
    after = posterior.marginal([0]).pdf(x)
    seen = np.exp(-0.5 * (x[:, 0] - _Z) ** 2 / _R)
    ax.fill_between(
        x[:, 0], prior.marginal([0]).pdf(x), color=ACCENT["third"], alpha=0.3, lw=0, label="prior"
    )
    ax.plot(x, after, color=ACCENT["sph"], lw=2.4, label="posterior")
    ax.plot(x, seen * after.max(), color=ACCENT["other"], lw=1.2, ls="--", label="likelihood, scaled")
    ax.axvline(_Z, color=INK, lw=0.6)
    ax.set_ylim(bottom=0)
    ax.legend(fontsize=9)


def _number(value):
    return f"{value:g}".replace("-", "−")


def _label(scenario, axes, titles):
    for ax, title in zip(axes, titles, strict=True):
        frame(ax, title, quantity(scenario, 0), quantity(scenario, 1))
