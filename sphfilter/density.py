"""The probability density a filter carries: particles with mass and smoothing length, and what to ask it."""

from dataclasses import dataclass, fields
from dataclasses import field as attribute

import numpy as np
from scipy import optimize, special
from scipy.stats import qmc

from . import level_set
from .core import kernels
from .core.field import Field
from .core.neighbors import build_index, choose_method
from .core.summation import sample_density, sample_density_parallel
from .domain import Domain
from .errors import ModelError
from .validate import array, choice, generator, row, state_rows

__all__ = ["LATTICE_SUPPORT", "ParticleDensity"]

LATTICE_SUPPORT = 1.2  # smoothing length on a lattice, in units of its spacing
READ_OUTS = ("points", "mixture", "log_density")
_PARALLEL_FROM = 10_000_000  # distances of points and particles, about a second's work of one thread
_SUBPOINTS = 128  # points that stand for one kernel where an integral over it has no closed form


@dataclass(frozen=True, eq=False, kw_only=True)
class ParticleDensity:
    """A probability density on SPH particles: p(x) = sum_j m_j W(x - x_j, h_j) (002 (16)).

    Attributes
    ----------
    x : ndarray, shape (N, n)
        Particle positions, in the units of the state.
    mass : ndarray, shape (N,)
        Probability masses; their sum is one.
    h : ndarray, shape (N,)
        Smoothing lengths, in the units of the state.
    t : float
        Time, seconds.
    kernel : str
        Name of the SPH kernel.
    read_out : str
        What mean, covariance and the like are computed from unless ``kind=`` says otherwise: "points"
        (sums over particles), "mixture" (integrals of p; its covariance is larger by the kernel's own) or
        "log_density" (sums over a lattice and the ring around its cut edge; the pdf is the exponential of the
        `field`, tails included).
    represented_mass : float
        Probability of the region the particles cover, where the density was cut; one if unknown.
    log_density : ndarray, shape (N,), or None
        Log-density carried along the particles' paths, for schemes that have it.
    invariant : ndarray, shape (N,), or None
        rho h^n on the last lattice, which smoothing lengths keep (002 (14)); None on a fresh lattice.
    field : Field or None
        Polynomials of log p between the nodes of a lattice, where the particles are one.
    volume : float or None
        Volume the particles fill in whitened coordinates, from which the next lattice starts.
    moments : tuple or None
        Mean (n,) and covariance (n, n) of the density beyond the cut too, where a lattice knows them.
    gaussian : bool
        Known to be Gaussian everywhere, by where it comes from.
    capacity : int or None
        Bound of the number of particles at the next re-gridding, unless another is given.
    domain : Domain or None
        Where the states live, if an axis is periodic or ends. Means of periodic axes are mean directions,
        covariances those of the differences the short way round. A log-density may lie several times round.

    Arrays are read-only; particles without mass are left out.
    """

    x: np.ndarray
    mass: np.ndarray
    h: np.ndarray
    t: float = 0.0
    kernel: str = "gaussian"
    read_out: str = "points"
    represented_mass: float = 1.0
    log_density: np.ndarray | None = None
    invariant: np.ndarray | None = None
    field: Field | None = None
    volume: float | None = None
    moments: tuple | None = None
    gaussian: bool = False
    capacity: int | None = None
    domain: Domain | None = None
    _index: list = attribute(init=False, repr=False, default_factory=list)

    def __post_init__(self):
        x = array("x", self.x, (None, None))
        own = {"x": x}
        for name in ("mass", "h", "log_density", "invariant"):
            if getattr(self, name) is not None:
                own[name] = array(name, getattr(self, name), (len(x),))
        if len(x) == 0 or own["mass"].min() < 0 or own["h"].min() <= 0 or own["mass"].sum() <= 0:
            raise ModelError("a density needs particles, masses >= 0 that are not all zero, and h > 0")
        own["mass"] /= own["mass"].sum()
        if self.domain is not None:  # none rather than one without bounds
            domain = Domain.of(self.domain, x.shape[1])
            object.__setattr__(self, "domain", None if domain.unbounded else domain)
        choice("kernel", self.kernel, kernels.KINDS)
        choice("read_out", self.read_out, READ_OUTS)
        heavy = own["mass"] > 0
        for name, value in own.items():
            value = value if heavy.all() else value[heavy]
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @classmethod
    def on_lattice(cls, laid, t, capacity=None, gaussian=False, domain=None):
        """The density of a `level_set.Laid` at time t."""
        spacing = abs(np.linalg.det(laid.field.A)) ** (1.0 / laid.x.shape[1])
        return cls(
            x=laid.x,
            mass=laid.mass,
            h=np.full(len(laid.x), LATTICE_SUPPORT * spacing),
            t=t,
            read_out="log_density",
            log_density=laid.field.log_p,
            field=laid.field,
            volume=laid.volume,
            moments=(laid.mean, laid.cov),
            gaussian=gaussian,
            capacity=capacity,
            domain=domain,
        )

    def __repr__(self):
        domain = "" if self.domain is None else f", domain={self.domain}"
        return (
            f"ParticleDensity(N={self.n_particles}, dim={self.dim}, t={self.t:g}, "
            f"read_out={self.read_out!r}, mean={row(self.mean())}, "
            f"std={row(np.sqrt(np.diag(self.cov())))}{domain})"
        )

    def __reduce__(self):
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.init}
        return _rebuild, (values,)  # through the constructor: copies are read-only too

    @property
    def dim(self):
        """Number of states n."""
        return self.x.shape[1]

    @property
    def n_particles(self):
        """Number of particles N."""
        return len(self.x)

    @property
    def kernel_code(self):
        """The kernel as compiled functions take it: its code and its constant C_n."""
        code = kernels.KINDS.index(self.kernel)
        return code, kernels.normalisation(code, self.dim)

    @property
    def kernel_variance(self):
        """c_K: the variance of one kernel is c_K h² along each axis."""
        return kernels.kernel_variance(self.kernel_code[0], self.dim)

    @property
    def mean_support(self):
        """K h averaged over the particles: how far a kernel reaches, in the units of the state."""
        return float(kernels.RADIUS[self.kernel_code[0]] * self.h.mean())

    def pdf(self, X):
        """Density at the states X (M, n) or (n,); an array (M,), per unit volume of the state space."""
        if self.field is not None and self.read_out == "log_density":
            return np.exp(self.logpdf(X))
        X = state_rows("X", X, self.dim)
        Y = self._within(X)
        if not self._index:  # built once, at the first question
            radius = kernels.RADIUS[self.kernel_code[0]]
            seen = self._with_images(radius * self.h.max())
            index = build_index(seen[0], radius * np.median(self.h), choose_method(len(seen[0]), self.dim))
            self._index.extend((*seen, index))
        out = np.empty(len(Y))
        # Threads only for long sums: a process that has used them cannot be forked.
        sums = sample_density_parallel if len(Y) * self.n_particles > _PARALLEL_FROM else sample_density
        sums(Y, *self._index, self.kernel_code, out)
        if self.domain is not None:
            out[~self.domain.contains(X)] = 0.0
        return out

    def logpdf(self, X):
        """Logarithm of `pdf`; minus infinity outside the kernels' supports, if it is a mixture's."""
        if self.field is not None and self.read_out == "log_density":
            X = state_rows("X", X, self.dim)
            if self.domain is None:
                return level_set.at(self.field, X)
            return special.logsumexp([level_set.at(self.field, X) for X in self._turns(X)], axis=0)
        with np.errstate(divide="ignore"):
            return np.log(self.pdf(X))

    def mean(self):
        """Mean, shape (n,); points and mixture agree, kernels being symmetric."""
        if self.domain is not None:
            return self.domain.mean(self.x, self.mass)
        if self.moments is not None and self.read_out == "log_density":
            return self.moments[0].copy()
        return self.mass @ self.x

    def cov(self, kind=None):
        """Covariance, shape (n, n)."""
        kind = self._kind(kind)
        if kind == "log_density" and self.moments is not None and self.domain is None:
            return self.moments[1].copy()
        d = self._from(self.x, self.mean())
        points = (d * self.mass[:, None]).T @ d
        if kind in ("points", "log_density"):
            return points
        return points + self.kernel_variance * (self.mass @ self.h**2) * np.eye(self.dim)

    def moment(self, powers, central=False, kind=None):
        """Expectation of prod_d x_d^powers[d], about the mean if `central` (the short way round an angle).

        Parameters
        ----------
        powers : sequence of int, length n
        central : bool
        kind : str, optional
            "points", "mixture" or "log_density" (integrated over a fixed set of points a kernel or cell).
        """
        powers = np.asarray(powers)
        if powers.shape != (self.dim,) or np.any(powers < 0) or np.any(powers != np.floor(powers)):
            raise ModelError(f"powers must be {self.dim} whole numbers >= 0, one a state, got {powers!r}")
        centre = self.mean()
        if powers.sum() <= 2 and self.domain is None:  # a lattice knows these beyond its cut too
            return self._low_moment(powers.astype(int), np.zeros(self.dim) if central else centre, kind)
        return self._expect(
            lambda X: np.prod((self._from(X, centre) if central else X) ** powers, axis=1), kind
        )

    def _low_moment(self, powers, mean, kind):
        """Moment of order two at most, of a density whose mean is taken to be `mean` (n,)."""
        axes = np.repeat(np.arange(self.dim), powers)
        product = float(np.prod(mean[axes]))
        return product + float(self.cov(kind)[tuple(axes)]) if len(axes) == 2 else product

    def probability(self, region, kind=None):
        """Probability of a region given as a function of states X (M, n) that returns booleans (M,).

        Examples
        --------
        >>> density.probability(lambda X: X[:, 0] > 3.0)    # doctest: +SKIP
        """
        inner = "log_density" if self.read_out == "log_density" else "mixture"
        return self._expect(lambda X: np.asarray(region(X), dtype=float), inner if kind is None else kind)

    def marginal(self, axes):
        """Density of the states in `axes` alone.

        A kernel's marginal is given the same kernel with its variance (exact for the Gaussian up to its cut).
        """
        axes = list(axes)
        if not axes or len(set(axes)) < len(axes) or not set(axes) <= set(range(self.dim)):
            raise ModelError(f"axes must be different numbers from 0 to {self.dim - 1}, got {axes}")
        code = self.kernel_code[0]
        ratio = self.kernel_variance / kernels.kernel_variance(code, len(axes))
        return ParticleDensity(
            x=self.x[:, axes],
            mass=self.mass,
            h=self.h * np.sqrt(ratio),
            t=self.t,
            kernel=self.kernel,
            read_out="points" if self.read_out == "log_density" else self.read_out,
            represented_mass=self.represented_mass,
            domain=None if self.domain is None else Domain(*[self.domain.axes[axis] for axis in axes]),
        )

    def sample(self, size, rng=None):
        """Draw states, shape (size, n), from the density; `rng` is a numpy Generator or a seed."""
        rng = generator(rng)
        if self.field is not None and self.read_out == "log_density":
            X = self._cell_points(rng.random((32, self.dim)))
            p = self.pdf(X)
            return self._within(X[rng.choice(len(X), size=size, p=p / p.sum())])
        chosen = rng.choice(self.n_particles, size=size, p=self.mass)
        offsets = self._kernel_points(rng.random((size, self.dim + 1)))
        return self._within(self.x[chosen] + self.h[chosen, None] * offsets)

    def mode(self):
        """The state of highest density, shape (n,): the best particle, then a simplex search from it."""
        best = self.x[np.argmax(self.pdf(self.x))]
        scale = 0.5 * np.median(self.h)
        simplex = np.vstack([best, best + scale * np.eye(self.dim)])
        found = optimize.minimize(
            lambda y: -self.pdf(y)[0], best, method="Nelder-Mead", options={"initial_simplex": simplex}
        )
        return found.x

    def hpd_level(self, probability):
        """Density level whose super-level set, the highest-density region, holds `probability`."""
        if not 0 < probability < 1:
            raise ModelError(f"probability must lie between 0 and 1, got {probability!r}")
        p = self.pdf(self.x)
        order = np.argsort(-p)
        return float(np.interp(probability, np.cumsum(self.mass[order]), p[order]))

    def _from(self, X, centre):
        """Differences of states X (M, n) from a centre (n,)."""
        return X - centre if self.domain is None else self.domain.nearest(X - centre)

    def _within(self, X):
        """States X (M, n), those beyond an end where they are seen from inside."""
        return X if self.domain is None else self.domain.fold(X)

    def _with_images(self, reach):
        own = self.x, self.mass, self.h
        return own if self.domain is None else self.domain.seen(self._within(self.x), *own[1:], reach)

    def _turns(self, X):
        """States X (M, n) turned round periodic axes, as often as the particles go round."""
        turns = [self._within(X)]
        for d in np.flatnonzero(self.domain.periodic):
            low, period = self.domain.low[d], self.domain.period[d]
            first, last = (np.floor((x - low) / period) for x in (self.x[:, d].min(), self.x[:, d].max()))
            shift = np.eye(self.dim)[d] * period
            turns = [Y + k * shift for Y in turns for k in np.arange(first - 1, last + 2)]
        return turns

    def _kind(self, kind):
        return self.read_out if kind is None else choice("kind", kind, READ_OUTS)

    def _expect(self, function, kind):
        """Expectation of function(X) -> (M,)."""
        kind = self._kind(kind)
        if kind == "points" or (kind == "log_density" and self.field is None):
            return float(self.mass @ function(self._within(self.x)))
        if kind == "log_density":
            X = self._cell_points(qmc.Sobol(self.dim, scramble=False).random(_SUBPOINTS // 8) + 1 / 32)
            p = np.exp(level_set.at(self.field, X))
            return float(p @ function(self._within(X)) / p.sum())
        uniform = qmc.Sobol(self.dim + 1, scramble=False).random(_SUBPOINTS)
        offsets = self._kernel_points(np.clip(uniform, 0.5 / _SUBPOINTS, 1 - 0.5 / _SUBPOINTS))
        X = (self.x[:, None] + self.h[:, None, None] * offsets).reshape(-1, self.dim)
        values = function(self._within(X))
        return float(self.mass @ values.reshape(self.n_particles, -1).mean(axis=1))

    def _cell_points(self, uniform):
        """Points (N k, n) in the lattice cells of all particles, at `uniform` (k, n) parts of a cell."""
        offsets = (np.asarray(uniform) % 1.0 - 0.5) @ self.field.A.T
        return (self.x[:, None] + offsets).reshape(-1, self.dim)

    def _kernel_points(self, uniform):
        """Map uniform numbers (k, n + 1) to points (k, n) distributed as the kernel with h = 1."""
        direction = special.ndtri(np.clip(uniform[:, :-1], 1e-15, 1 - 1e-15))
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        code = self.kernel_code[0]
        q = np.linspace(0.0, kernels.RADIUS[code], 512)
        radial = q ** (self.dim - 1) * np.array([kernels.shape(code, qk) for qk in q])
        cdf = np.concatenate([[0.0], np.cumsum(0.5 * (radial[1:] + radial[:-1]))])
        radius = np.interp(uniform[:, -1], cdf / cdf[-1], q)
        return radius[:, None] * direction / np.maximum(length, 1e-300)


def _rebuild(values):
    return ParticleDensity(**values)
