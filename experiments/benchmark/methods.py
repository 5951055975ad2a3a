"""The competitors: families of filters, and the sizes at which each is run."""

from dataclasses import dataclass

from experiments.scene.filters import Factory
from experiments.scene.settings import Grid, MomentFilter, Particle
from sphfilter.config import CloudScheme, FamilyScheme, FilterConfig
from sphfilter.files.model_file import Sph

from . import boxed
from .families import FAMILIES, check_families

#: Particles by number of states (three stands for all above two), quick or not.
_SPH = {1: (25, 50, 100, 200), 2: (100, 200, 400, 800, 1600), 3: (200, 500, 1000, 2000, 4000)}
#: Of n_particles="auto": one over the target error.
_AUTO = (10, 33, 100, 300, 1000)
_PAPER = {1: (50, 200), 2: (200, 800), 3: (1000,)}
_PF, _PF4 = (200, 1000, 10_000, 100_000), (1000, 10_000, 100_000)
_REFEREE = (48, 96)
#: Nodes an axis of the boxed grid, and its steps in an interval between measurements.
_GRID = ((32, 12), (48, 25), (64, 50), (96, 100))
#: Sizes of schemes that take no number of particles, and the schemes: points, or a degree.
_FORCED = {
    "cloud": ((256, 1024, 4096, 16_384, 65_536), lambda size: CloudScheme(n_points=size)),
    "family": ((2, 3, 4, 6), lambda size: FamilyScheme(degree=size)),
}
#: Particles from which the better of the particle filters is tried with a second thread, too.
_TWO_THREADS_FROM = 100_000


@dataclass(frozen=True)
class Method:
    """One competitor at one size."""

    family: str  # a name of `FAMILIES`, or "sph:SCHEME"
    # particles at most, nodes an axis, or one over the error aimed at; zero for filters that have none
    size: int
    threads: int
    factory: object  # Factory or BoxedFactory

    @property
    def key(self):
        """Name of its rows on disk."""
        return "-".join([self.family.replace(":", "."), *([str(self.size)] if self.size else []),
                         *([f"{self.threads}threads"] if self.threads > 1 else [])])  # fmt: skip

    @property
    def series(self):
        """Family, and threads where there are two: what a curve joins."""
        return self.family if self.threads == 1 else f"{self.family}, {self.threads} threads"


def label(series):
    """A series in words."""
    family, _, threads = series.partition(", ")
    scheme = family.partition(":")[2]
    words = f"SPH filter, {scheme.replace('_', ' ')}" if scheme else FAMILIES[family][1]
    return words + (f", {threads}" if threads else "")


def short(family):
    """A family in a word or two."""
    scheme = family.partition(":")[2]
    return f"SPH, {scheme.replace('_', ' ')}" if scheme else FAMILIES[family][0]


def size_text(family, size):
    """A size in words: particles or nodes, or the error that n_particles="auto" aims at; empty for none."""
    if family == "auto":
        return f"target error {1 / size:.2g}"
    return f"N = {size:,}" if size else ""


def default_families(scenario):
    """Families that fit a scenario."""
    exact = scenario.settings.exact
    fitting = ["sph", "auto", "paper", "ekf", "ukf", "pf", "pf4"]
    if boxed.fits(scenario):
        fitting.append("grid")
    return fitting + [exact] * (exact in FAMILIES)


def methods(families, scenario, counts=None, full=False):
    """All competitors of some families on a scenario, a list of `Method`, smallest first within a family.

    `counts` are particles of the SPH and particle filters instead of the usual ones; `full` adds the
    expensive sizes. Raises `ConfigError` for an unknown family or scheme, or one that does not fit the
    scenario.
    """
    check_families(families)
    return [m for family in families for m in _family(family, scenario, counts, full)]


def _family(family, scenario, counts, full):
    """The competitors of one family; the kernels of the paper are those of 002 Tables 6, 8 and 10."""
    n, scheme = min(scenario.model.dim, 3), family.removeprefix("sph:")
    if family in ("pf", "pf4"):
        return _particle(family, scenario, counts or (_PF4 if family == "pf4" else _PF) + (10**6,) * full)
    if family == "grid":
        interval = scenario.settings.times.interval
        made = {size: boxed.Boxed(size=size, step=interval / parts) for size, parts in _GRID}
        return [Method(family, size, 1, boxed.BoxedFactory(scenario, own)) for size, own in made.items()]
    if family == "referee":
        name, made = "grid", {size: Grid(size=size) for size in _REFEREE}
    elif family == "auto":
        own = {size: FilterConfig(target_error=1.0 / size) for size in counts or _AUTO}
        name, made = "sph", {size: Sph(n_particles="auto", config=config) for size, config in own.items()}
    elif family == "paper":
        config = FilterConfig.paper(kernel="lucy" if n <= 2 else "gaussian")
        name, made = "sph", _sized(counts or _PAPER[n] + (5204,) * (full and n == 3), config)
    elif scheme in _FORCED and scheme != family:
        sizes, forced = _FORCED[scheme]
        name, made = "sph", {size: Sph(config=FilterConfig(scheme=forced(size))) for size in counts or sizes}
    elif family == "sph" or scheme != family:
        config = FilterConfig() if scheme == family else FilterConfig(scheme=scheme)
        name, made = "sph", _sized(counts or _SPH[n], config)
    else:
        name, made = family, {0: MomentFilter() if family in ("ekf", "ukf") else None}
    return [Method(family, size, 1, Factory(name, scenario, own)) for size, own in made.items()]


def _sized(sizes, config):
    return {size: Sph(n_particles=size, config=config) for size in sizes}


def _particle(family, scenario, sizes):
    made, order = [], 4 if family == "pf4" else 2
    for size in sizes:
        for threads in (1, 2) if size >= _TWO_THREADS_FROM and family == "pf4" else (1,):
            settings = Particle(n_particles=size, order=order, n_threads=threads, step=None)
            made.append(Method(family, size, threads, Factory("pf", scenario, settings)))
    return made
