"""Settings as frozen, keyword-only dataclasses that check themselves, and can be read from TOML.

Pydantic does the checking; its report is turned into one sentence a user can act on, which names the
nearest valid key where a key is unknown.
"""

import logging
import tomllib
from dataclasses import asdict, fields, is_dataclass, replace
from typing import Annotated, Any, Literal, Self, TypeAlias

import tomli_w
from pydantic import BeforeValidator, Field, model_validator

from .errors import ConfigError, nearest
from .settings import Count, Positive, from_table, settings

_LOGGER = logging.getLogger("sphfilter")

#: M_B for n = 2, 3, 4 (002 section 4.5). For n = 1 two layers of a lattice; n = 5, 6 continue the growth.
BUFFER_NEIGHBORS = {1: 4, 2: 8, 3: 30, 4: 54, 5: 80, 6: 110}


@settings
class PaperScheme:
    """The scheme of 002, with its errata mended and every knob exposed.

    Attributes
    ----------
    kernel : str
        Lucy for the scenes of 002 Tables 6 and 8, Gaussian for Table 10.
    represented_mass : float
        P_T: probability inside the core ellipsoid (39) at the start, and of the core when re-gridding.
    domain_mass : float
        P~_T: probability kept, core and boundary, when a re-gridding discards its lightest nodes (6.1).
    buffer_ratio : float
        k_R of (42): layers of buffer particles around the core, in support radii.
    support_range, support_steps
        Values of the support Lambda = K h / dx swept for the best initial h (002 4.6.1). The coupling
        eta = h / dx of 000 is the range (K eta, K eta), with K = 3, 2, 1 for the Gaussian, the cubic and
        Lucy's kernel: eta = 1.2 is (3.6, 3.6), (2.4, 2.4) and (1.2, 1.2).
    anisotropy : float
        A_max: largest ratio between the lattice spacings of two axes; 1 is 002's own.
    masses : str
        "riemann" (density times cell volume) or "collocation" (002 4.6.2: solved for, if non-negative).
    smoothing : str
        Smoothing length: "proportional" (002 (14), lagged a step), "fixed_point", "newton" or "fixed".
    smoothing_tolerance, smoothing_iterations, discard_unconverged
        A fixed point has converged where a sweep changes h by less than this part; Newton's rule to 1e-6.
        Either stops after so many iterations. Particles that have not converged then stay, or are dropped
        and the others share their mass (000 Algorithm 3), see `PredictInfo.n_discarded`.
    integrator, cfl, c_cfl, dt_max
        Time stepping: (17)-(18); "relative" compares with the nearest neighbour's velocity (000) and wants
        `dt_max` seconds, since it guards against collisions and does not control the error; "fixed" takes
        `dt_max` for every step, without the limit of diffusion (000). Where drift or noise depend on time a
        step is a hundredth of the prediction at most; give `dt_max` if that is coarse.
    c_diffusion : float or None
        Explicit limit dt <= c_diffusion c_K h^2 / tr D (unstable from about 2.7 on); not in 002, None is off.
    search, bypass, c_nns, bypass_max, buffer_neighbors
        Neighbour search, and its bypass (43)-(47); `buffer_neighbors` is M_B (by dimension if None), and
        half of it forces a search.
    max_steps : int
        Steps of one prediction, re-griddings included, after which it is given up with an error.
    read_out : str
        What mean and covariance are computed from: "points" or the "mixture" of kernels.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.PaperScheme(kernel="gaussian", support_range=(3.6, 3.6), integrator="midpoint").c_cfl)
    0.2
    """

    name: Literal["paper"] = "paper"
    kernel: Literal["gaussian", "lucy", "cubic", "wendland_c2", "wendland_c4"] = "lucy"
    represented_mass: Annotated[float, Field(gt=0.5, lt=1)] = 0.995
    domain_mass: Annotated[float, Field(gt=0.5, lt=1)] = 0.9995
    buffer_ratio: Annotated[float, Field(ge=0)] = 1.5
    support_range: tuple[Positive, Positive] = (2.2, 3.0)
    support_steps: Count = 9
    anisotropy: Annotated[float, Field(ge=1)] = 1.0
    masses: Literal["riemann", "collocation"] = "riemann"
    smoothing: Literal["fixed", "proportional", "fixed_point", "newton"] = "proportional"
    smoothing_tolerance: Positive = 1e-3
    smoothing_iterations: Count = 30
    discard_unconverged: bool = False
    integrator: Literal["euler", "midpoint", "rk4"] = "euler"
    cfl: Literal["absolute", "relative", "fixed"] = "absolute"
    c_cfl: Positive = 0.2
    dt_max: Positive | None = None
    c_diffusion: Positive | None = 1.0
    search: Literal["auto", "brute", "cells", "tree"] = "auto"
    bypass: bool = True
    c_nns: Positive = 1.0
    bypass_max: Count = 15
    buffer_neighbors: Count | None = None
    max_steps: Count = 200_000
    read_out: Literal["points", "mixture"] = "points"

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.support_range[0] > self.support_range[1]:
            raise ValueError("support_range must rise, e.g. [2.2, 3.0]")
        if self.discard_unconverged and self.smoothing not in ("fixed_point", "newton"):
            raise ValueError('discard_unconverged needs smoothing = "fixed_point" or "newton", which iterate')
        if self.cfl == "relative" and self.dt_max is None:
            raise ValueError('cfl = "relative" guards against collisions only: give dt_max as well')
        if self.cfl == "fixed" and self.dt_max is None:
            raise ValueError('cfl = "fixed" takes steps of dt_max: give it, seconds')
        return self


