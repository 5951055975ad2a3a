"""The probability density a filter carries: particles with mass and smoothing length, and what to ask it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from .. import drawing
from .._types import Floats, Noted, ReadOut, Seed
from ..core.field.field import Field
from ..core.field.walls import NO_WALLS, Walls
from ..core.sph import kernels
from ..errors import ModelError
from ..lattice.level_set import LatticeDensity
from ..model.domain import Domain
from ..validate import array, choice, count, generator, row, state_rows
from . import statistics
from .cloud import Cloud
from .defect import Defect
from .family import Family, moments_of, nodes_of
from .folded import Folded
from .left_out import LeftOut
from .memory import Memory
from .pieces import Pieces
from .points import CloudState
from .shapes import Kernels, Polynomials, Shape, lattice_particles
from .weighted import WeightedStates, hpd_rank

READ_OUTS: tuple[ReadOut, ...] = ("points", "mixture", "log_density", "cloud", "family", "pieces")
SUMMED = 1e-14  # from one, of a sum of normalised masses; measured: 3e-16 at most of ten to 10^6


@dataclass(frozen=True, eq=False, kw_only=True)
class ParticleDensity(Noted):
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
        "log_density" (sums over a lattice and the ring
        around its cut edge; the pdf is the exponential of the `field`, tails included), "cloud" (sums over
        weighted points; the pdf is that of kernels as wide as the density about each is), "family" (the
        exponential of one polynomial, and a lattice laid for what has no closed form) or "pieces" (a few
        Gaussians). Questions about the density between the points, read as "points", are answered by the
        mixture.
    represented_mass : float
        Probability of the region the particles cover, where the density was cut; one if unknown.
    log_density : ndarray, shape (N,), or None
        Log-density at the particles, where they are the nodes of a lattice.
    invariant : ndarray, shape (N,), or None
        rho h^n on the last lattice, which smoothing lengths keep (002 (14)); None on a fresh lattice.
    field : Field or None
        Polynomials of log p between the nodes of a lattice, where the particles are one.
    volume : float or None
        Volume the particles fill in whitened coordinates, from which the next lattice starts.
    moments : tuple or None
        Mean (n,) and covariance (n, n) of the density with its tails beyond the cut, where a lattice knows
        them.
    gaussian : bool
        Whether the density is known to be Gaussian everywhere, by its origin.
    capacity : int or None
        Bound of the number of particles at the next re-gridding, unless another is given.
    domain : Domain or None
        Where the states live, if an axis is periodic or ends. Means of periodic axes are mean directions,
        covariances those of the differences the short way round. A log-density may lie several times round.

    residual : float or None
        Mean over the mass of |p/p' - 1| between the nodes of a lattice, where p' is what its polynomials say
        and p what was laid; None if unknown.
    error : float
        Estimated error of the mean, in standard deviations, accumulated over the record that led to the
        density; NaN where a scheme on the way made no estimate.
    family : Family or None
        Frame and coefficients of the polynomial that log p is, where the density is one family.
    defect : Defect or None
        What the family leaves out, where that is known.
    pieces : Pieces or None
        Gaussians that the density is the sum of.
    needs : Memory or None
        What its last steps needed, where a target error chooses how it is represented, as with
        ``n_particles="auto"``; None where a number of particles does.
    lost : float
        Probability that lattices have gained on the way, or lost (negative), as far as it still matters.
    rough : float
        Size of what a family, or one that a lattice follows, may have got wrong of the shape of log p.
    cloud : CloudState or None
        How the points of a cloud came since the last reading, and a smaller cloud that tells the error.
    left_out : LeftOut or None
        What readings have left out of it, far away.

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

    x: Floats
    mass: Floats
    h: Floats
    t: float = 0.0
    kernel: str = "gaussian"
    read_out: ReadOut = "points"
    represented_mass: float = 1.0
    log_density: Floats | None = None
    invariant: Floats | None = None
    field: Field | None = None
    volume: float | None = None
    moments: tuple[Floats, Floats] | None = None
    gaussian: bool = False
    capacity: int | None = None
    domain: Domain | None = None
    residual: float | None = None
    error: float = 0.0
    lost: float = 0.0
    rough: float = 0.0
    cloud: CloudState | None = None
    family: Family | None = None
    defect: Defect | None = None
    pieces: Pieces | None = None
    needs: Memory | None = None
    left_out: LeftOut | None = None

    def __post_init__(self) -> None:
        x = array("x", self.x, (None, None))
        own = {"x": x}
        for name in ("mass", "h", "log_density", "invariant"):
            if getattr(self, name) is not None:
                own[name] = array(name, getattr(self, name), (len(x),))
        mass, total = own["mass"], own["mass"].sum()
        if len(x) == 0 or mass.min() < 0 or own["h"].min() <= 0 or total <= 0:
            raise ModelError("a density needs particles, masses >= 0 that are not all zero, and h > 0")
        if abs(total - 1.0) > SUMMED:  # else a copy would differ in its last bits
            mass /= total
        if self.domain is not None:  # none rather than one without bounds
            domain = Domain.of(self.domain, x.shape[1])
            object.__setattr__(self, "domain", None if domain.unbounded else domain)
        choice("kernel", self.kernel, kernels.KINDS)
        choice("read_out", self.read_out, READ_OUTS)
        heavy = mass > 0
        all_heavy = heavy.all()
        for name, value in own.items():
            value = value if all_heavy else value[heavy]
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @classmethod
    def on_lattice(
        cls,
        laid: LatticeDensity,
        t: float,
        capacity: int | None = None,
        gaussian: bool = False,
        domain: Domain | None = None,
        **known: float,
    ) -> "ParticleDensity":
        """The density of a `level_set.Laid` at time t; known: its `residual`, `error`, `lost`, `rough`."""
        about: dict[str, Any] = {"t": t, "capacity": capacity, "gaussian": gaussian, "domain": domain} | known
        return cls(**lattice_particles(laid), **about)

    @classmethod
    def of_new(cls, **parts: Any) -> "ParticleDensity":
        """The same density from arrays that were made for it, and need neither be copied nor normalised."""
        x, mass, h = parts["x"], parts["mass"], parts["h"]
        sound = np.isfinite(x).all() and mass.min() > 0.0 and 0.0 < h.min() <= h.max() < np.inf
        if not sound or abs(mass.sum() - 1.0) > SUMMED:
            return cls(**parts)
        new = object.__new__(cls)  # whose other fields are those of the class
        vars(new).update(parts)
        for own in (x, mass, h):
            own.flags.writeable = False
        return new

    @classmethod
    def of_family(cls, family: Family, **about: Any) -> "ParticleDensity":
        """One family, whose nodes are its particles: they are laid where somebody asks for them."""
        new = object.__new__(cls)
        moments = (family.mu.copy(), family.A @ family.A.T) if about.get("gaussian") else moments_of(family)
        vars(new).update(about, family=family, moments=moments, read_out="family")
        return new

    if not TYPE_CHECKING:  # other names are none

        def __getattr__(self, name: str) -> Any:
            family = vars(self).get("family")
            if family is None or name not in ("x", "mass", "h"):
                raise AttributeError(f"a ParticleDensity has no {name!r}")
            for key, value in nodes_of(family).items():
                value.flags.writeable = False
                vars(self)[key] = value
            return vars(self)[name]

    def __repr__(self) -> str:
        domain = "" if self.domain is None else f", domain={self.domain}"
        return (
            f"ParticleDensity(N={self.n_particles}, dim={self.dim}, t={self.t:g}, "
            f"read_out={self.read_out!r}, mean={row(self.mean())}, "
            f"std={row(np.sqrt(np.diag(self.cov())))}{domain})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        from .storage import density_from, models_of, stored  # which knows this class

        return density_from, (stored(self), models_of(self))  # without what can be made again

    def __deepcopy__(self, memo: dict[int, Any]) -> "ParticleDensity":
        return self  # nothing in it can be changed

    @property
    def dim(self) -> int:
        """Number of states n."""
        own: Any = vars(self)
        return own["x"].shape[1] if "x" in own else len(own["family"].mu)

    @property
    def walls(self) -> Walls:
        """Where the axes end, low and high, shape (n,) each; empty arrays if none does."""
        return NO_WALLS if self.domain is None else self.domain.walls

    @property
    def n_particles(self) -> int:
        """Number of particles N."""
        own: Any = vars(self)
        return len(own["x"] if "x" in own else own["family"].basis.xi)

    @property
    def sph_kernel(self) -> kernels.Kernel:
        """The kernel in numbers."""
        return kernels.Kernel.of(self.kernel, self.dim)

    @property
    def kernel_variance(self) -> float:
        """c_K: the variance of one kernel is c_K h² along each axis."""
        return self.sph_kernel.variance

    @property
    def mean_support(self) -> float:
        """K h averaged over the particles: how far a kernel reaches, in the units of the state."""
        return float(self.sph_kernel.radius * self.h.mean())

    @cached_property
    def form(self) -> Shape:
        """The shape that answers questions: `Kernels`, `Cloud` or `Polynomials`, `Folded` in a domain."""
        return self._shape(self.read_out)

    def _shape(self, kind: ReadOut) -> Shape:
        """The shape that is read as `kind`."""
        shape: Any
        formula: Any = {"family": self.family, "pieces": self.pieces}.get(kind)
        if formula is not None:
            shape = formula.shape(self.moments)
        elif kind == "log_density" and self.field is not None:
            shape = Polynomials(self.field, self.x, self.mass, self.moments)
        else:
            kind = "points" if kind in ("log_density", "family", "pieces") else kind
            points = Cloud if kind == "cloud" else Kernels
            shape = points(self.x, self.mass, self.h, self.sph_kernel, kind, log_p=self.log_density)
        return shape if self.domain is None else Folded(shape, self.domain)

    @property
    def cells(self) -> Floats:
        """Middles (M, n) of the lattice's cells in which the density is more than nothing."""
        found = self.form.cells
        if found is None:
            raise ModelError("the density lies on no lattice of level sets, and has no cells")
        return found

    def pdf(self, X: ArrayLike) -> Floats:
        """Density at the states X (M, n) or (n,); an array (M,), per unit volume of the state space."""
        return self.form.pdf(state_rows("X", X, self.dim))

    def logpdf(self, X: ArrayLike) -> Floats:
        """Logarithm of `pdf`; minus infinity outside the kernels' supports, if the density is a mixture."""
        return self.form.logpdf(state_rows("X", X, self.dim))

    def gradient(self, X: ArrayLike) -> Floats:
        """Gradient of `pdf` at the states X (M, n) or (n,), shape (M, n)."""
        return self.form.gradient(state_rows("X", X, self.dim))

    def mean(self) -> Floats:
        """Mean, shape (n,); the mean of a periodic axis is a direction."""
        return self.form.mean()

    def cov(self, kind: ReadOut | None = None) -> Floats:
        """Covariance, shape (n, n); `kind` is a `read_out`."""
        shape = self.form if kind is None else self._shape(choice("kind", kind, READ_OUTS))
        return shape.cov(self.mean())

    def moment(self, powers: Sequence[int], central: bool = False, kind: ReadOut | None = None) -> float:
        """Expectation of prod_d x_d^powers[d], about the mean if `central` (the short way round an angle).

        Parameters
        ----------
        powers : sequence of int, length n
        central : bool
        kind : str, optional
            A `read_out`; by default "points" for a "cloud", since a prediction gets the moments of its points
            right. "log_density" takes a fixed set of points a cell.
        """
        read = self._read(kind, {"cloud": "points"})
        return statistics.moment(read, powers, self.mean() if central else None)

    def probability(self, region: Callable[[Floats], ArrayLike], kind: ReadOut | None = None) -> float:
        """Probability of a region given as a function of states X (M, n) that returns booleans (M,).

        It may return numbers from 0 to 1, of which that is the expectation.

        Examples
        --------
        >>> import sphfilter as sf
        >>> density = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=100)
        >>> print(f"{density.probability(lambda X: X[:, 0] > 3.0):.5f}")  # 0.00135
        0.00135
        """

        def values(X: Floats) -> Floats:
            p = array("what the region returns", region(X), (len(X),), "a boolean for each row of X")
            off = p[(p < 0.0) | (p > 1.0)]
            if len(off):
                raise ModelError(
                    f"a region returns booleans for states X, got {off[0]:g}; compare: X[:, 0] > 0"
                )
            return p

        return statistics.expectation(self._between(kind), values, smooth=False)

    @overload
    def quantile(self, axis: int, probability: float, kind: ReadOut | None = None) -> float: ...

    @overload
    def quantile(
        self, axis: int, probability: Sequence[float] | Floats, kind: ReadOut | None = None
    ) -> Floats: ...

    def quantile(
        self, axis: int, probability: float | Sequence[float] | Floats, kind: ReadOut | None = None
    ) -> float | Floats:
        """Value below which a state lies with a probability; an array (K,) for an array of probabilities.

        The probability is counted from the low end of the domain, if the axis has one; `kind` is a
        `read_out`.
        """
        return statistics.quantile(self._between(kind), axis, probability)

    def entropy(self, kind: ReadOut | None = None) -> float:
        """Differential entropy -E[log p], nats; it depends on the units of the states.

        Read as "points", the density has the entropy of the log-density that its particles carry, if they
        carry one; `kind` is a `read_out`.
        """
        return statistics.entropy(self._between(kind))

    def hpd_region(self, probability: float, kind: ReadOut | None = None) -> statistics.Region:
        """The smallest region that holds `probability`, as a `statistics.Region`.

        The region is a function of states X (M, n) that returns booleans (M,), with a `level` and a `volume`;
        `kind` is a `read_out`.
        """
        return statistics.highest_region(self._between(kind), probability)

    def hpd_level(self, probability: float) -> float:
        """Density level whose super-level set, the highest-density region, holds `probability`."""
        return self.hpd_region(probability).level

    def hpd_rank(self, X: ArrayLike, kind: ReadOut | None = None) -> Floats:
        """Probability of the region where the density is higher than at states X (M, n) or (n,), shape (M,).

        The rank is zero at the mode, one far away, and uniform for states drawn from the density: where a
        truth lies outside of the 95 % region as often as one time in twenty, the density is calibrated.
        """
        return hpd_rank(self.spread(kind), state_rows("X", X, self.dim))

    def spread(self, kind: ReadOut | None = None) -> WeightedStates:
        """The density as states and weights whose sums are its expectations, `WeightedStates`."""
        return statistics.spread(self._between(kind))

    @cached_property
    def pdf_error(self) -> float:
        """Estimated Hellinger distance of the `pdf` of a cloud from the true one; NaN where nothing tells it.

        In [0, 1]: the square is half the integral of (√p - √q)². A smaller cloud beside it tells.
        """
        return statistics.pdf_error(self)

    def error_of(self, question: Callable[["ParticleDensity"], Any]) -> Any:
        """Estimated standard error of an answer of this density, a float or an array of the answer's shape.

        Parameters
        ----------
        question : callable
            Of a density; returns a number or an array. Of a cloud parts of it are asked, whose answers
            differ; of a family the same one with its defect; of any other the same one moved and stretched,
            as far as its `error` says. NaN of kernels, of which nothing tells an error.

        Examples
        --------
        >>> import sphfilter as sf
        >>> config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=4096))
        >>> model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[1.0]])
        >>> flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[1.0]], config=config)
        >>> info = flt.predict(1.0), flt.update([0.5])
        >>> error = flt.density.error_of(lambda p: p.probability(lambda X: X[:, 0] > 1.0))
        >>> print(f"{flt.density.probability(lambda X: X[:, 0] > 1.0):.2f}", error < 0.01)
        0.09 True
        """
        found = statistics.error_of(self, question)
        return found if found.ndim else float(found)

    def mode(self) -> Floats:
        """The state of highest density, shape (n,): the best particle, then a simplex search from it."""
        return statistics.mode(self)

    def plot(self, axes: Sequence[int] | None = None, ax: Any = None) -> Any:
        """Draw the density; needs matplotlib.

        Parameters
        ----------
        axes : sequence of int, optional
            States that are drawn, all if not given: one as a line, two as a map with the smallest regions
            that hold .5, .9 and .99, more as all pairs.
        ax : matplotlib Axes, or an array (k, k) of these, optional
            A new figure if not given; returned either way.
        """
        own = list(range(self.dim)) if axes is None else statistics.checked_axes(axes, self.dim)
        return drawing.density(self, [f"x{a}" for a in range(self.dim)], own, ax)

    def sample(self, size: int, rng: Seed = None) -> Floats:
        """Draw states, shape (size, n), from the density; `rng` is a numpy Generator or a seed."""
        return self.form.sample(count("size", size, least=0), generator(rng))

    def marginal(self, axes: Sequence[int]) -> "ParticleDensity":
        """Density of the states in `axes` alone, a `ParticleDensity` with the domain of those axes.

        A log-density is summed over the others, on a lattice of its own. A kernel's marginal is given the
        same kernel with its variance (exact for the Gaussian up to its cut).
        """
        axes = statistics.checked_axes(axes, self.dim)
        if axes == list(range(self.dim)):
            return self
        domain = None if self.domain is None else Domain(*[self.domain.axes[axis] for axis in axes])
        about: dict[str, Any] = {"t": self.t, "domain": domain, "error": self.error}
        given = self.form.marginal(axes)
        if "moments" in given:  # of a lattice or of a family
            return ParticleDensity(**given, **about, gaussian=self.gaussian)
        about |= {"kernel": self.kernel, "represented_mass": self.represented_mass}
        return ParticleDensity(**given, **about)

    def _read(self, kind: ReadOut | None, usual: Mapping[ReadOut, ReadOut]) -> "ParticleDensity":
        """The density read as a kind, if one is given; else as is usual for its own, or itself."""
        own = self.read_out
        read_out = usual.get(own, own) if kind is None else choice("kind", kind, READ_OUTS)
        return self if read_out == own else replace(self, read_out=read_out)

    def _between(self, kind: ReadOut | None) -> "ParticleDensity":
        """The density as it is read between its points."""
        return self._read(kind, {"points": "mixture"})
