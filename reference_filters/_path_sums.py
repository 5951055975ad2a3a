"""Sums over many paths of a model at given times, for moments and probabilities of any kind."""

import numpy as np

from sphfilter import validate
from sphfilter.errors import ModelError
from sphfilter.model.paths import advance

from ._monomials import checked_powers, down_set, moment_name, recentred, sum_monomials
from ._paths import Paths
from ._starts import draw
from ._store import digest

#: States at which model and indicators are probed for the name of a problem.
_PROBES = 64


class PathSums:
    """What is asked of which paths; arguments as of `monte_carlo.simulate_statistics`.

    Summed are monomials about a centre for each time, the mean of the first paths drawn (so that central
    moments lose no digits), and after them the indicators. The first monomial counts the paths.

    Attributes
    ----------
    times : ndarray, shape (T,)
    names : tuple of S str
        Of the statistics.
    shape : tuple
        (T, K) for K sums.
    """

    def __init__(self, model, start, t0, times, moments, central, indicators, step, tolerance, n_threads):
        n = model.dim
        self.model, self.start, self.indicators = model, start, dict(indicators or {})
        self.times, self.t0 = validate.times("times", times), validate.real("t0", t0)
        if self.times[0] < self.t0:
            raise ModelError(f"times begin at {self.times[0]:g}, before the start at t0 = {self.t0:g}.")
        self.moments = checked_powers("moments", moments, n)
        self.central = checked_powers("central", central, n)
        if any(a[d] for a in self.central for d in np.flatnonzero(model.domain.periodic)):
            raise ModelError("an angle has no central moments; ask for indicators such as its cos and sin.")
        self.step = None if step is None else validate.positive("step", step)
        self.tolerance = validate.positive("tolerance", tolerance)
        self.n_threads = validate.count("n_threads", n_threads)
        self.powers = down_set([*self.moments, *self.central, *_axes(n)], n)
        self.names = (
            *(moment_name(a, model.states) for a in self.moments),
            *(moment_name(a, model.states, central=True) for a in self.central),
            *self.indicators,
        )
        if not self.names:
            raise ModelError("nothing is asked of the paths; give moments, central or indicators.")
        self.shape = (len(self.times), len(self.powers) + len(self.indicators))

    def over(self, size, rng, centre=None):
        """Sums over `size` paths about `centre`, by default their own mean.

        Returns
        -------
        sums : ndarray, shape (T, K)
        centre : ndarray, shape (T, n)
        """
        x, t = draw(self.start, rng, size, self.model.domain), self.t0
        # `Paths` remembers a step: with one of its own, what is drawn depends on rng alone
        paths = Paths(self.model, step=self.step, n_threads=self.n_threads)
        sums, means = np.empty(self.shape), np.empty((len(self.times), self.model.dim))
        for k, t1 in enumerate(self.times):
            if t1 > t:
                x = self._moved(paths, x, t, t1, rng)
            t = t1
            means[k] = x.mean(axis=0) if centre is None else centre[k]
            sums[k, : len(self.powers)] = sum_monomials(x, means[k], self.powers)
            sums[k, len(self.powers) :] = [_sum_of(name, f, x) for name, f in self.indicators.items()]
        return sums, means

    def _moved(self, paths, x, t, t1, rng):
        domain = self.model.domain
        if domain.walled.any():
            x = advance(self.model, x, t, t1, rng, self.step)
        else:
            paths.move(x, t, t1, _variance(x), self.tolerance, rng)
        return domain.wrap(x) if domain.periodic.any() else x

    def statistics(self, sums, centre):
        """Values (G, T, S) of what was asked, from the sums (G, T, K) of G groups about `centre`."""
        values = sums / sums[..., :1]
        about = values[..., : len(self.powers)]
        own_mean = recentred(about, self.powers, centre, _axes(self.model.dim))
        raw = recentred(about, self.powers, centre, self.moments)
        central = recentred(about, self.powers, centre - own_mean, self.central)
        return np.concatenate([raw, central, values[..., len(self.powers) :]], axis=-1)

    def name(self, settings):
        """Name for a cache: what the parts compute at fixed states, so that any way to write them will do."""
        x = draw(self.start, np.random.default_rng(0), _PROBES, self.model.domain)
        X = np.concatenate([x, x + np.random.default_rng(1).standard_normal(x.shape) * (1.0 + np.abs(x))])
        stepping = None if self.model.linear else (self.step, self.tolerance)
        told = (settings, stepping, self.model.domain, self.powers, self.moments, self.central)
        parts = [repr((*told, tuple(self.indicators))).encode(), x, self.t0, self.times]
        parts += [self.model.spectral_density, *(f(X) for f in self.indicators.values())]
        edges = np.concatenate([[self.t0], self.times])
        for t in np.unique(np.concatenate([edges, 0.5 * (edges[1:] + edges[:-1])])):
            parts += [self.model.drift(X, t), self.model.noise(X, t)]
        return digest(parts)


def _variance(x):
    """Variance of states (N, n), shape (n,), that of a thousandth of the state where all are the same.

    Steps are chosen in standard deviations, of which there may be none: known states, noise zero at first.
    """
    mean, variance = x.mean(axis=0), x.var(axis=0)
    known = variance <= 1e-24 * mean**2
    return np.where(known, 1e-6 * np.where(mean == 0.0, 1e-6, mean**2), variance)


def _axes(n):
    """Powers of the n means."""
    return [tuple(row) for row in np.eye(n, dtype=int).tolist()]


def _sum_of(name, indicator, x):
    values = np.asarray(indicator(x), dtype=float)
    if values.shape != (len(x),):
        raise ModelError(f"indicator {name!r} of {len(x)} states has shape {values.shape}, not ({len(x)},).")
    return values.sum()