@settings
class LogDensityScheme:
    """Log-density on a whitened lattice, carried along backward stochastic characteristics.

    Nothing here has to be tuned: time steps, lattices and neighbourhoods follow from the density.

    Attributes
    ----------
    reach : float, optional
        Z: particles lie where log p is within Z²/2 of its largest, so out to Z sigma of a Gaussian. By
        default 5.5, 4.2 and 4 in one, two and more dimensions.
    tolerance : float, optional
        Error allowed in the paths of a time step: rms over the mass, in standard deviations. By default in
        proportion to the error of the lattice.
    noise_share : float, optional
        Largest variance that the noise of a time step may have, in units of the density's own variance. By
        default steps are as long as their own error allows.
    quadrature : int
        Gauss-Hermite points of one noise over a step.
    most_lost : float
        Probability that the lattices of one prediction may lose or gain in all before it is given up; five
        times as much as long as the error it estimates leaves no doubt about the mean.
    max_steps : int
        Steps of one prediction after which it is given up with an error.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.FilterConfig(scheme=sf.LogDensityScheme(reach=5.0)).scheme.reach)
    5.0
    """

    name: Literal["log_density"] = "log_density"
    reach: Annotated[float, Field(ge=2.5, le=12)] | None = None
    tolerance: Positive | None = None
    noise_share: Annotated[float, Field(gt=0, le=20)] | None = None
    quadrature: Annotated[int, Field(ge=2, le=15)] = 5
    most_lost: Positive = 0.01
    max_steps: Count = 10_000


@settings
class CloudScheme:
    """Weighted points on paths of the model, quasi-random, which a reading leads to where it finds the state.

    Their noise follows from a fixed key and the time: the same input gives the same bits. Errors fall about
    as the number of points to the power of .6; a smaller cloud beside tells them.

    Attributes
    ----------
    n_points : int
        Points of a cloud; a thousand know a mean to one or three hundredths of its standard deviation.
    max_steps : int
        Steps of one prediction after which it is given up with an error.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.FilterConfig(scheme="cloud").scheme.n_points)
    20000
    """

    name: Literal["cloud"] = "cloud"
    n_points: Annotated[int, Field(ge=200, le=10_000_000)] = 20_000
    max_steps: Count = 200_000


@settings
class FamilyScheme:
    """One exponential family: log p is a polynomial, carried by an ordinary equation at a few dozen nodes.

    Cheap where the density keeps one shape, of up to six states and smooth; where it does not, the estimated
    error says so, or the step is refused.

    Attributes
    ----------
    degree : int, optional
        Total degree of the polynomial: by default 6, 6, 5, 4, 3 and 3 for one to six states.
    tolerance : float
        Error allowed in a time step: of the coefficients, and of the frame in standard deviations.
    max_steps : int
        Steps of one prediction after which it is given up with an error.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.FilterConfig(scheme=sf.FamilyScheme(degree=4)).scheme.name)
    family
    """

    name: Literal["family"] = "family"
    degree: Annotated[int, Field(ge=2, le=8)] | None = None
    tolerance: Positive = 1e-3
    max_steps: Count = 10_000


