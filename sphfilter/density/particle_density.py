"""The probability density a filter carries: particles with mass and smoothing length, and what to ask it."""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy import special

from ..core.field.field import Field
from ..core.sph import kernels
from ..errors import ModelError
from ..lattice import field
from ..model.domain import Domain
from ..validate import array, choice, generator, row, state_rows
from . import marginal, mixture, statistics

__all__ = ["LATTICE_SUPPORT", "ParticleDensity"]

LATTICE_SUPPORT = 1.2  # smoothing length on a lattice, in units of its spacing
READ_OUTS = ("points", "mixture", "shrunk", "log_density")


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
        (sums over particles), "mixture" (integrals of p; its covariance is larger by the kernel's own),
        "shrunk" (as "mixture", with what the kernels widen taken back: mean and covariance are those of the
        points; with a domain it is the mixture) or "log_density" (sums over a lattice and the ring around
        its cut edge; the pdf is the exponential of the `field`, tails included). Where the points do not say
        how the density lies between them, they stand for the mixture.
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

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> p = sf.initialize(sf.Gaussian([0.0, 0.0], [[1.0, 0.5], [0.5, 1.0]]), n_particles=300)
    >>> print(p.pdf([0.0, 0.0]).round(4), f"{p.moment([1, 1]):.4f} {p.entropy():.3f}")
    [0.1838] 0.4999 2.694
    >>> print(p.hpd_region(0.95)([[0.0, 0.0], [2.0, -2.0]]), f"{p.marginal([0]).quantile(0, 0.975):.3f}")
    [ True False] 1.960
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

    @cached_property
    def mixture(self):
        """The kernels that `pdf` sums, as a `mixture.Mixture`; made at the first question."""
        if self.read_out == "shrunk" and self.domain is None:
            found = mixture.shrunk(self.x, self.mass, self.h, self.kernel_code)
            if found is not None:
                return found
        own = self.x, self.mass, self.h
        if self.domain is not None:
            reach = kernels.RADIUS[self.kernel_code[0]] * self.h.max()
            own = self.domain.seen(self._within(self.x), *own[1:], reach)
        return mixture.mixture(*own, self.kernel_code)

    @cached_property
    def cells(self):
        """Middles (M, n) of the lattice's cells in which the density is more than nothing."""
        return marginal.around(self.field)

    def pdf(self, X):
        """Density at the states X (M, n) or (n,); an array (M,), per unit volume of the state space."""
        if self.field is not None and self.read_out == "log_density":
            return np.exp(self.logpdf(X))
        X = state_rows("X", X, self.dim)
        out = mixture.pdf(self.mixture, self._within(X))
        if self.domain is not None:
            out[~self.domain.contains(X)] = 0.0
        return out

    def logpdf(self, X):
        """Logarithm of `pdf`; minus infinity outside the kernels' supports, if it is a mixture's."""
        if self.field is not None and self.read_out == "log_density":
            X = state_rows("X", X, self.dim)
            if self.domain is None:
                return field.at(self.field, X)
            return special.logsumexp([field.at(self.field, X) for X in self._turns(X)], axis=0)
        with np.errstate(divide="ignore"):
            return np.log(self.pdf(X))

    def gradient(self, X):
        """Gradient of `pdf` at the states X (M, n) or (n,), shape (M, n)."""
        X = state_rows("X", X, self.dim)
        if self.field is not None and self.read_out == "log_density":
            turns = [X] if self.domain is None else self._turns(X)
            p = (np.exp(field.at(self.field, Y)) for Y in turns)
            slopes = (field.gradient(self.field, Y) for Y in turns)
            return sum(each[:, None] * slope for each, slope in zip(p, slopes, strict=True))
        out = mixture.gradient(self.mixture, self._within(X))
        if self.domain is not None:
            out[~self.domain.contains(X)] = 0.0
        return out

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
        if kind != "mixture":
            return points
        return points + self.kernel_variance * (self.mass @ self.h**2) * np.eye(self.dim)

    def moment(self, powers, central=False, kind=None):
        """Expectation of prod_d x_d^powers[d], about the mean if `central` (the short way round an angle).

        Parameters
        ----------
        powers : sequence of int, length n
        central : bool
        kind : str, optional
            A `read_out`; "points" for a density that is "shrunk", for it is they whose moments a prediction
            gets right. "shrunk" and "log_density" take a fixed set of points a kernel or cell.
        """
        read = self._read("points" if kind is None and self.read_out == "shrunk" else kind)
        return statistics.moment(read, powers, self.mean() if central else None)

    def probability(self, region, kind=None):
        """Probability of a region given as a function of states X (M, n) that returns booleans (M,).

        Examples
        --------
        >>> import sphfilter as sf
        >>> density = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=100)
        >>> print(f"{density.probability(lambda X: X[:, 0] > 3.0):.5f}")  # 0.00135
        0.00135
        """
        read = self._between(kind)
        return statistics.expectation(read, lambda X: np.asarray(region(X), dtype=float), smooth=False)

    def quantile(self, axis, probability, kind=None):
        """Value below which a state lies with `probability`, a float, or an array (K,) for an array of them.

        It is counted from the low end of the domain, if the axis has one; `kind` is a `read_out`.
        """
        return statistics.quantile(self._between(kind), axis, probability)

    def entropy(self, kind=None):
        """Differential entropy -E[log p], nats; it depends on the units of the states.

        Of "points" that of the log-density they carry, if they do; `kind` is a `read_out`.
        """
        return statistics.entropy(self._between(kind))

    def hpd_region(self, probability, kind=None):
        """The smallest region that holds `probability`, as a `statistics.Region`.

        It is a function of states X (M, n) that returns booleans (M,), with its `level` and its `volume`;
        `kind` is a `read_out`.
        """
        return statistics.highest_region(self._between(kind), probability)

    def hpd_level(self, probability):
        """Density level whose super-level set, the highest-density region, holds `probability`."""
        return self.hpd_region(probability).level

    def hpd_rank(self, X, kind=None):
        """Probability of the region where the density is higher than at states X (M, n) or (n,), shape (M,).

        Zero at the mode, one far away, and uniform for states drawn from the density: where a truth lies
        outside of the 95 % region as often as one time in twenty, the density is calibrated.
        """
        return statistics.hpd_rank(self._between(kind), X)

    def spread(self, kind=None):
        """The density as states and weights whose sums are its expectations, `WeightedStates`."""
        return statistics.spread(self._between(kind))

    def mode(self):
        """The state of highest density, shape (n,): the best particle, then a simplex search from it."""
        return statistics.mode(self)

    def sample(self, size, rng=None):
        """Draw states, shape (size, n), from the density; `rng` is a numpy Generator or a seed."""
        return statistics.sample(self, size, generator(rng))

    def marginal(self, axes):
        """Density of the states in `axes` alone, a `ParticleDensity` with the domain of those axes.

        A log-density is summed over the others, on a lattice of its own. A kernel's marginal is given the
        same kernel with its variance (exact for the Gaussian up to its cut).
        """
        axes = statistics.checked_axes(axes, self.dim)
        if axes == list(range(self.dim)):
            return self
        domain = None if self.domain is None else Domain(*[self.domain.axes[axis] for axis in axes])
        if self.read_out == "log_density" and self.field is not None:
            laid = marginal.laid_marginal(self, axes)
            return ParticleDensity.on_lattice(laid, self.t, gaussian=self.gaussian, domain=domain)
        return ParticleDensity(
            x=self.x[:, axes],
            mass=self.mass,
            h=marginal.projected_lengths(self, axes),
            t=self.t,
            kernel=self.kernel,
            read_out="points" if self.read_out == "log_density" else self.read_out,
            represented_mass=self.represented_mass,
            domain=domain,
        )

    def _from(self, X, centre):
        """Differences of states X (M, n) from a centre (n,)."""
        return X - centre if self.domain is None else self.domain.nearest(X - centre)

    def _within(self, X):
        """States X (M, n), those beyond an end where they are seen from inside."""
        return X if self.domain is None else self.domain.fold(X)

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

    def _read(self, kind):
        """The density with another read-out, or itself."""
        kind = self._kind(kind)
        return self if kind == self.read_out else replace(self, read_out=kind)

    def _between(self, kind):
        """The density as it is read between its points."""
        return self._read("mixture" if kind is None and self.read_out == "points" else kind)


def _rebuild(values):
    return ParticleDensity(**values)