@settings
class AcceptanceTest:
    """Measurement acceptance of 002 6.3; off unless asked for (`FilterConfig.paper` asks).

    Attributes
    ----------
    enabled : bool
    z_pi : float
        Standard deviations of the expected posterior that must lie inside the prior's domain (61).
    f_edge : float
        Largest part of the expected posterior that may lie in the kernels' overhang (62).
    on_reject : str
        "keep" the prior's particles, or "resample" them.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.FilterConfig(acceptance=sf.AcceptanceTest(enabled=True, f_edge=0.6)).acceptance.z_pi)
    2.576
    """

    enabled: bool = False
    z_pi: Positive = 2.576
    f_edge: Annotated[float, Field(ge=0, lt=1)] = 1 / 3
    on_reject: Literal["keep", "resample"] = "keep"


@settings
class _Settings:
    """Reading, writing and changing settings."""

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Read settings from TOML text; raise `ConfigError` for text that is not TOML or not valid."""
        try:
            return cls(**tomllib.loads(text))
        except tomllib.TOMLDecodeError as problem:
            raise ConfigError(f"not valid TOML: {problem}") from None

    def to_toml(self) -> str:
        """Return all settings as TOML text; keys that are None are left out."""
        return tomli_w.dumps(_without_none(asdict(self)))

    @classmethod
    def paper(cls, **changes: Any) -> Self:
        """Return the scheme of 002 with its published values; `changes` go to the part that has the key.

        Examples
        --------
        >>> from sphfilter import FilterConfig
        >>> FilterConfig.paper(kernel="gaussian", z_pi=3.0).scheme.kernel
        'gaussian'
        """
        settings = cls(**{"scheme": PaperScheme(), **cls._paper_parts()})
        parts = {f.name: getattr(settings, f.name) for f in fields(cls)}
        owner = {f.name: part for part, value in parts.items() if is_dataclass(value) for f in fields(value)}
        for key, value in changes.items():
            if key not in owner:
                known = ", ".join(owner)
                raise ConfigError(f"unknown key {key!r}{nearest(key, owner)}; valid keys are {known}")
            parts[owner[key]] = replace(parts[owner[key]], **{key: value})
        return cls(**parts)

    @classmethod
    def _paper_parts(cls) -> dict[str, Any]:
        return {}


def _without_none(tree: dict[str, Any]) -> dict[str, Any]:
    return {k: _without_none(v) if isinstance(v, dict) else v for k, v in tree.items() if v is not None}


SCHEMES = {scheme.name: scheme for scheme in (LogDensityScheme, PaperScheme, CloudScheme, FamilyScheme)}
#: Names become settings: of these a configuration holds "auto" only.
_Name = Literal["auto", "log_density", "paper", "cloud", "family"]
_Settled = LogDensityScheme | PaperScheme | CloudScheme | FamilyScheme
Scheme: TypeAlias = _Name | _Settled
#: Schemes that were taken out: files and programs that name one get the default, and are told so.
_TAKEN_OUT = {"corrected": "moment-corrected SPH"}


def _named_scheme(value: object) -> object:
    """A scheme by its name, or as a table: the paper's where the table does not name one."""
    name = value.get("name") if isinstance(value, dict) else value
    if isinstance(name, str) and name in _TAKEN_OUT:
        _LOGGER.warning('scheme %r, %s, was taken out; "auto" takes its place', name, _TAKEN_OUT[name])
        return "auto"
    if isinstance(value, str) and value in SCHEMES:
        return SCHEMES[value]()
    if isinstance(value, str) and value != "auto":
        known = ["auto", *SCHEMES]
        raise ValueError(f"there is no scheme {value!r}{nearest(value, known)}; there are {', '.join(known)}")
    if isinstance(value, dict):
        name = value.get("name", "paper")
        if name not in SCHEMES:
            raise ValueError(f"there is no scheme {name!r}{nearest(str(name), SCHEMES)}")
        return from_table(SCHEMES[name], value)
    if not isinstance(value, str | _Settled):
        raise ValueError(f"a scheme is auto, one of {', '.join(SCHEMES)}, or its settings, not {value!r}")
    return value


SchemeChoice = Annotated[Scheme, BeforeValidator(_named_scheme)]


_RULES = "never", "health"


def _remesh_rule(value: object) -> object:
    if value in _RULES or (isinstance(value, int | float) and value > 0):
        return value
    raise ValueError(f"{value!r} is none of never, health and seconds above zero{nearest(value, _RULES)}")


RemeshRule = Annotated[Literal["never", "health"] | Positive, BeforeValidator(_remesh_rule)]


@settings
class SolverConfig(_Settings):
    """Settings of the transient solver.

    Attributes
    ----------
    scheme : "auto", or a scheme, or its name
        "auto" carries the log-density where the model and the number of particles allow it, and falls back
        on a cloud of weighted points where they do not, beside walls on sums over kernels; the info says
        which it was.
    exact_linear : bool
        Carry a Gaussian through a linear model in closed form.
    remesh : "never", "health" or float
        When `propagate` puts particles that sums over kernels have carried on a new lattice (002 5.3): never,
        where `health` finds that they have mixed, clumped or gone astray, or so many seconds apart.
        Log-densities are on a new lattice at every step anyway.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.SolverConfig(scheme="paper", remesh=2.0).scheme.masses)
    riemann
    """

    scheme: SchemeChoice = "auto"
    exact_linear: bool = False
    remesh: RemeshRule = "never"


@settings
class FilterConfig(_Settings):
    """Settings of the filter: as `SolverConfig`, and the acceptance test of a measurement.

    Attributes
    ----------
    scheme : "auto", or a scheme, or its name
    exact_linear : bool
    acceptance : AcceptanceTest
    target_error : float
        Error of the posterior mean, in posterior standard deviations, root mean square over the states, which
        ``n_particles="auto"`` aims at; `info.error` is what a step estimates of the same number.
    density_error : float, optional
        Hellinger distance of the density that is wanted. With it ``n_particles="auto"`` lays lattices in one
        and two states instead of clouds, whose moments cost less, but whose densities are rougher. Without it
        the density is as good as the points give.
    most_left_out : float
        Probability that an update may leave out where it finds some beyond the cut of the posterior, such as
        in a remote mode; more is flagged, `Code.UNRESOLVED`. Beyond √20 = 4.5 standard deviations it counts
        by the square of the distance, as a variance does: ε at L of these as ε L² / 20.
    time_budget : float, optional
        Wall-clock seconds that a predict of a filter and the updates after it may take together. With it
        results depend on the machine and its load.

    Examples
    --------
    >>> import sphfilter as sf
    >>> config = sf.FilterConfig(target_error=0.003)
    >>> print(sf.FilterConfig.from_toml(config.to_toml()) == config)
    True
    >>> print(sf.FilterConfig(scheme="paper").scheme.kernel, sf.FilterConfig.paper().acceptance.enabled)
    lucy True
    """

    scheme: SchemeChoice = "auto"
    exact_linear: bool = False
    acceptance: AcceptanceTest = Field(default_factory=AcceptanceTest)
    target_error: Positive = 0.01
    time_budget: Positive | None = None
    most_left_out: Annotated[float, Field(gt=0, lt=1)] = 1e-3
    density_error: Positive | None = None

    def __repr__(self) -> str:
        """The settings, but for the defaults of those that came later: campaigns know their runs by this."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        for later in ("most_left_out", "density_error"):
            if values[later] == getattr(FilterConfig, later):
                del values[later]
        return f"FilterConfig({', '.join(f'{name}={value!r}' for name, value in values.items())})"

    @classmethod
    def _paper_parts(cls) -> dict[str, Any]:
        return {"acceptance": AcceptanceTest(enabled=True)}


#: Settings of a prediction.
AnyConfig: TypeAlias = SolverConfig | FilterConfig


def checked_filter_config(config: FilterConfig | None) -> FilterConfig:
    """Return `config`, the default for None; anything but a `FilterConfig` is a `ConfigError`."""
    if config is None:
        return FilterConfig()
    if not isinstance(config, FilterConfig):
        raise ConfigError(f"config must be a FilterConfig such as FilterConfig.paper(), not {config!r:.80}")
    return config
